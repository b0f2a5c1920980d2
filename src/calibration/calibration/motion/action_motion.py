"""Motion by an action: send the goal, hear its end, cancel it.  Answers that do not come are given up.

A server that died is invisible for 20 s and its futures never complete, so every wait has an end of its own.
"""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.node import Node

from calibration.motion.base import Done, End
from calibration.rclpy_gaps import in_executor
from calibration_core.motion.trajectory import Trajectory

ACCEPT_TIME = 2.0  # s, a driver takes to accept or reject a goal


@dataclasses.dataclass(eq=False)
class _Goal:
    """A goal on its way; `done` is called once."""

    done: Done
    sent: float
    handle: Any = None
    cancelled: bool = False
    over: bool = False


class ActionMotion:
    """A back end for any action that takes a trajectory."""

    def __init__(
        self,
        node: Node,
        action: Any,
        name: str,
        to_goal: Callable[[Trajectory], Any],
        verdict: Callable[[Any], tuple[bool, str]],
    ) -> None:
        """Listen for the action.

        Args:
            node: Whose executor carries the answers.
            action: The action's class.
            name: Its name.
            to_goal: Makes a goal of a trajectory.
            verdict: Tells from the answer (`.status`, `.result`) whether the driver calls it a success, and its words.
        """
        self._node, self._client = node, ActionClient(node, action, name)
        self._name, self._to_goal, self._verdict = name, to_goal, verdict
        self._lock = threading.Lock()
        self._goal: _Goal | None = None

    @property
    def answers(self) -> bool:
        """The driver says when a motion has ended."""
        return True

    @property
    def commands(self) -> bool:
        """The robot moves by our command."""
        return True

    @property
    def goal(self) -> bytes | None:
        """Identifier of the goal under way; None: it is not accepted yet, or over."""
        with self._lock:
            goal = self._goal
            return None if goal is None or goal.over or goal.handle is None else bytes(goal.handle.goal_id.uuid)

    def missing(self) -> str:
        """Look for the driver's action server."""
        return "" if self._client.server_is_ready() else f"no action server {self._name}"

    def move(self, trajectory: Trajectory, done: Done) -> None:
        """Send a goal."""
        goal = _Goal(done, time.monotonic())
        with self._lock:
            self._goal = goal
        message = self._to_goal(trajectory)

        def send() -> None:
            if goal.cancelled:
                self._end(goal, End.FAILURE, "stopped before it was sent")
                return
            future = self._client.send_goal_async(message)
            future.add_done_callback(lambda answer: self._on_accept(goal, answer))

        in_executor(self._node, send)

    def stop(self) -> None:
        """Cancel the goal; one that is not accepted yet, as soon as it is; one that is not sent yet never is."""
        with self._lock:
            goal = self._goal
            if goal is None or goal.over:
                return
            goal.cancelled = True
            handle = goal.handle
        if handle is not None:
            handle.cancel_goal_async()

    def tick(self, now: float) -> None:
        """Give up a goal that is neither accepted nor rejected."""
        with self._lock:
            goal = self._goal
            late = goal is not None and not goal.over and goal.handle is None and now - goal.sent > ACCEPT_TIME
        if late and goal is not None:
            goal.cancelled = True  # should it be accepted after all
            self._end(goal, End.FAILURE, f"{self._name} does not answer")

    def _on_accept(self, goal: _Goal, future: Any) -> None:
        error = future.exception()
        handle = None if error is not None else future.result()
        if handle is None or not handle.accepted:
            self._end(goal, End.FAILURE, f"{self._name} rejects the trajectory" if error is None else str(error))
            return
        with self._lock:
            goal.handle = handle
            cancelled = goal.cancelled
        if cancelled:
            handle.cancel_goal_async()
        handle.get_result_async().add_done_callback(lambda answer: self._on_result(goal, answer))

    def _on_result(self, goal: _Goal, future: Any) -> None:
        if future.exception() is not None:
            self._end(goal, End.FAILURE, str(future.exception()))
            return
        answer = future.result()
        success, text = self._verdict(answer)
        if answer.status == GoalStatus.STATUS_CANCELED and not goal.cancelled:
            self._end(goal, End.CANCELLED, text or End.CANCELLED.value)
        else:
            self._end(goal, End.SUCCESS if success else End.FAILURE, text)

    def _end(self, goal: _Goal, how: End, text: str) -> None:
        with self._lock:
            if goal.over:
                return
            goal.over = True
        goal.done(how, text)
