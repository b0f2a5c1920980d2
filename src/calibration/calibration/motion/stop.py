"""The stop of a motion, as the sequencer and as the guard command it.  No stage of it is safety-rated.

The sequencer takes one stage after the other, where the one before has not brought the robot to rest in time:

    the back end's own stop -> hold by a topic -> the maker's stop services -> tell the operator

The guard has its own way to each back end, for the case that the sequencer cannot stop its motions any more:

    follow_joint_trajectory, simulated   every goal of the action is cancelled
    joint_trajectory_topic               a trajectory of one point, where the robot comes to rest, takes its place
    external                             nothing: only the hand on the pendant stops the robot
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

from action_msgs.msg import GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_action_status_default
from trajectory_msgs.msg import JointTrajectory

from calibration.asks import Server
from calibration.motion.backends import USUAL, Backend, Course, hold
from calibration.rclpy_gaps import hidden
from calibration_core.errors import InputError, quoted
from calibration_core.motion.stop_proof import RequestedStop

STAGES = 4
PATIENCE = 0.5  # s, between two stages
DESPERATE = "the robot does not stop: press the emergency stop"
ANSWER = 1.0  # s, in which a driver acknowledges that it cancels
OVER = (GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_CANCELED, GoalStatus.STATUS_ABORTED)
Ended = Callable[[bytes, bool], None]
"""Called when a goal is over: its identifier, and whether it ended as cancelled."""


class Stopper:
    """Stops the robot by one stage after the other; every method returns at once, times are s of the steady clock."""

    def __init__(
        self,
        node: Any,
        backend: Backend,
        joints: tuple[str, ...],
        course: Course,
        *,
        hold_topic: str = "",
        calls: Sequence[tuple[Server, Any]] = (),
        trace: str = "",
    ) -> None:
        """Prepare.

        Args:
            node: Whose publishers and diagnostics are used.
            backend: Its own stop is the first stage.
            joints: Names, in the order of q.
            course: Tells where the robot is, and how it moves.
            hold_topic: Takes a hold trajectory, the second stage; empty: there is none.
            calls: Servers and requests of the maker's stop services, the third stage.
            trace: File for the monotonic clock's ns of every stage taken; empty: none.
        """
        self._node, self._backend, self._joints, self._course, self._calls = node, backend, joints, course, calls
        self._hold = node.create_publisher(JointTrajectory, hold_topic, QoSProfile(depth=1)) if hold_topic else None
        self._trace = Path(trace) if trace else None
        self._next, self._due = STAGES, math.inf

    @property
    def under_way(self) -> bool:
        """Whether a stop was begun, and the robot has not been seen to stand since."""
        return math.isfinite(self._due)

    def begin(self, now: float) -> None:
        """Take the first stage; a stop under way goes on from where it is."""
        if not self.under_way:
            self._next, self._due = 1, now + PATIENCE
        self.take(0)

    def advance(self, now: float, standing: Callable[[], bool]) -> None:
        """Take the stage that is due, if any is; the stop ends when the robot stands."""
        if not self.under_way:
            return
        if standing():
            self._due = math.inf
        elif now >= self._due and self._next < STAGES:
            self._next, self._due = self._next + 1, now + PATIENCE
            self.take(self._next - 1)

    def take(self, stage: int) -> None:
        """Take a stage, from any thread."""
        if stage == 0:
            self._backend.stop()
            self._note("stop")
        elif stage == 1 and self._hold is not None and (course := self._course()) is not None:
            self._hold.publish(hold(self._joints, *course))
            self._note("hold")
        elif stage == 2:
            for server, request in self._calls:
                server.ask(request, lambda *_: None)
                self._note("maker's stop")
        elif stage == 3:
            self._node.diagnostics.report("operator", 2, DESPERATE)
            self._node.get_logger().fatal(DESPERATE)

    def _note(self, what: str) -> None:
        now = time.monotonic_ns()  # before the file is opened, for which a disk may have to be waited
        if self._trace is not None:
            with self._trace.open("a", encoding="utf-8") as file:
                file.write(f"{now},{what}\n")


class StopPath(Protocol):
    """A way to stop the robot; methods return at once.

    Attributes:
        how: What the driver does.
        text: The same for a person, with names.
    """

    how: RequestedStop
    text: str

    def command(self, now: float) -> None:
        """Stop whatever is being followed; `now` is s of the steady clock."""

    @property
    def waiting(self) -> bool:
        """Whether the driver has yet to acknowledge a stop."""

    def unanswered(self, now: float) -> bool:
        """Tell whether a driver that has to acknowledge a stop has not done so in time."""


class CancelGoals:
    """Cancels every goal of an action."""

    how = RequestedStop.CANCEL

    def __init__(self, node: Node, action: str, ended: Ended) -> None:
        """Take the action's name, and who is told of goals that are over."""
        self.text = f"every goal of {action} is cancelled"
        self._server = Server(node, CancelGoal, hidden(action, "cancel_goal"))
        self._ended = ended
        self._since = math.inf  # of the oldest stop that is not acknowledged
        node.create_subscription(
            GoalStatusArray, hidden(action, "status"), self._on_status, qos_profile_action_status_default
        )

    def command(self, now: float) -> None:
        """Cancel; without a goal's name and a time it means all goals.  One answer is awaited, that to the last."""
        self._since = now if self.unanswered(now) else min(self._since, now)
        self._server.drop()
        self._server.ask(CancelGoal.Request(), self._on_answer)

    @property
    def waiting(self) -> bool:
        """Whether the driver has yet to acknowledge."""
        return math.isfinite(self._since)

    def unanswered(self, now: float) -> bool:
        """Tell whether the driver has not acknowledged in time."""
        return now - self._since > ANSWER

    def _on_answer(self, answer: Any, _text: str) -> None:
        if answer is not None:
            self._since = math.inf

    def _on_status(self, message: Any) -> None:
        for one in message.status_list:
            if one.status in OVER:
                self._ended(bytes(one.goal_info.goal_id.uuid), one.status == GoalStatus.STATUS_CANCELED)


class HoldPosition:
    """Sends the robot where it comes to rest on its way."""

    how = RequestedStop.HOLD
    waiting = False

    def __init__(self, node: Node, topic: str, joints: tuple[str, ...], course: Course) -> None:
        """Take the topic's name, the joints in the order of q, and what tells how the robot moves."""
        self.text = f"the position is held by {topic}"
        self._joints, self._course = joints, course
        self._publisher = node.create_publisher(JointTrajectory, topic, QoSProfile(depth=10))

    def command(self, now: float) -> None:  # noqa: ARG002  # nothing is answered
        """Hold; nothing where the position is not known."""
        course = self._course()
        if course is not None:
            self._publisher.publish(hold(self._joints, *course))

    def unanswered(self, now: float) -> bool:  # noqa: ARG002
        """Nothing is ever answered."""
        return False


class Pendant:
    """Somebody else moves the robot: nothing is commanded, and nothing can be stopped."""

    how = RequestedStop.NONE
    waiting = False
    text = f"none: {RequestedStop.NONE.value}"

    def command(self, now: float) -> None:
        """Do nothing."""

    def unanswered(self, now: float) -> bool:  # noqa: ARG002
        """Nothing is ever answered."""
        return False


def make_stop_path(
    name: str, node: Any, joints: tuple[str, ...], *, interface: str, course: Course, ended: Ended
) -> StopPath:
    """Return the stop path of a back end; `ended` is told of goals that are over, the rest as for `make_backend`.

    Raises:
        InputError: There is no such back end.
    """
    at = interface or USUAL.get(name, "")
    match name:
        case "follow_joint_trajectory" | "simulated":
            return CancelGoals(node, at, ended)
        case "joint_trajectory_topic":
            return HoldPosition(node, at, joints, course)
        case "external":
            return Pendant()
    raise InputError("parameters", "motion.backend", quoted(name), "one of the back ends")
