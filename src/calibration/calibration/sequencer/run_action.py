"""The action `~/run` of the sequencer: what may be asked for, one run at a time, and how it ended."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from calibration_interfaces.action import RunPlan
from calibration_interfaces.msg import Outcome, SessionEvent
from rclpy.action import CancelResponse, GoalResponse

from calibration.background import Background
from calibration.conversions import to_header, to_outcome
from calibration.sequencer.admission import refusal
from calibration_core.errors import InputError
from calibration_core.measurement import messages as m

NAME = "~/run"
BUSY = "a plan is being measured"


class RunAction:
    """Takes goals, has them measured, and tells their ends."""

    def __init__(
        self, node: Any, measure: Callable[[Any], Any], stop: Callable[[], None], against: Callable[[], str]
    ) -> None:
        """Offer the action.

        Args:
            node: The sequencer: its run (`runner`, `port`), `feedback`, `events`, `cell` and diagnostics.
            measure: Measures the plan of a goal, in a thread of its own; returns the result.
            stop: Stops the robot.
            against: Says what speaks against any run now; empty: nothing.
        """
        self._node, self._measure, self._stop, self._against = node, measure, stop, against
        self._ended = threading.Event()
        self._ended.set()
        node.create_action_server(
            RunPlan, NAME, self._on_run, goal_callback=self._on_goal, cancel_callback=self._on_cancel
        )

    @property
    def busy(self) -> str:
        """Say that a plan is being measured; empty: none is."""
        return "" if self._ended.is_set() else BUSY

    def wait(self, seconds: float) -> bool:
        """Wait for the end of a run; return whether it has ended."""
        return self._ended.wait(seconds)

    def _on_goal(self, request: Any) -> GoalResponse:
        """Reject what cannot be begun; as a rejected goal carries no words, they are told otherwise."""
        node = self._node
        why = self._against() or self.busy or refusal(request, node.cell)
        if not why:
            return GoalResponse.ACCEPT
        node.get_logger().error(f"the goal is rejected: {why}")
        node.diagnostics.report("run", 1, f"the goal is rejected: {why}")
        header = to_header(node.now_ns())
        node.events.publish(SessionEvent(header=header, kind=SessionEvent.REJECTED, source="sequencer", text=why))
        return GoalResponse.REJECT

    def _on_cancel(self, _goal: Any) -> CancelResponse:
        runner = self._node.runner
        if runner is not None:
            runner.post(m.Stop(0.0))
        return CancelResponse.ACCEPT

    async def _on_run(self, goal: Any) -> Any:
        node = self._node
        if self.busy:
            goal.abort()
            return RunPlan.Result(outcome=to_outcome(Outcome.BUSY, BUSY))
        self._ended.clear()
        node.feedback.prepare(goal.request)
        result = RunPlan.Result()
        try:
            result = await Background(node, lambda: self._measure(goal))
        except InputError as error:  # once a run is under way, it is the disk that cannot be used any more
            self._stop()
            result.outcome = to_outcome(Outcome.INPUT_UNUSABLE if node.runner is None else Outcome.FAULT, str(error))
        except Exception as error:  # noqa: BLE001  # a defect of ours: it must reach whoever asked
            node.get_logger().error(f"{type(error).__name__}: {error}")
            self._stop()
            result.outcome = to_outcome(Outcome.INTERNAL, f"{type(error).__name__}: {error}")
        # Not in a `finally`: a coroutine that the ending process closes must not publish, its publishers are gone.
        node.runner = node.port = None
        node.feedback.end(str(result.outcome.text))
        self._ended.set()
        if goal.is_cancel_requested:
            result.outcome.code = Outcome.CANCELLED
            goal.canceled()
        elif result.outcome.code == Outcome.OK:
            goal.succeed()
        else:
            goal.abort()
        return result
