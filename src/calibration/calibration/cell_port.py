"""What the procedure commands, carried out in the cell: loads, readings, announcements, the session's records."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from calibration_interfaces.msg import SessionEvent
from rclpy.node import Node

from calibration.clients import Instruments, LoadDevice, Measured
from calibration.conversions import to_header, to_step
from calibration.motion.arrival import Joints
from calibration.readings import confirmed_readings, to_reading
from calibration_core.procedure import messages as m
from calibration_core.procedure.plan import REFERENCE_NUMBER
from calibration_core.procedure.session import Session
from calibration_core.recording.session_values import Decision, Event
from calibration_core.timeseries import NANOSECONDS

PATIENCE = 600.0  # s of wall time, for an instrument's answer; its own timeout ends it before
SOURCE = "sequencer"
ERRORS = frozenset({m.Kind.FAULT, m.Kind.ABORTED})
WARNINGS = frozenset({
    m.Kind.PERMISSION_LOST, m.Kind.CONDITION_VIOLATED, m.Kind.CONFIGURATION_RETRIED, m.Kind.CONFIGURATION_SKIPPED,
})  # fmt: skip


class CellPort:
    """Implements `runner.Cell`; called by the runner's thread alone, but for `load_applied`.

    Attributes:
        session: Open for writing.
        confirmed: Readings on the disk.
    """

    def __init__(
        self,
        node: Any,
        session: Session,
        joints: Joints,
        instruments: Instruments,
        load_device: LoadDevice | None,
        *,
        temperature: Callable[[], float],
        progress: Callable[[], None],
        scaling: Callable[[], float],
    ) -> None:
        """Take what the cell is made of.

        Args:
            node: The sequencer: its clock, parameters and publishers.
            session: Open for writing.
            joints: The joint states.
            instruments: Tracker and force/torque sensor.
            load_device: None: an operator changes the load.
            temperature: Returns the last temperature, degrees Celsius, or NaN.
            progress: Tells how far it is.
            scaling: Returns the controller's speed scaling, or NaN.
        """
        self._node, self.session, self._joints = node, session, joints
        self._instruments, self._load_device = instruments, load_device
        self._temperature, self.progress, self.scaling = temperature, progress, scaling
        self._plan = session.plan_sha256
        self._attempt: tuple[int, int, int] | None = None  # row of the session, configuration, count
        self._awaited: tuple[m.RequestLoad, Callable[[bool, str], None]] | None = None
        self.confirmed = 0

    def seconds(self) -> float:
        """Return the cell's time, s."""
        return float(self._node.now_ns() / NANOSECONDS)

    # --- loads and readings ------------------------------------------------------------------------------------------

    def apply_load(self, command: m.RequestLoad, answered: Callable[[bool, str], None]) -> None:
        """Change the load, or ask the operator to."""
        if self._load_device is not None:
            self._load_device.apply(command.wrench, self._node.value("load.timeout"), PATIENCE, answered)
            return
        self._awaited = (command, answered)
        force = ", ".join(f"{value:.0f}" for value in command.wrench[:3])
        self.ask(f"configuration {command.configuration}, step {command.step}: pull with ({force}) N, then confirm")

    def load_applied(self, configuration: int, step: int) -> str:
        """Take the operator's word that the load is on; return what is wrong with it, empty if nothing is."""
        if self._awaited is None:
            return "no load is waited for"
        command, answered = self._awaited
        if (command.configuration, command.step) != (configuration, step):
            return f"the load of configuration {command.configuration}, step {command.step} is waited for"
        self._awaited = None
        answered(True, "")
        return ""

    def measure(self, answered: Callable[[Measured], None]) -> None:
        """Average over one window."""
        value = self._node.value
        self._instruments.measure(
            self._node.cell.points, value("window"), value("measure_timeout"), value("min_samples"), PATIENCE, answered
        )

    def confirm(self, command: m.TakeReading, measured: Measured) -> None:
        """Put the readings of one step on the disk, then announce them.

        Raises:
            ReadingError: No joint states came while it was measured.
            SessionError: They are there already.
        """
        place = (command.configuration, command.step)
        temperature = self._temperature()
        rows = confirmed_readings(*place, measured.points, measured.wrench, self._joints, temperature)
        row = self._row(command.configuration)
        self.session.record(row, rows)
        if command.configuration == REFERENCE_NUMBER:
            self.session.end_attempt(row, completed=True)
        self.confirmed += len(rows)
        tare = 0 if measured.wrench is None else measured.wrench.tare
        for reading, mean in zip(rows, measured.points, strict=True):
            message = to_reading(reading, command.attempt, self._node.cell.robot.joints, mean.frame, tare)
            self._node.readings.publish(message)

    def _row(self, configuration: int) -> int:
        if configuration == REFERENCE_NUMBER or self._attempt is None:
            return self.session.begin_attempt(configuration, self._node.now_ns())
        return self._attempt[0]

    # --- what needs no answer ----------------------------------------------------------------------------------------

    def carry_out(self, command: m.Command) -> None:
        """Announce or store it."""
        now = self._node.now_ns()
        match command:
            case m.Mark():
                self._node.steps.publish(to_step(now, command.configuration, command.step, command.phase))
            case m.BeginAttempt():
                row = self.session.begin_attempt(command.configuration, now)
                self._attempt = (row, command.configuration, command.attempt)
            case m.EndAttempt():
                if self._attempt is not None:
                    self.session.end_attempt(self._attempt[0], completed=command.completed, reason=command.reason)
                self._attempt = None
            case m.AskOperator():
                self.ask(command.text)
            case m.Record():
                self._tell(command, now)

    def _tell(self, record: m.Record, now: int) -> None:
        place = {"configuration": record.configuration, "step": record.step}
        words = {"source": SOURCE, "text": record.text, "plan_sha256": self._plan}
        self._node.events.publish(SessionEvent(header=to_header(now), kind=int(record.kind), **place, **words))
        text = f"{record.kind.name.lower()} {record.configuration}.{record.step} {record.text}".rstrip()
        self.session.note(Event(now, record.kind.name.lower(), f"{record.configuration}.{record.step} {record.text}"))
        if record.kind in ERRORS:
            self._node.get_logger().error(text)
        elif record.kind in WARNINGS:
            self._node.get_logger().warning(text)
        else:
            self._node.get_logger().info(text)
        if record.kind is m.Kind.CONFIGURATION_DONE:
            self._node.feedback.configuration_done(str(self.session.directory))

    def ask(self, text: str) -> None:
        """Show the operator what is needed."""
        self._node.diagnostics.report("operator", 1, text)
        self._node.get_logger().warning(text)

    def decided(self, decision: Decision) -> None:
        """Store a change of the guard's mind."""
        self.session.decide(decision)

    # --- stopping, and requests without an answer --------------------------------------------------------------------

    def stop_rung(self, rung: int) -> None:
        """Take a rung of the stop ladder."""
        self._node.stopper.take(rung)

    def look(self, now: float) -> None:
        """Give up requests that are not answered."""
        self._instruments.tick(now)
        if self._load_device is not None:
            self._load_device.port.tick(now)


def call_and_wait(node: Node, client: Any, request: Any, timeout: float) -> Any:
    """Call a service from a thread that is not the executor's; return its answer, None if none comes in time."""
    if not client.wait_for_service(timeout):
        return None
    future = client.call_async(request)
    end = time.monotonic() + timeout
    while not future.done() and time.monotonic() < end and node.context.ok():
        time.sleep(0.005)
    if not future.done():
        client.remove_pending_request(future)
        return None
    return future.result()
