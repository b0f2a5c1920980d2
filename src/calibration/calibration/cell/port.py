"""What the procedure commands, carried out in the cell: loads, readings, announcements, the session's records."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from calibration_interfaces.action import ApplyLoad, Measure
from calibration_interfaces.msg import Outcome, SessionEvent

from calibration.cell.clients import Measured
from calibration.cell.reading_checks import PresentLoad, ReadingChecks, ReadingError, confirmed_readings, to_reading
from calibration.conversions import to_header, to_step, to_wrench
from calibration_core.errors import SessionGoneError
from calibration_core.measurement import messages as m
from calibration_core.measurement.load_time import LoadTime
from calibration_core.measurement.session import Session
from calibration_core.measurement.target_check import TARGETS
from calibration_core.planning.plans.plan import REFERENCE_NUMBER, placed
from calibration_core.recording.session_values import Event
from calibration_core.timeseries import NANOSECONDS, Float1D, Override

DEVICE = "the load device"
LOAD_OVERRIDE = "load"  # name under which an operator's word against the sensor stands in the session
PATIENCE = 600.0  # s of wall time, for an instrument's answer; its own timeout ends it before
SOURCE = "sequencer"
ERRORS = frozenset({m.Kind.FAULT, m.Kind.ABORTED})
AT_REFERENCE = frozenset({  # where number 0 is the reference; otherwise it says that nothing is under way
    m.Kind.REFERENCE, m.Kind.LOAD_APPLIED, m.Kind.LOAD_OVERRIDDEN, m.Kind.READING_REJECTED, m.Kind.POINT_EXCLUDED,
    m.Kind.CONFIGURATION_RETRIED, m.Kind.CONFIGURATION_SKIPPED,
})  # fmt: skip
WARNINGS = frozenset({
    m.Kind.PERMISSION_LOST, m.Kind.CONDITION_VIOLATED, m.Kind.CONFIGURATION_RETRIED, m.Kind.CONFIGURATION_SKIPPED,
    m.Kind.POINT_EXCLUDED,
})  # fmt: skip


@dataclass(frozen=True)
class Reached:
    """A load that its device reports as applied, until the sensor agrees.

    Attributes:
        command: What is wanted.
        answered: Takes whether the load is on, and why not.
        time: That it has had to come to the sensor.
        asked: Whether the operator was asked to start a silent sensor.
    """

    command: m.RequestLoad
    answered: Callable[[bool, str], None]
    time: LoadTime
    asked: bool = False


class CellPort:
    """Implements `runner.Cell`; called by the runner's thread alone.

    Attributes:
        session: Open for writing.
        confirmed: Readings on the disk.
    """

    def __init__(self, node: Any, session: Session, checks: ReadingChecks) -> None:
        """Take the sequencer with all that it has of the cell, a session that is open for writing, and the checks."""
        self._node, self.session, self._checks = node, session, checks
        self._plan = session.plan_sha256
        self._identity = session.identity
        self._unwritten: list[Callable[[], object]] = []  # while the session's files are gone
        self._attempt: int | None = None  # row of the session
        self._awaited: tuple[m.RequestLoad, Callable[[bool, str], None]] | None = None
        self._reached: Reached | None = None
        self.excluded: dict[str, str] = {}  # points of the present configuration, with by whom and why
        self._posture: int | None = None  # whose those are
        self.confirmed = 0
        done = session.completed[-1:]  # what was measured last is how the targets stand
        checks.targets.restore([one for one in session.confirmed() if one.configuration in done])

    def seconds(self) -> float:
        """Return the cell's time, s."""
        return float(self._node.now_ns() / NANOSECONDS)

    # --- loads and readings ------------------------------------------------------------------------------------------

    def apply_load(self, command: m.RequestLoad, answered: Callable[[bool, str], None]) -> None:
        """Change the load, or ask the operator to."""
        place = placed(command.configuration, command.step)
        if np.any(command.wrench):  # before anybody is asked to pull: whoever is killed now leaves a word of it
            self._checks.loading(f"{place} of {self.session.directory}")
        if not command.unknown:
            self._checks.load_begins()
        device = self._node.load_device
        if device is not None:

            def take(answer: Any, text: str) -> None:  # as every answer to a load
                outcome = None if answer is None else answer.result.outcome
                if outcome is not None and outcome.code == Outcome.OK:  # the sensor has to agree, where there is one
                    self._reached = Reached(command, answered, LoadTime(self.seconds(), time.monotonic()))
                else:
                    answered(False, text if outcome is None else str(outcome.text))

            target, timeout = to_wrench(command.wrench), self._node.value("load.timeout")
            device.ask(ApplyLoad.Goal(target=target, timeout=timeout), take, PATIENCE)
            return
        if command.unknown:
            why = self._checks.pulls() or self._checks.load_left() or "a load may be on"
            self._await(command, answered, f"{place}: {why}: see that nothing pulls, then confirm")
            return
        force = ", ".join(f"{value:.0f}" for value in command.wrench[:3])
        what = f"pull with ({force}) N" if np.any(command.wrench) else "release the load"
        self._await(command, answered, f"{place}: {what}, then confirm")

    def _await(self, command: m.RequestLoad, answered: Callable[[bool, str], None], text: str) -> None:
        """Ask a person for a load, or for its release."""
        self._awaited = (command, answered)
        self.ask(text)

    def _answer(
        self, command: m.RequestLoad, answered: Callable[[bool, str], None], who: str, *, against: bool = False
    ) -> None:
        """Tell that a load is on or released, once that is kept for the runs to come; `who` says so."""
        if not np.any(command.wrench):
            self._checks.released(who if command.unknown or against else "", against=against)
        answered(True, "")

    def load_applied(self, request: Any) -> tuple[int, str]:
        """Take the operator's word that the load is on, if the sensor agrees, or against it by override.

        Args:
            request: Of the service `LoadApplied`.

        Returns:
            Code of the outcome, and what is wrong; empty if nothing is.
        """
        operator, reason = request.operator_name.strip(), request.reason.strip()
        if not operator:
            return Outcome.INPUT_UNUSABLE, "the name of who confirms is missing"
        if request.override and not reason:
            return Outcome.INPUT_UNUSABLE, "the reason is missing: say why the load counts although the sensor differs"
        if self._awaited is None:
            return Outcome.INPUT_UNUSABLE, "no load is waited for"
        command, answered = self._awaited
        if (command.configuration, command.step) != (request.configuration, request.step):
            place = placed(command.configuration, command.step)
            return Outcome.INPUT_UNUSABLE, f"the load of {place} is waited for"
        fault = self._checks.load(command.wrench, left=command.unknown)
        if fault and not request.override:
            return Outcome.NOT_REACHED, fault
        self._awaited = None
        if fault:
            self._override_load(command, operator, f"{reason} ({fault})")
        self._answer(command, answered, operator, against=bool(fault))
        return Outcome.OK, ""

    def _override_load(self, command: m.RequestLoad, operator: str, text: str) -> None:
        """Take a load that the sensor does not find, and record who answers for it."""
        place = placed(command.configuration, command.step)
        self._checks.override(command.configuration, command.step)
        now, override = self._node.now_ns(), Override(LOAD_OVERRIDE, operator, f"{place}: {text}")
        self.keep(lambda: self.session.override(now, override))
        words = f"by {operator}: {text}"
        self.carry_out(m.Record(m.Kind.LOAD_OVERRIDDEN, command.configuration, command.step, words))

    def _look_at_load(self, now: float) -> None:
        """Answer for a load device once the sensor agrees with it, or does not in time."""
        load = self._reached
        if load is None:
            return
        of_device = load.command.unknown and self._checks.unproven  # its word is the first that is known
        fault = "" if of_device else self._checks.load(load.command.wrench, left=load.command.unknown)
        silent = self._checks.silent  # its node may live: what pulls is not known, and nothing is at odds with it
        elapsed = load.time.looked(self.seconds(), now, lost=silent or bool(self.lost(now)))
        if fault and not elapsed.over(self._node.equipment.ready):
            if silent and not load.asked:
                self.ask(fault.removesuffix(", then confirm again"))
            self._reached = replace(load, time=elapsed, asked=load.asked or silent)
            return
        self._reached = None
        says = "on" if np.any(load.command.wrench) else "released"
        if not fault:
            self._answer(load.command, load.answered, DEVICE)
        elif load.command.unknown:  # something else pulls, or the sensor has changed: a person has to look
            text = f"the load device says that the load is released; {fault}"
            self._await(load.command, load.answered, f"{text}; then confirm, or override with your name")
        else:
            load.answered(False, f"the load device says that the load is {says}; {fault}")

    def override_condition(self, message: Any) -> None:
        """Take an override by name: of a condition of the standard, or of what was found wrong with the targets."""
        self._node.conditions.override(message, self)
        if message.condition == TARGETS:
            self._checks.targets.accept()
            text = f"{TARGETS} by {message.operator_name.strip()}: {message.reason.strip()}"
            self.carry_out(m.Record(m.Kind.CONDITION_OVERRIDDEN, 0, 0, text))

    def present_load(self, wanted: Float1D) -> PresentLoad:
        """Tell what pulls now against what is wanted, (6,) N and N*m, base axes, at the wrench point."""
        awaited = self._awaited
        return self._checks.present(wanted, left=awaited is not None and awaited[0].unknown)

    def pulls(self) -> str | None:
        """Say what pulls although nothing should; empty: nothing does.  None: nobody knows now."""
        return self._checks.pulls()

    @property
    def averaged(self) -> float:
        """Share of the averaging window of the reading under way, 0 to 1; NaN: nothing is averaged."""
        return self._node.instruments.averaged

    @property
    def under_way(self) -> Measure.Feedback:
        """The point that a beam is aimed at, those that come after it, and those left out; empty where none is."""
        return self._node.instruments.under_way

    def measure(self, configuration: int, answered: Callable[[Measured], None]) -> None:
        """Average over one window, which begins no earlier than the robot was last seen to stand.

        Points that an operator has excluded stay so until the next configuration.
        """
        self._stand(configuration)
        points = [name for name in self._node.cell.points if name not in self.excluded]
        window, timeout = self._node.value("window"), self._node.value("measure_timeout")
        since = self._node.joints.until
        self._node.instruments.measure(points, window, timeout, since, PATIENCE, answered)

    def confirm(self, command: m.TakeReading, measured: Measured) -> None:
        """Put the readings of one step on the disk, then announce them.

        Raises:
            ReadingError: They are not what was planned: another posture, another load, or not recorded.
            SessionError: They are there already.
        """
        lost = self.lost(time.monotonic())
        if lost:
            raise ReadingError(lost)
        self.write()
        self.exclude(command, measured.excluded)
        self._checks.reading(command, measured)
        place = (command.configuration, command.step)
        temperature = self._node.conditions.temperature
        rows = confirmed_readings(*place, measured.points, measured.wrench, self._node.joints, temperature)
        row = self._row(command.configuration)
        self.session.record(row, rows)
        if command.configuration == REFERENCE_NUMBER:
            self.keep(lambda: self.session.end_attempt(row, completed=True))
        self.confirmed += len(rows)
        tare = 0 if measured.wrench is None else measured.wrench.tare
        for reading, mean in zip(rows, measured.points, strict=True):
            message = to_reading(
                reading, self._identity, command.attempt, self._node.cell.robot.joints, mean.frame, tare
            )
            self._node.readings.publish(message)

    def _stand(self, configuration: int) -> None:
        if configuration != self._posture:
            self._posture, self.excluded = configuration, {}

    def exclude(self, command: m.TakeReading, excluded: Mapping[str, str]) -> None:
        """Leave points out of the configuration from now on, and record by whom and why."""
        for name, why in excluded.items():
            self.excluded[name] = why
            self.carry_out(m.Record(m.Kind.POINT_EXCLUDED, command.configuration, command.step, f"{name} {why}"))

    def _row(self, configuration: int) -> int:
        if configuration == REFERENCE_NUMBER or self._attempt is None:
            return self.session.begin_attempt(configuration, self._node.now_ns())
        return self._attempt

    def _begin_attempt(self, configuration: int, now: int) -> None:
        self._attempt = self.session.begin_attempt(configuration, now)

    def _end_attempt(self, *, completed: bool, reason: str) -> None:
        if self._attempt is not None:
            self.session.end_attempt(self._attempt, completed=completed, reason=reason)
        self._attempt = None

    # --- what needs no answer ----------------------------------------------------------------------------------------

    def carry_out(self, command: m.Command) -> None:
        """Announce or store it."""
        now = self._node.now_ns()
        match command:
            case m.Mark():
                self._node.steps.publish(to_step(now, command.configuration, command.step, command.phase))
            case m.BeginAttempt():
                self._checks.begin()
                self._stand(command.configuration)
                self.keep(lambda: self._begin_attempt(command.configuration, now))
            case m.EndAttempt():
                self.keep(lambda: self._end_attempt(completed=command.completed, reason=command.reason))
            case m.AskOperator():
                self.ask(command.text)
            case m.Record():
                self._announce_event(command, now)

    def _announce_event(self, record: m.Record, now: int) -> None:
        place = {"configuration": record.configuration, "step": record.step}
        words = {"source": SOURCE, "text": record.text, "plan_sha256": self._plan}
        self._node.events.publish(SessionEvent(header=to_header(now), kind=int(record.kind), **place, **words))
        text = logged(record)
        event = Event(now, record.kind.name.lower(), f"{record.configuration}.{record.step} {record.text}")
        self.keep(lambda: self.session.note(event))
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

    def keep(self, work: Callable[[], object]) -> None:
        """Write to the session; where its files are gone the run is paused, and it is written once they are back."""
        self._unwritten.append(work)
        with contextlib.suppress(SessionGoneError):  # told as what is lost
            self.write()

    def write(self) -> None:
        """Write what could not be written before.

        Raises:
            SessionError: It still cannot be.
        """
        while self._unwritten:
            self._unwritten[0]()
            self._unwritten.pop(0)

    # --- stopping, and requests without an answer --------------------------------------------------------------------

    def scaling(self) -> float:
        """Return the share of the programmed speed at which the controller moves; NaN: not known."""
        return float(self._node.conditions.scaling)

    def progress(self) -> None:
        """Tell how far it is."""
        self._node.progress()

    def ready(self, since: float) -> bool:
        """Tell whether all that a reading needs has given a sign of life since then, s of the steady clock."""
        return bool(self._node.equipment.ready(since))

    def recorded(self, since: float) -> bool:
        """Tell whether the recorder has."""
        return bool(self._node.equipment.recorded(since))

    def lost(self, now: float) -> str:
        """Say which recorder or instrument has fallen silent, or that the session's files are gone; else empty."""
        return "; ".join(filter(None, [str(self._node.equipment.fault(now)), self.session.fault()]))

    def look(self, now: float) -> None:
        """Give up requests that are not answered; bring a recorder that is closed back to the bag."""
        self._node.equipment.tick(now)
        self._look_at_load(now)
        for server in self._node.servers:
            server.tick(now)


def logged(record: m.Record) -> str:
    """Return the line of the log for what happened."""
    somewhere = record.configuration != REFERENCE_NUMBER or record.kind in AT_REFERENCE
    where = placed(record.configuration, record.step) if somewhere else ""
    return ": ".join(filter(None, [record.kind.name.lower().replace("_", " "), where, record.text]))
