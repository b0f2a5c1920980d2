"""How a tracker's own clock goes against the robot's, from the motion of a point that both of them see.

Between two samples of the tracker a point has moved by some distance; the robot's model says how far it moved between
the same two moments.  Distances need neither the tracker's pose nor a derivative.  Where the clocks are is searched for
by the course of the speeds, then fitted to the distances, together with a factor for what the model errs by.
"""

from __future__ import annotations

import collections
import dataclasses
import math

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.policy import (
    CLOCK_ANEW,
    CLOCK_COMMON,
    CLOCK_KNOWN,
    CLOCK_LATE,
    CLOCK_RATE,
    CLOCK_UNLIKE,
    CLOCK_WANDER,
    MAD,
)
from calibration_core.timeseries import NANOSECONDS, Bool1D, Float1D, Float2D, Int1D

SPAN = 0.1  # s, between the two samples of a distance: at 250 mm/s a thousand times a tracker's noise
GAP = 0.25  # s between two joint states, within which the robot may have been anywhere
STILL = 0.005  # m/s, root mean square: a robot that stands shows nothing
GRID = 0.02  # s, of the search
PIECE = 30.0  # s of motion that is searched for: clocks that differ by 1e-3 part by 0.03 s meanwhile
RIVAL, PLAIN = 4.0, 0.01  # times the least share left, and share: another offset that leaves no more fits as well
WIDE = 1.0  # s to either side, within which such offsets are the same minimum
WIDELY = np.diag([WIDE**2, CLOCK_RATE**2])  # covariance of a clock before its motion is fitted
GROSS = 5.0  # standard deviations, from which a distance loses weight: a tracker's gross errors
BLOCK = 1.0  # s, over which errors of the model belong together
STEP, STEP_RATE = 1e-3, 1e-4  # s, and rate: of derivatives
STEPS = np.diag([STEP, STEP_RATE])
FEWEST = 20  # distances that are fitted
LEAST = 1e-9  # m: residuals without noise
PASSES, CLOSE = 10, 1e-6  # iterations at most, and s: steps that are too small to go on
KEEP = 60.0  # s of samples


@dataclasses.dataclass(frozen=True, eq=False)
class SenderClock:
    """The sender's clock against the robot's.

    Attributes:
        robot: ns of the robot's clock ...
        sender: ... at which the sender's shows this, ns.
        rate: s of the sender's clock in one of the robot's.
        covariance: (2, 2) of offset, s, and rate.
    """

    robot: int
    sender: int
    rate: float
    covariance: Float2D

    @property
    def offset(self) -> float:
        """How far the sender's clock is ahead, s."""
        return (self.sender - self.robot) / NANOSECONDS

    @property
    def std(self) -> tuple[float, float]:
        """One standard deviation of the offset, s, and of the rate."""
        return math.sqrt(self.covariance[0, 0]), math.sqrt(self.covariance[1, 1])

    @property
    def figures(self) -> str:
        """The figures in words."""
        side, (offset, rate) = "ahead of" if self.offset >= 0.0 else "behind", self.std
        ahead = f"{abs(self.offset):.4f} s (standard deviation {offset * 1e3:.2g} ms) {side} the robot's"
        return f"the tracker's clock is {ahead}, rate {self.rate:.7f} (standard deviation {rate:.1g})"

    def by_robot(self, stamp: int) -> int:
        """Return the time of the robot's clock, ns, at which the sender's shows `stamp`, ns."""
        return self.robot + round((stamp - self.sender) / self.rate)

    def at(self, robot: int) -> SenderClock:
        """Return the same at another time of the robot's clock, ns: less sure the farther it is off."""
        ahead = (robot - self.robot) / NANOSECONDS
        to, far = np.array([[1.0, ahead], [0.0, 1.0]]), abs(ahead)
        wander = CLOCK_WANDER**2 * np.array([[far**3 / 3.0, far * ahead / 2.0], [far * ahead / 2.0, far]])
        sender = self.sender + round(self.rate * (robot - self.robot))
        return SenderClock(robot, sender, self.rate, to @ self.covariance @ to.T + wander)

    def minus(self, other: SenderClock) -> Float1D:
        """Return by how much offset, s, and rate exceed another's at the same time of the robot's clock."""
        return np.array([(self.sender - other.sender) / NANOSECONDS, self.rate - other.rate])


class ClockFromMotion:
    """Learns a tracker's clock from every motion that the robot makes.

    Attributes:
        clock: What is known of it; None: nothing.
    """

    def __init__(self, cell: Cell) -> None:
        """Begin with nothing known."""
        self._chain, self._points = chain_of(cell), nominal_parameters(cell).points
        self._seen = {name: collections.deque[tuple[int, int, Float1D]]() for name in self._points}
        self.clock: SenderClock | None = None
        self._why = "no motion was seen"

    def by_robot(self, stamp: int, received: int) -> int | None:
        """Return the time of a sample by the robot's clock, from its stamp and the robot's time now, ns; None: unknown.

        A clock that is far off the time of receipt was set, and is unknown from now on.
        """
        if self.clock is None:
            return None
        time = self.clock.by_robot(stamp)
        if abs(time - received) <= CLOCK_LATE * NANOSECONDS:
            return time
        self.clock, self._why = None, "it was set"
        for seen in self._seen.values():
            seen.clear()
        return None

    def add(self, name: str, stamp: int, received: int, position: Float1D) -> None:
        """Take a sample of a point: its stamp and the robot's time now, ns; (3,) m, tracker frame."""
        seen = self._seen[name]
        seen.append((stamp, received, position))
        while received - seen[0][1] > KEEP * NANOSECONDS:
            seen.popleft()

    def learn(self, time: Int1D, q: Float2D) -> bool:
        """Take a motion, stamps (k,) ns and joint angles (k, n) rad; tell whether another clock is known now."""
        if not len(time):
            return False
        first, last = time[0] - CLOCK_LATE * NANOSECONDS, time[-1] + CLOCK_LATE * NANOSECONDS
        for name, kept in self._seen.items():
            seen = [one for one in kept if first <= one[1] <= last]
            if not seen:
                continue
            stamps, received = np.array([one[:2] for one in seen], dtype=np.int64).T
            tracker = stamps, np.array([one[2] for one in seen])
            path = posture(self._chain, q).point(self._points[name]).T
            found = sender_clock((time, path), tracker, self.clock, received)
            if isinstance(found, SenderClock):
                self.clock = found
                return True
            self._why = found
        return False

    def missing(self, now: int) -> str:
        """Say what is missing before readings may count by it, at a time of the robot's clock, ns; empty: nothing."""
        if self.clock is None:
            return f"the tracker's clock is not known ({self._why}): move the robot"
        std = self.clock.at(now).std[0]
        return "" if std <= CLOCK_KNOWN else f"the tracker's clock is known to {std:.2g} s only: move the robot"

    def figures(self, now: int) -> str:
        """Say what is known at a time of the robot's clock, ns; empty: nothing."""
        return "" if self.clock is None else self.clock.at(now).figures


def sender_clock(
    robot: tuple[Int1D, Float2D],
    tracker: tuple[Int1D, Float2D],
    near: SenderClock | None = None,
    received: Int1D | None = None,
) -> SenderClock | str:
    """Estimate the clock from a stretch of time in which the robot moves.

    Args:
        robot: Stamps (k,) ns and where the point is by the model (k, 3) m, base frame.
        tracker: Stamps (n,) ns and where it was seen (n, 3) m, tracker frame.
        near: What is known of the clock; it counts unless the motion contradicts it.
        received: (n,) ns of the robot's clock, near which the tracker's stamps are; None: they may be anywhere.

    Returns:
        The clock, near the middle of the motion; or why the motion does not show it.
    """
    if min(len(robot[0]), len(tracker[0])) < 3:
        return "samples of the robot or of the tracker are missing"
    moved, seen = _Distances.of(*robot), _Distances.of(*tracker)
    if min(moved.energy, seen.energy) < STILL**2:
        return "the robot does not move, or the tracker does not see it move"
    if near is not None:
        before = near.at(int(robot[0][len(robot[0]) // 2]))
        free = _fitted(robot, seen, dataclasses.replace(before, covariance=WIDELY))
        if isinstance(free, SenderClock):  # beside a sure clock, a motion that contradicts it would count for nothing
            change = free.minus(before)
            if change @ np.linalg.solve(before.covariance + free.covariance, change) > CLOCK_ANEW**2:
                return free
        found = _fitted(robot, seen, before)
        if isinstance(found, SenderClock):
            return found
    ahead = None if received is None else float(np.max(tracker[0] - received)) / NANOSECONDS
    start = _searched(moved, seen, ahead)
    return start if isinstance(start, str) else _fitted(robot, seen, start)


@dataclasses.dataclass(frozen=True, eq=False)
class _Distances:
    """How far a point moved, (m,) m, between pairs of stamps, (m,) ns."""

    begin: Int1D
    end: Int1D
    length: Float1D

    @classmethod
    def of(cls, time: Int1D, position: Float2D) -> _Distances:
        interval = max(float(np.median(np.diff(time))) / NANOSECONDS, 1e-6)
        apart = min(max(round(SPAN / interval), 1), len(time) - 1)
        begin, end = time[:-apart], time[apart:]
        whole = (end > begin) & (end - begin < 2.0 * apart * interval * NANOSECONDS)
        length = np.linalg.norm(position[apart:] - position[:-apart], axis=1)
        return cls(begin[whole], end[whole], length[whole])

    @property
    def speed(self) -> Float1D:
        return self.length / ((self.end - self.begin) / NANOSECONDS)

    @property
    def energy(self) -> float:
        """Mean square of the speed, m^2/s^2."""
        return float(np.mean(self.speed**2)) if len(self.length) else 0.0

    def on_grid(self) -> tuple[int, Float1D, Float1D]:
        """Return a time, ns, speeds on a grid from there on, and where they are known (1, else 0)."""
        middle = self.begin + (self.end - self.begin) // 2
        at = (middle - middle[0]) / NANOSECONDS
        grid = np.arange(0.0, at[-1] + GRID, GRID)
        after = np.minimum(np.searchsorted(at, grid), len(at) - 1)
        off = np.minimum(np.abs(at[after] - grid), np.abs(grid - at[np.maximum(after - 1, 0)]))
        known = (off <= GAP).astype(float)
        return int(middle[0]), np.interp(grid, at, self.speed) * known, known


def _searched(moved: _Distances, seen: _Distances, ahead: float | None) -> SenderClock | str:
    """Search for the offset, near `ahead`, s, at which the speeds of a piece of the motion are those that were seen."""
    begin, a, in_a = moved.on_grid()
    start, b, in_b = seen.on_grid()
    if len(a) > (wide := round(PIECE / GRID)):
        total = np.concatenate([[0.0], np.cumsum(a**2)])
        first = int(np.argmax(total[wide:] - total[:-wide]))
        begin, a, in_a = begin + round(first * GRID * NANOSECONDS), a[first : first + wide], in_a[first : first + wide]
    lags = np.arange(1 - len(a), len(b))  # steps of the grid

    def sums(x: Float1D, y: Float1D) -> Float1D:
        """Sum of x[i] y[i + lag] for each lag."""
        size = len(x) + len(y)
        return np.asarray(np.fft.irfft(np.conj(np.fft.rfft(x, size)) * np.fft.rfft(y, size), size)[lags])

    robots, trackers = sums(a**2, in_b), sums(in_a, b**2)
    common = np.maximum(robots / float(a @ a), trackers / float(b @ b)) >= CLOCK_COMMON
    if ahead is not None:
        common &= np.abs((start - begin) / NANOSECONDS + GRID * lags - ahead) <= CLOCK_LATE
    left = np.where(common, 1.0 - 2.0 * sums(a, b) / np.maximum(robots + trackers, 1e-30), 1.0)
    best = int(np.argmin(left))
    if left[best] > CLOCK_UNLIKE:
        return f"the tracker sees another motion than the robot's: {100 * left[best]:.0f} % of the speeds do not agree"
    rivals = np.flatnonzero(left <= max(RIVAL * left[best], PLAIN))
    if np.abs(rivals - best).max() * GRID > WIDE:
        return "the motion repeats itself or keeps its speed: more than one offset fits"
    middle = round(len(a) / 2 * GRID * NANOSECONDS)
    sender = start + middle + round(float(lags[best]) * GRID * NANOSECONDS)
    return SenderClock(begin + middle, sender, 1.0, WIDELY)


def _fitted(robot: tuple[Int1D, Float2D], seen: _Distances, prior: SenderClock) -> SenderClock | str:
    """Fit offset and rate to prior and distances, from the middle outwards: no error of the rate may carry away."""
    time = (robot[0] - prior.robot) / NANOSECONDS
    begins, ends = (seen.begin - prior.sender) / NANOSECONDS, (seen.end - prior.sender) / NANOSECONDS
    alone = np.concatenate([np.diff(time) > GAP, [True]])  # nobody knows where the robot is after such a sample
    reach, farthest = PIECE / 2.0, float(max(abs(begins[0]), abs(ends[-1])))
    margin = STEP + STEP_RATE * farthest  # derivatives reach beyond a moment
    known, weight_of_prior = np.array([0.0, prior.rate]), np.linalg.inv(prior.covariance)
    now, covariance, left = known, prior.covariance, 1.0

    def distances(offset: float, rate: float) -> tuple[Float1D, Bool1D]:
        """Return how far the point moved by the model, m, and whether that is known."""
        at = (np.stack([begin, end]) - offset) / rate
        before = np.searchsorted(time, at, side="right") - 1
        inside = (at - margin >= time[0]) & (at + margin <= time[-1])
        way = np.column_stack([np.subtract(*np.interp(at, time, axis)) for axis in robot[1].T])
        return np.linalg.norm(way, axis=1), (inside & ~alone[before]).all(axis=0)

    while True:
        rows = (np.abs(begins) <= reach) & (np.abs(ends) <= reach)
        begin, end = begins[rows], ends[rows]
        for _ in range(PASSES):
            expected, some = distances(*now)
            expected, length = expected[some], seen.length[rows][some]
            power = float(expected @ expected)
            if len(length) < FEWEST or power <= len(length) * (STILL * SPAN) ** 2:
                return "too little of the motion was seen"
            gain = float(expected @ length) / power  # what the model errs by
            slopes = [
                gain * (distances(*(now + by))[0] - distances(*(now - by))[0])[some] / (2.0 * by.sum()) for by in STEPS
            ]
            design = np.column_stack([*slopes, expected])
            residual = length - gain * expected
            scale = max(MAD * float(np.median(np.abs(residual))), LEAST)
            weight = np.minimum(1.0, GROSS * scale / np.maximum(np.abs(residual), LEAST))
            normal = design.T @ (weight[:, None] * design) + np.diag([LEAST**2] * 3)
            number = np.unique(np.floor(begin[some] / BLOCK), return_inverse=True)[1]
            scores = np.zeros((int(number.max()) + 1, 3))
            np.add.at(scores, number, design * (weight * residual)[:, None])
            inverse = np.linalg.inv(normal)
            blocks = inverse @ scores.T @ scores @ inverse * len(scores) / max(len(scores) - 3, 1)
            white = float(weight @ residual**2) / (len(length) - 3)  # errors of the model last longer than noise
            variance = max(white, float(np.max(np.diag(blocks)[:2] / np.diag(inverse)[:2])), LEAST**2)
            weight_of_motion = np.linalg.inv(inverse[:2, :2]) / variance
            covariance = np.linalg.inv(weight_of_motion + weight_of_prior)
            step = (inverse @ design.T @ (weight * residual))[:2]
            change = covariance @ (weight_of_motion @ step + weight_of_prior @ (known - now))
            now, left = now + change, float(weight @ residual**2 / (weight @ length**2))
            if abs(change[0]) < CLOSE:
                break
        if reach >= farthest:
            break
        reach *= 2.0
    if not left <= CLOCK_UNLIKE:
        return f"the tracker sees another motion than the robot's: {100 * left:.0f} % of the distances do not agree"
    if covariance[0, 0] > CLOCK_KNOWN**2:
        return "the speed changes too little: the motion does not show the offset"
    return SenderClock(prior.robot, prior.sender + round(now[0] * NANOSECONDS), float(now[1]), covariance)
