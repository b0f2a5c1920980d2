"""Targets measured one after the other by a tracker with one beam: aim, measure, and believe only what can be."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable, Sequence

import numpy as np
from calibration_interfaces.msg import Outcome

from calibration.conversions import Mean, Sample
from calibration.instruments.acquisition import MeasuringError
from calibration.instruments.drivers import Driver, DriverError, Seen, Wait
from calibration.instruments.stream import Stream
from calibration.motion.arrival import Joints
from calibration_core.measurement.aim import Aim
from calibration_core.observations.average import Average, average
from calibration_core.observations.window import settled_from
from calibration_core.timeseries import Float1D

Report = Callable[[float, str], None]
"""Gets the share done and what is under way, for a person."""


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

    @property
    def awaited(self) -> str:
        """What is missing while it waits, for a person."""
        return self._awaited or f"{self._name}: {self._driver.awaited}"

    def measure(
        self, streams: Sequence[Stream], window: float, since: int, turn: Callable[[], Wait], report: Report
    ) -> tuple[list[Mean], list[tuple[Stream, Sample]]]:
        """Measure targets one after the other; nothing of it counts where one of them cannot be.

        Args:
            streams: Of the targets; their checks are applied.
            window: s, that each is measured at least.
            since: ns, before which nothing is measured.
            turn: Begins the time that one target may take.
            report: Gets which target is under way, and which are left.

        Returns:
            A mean per target, and the samples behind them.

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
            tried, means, samples = self._aim.copy(), [], []
            for k, stream in enumerate(streams):
                left = ", ".join(one.name for one in streams[k + 1 :])
                report(k / len(streams), f"measuring {stream.name}" + (f", then {left}" if left else ""))
                mean, taken = self._one(tried, stream, window, turn())
                means.append(mean)
                samples += [(stream, sample) for sample in taken]
            self._aim = tried
            return means, samples
        finally:
            self._lock.release()

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


def _mean(seen: Sequence[Seen], scatter: Average) -> Average:
    """Return a mean with the larger of what its samples scatter and what the tracker states of them."""
    stated = [one.covariance for one in seen if one.covariance is not None]
    claim = np.sum(stated, axis=0) / len(stated) / len(seen) if stated else np.zeros((3, 3))
    return dataclasses.replace(scatter, covariance=max(scatter.covariance, claim, key=np.trace))
