"""What whoever asked for a plan hears while it is measured: where it stands, and what the readings determine so far."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from calibration_interfaces.action import RunPlan
from calibration_interfaces.msg import MeasurementProgress, ProcedureState
from geometry_msgs.msg import Wrench

from calibration.cell.reading_checks import PresentLoad
from calibration.conversions import to_header, to_wrench
from calibration.evaluation.worker import CancelledError, Worker
from calibration.topics import PROCEDURE, PROGRESS
from calibration_core.measurement import messages as m
from calibration_core.measurement.sequence import Sequence
from calibration_core.measurement.snapshot import Snapshot
from calibration_core.timeseries import Float1D

NICENESS = 10


class Advisor:
    """Answers after every configuration, the newest request first; one at a time."""

    def __init__(self, report: Callable[[dict[str, Any]], None], complain: Callable[[str], None]) -> None:
        """Start the process.

        Args:
            report: Called with every answer, see `commands.progress.progress_record`, in a thread of its own.
            complain: Called with why there is none.
        """
        self._report, self._complain = report, complain
        self._worker = Worker(niceness=NICENESS)
        self._wanted: dict[str, Any] | None = None
        self._lock = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="advisor", daemon=True)
        self._thread.start()

    def ask(self, session: str, cell: str, wanted: float) -> None:
        """Ask what its readings determine; an older question that was not answered yet is dropped."""
        with self._lock:
            self._wanted = {"session": session, "cell": cell, "wanted": wanted}
            self._lock.notify()

    def _run(self) -> None:
        while True:
            with self._lock:
                self._lock.wait_for(lambda: self._wanted is not None or self._closing)
                question, self._wanted = self._wanted, None
            if self._closing or question is None:
                return
            try:
                answer = self._worker.ask(question, lambda: self._closing)
            except CancelledError:
                return
            except RuntimeError as error:
                self._complain(str(error))
                continue
            if answer["kind"]:
                self._complain(answer["trace"] or answer["text"])
            elif answer["progress"] is not None:
                self._report(answer["progress"])

    def close(self) -> None:
        """End the process; what is being worked out is given up."""
        with self._lock:
            self._closing = True
            self._lock.notify()
        self._thread.join(2.0)
        self._worker.close()


PERIOD = 0.5  # s of wall time between two feedbacks
STILL = 1.0  # s of wall time between two messages that tell nothing new
LIVE = 0.2  # s, likewise, while a load is being changed or a reading is taken: both are watched
STATES = {
    m.RunState.IDLE: ProcedureState.PREPARING,
    m.RunState.READY: ProcedureState.READY,
    m.RunState.MOVING: ProcedureState.MOVING,
    m.RunState.LOADING: ProcedureState.LOADING,
    m.RunState.SETTLING: ProcedureState.SETTLING,
    m.RunState.READING: ProcedureState.READING,
    m.RunState.UNLOADING: ProcedureState.UNLOADING,
    m.RunState.FINISHED: ProcedureState.FINISHED,
}


class ProcedureReport:
    """Tells what the sequencer does."""

    def __init__(self, node: Any) -> None:
        """Offer the topic; no plan is being measured yet."""
        self._node = node
        self._publisher = node.create_publisher(PROCEDURE.message, PROCEDURE.relative, PROCEDURE.qos)
        self._reported_state: tuple[Snapshot, bool] | None = None
        self._sent = -math.inf
        self._message = ProcedureState(text="no plan is being measured", seconds_left=math.nan)
        self._message.band_force = self._message.band_angle = self._message.averaged = math.nan
        self._send()

    def preparing(self, plan: str, session: str, recording: str) -> None:
        """Tell that a goal was accepted."""
        self._message = self._fresh(ProcedureState.PREPARING, "looking for what the run needs")
        self._message.plan, self._message.session, self._message.recording = plan, session, recording
        self._message.waits_for = ProcedureState.NODES
        self._message.waiting = "the cell's nodes and drivers"
        self._send()

    def ended(self, text: str) -> None:
        """Tell that a run is over, and how."""
        self._message.state, self._message.text = ProcedureState.FINISHED, text
        self._message.waits_for, self._message.waiting, self._message.question = ProcedureState.NOBODY, "", ""
        self._message.moving = self._message.paused = self._message.held = self._message.load_awaited = False
        self._message.averaged, self._message.seconds_left = math.nan, 0.0
        self._message.goal = []
        self._send()

    def publish(
        self, sequence: Sequence, present: Callable[[Float1D], PresentLoad], port: Any, *, moving: bool
    ) -> None:
        """Tell how a run stands; nothing is sent if that is no news.

        Args:
            sequence: The procedure.
            present: Tells what pulls now, given what is wanted.
            port: Tells how far the reading under way is, and which points are measured, left and excluded.
            moving: Whether a motion is under way.
        """
        now = sequence.snapshot()
        reading = now.state is m.RunState.READING
        period = LIVE if now.load_awaited or reading else STILL
        if (now, moving) == self._reported_state and time.monotonic() - self._sent < period:
            return
        self._reported_state = (now, moving)
        old, target = self._message, np.array(now.target)
        new = self._fresh(STATES[now.state], now.text)
        new.plan, new.session, new.recording = old.plan, old.session, old.recording
        new.waits_for, new.waiting, new.question = int(now.waits_for), now.waiting, now.question
        new.paused, new.held, new.moving = now.paused, now.held, moving
        new.readings, new.kind, new.phase_name = now.readings, now.item, now.phase_name
        new.configuration, new.step, new.phase = now.configuration, now.step, int(now.phase)
        new.attempt, new.steps = now.attempt, now.steps
        new.configurations_done, new.configurations_skipped = now.done, now.given_up
        new.configurations_total = now.total
        new.share_done, new.seconds_left = float(sequence.queue.share_done), float(sequence.seconds_left)
        new.load_awaited, new.target = now.load_awaited, to_wrench(target)
        size = float(np.linalg.norm(target[:3]))
        new.direction = target[:3] / size if size > 0.0 else np.zeros(3)
        if reading:
            aimed = port.under_way
            new.averaged, new.point, new.points_left = port.averaged, aimed.point, aimed.left
            new.points_excluded = list(dict.fromkeys([*port.excluded, *aimed.excluded]))
        else:
            new.points_excluded = list(port.excluded)
        load = present(target)
        new.band_force, new.band_angle = load.band_force, load.band_angle
        new.load_felt_known, new.load_fault = load.felt is not None, load.fault if now.load_awaited else ""
        new.load_felt = to_wrench(np.zeros(6) if load.felt is None else load.felt)
        new.goal = list(now.goal)
        new.reading_verdict, new.reading_text = int(now.reading.verdict), now.reading.text
        new.reading_configuration, new.reading_step = now.reading.configuration, now.reading.step
        self._message = new
        self._send()

    def _fresh(self, state: int, text: str) -> ProcedureState:
        message = ProcedureState(state=state, text=text, seconds_left=math.nan, target=Wrench())
        message.band_force = message.band_angle = message.averaged = math.nan
        message.joints = list(self._node.cell.robot.joints)
        return message

    def _send(self) -> None:
        self._message.header = to_header(self._node.now_ns())
        self._sent = time.monotonic()
        self._publisher.publish(self._message)


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
        self._report.publish(runner.sequence, port.present_load, port, moving=runner.moving)
        if time.monotonic() - self._reported < PERIOD:
            return
        self._reported = time.monotonic()
        sequence, stands = runner.sequence, runner.sequence.snapshot()
        goal.publish_feedback(
            RunPlan.Feedback(
                configuration=stands.configuration,
                step=stands.step,
                phase=int(stands.phase),
                share_done=float(sequence.queue.share_done),
                seconds_left=float(sequence.seconds_left),
                text=stands.text,
            )
        )

    def close(self) -> None:
        """End the process."""
        if self._advisor is not None:
            self._advisor.close()
