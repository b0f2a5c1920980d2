"""What whoever asked for a plan hears while it is measured: where it stands, and what the readings determine so far."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

from calibration_interfaces.action import RunPlan
from calibration_interfaces.msg import MeasurementProgress

from calibration.conversions import to_header
from calibration.sequencer.advisor import Advisor
from calibration.sequencer.parameters import DEVICE
from calibration.status.procedure import ProcedureReport
from calibration.topics import PROGRESS
from calibration_core.measurement import messages as m
from calibration_core.timeseries import Phase

PERIOD = 0.5  # s of wall time between two feedbacks


class Feedback:
    """Feedback of the run that is under way, and the topic of progress."""

    def __init__(self, node: Any, *, advise: bool) -> None:
        """Offer the topic; start the process that works progress out, if it is wanted."""
        self._node = node
        self._publisher = node.create_publisher(PROGRESS.message, PROGRESS.relative, PROGRESS.qos)
        self._advisor = Advisor(self._on_progress, self._complain) if advise else None
        self._reported = -math.inf
        self._goal: Any = None
        self._runner: Any = None
        self._report = ProcedureReport(node)

    def prepare(self, request: Any) -> None:
        """Tell that a goal was accepted, and what it asks for."""
        self._report.preparing(str(request.plan), str(request.session), str(Path(request.session) / "bag"))

    def begin(self, goal: Any, runner: Any) -> None:
        """Take the goal and the runner of a run."""
        runner.observer.by_device = self._node.value("load.by") == DEVICE
        self._goal, self._runner = goal, runner

    def end(self, text: str) -> None:
        """Forget the run; tell how it ended."""
        self._goal = self._runner = None
        self._report.ended(text)

    def configuration_done(self, session: str) -> None:
        """Have it worked out what its readings determine; returns at once."""
        goal = self._goal
        if self._advisor is not None and goal is not None:
            self._advisor.ask(session, str(self._node.cell.path), float(goal.request.wanted_accuracy))

    def _on_progress(self, found: dict[str, Any]) -> None:
        message = MeasurementProgress(header=to_header(self._node.now_ns()), **found)
        self._publisher.publish(message)
        say = self._node.get_logger().warning if message.suspicious else self._node.get_logger().info
        say(f"after configuration {message.configuration}: {message.text}")
        self._node.diagnostics.report("progress", int(message.suspicious), message.text)
        goal, runner = self._goal, self._runner
        if goal is not None and runner is not None and message.enough and goal.request.stop_when_enough:
            runner.post(m.Enough(0.0, message.text))

    def _complain(self, text: str) -> None:
        self._node.get_logger().error(f"no progress can be worked out: {text}")
        self._node.diagnostics.report("progress", 2, text.strip().splitlines()[-1] if text.strip() else "no words")

    def send(self) -> None:
        """Tell every change, and send the feedback now and then."""
        goal, runner, port = self._goal, self._runner, self._node.port
        if runner is None or goal is None or port is None:
            return
        self._report.publish(runner.sequence, runner.observer, port.present_load, port.averaged, moving=runner.moving)
        if time.monotonic() - self._reported < PERIOD:
            return
        self._reported = time.monotonic()
        sequence = runner.sequence
        configuration, step, phase = sequence.position or (0, 0, Phase.MOVING)
        goal.publish_feedback(
            RunPlan.Feedback(
                configuration=configuration,
                step=step,
                phase=int(phase),
                share_done=float(sequence.queue.share_done),
                seconds_left=float(sequence.seconds_left),
                text=runner.observer.text,
            )
        )

    def close(self) -> None:
        """End the process."""
        if self._advisor is not None:
            self._advisor.close()
