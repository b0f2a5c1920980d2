"""Targets measured one after the other by a tracker with one beam: aim, measure, and believe only what can be."""

from __future__ import annotations

import contextlib
import dataclasses
import threading
from collections.abc import Callable, Sequence

import numpy as np
from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import PointRequest

from calibration.conversions import Mean, Sample
from calibration.instruments.acquisition import MeasuringError
from calibration.instruments.drivers import Driver, DriverError, Seen, Wait
from calibration.instruments.stream import Stream
from calibration.motion.arrival import Joints
from calibration_core.measurement.aim import Aim
from calibration_core.observations.average import Average, average
from calibration_core.observations.window import settled_from
from calibration_core.timeseries import Float1D

IDLE = "no point is being measured one after the other"
Report = Callable[[float, str], None]
"""Gets the share done and what is under way, for a person."""


class _OtherwiseError(Exception):
    """The operator wants something else than what is being measured."""


@dataclasses.dataclass(eq=False)
class _Turns:
    """Targets of one request: measured, left (the first is being measured), and excluded, with by whom and why."""

    left: list[str]
    excluded: dict[str, str]
    means: dict[str, tuple[Mean, list[Sample]]] = dataclasses.field(default_factory=dict)
    changed: bool = False  # the one that is being measured is another one now, or begins again


class OneBeam:
    """One tracker, and what is known of where it looks."""

    def __init__(self, aim: Aim, driver: Driver, joints: Joints, tolerance: float, frame: str) -> None:
        """Take what it works with.

        Args:
            aim: Where the targets are.
            driver: The tracker.
            joints: The joint states.
            tolerance: m, change over a window that does not matter.
            frame: Name of the tracker's frame.
        """
        self._aim, self._driver, self._joints = aim, driver, joints
        self._tolerance, self._frame = np.full(3, tolerance), frame
        self._lock = threading.Lock()  # there is one beam
        self._name = self._awaited = ""
        self._turns: _Turns | None = None  # while targets are measured
        self._asking = threading.Lock()  # they change by one thread at a time

    @property
    def awaited(self) -> str:
        """What is missing while it waits, for a person."""
        return self._awaited or f"{self._name}: {self._driver.awaited}"

    def measure(
        self,
        streams: Sequence[Stream],
        window: float,
        since: int,
        turn: Callable[[], Wait],
        report: Report,
        excluded: dict[str, str] | None = None,
    ) -> tuple[list[Mean], list[tuple[Stream, Sample]]]:
        """Measure targets one after the other; nothing of it counts where one of them cannot be.

        Args:
            streams: Of the targets; their checks are applied.
            window: s, that each is measured at least.
            since: ns, before which nothing is measured.
            turn: Begins the time that one target may take.
            report: Gets which target is under way, and which are left.
            excluded: Gets targets that the operator leaves out, with by whom and why.

        Returns:
            A mean per target that is not excluded, in the order of `streams`, and the samples behind them.

        Raises:
            MeasuringError: A target was not found, not measured, or cannot be where it was found.
        """
        wait = turn()
        self._awaited = "another request is measured"
        while not self._lock.acquire(blocking=False):
            wait()
        try:
            self._awaited = "the node's clock is behind the robot's"
            while wait() < since:
                pass
            tried, named = self._aim.copy(), {stream.name: stream for stream in streams}
            turns = self._turns = _Turns(list(named), {} if excluded is None else excluded)
            while turns.left:
                name = turns.left[0]
                report(len(turns.means) / len(streams), f"measuring {name}" + after(turns.left[1:]))
                with contextlib.suppress(_OtherwiseError):
                    measured = self._one(tried, named[name], window, self._unless_changed(turns, turn()))
                    with self._asking:
                        if not turns.changed:
                            turns.means[turns.left.pop(0)] = measured
                turns.changed = False
            self._aim = tried
            taken = [(stream, *turns.means[stream.name]) for stream in streams if stream.name in turns.means]
            samples = [(stream, sample) for stream, _, of_stream in taken for sample in of_stream]
            return [mean for _, mean, _ in taken], samples
        finally:
            self._turns = None
            self._lock.release()

    @property
    def under_way(self) -> tuple[str, list[str]]:
        """The target that is being measured, and those that come after it."""
        turns = self._turns
        left = [] if turns is None else list(turns.left)
        return (left[0], left[1:]) if left else ("", [])

    def ask(self, what: int, point: str, why: str) -> str:
        """Take what the operator wants of a target; return why it cannot be, empty: it is done.

        Args:
            what: SKIP, REPEAT or EXCLUDE of `PointRequest`.
            point: The target; empty: the one that is being measured.
            why: By whom it is excluded, and why.
        """
        with self._asking:
            turns = self._turns
            if turns is None or not turns.left:
                return IDLE
            first, name = turns.left[0], point or turns.left[0]
            if name not in turns.left and name not in turns.means:
                return f"{name} is not measured in this reading"
            if what == PointRequest.Request.SKIP and (name not in turns.left or turns.left == [name]):
                return f"{name} is measured already" if name in turns.means else f"{name} is the last one that is left"
            if what == PointRequest.Request.EXCLUDE and len(turns.left) + len(turns.means) == 1:
                return f"{name} is the last point of this reading: leave the configuration out instead"
            turns.means.pop(name, None)
            others = [one for one in turns.left if one != name]
            turns.left = {PointRequest.Request.SKIP: [*others, name], PointRequest.Request.REPEAT: [name, *others]}.get(
                what, others
            )
            if what == PointRequest.Request.EXCLUDE:
                turns.excluded[name] = why
            turns.changed |= turns.left[:1] != [first] or name == first
            return ""

    @staticmethod
    def _unless_changed(turns: _Turns, wait: Wait) -> Wait:
        def look() -> int:
            if turns.changed:
                raise _OtherwiseError
            return wait()

        return look

    def close(self) -> None:
        """Give back what the driver holds."""
        self._driver.close()

    def _one(self, aim: Aim, stream: Stream, window: float, wait: Wait) -> tuple[Mean, list[Sample]]:
        self._name = name = stream.name
        q = self._posture(name, wait)
        what = "aiming"
        try:
            self._driver.aim(name, aim.place(name, q), wait)
            what = "measuring"
            seen = self._driver.measure(window, wait)
        except DriverError as error:
            raise MeasuringError(Outcome.FAULT, f"{what} at {name} failed: {error}") from error
        samples = [Sample((one.begin + one.end) // 2, self._frame, one.place) for one in seen]
        for sample in samples:
            if not stream.take(sample, sample.stamp):
                problem = stream.check.problem.name.lower().replace("_", " ")
                text = f"{name} was measured at {np.round(sample.values, 6).tolist()} m: {problem}"
                raise MeasuringError(Outcome.FAULT, text)
        values = np.array([sample.values for sample in samples])
        if settled_from(np.array([sample.stamp for sample in samples]), values, self._tolerance) != 0:
            raise MeasuringError(Outcome.NOT_SETTLED, f"{name}: moves while it is measured")
        mean = _mean(seen, average(values))
        if fault := aim.fault(name, q, mean.mean):
            raise MeasuringError(Outcome.FAULT, f"{fault}: look at beam and targets, and at frames.tracker")
        aim.keep(name, q, mean.mean)
        return Mean(name, self._frame, seen[0].begin, seen[-1].end, mean), samples

    def _posture(self, name: str, wait: Wait) -> Float1D:
        """Return the joint angles (n,) rad of now, from joint states that came since it was asked."""
        self._awaited, before = f"no joint states come, and {name} cannot be aimed at", self._joints.until
        while self._joints.until == before:
            wait()
        self._awaited = ""
        latest = self._joints.latest
        if latest is None or self._joints.moving():
            raise MeasuringError(Outcome.NOT_SETTLED, f"{name}: the robot moves")
        return latest


def after(left: Sequence[str]) -> str:
    """Return in words what comes after a target."""
    return f", then {', '.join(left)}" if left else ""


def _mean(seen: Sequence[Seen], scatter: Average) -> Average:
    """Return a mean with the larger of what its samples scatter and what the tracker states of them."""
    stated = [one.covariance for one in seen if one.covariance is not None]
    claim = np.sum(stated, axis=0) / len(stated) / len(seen) if stated else np.zeros((3, 3))
    return dataclasses.replace(scatter, covariance=max(scatter.covariance, claim, key=np.trace))
