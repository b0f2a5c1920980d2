"""Clocks: streams stamped on different time bases, and the offset between tracker and force/torque sensor.

On a load ramp a point moves with the load, p(t) = a + B s(t - d), where s is the load along the ramp, and d how much
the tracker's stamps are ahead of the force sensor's.  Wrong stamps leave the residual B ds/dt d: it shows at the ends
of the ramp, against the plateaus on either side.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration_core.cell import Cell
from calibration_core.errors import RecordingError
from calibration_core.observations.plateaus import USUAL_SIGMA, Window
from calibration_core.policy import MAD
from calibration_core.timeseries import (
    NANOSECONDS,
    Bool1D,
    Float1D,
    Float2D,
    Int1D,
    Note,
    Readings,
    Streams,
    TimeSeries,
)

OTHER_BASE = 5.0  # s; streams further apart than this are on different time bases
SOONEST = 0.02  # quantile of what stamps are behind receive times; fewer may be stamped wrong
SEARCH = 1.0  # s, either way
GRID = 0.02  # s
NEAR = 4  # grid steps either way for the final fit
SMOOTHING = 0.1  # s
MARGIN = 1.0  # s of plateau used on either side of a ramp
MIN_SAMPLES = 10
MIN_RAMPS = 3
MIN_LOAD = 20.0  # standard deviations of the force/torque sensor between the plateaus
SIGNIFICANCE = 5.0
SMALLEST = 0.002  # s; less is not worth a correction


@dataclasses.dataclass(frozen=True)
class ClockOffset:
    """How far the tracker's stamps are ahead of the force/torque sensor's.

    Attributes:
        seconds: The offset.
        std: One standard deviation, from the scatter between ramps.
        ramps: Number of ramps used.
    """

    seconds: float
    std: float
    ramps: int

    @property
    def significant(self) -> bool:
        """Whether it is worth a correction."""
        return abs(self.seconds) > SIGNIFICANCE * self.std and abs(self.seconds) > SMALLEST


def on_one_base(recording: Streams) -> Streams:
    """Bring streams onto the time base of the joint states where their stamps count from somewhere else.

    What the stamps of a stream are behind the receive times, at the soonest, should be about the same for all streams;
    where it differs by more than five seconds from that of the joint states, the stream is shifted by the difference.
    """
    reference = _lag(recording.joints)
    notes: list[Note] = []

    def shifted(series: TimeSeries | None, name: str) -> TimeSeries | None:
        if series is None or not len(series):
            return series
        by = _lag(series) - reference
        if abs(by) <= OTHER_BASE * NANOSECONDS:
            return series
        text = f"stamps count from another start: shifted by {by / NANOSECONDS:.6f} s to agree with the joint states"
        notes.append(Note("time_base", name, text, len(series)))
        return dataclasses.replace(series, time=series.time + by)

    wrench = shifted(recording.wrench, "wrench")
    temperature = shifted(recording.temperature, "temperature")
    points = {name: shifted(series, name) or series for name, series in recording.points.items()}
    if not notes:
        return recording
    return dataclasses.replace(
        recording, wrench=wrench, temperature=temperature, points=points, notes=(*recording.notes, *notes)
    )


def _lag(series: TimeSeries) -> int:
    """Return what the stamps are behind the receive times, ns, where nothing waited: a queue only ever adds to it."""
    return int(np.sort(series.received - series.time)[round(SOONEST * (len(series) - 1))])


def clock_offset(recording: Streams, windows: list[Window], cell: Cell) -> ClockOffset | None:
    """Estimate the offset from the load ramps between the windows of each configuration.

    Returns:
        The weighted mean over ramps, with the larger of its formal standard deviation and the one from the scatter
        between ramps; None if fewer than three ramps can be used.
    """
    if recording.wrench is None:
        return None
    sensor = cell.instruments.force_torque
    sigma = np.repeat(USUAL_SIGMA if sensor is None else (sensor.sigma_force, sensor.sigma_torque), 3)
    ramps = [
        ramp
        for before, after in itertools.pairwise(windows)
        if before.configuration == after.configuration
        and (ramp := _ramp(recording.wrench, recording.points, before, after, np.maximum(sigma, 1e-6))) is not None
    ]
    if len(ramps) < MIN_RAMPS:
        return None
    grid = np.arange(-round(SEARCH / GRID), round(SEARCH / GRID) + 1) * GRID
    around = np.arange(-NEAR, NEAR + 1) * GRID
    shares = np.array([ramp.misfit(grid) / ramp.misfit(grid[:1]) for ramp in ramps])
    start = float(grid[np.argmin(shares.sum(axis=0))])
    fits: list[tuple[float, float]] = []
    for _ in range(2):  # the second time around the first result: the parabola is narrow
        fits = [fit for ramp in ramps if (fit := ramp.best(start + around)) is not None]
        if len(fits) < MIN_RAMPS:
            return None
        start = float(np.median([delay for delay, _ in fits]))
    delays, stds = (np.array(column) for column in zip(*fits, strict=True))
    middle = float(np.median(delays))
    spread = MAD * float(np.median(np.abs(delays - middle)))
    near = np.abs(delays - middle) <= np.maximum(5.0 * spread, 5.0 * stds)
    weight = 1.0 / (stds[near] ** 2 + spread**2)
    mean = float(np.average(delays[near], weights=weight))
    scatter = float(np.average((delays[near] - mean) ** 2, weights=weight))
    std = max(float(np.sqrt(1.0 / weight.sum())), float(np.sqrt(scatter / max(int(near.sum()) - 1, 1))))
    return ClockOffset(mean, std, int(near.sum()))


def corrected(recording: Streams, offset: ClockOffset | None) -> tuple[Streams, list[Note]]:
    """Take a significant offset out, and report any.

    The clock that is set right is the one that is further from the joint states', judged by receive times.
    """
    if offset is None or recording.wrench is None:
        return recording, []
    size = (
        f"{abs(offset.seconds) * 1e3:.1f} ms (standard deviation {offset.std * 1e3:.1f} ms, {offset.ramps} load ramps)"
    )
    side = "ahead of" if offset.seconds >= 0 else "behind"
    text = f"the tracker's time stamps are {size} {side} the force/torque sensor's"
    if not offset.significant:
        return recording, [Note("clock_offset", "tracker", f"{text}: not significant, not corrected")]
    base = _lag(recording.joints)
    tracker = float(np.median([_lag(series) for series in recording.points.values()])) - base
    by = round(offset.seconds * NANOSECONDS)
    if abs(_lag(recording.wrench) - base) > abs(tracker):
        wrench = dataclasses.replace(recording.wrench, time=recording.wrench.time + by)
        note = Note("clock_offset", "force/torque sensor", f"{text}: the sensor's stamps are corrected")
        return dataclasses.replace(recording, wrench=wrench), [note]
    points = {name: dataclasses.replace(series, time=series.time - by) for name, series in recording.points.items()}
    note = Note("clock_offset", "tracker", f"{text}: the tracker's stamps are corrected")
    return dataclasses.replace(recording, points=points), [note]


@dataclasses.dataclass(frozen=True, eq=False)
class _Ramp:
    """One change of load: the load along it at the sensor's times, and each point's positions at the tracker's."""

    load_time: Float1D
    load: Float1D
    points: tuple[tuple[Float1D, Float2D], ...]

    def misfit(self, delays: NDArray[np.floating[Any]]) -> Float1D:
        """Sum of squares (d,) m² that a + B s(t - delay) leaves of the positions, for each delay, s."""
        rest = np.zeros(len(delays))
        for time, position in self.points:
            moved = position - position.mean(axis=0)
            load = np.interp(time - delays[:, None], self.load_time, self.load)
            load -= load.mean(axis=1, keepdims=True)
            power = np.maximum((load**2).sum(axis=1), 1e-30)
            rest += (moved**2).sum() - ((load @ moved) ** 2).sum(axis=1) / power
        return rest

    def best(self, delays: NDArray[np.floating[Any]]) -> tuple[float, float] | None:
        """Vertex of the parabola through the misfit at the delays and its standard deviation, s; None without one."""
        rest = self.misfit(delays)
        centre = float(delays.mean())
        curvature, slope = np.polyfit(delays - centre, rest, 2)[:2]
        if curvature <= 0.0:
            return None
        delay = -slope / (2.0 * curvature)
        if abs(delay) > 2.0 * float(delays[-1] - centre):
            return None
        freedom = sum(3 * (len(time) - 2) for time, _ in self.points) - 1
        variance = max(float(rest.min()), 0.0) / freedom
        return float(centre + delay), float(np.sqrt(variance / curvature))


def _smooth(time: Int1D, values: Float1D) -> Float1D:
    """Average over `SMOOTHING` s around each sample: noise would hide the slope; symmetric, so nothing is delayed."""
    wide = int(SMOOTHING * NANOSECONDS / 2 / max(float(np.median(np.diff(time))), 1.0))
    if wide == 0:
        return values
    total = np.concatenate([[0.0], np.cumsum(values)])
    at = np.arange(len(values))
    reach = np.minimum(np.minimum(at, len(values) - 1 - at), wide)
    return np.asarray((total[at + reach + 1] - total[at - reach]) / (2 * reach + 1))


def _ramp(
    wrench: TimeSeries, points: Mapping[str, TimeSeries], before: Window, after: Window, sigma: Float1D
) -> _Ramp | None:
    """Cut out one change of load with a margin of plateau, or None where there is too little to see."""
    margin = int(MARGIN * NANOSECONDS)
    begin = max(before.begin, before.end - margin)
    end = min(after.end, after.begin + margin)
    wide = int((SEARCH + 0.5) * NANOSECONDS)
    rows = slice(*np.searchsorted(wrench.time, [begin - wide, end + wide]))
    load = wrench.values[rows] / sigma
    inside = (wrench.time[rows] >= begin) & (wrench.time[rows] <= end)
    first = load[(wrench.time[rows] >= begin) & (wrench.time[rows] < before.end)]
    last = load[(wrench.time[rows] >= after.begin) & (wrench.time[rows] <= end)]
    if min(len(first), len(last), int(inside.sum()) - len(first) - len(last)) < 2:
        return None
    change = last.mean(axis=0) - first.mean(axis=0)
    size = float(np.linalg.norm(change))
    if size < MIN_LOAD:
        return None
    along = _smooth(wrench.time[rows], (load - first.mean(axis=0)) @ (change / size))
    cut = []
    for series in points.values():
        some = slice(*np.searchsorted(series.time, [begin, end]))
        time, position = series.time[some], series.values[some]
        ramping = (time >= before.end) & (time < after.begin)
        if int(ramping.sum()) >= 3 and len(time) >= MIN_SAMPLES:
            cut.append(((time - begin) / NANOSECONDS, position))
    if not cut:
        return None
    return _Ramp((wrench.time[rows] - begin) / NANOSECONDS, along, tuple(cut))


# --- input that is no measurement -------------------------------------------------------------------------------------


TO_AND_FRO = 0.1  # share of messages that jump away from both neighbours; noise does so in fewer than 0.02
NEARER = 5.0  # times nearer to each other than to the message between them, the neighbours of such a message
SOON = 1.0  # s between such neighbours: a robot does not go there and back meanwhile
JUMP_JOINTS = 5e-4  # rad, m: more than an encoder's step
JUMP_POINTS = 1e-4  # m: more than the noise of a laser tracker
JUMP_WRENCH = 0.05  # of the largest load
LAST_DIGITS = 8 * np.finfo(np.float64).eps  # relative: averages of equal numbers differ by no more
MOVED_JOINT = 1e-3  # rad, m
MOVED_POINT = 0.01  # m: more than any load bends a robot
FEWEST_STEPS = 3  # of a configuration, in which a wrench that is measured is never the same
COPIED = 0.01  # of the configurations: so few are copied rows, gross errors (2 of 1,000 in a public UR10 table)


def without_faults(recording: Streams, cell: Cell) -> Streams:
    """Return a recording without readings of lost targets.

    Trackers report 0, 0, 0 where they see no target; no measured position is that to the bit.

    Raises:
        RecordingError: A topic carries messages of two publishers, or nothing but zeros.
    """
    path, topics = recording.provenance.path, cell.topics
    streams = [(topics.joint_states, recording.joints, JUMP_JOINTS)]
    points, notes = dict(recording.points), []
    for name, series in recording.points.items():
        topic = topics.point(name)
        lost = ~series.values.any(axis=1)
        if cell.measurements.points == "absolute" and lost.any():
            if lost.all():
                expected = "positions; trackers report zeros where they see no target"
                raise RecordingError(path, topic, "zeros in all messages", expected)
            kept = ~lost
            points[name] = TimeSeries(series.time[kept], series.values[kept], series.received[kept], series.frame)
            count = int(lost.sum())
            text = f"{count} messages of exactly 0, 0, 0 are left out: trackers report them where they see no target"
            notes.append(Note("zeros", topic, text, count))
        streams.append((topic, points[name], JUMP_POINTS))
    if recording.wrench is not None:
        wrench = recording.wrench
        force = TimeSeries(wrench.time, wrench.values[:, :3], wrench.received, wrench.frame)
        streams.append((topics.wrench, force, JUMP_WRENCH * float(np.abs(force.values).max(initial=0.0))))
    for topic, series, jump in streams:
        if _jumps_to_and_fro(series, jump):
            found = "messages that jump to and fro between two values: two publishers write on it"
            expected = f"one: ros2 topic info -v {topic} names them; record again with one of them"
            raise RecordingError(path, topic, found, expected)
    return dataclasses.replace(recording, points=points, notes=(*recording.notes, *notes))


def _jumps_to_and_fro(series: TimeSeries, least: float) -> bool:
    """Tell whether many messages lie far from both neighbours, and these near each other."""
    values = series.values
    if len(values) < 3:
        return False
    soon = series.time[2:] - series.time[:-2] < SOON * NANOSECONDS
    step = np.abs(np.diff(values, axis=0)).max(axis=1)
    apart = np.abs(values[2:] - values[:-2]).max(axis=1)
    away = np.minimum(step[1:], step[:-1])
    return bool(np.mean(soon & (away > least) & (away > NEARER * apart)) > TO_AND_FRO)


def refuse_frozen(readings: Readings, cell: Cell) -> None:
    """Refuse readings that stay the same, to the last digit, while what they measure changes.

    Raises:
        RecordingError: A target, the joint angles or the wrench stand still; it says where.
    """
    path = readings.provenance.path
    if cell.measurements.points == "absolute":
        for index, name in enumerate(readings.points):
            rows = np.flatnonzero(readings.point == index)
            rows = rows[np.unique(readings.configuration[rows], return_index=True)[1]]
            q, position, numbers = readings.q[rows], readings.position[rows], readings.configuration[rows]
            turned = np.abs(np.diff(q[:, :-1], axis=0)).max(axis=1) > MOVED_JOINT
            moved = np.linalg.norm(np.diff(position, axis=0), axis=1) > MOVED_POINT
            for what, same in ((name, _same(position) & turned), ("joint angles", _same(q) & moved)):
                if same.any() and same.mean() > COPIED:
                    where = ", ".join(map(str, numbers[1:][same][:10]))
                    found = f"the numbers of the configuration before, to the last digit, in configuration {where}"
                    expected = "readings that move with the robot: its source stood still there; leave these out"
                    raise RecordingError(path, what, found, expected)
    if readings.wrench is None:
        return
    still = []
    for number in np.unique(readings.configuration):
        rows = np.flatnonzero(readings.configuration == number)
        wrench = readings.wrench[rows]
        if len(np.unique(readings.step[rows])) >= FEWEST_STEPS and _same(wrench).all() and wrench.any():
            still.append((int(number), wrench[:1]))
    if len(still) > 1 and _same(np.vstack([wrench for _, wrench in still])).all():
        where = ", ".join(str(number) for number, _ in still)
        found = f"the same numbers, to the last digit, in all steps of configurations {where}"
        raise RecordingError(path, "wrench", found, "readings of a load: the sensor stood still there; leave these out")


def _same(values: Float2D) -> Bool1D:
    """Tell of each row but the first, (n, k), whether it repeats the one before."""
    return np.asarray((np.abs(np.diff(values, axis=0)) <= LAST_DIGITS * np.abs(values[1:])).all(axis=1))
