"""Checks of the samples of one stream, one after another, as they arrive.

What is rejected must not be measured with; a gap rejects nothing, but no average may reach across a break, which is
what counts as a gap in a recording.  The checks know
nothing of where samples come from: they take numbers and give a verdict.
"""

from __future__ import annotations

import collections
import dataclasses
import enum
import math

import numpy as np

from calibration_core.recording.bags.streams import GAP_FACTOR, GAP_SECONDS
from calibration_core.timeseries import NANOSECONDS, Float1D

LEARNING = 10  # intervals from which the usual one is known
REMEMBERED = 101
BACK_SECONDS, BACK_SAMPLES = 1.0, 3  # so many samples in order, so far behind: the clock itself went back
ROTATION_TOLERANCE = 1e-3  # of the norm of a quaternion


class Problem(enum.IntEnum):
    """What is wrong with a sample; the numbers are those of `calibration_interfaces/msg/SampleCheck`."""

    FINE = 0
    SILENT = 1
    NOT_FINITE = 2
    FROZEN = 3
    JUMP = 4
    WRONG_FRAME = 5
    IMPLAUSIBLE = 6
    OUT_OF_ORDER = 7
    GAP = 8
    INCOMPATIBLE_QOS = 9
    TWO_SOURCES = 10


@dataclasses.dataclass(frozen=True)
class Limits:
    """What is expected of a stream; zero or empty switches a check off.

    Attributes:
        frame: `frame_id` that the samples must carry.
        largest: Largest norm of each group of three numbers, in the unit of the values (m; N, N*m).
        fastest: Largest change of each group of three numbers per second.
        frozen: Identical samples in a row from which the stream counts as frozen, at least 2.
        interval: Usual interval, s; 0: learnt from the first samples.
        gap: Intervals from which samples are missing between two.
    """

    frame: str = ""
    largest: tuple[float, ...] = ()
    fastest: tuple[float, ...] = ()
    frozen: int = 0
    interval: float = 0.0
    gap: float = 1.5

    def __post_init__(self) -> None:
        """Raise ValueError on limits that make no sense."""
        numbers = (*self.largest, *self.fastest, self.interval, self.gap)
        if not all(math.isfinite(one) and one >= 0.0 for one in numbers) or self.frozen in (1, -1) or self.gap <= 1.0:
            msg = f"limits {self}"
            raise ValueError(msg)


@dataclasses.dataclass
class Counts:
    """What a stream has brought so far.

    Attributes:
        received: Samples.
        accepted: Samples that passed every check.
        rejected: Problem -> samples rejected for it.
        gaps: Intervals in which samples are missing.
        missing: Samples missing in them.
    """

    received: int = 0
    accepted: int = 0
    rejected: dict[Problem, int] = dataclasses.field(default_factory=dict)
    gaps: int = 0
    missing: int = 0


class StreamCheck:
    """The checks of one stream and what they have found.

    Attributes:
        counts: What the stream has brought so far.
        problem: Problem of the last sample.
        gap_before: Whether samples are missing between the last sample and the one before it.
        break_before: Whether so many are missing that no average may reach across.
    """

    def __init__(self, limits: Limits) -> None:
        """Start without any sample."""
        self.limits = limits
        self.counts = Counts()
        self.problem = Problem.FINE
        self.gap_before = self.break_before = False
        self._time: int | None = None  # of the last sample in order
        self._behind: list[int] = []  # stamps in order among themselves, far behind that one
        self._last: tuple[int, Float1D] | None = None  # the last sample accepted
        self._bytes = b""
        self._alike = 0
        self._intervals: collections.deque[int] = collections.deque(maxlen=REMEMBERED)
        self._pending: list[int] = []  # intervals seen before the usual one was known
        self._interval = round(limits.interval * NANOSECONDS)

    @property
    def interval(self) -> float:
        """Usual interval between stamps, s; NaN while unknown."""
        return self._interval / NANOSECONDS if self._interval else math.nan

    def add(self, time: int, values: Float1D, frame: str = "", rotation: Float1D | None = None) -> Problem:
        """Judge the next sample.

        Args:
            time: Stamp, ns.
            values: (k,) numbers, groups of three.
            frame: `frame_id`.
            rotation: (4,) quaternion that came with the sample, None if there is none.

        Returns:
            FINE, or the first problem found; every problem but FINE means: not to be measured with.
        """
        self.counts.received += 1
        self.gap_before = self.break_before = False
        self.problem = self._judge(time, values, frame, rotation)
        if self.problem is Problem.FINE:
            self.counts.accepted += 1
            self._last = (time, values)
        else:
            self.counts.rejected[self.problem] = self.counts.rejected.get(self.problem, 0) + 1
        return self.problem

    def restart(self) -> None:
        """Begin anew with the next sample: stamps count otherwise from there on."""
        self._time = self._last = None
        self._behind.clear()

    def _judge(self, time: int, values: Float1D, frame: str, rotation: Float1D | None) -> Problem:
        if self._time is not None and time <= self._time and not self._clock_went_back(time, self._time):
            return Problem.OUT_OF_ORDER
        self._behind.clear()
        self._count_gap(time)
        if not np.isfinite(values).all() or not (rotation is None or np.isfinite(rotation).all()):
            return Problem.NOT_FINITE
        if self.limits.frame and frame != self.limits.frame:
            return Problem.WRONG_FRAME
        if rotation is not None and abs(float(np.linalg.norm(rotation)) - 1.0) > ROTATION_TOLERANCE:
            return Problem.IMPLAUSIBLE
        if _beyond(values, self.limits.largest):
            return Problem.IMPLAUSIBLE
        if self._is_frozen(values, rotation):
            return Problem.FROZEN
        if self._last is not None:
            seconds = (time - self._last[0]) / NANOSECONDS
            if _beyond((values - self._last[1]) / seconds, self.limits.fastest):
                return Problem.JUMP
        return Problem.FINE

    def _clock_went_back(self, time: int, latest: int) -> bool:
        """Whether this is no straggler but the stream's clock, set back; the stream then begins anew."""
        in_order = not self._behind or time > self._behind[-1]
        far = latest - time >= BACK_SECONDS * NANOSECONDS
        self._behind = [*(self._behind if in_order else ()), time] if far else []
        if len(self._behind) < BACK_SAMPLES:
            return False
        self.restart()
        return True

    def _is_frozen(self, values: Float1D, rotation: Float1D | None) -> bool:
        content = values.tobytes() + (b"" if rotation is None else rotation.tobytes())
        self._alike = self._alike + 1 if content == self._bytes else 1
        self._bytes = content
        return bool(self.limits.frozen) and self._alike >= self.limits.frozen

    def _count_gap(self, time: int) -> None:
        before, self._time = self._time, time
        if before is None:
            return
        interval = time - before
        if self.limits.interval:
            self._judge_gap(interval)
            return
        self._intervals.append(interval)
        if len(self._intervals) < LEARNING:
            self._pending.append(interval)
            return
        self._interval = sorted(self._intervals)[(len(self._intervals) - 1) // 2]
        for one in (*self._pending, interval):
            self._judge_gap(one)
        self._pending.clear()

    def _judge_gap(self, interval: int) -> None:
        if interval > self.limits.gap * self._interval:
            self.gap_before = True
            self.break_before = interval > max(GAP_FACTOR * self._interval, GAP_SECONDS * NANOSECONDS)
            self.counts.gaps += 1
            self.counts.missing += max(round(interval / self._interval) - 1, 1)


def _beyond(values: Float1D, limits: tuple[float, ...]) -> bool:
    """Whether a group of three numbers is longer than its limit; 0: no limit."""
    return any(
        limit > 0.0 and float(np.linalg.norm(values[3 * group : 3 * group + 3])) > limit
        for group, limit in enumerate(limits)
    )
