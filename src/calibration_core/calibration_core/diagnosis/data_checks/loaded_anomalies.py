"""What is wrong with the data, before any physics: no model of the robot's elasticity is needed for it.

The tool as a rigid body: where each point stands against the others, by configuration and step.

Loads and the robot move the tool, not its shape.  Everything here is seen in the flange axes, in residuals of any model
of the robot that is right up to a rigid motion of the tool.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from calibration_core.diagnosis.data_checks.noise import Scatter, left_over
from calibration_core.identification.checks.noise_audit import OUTLIERS, outlier_text
from calibration_core.identification.result.estimate import Anomaly
from calibration_core.identification.statistics import f_tail
from calibration_core.identification.stiffness.loaded import PreparedLoaded
from calibration_core.identification.stiffness.problem import LoadedProblem
from calibration_core.model.effects import effect_named
from calibration_core.model.effects.state import State
from calibration_core.policy import CONFIRMED, CREEP, FAULT_CHANCE, NOTHING_ELSE, SLIGHT_STEP
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Int1D, Readings, numbers_in_time


@dataclasses.dataclass(frozen=True, eq=False)
class Shape:
    """Residuals as a table.

    Attributes:
        numbers: (k,) numbers of the configurations, in the order of time.
        table: (k, s, p, 3) m, flange axes; NaN where nothing was read.
        which: (p,) index of every point among the names of the readings.
    """

    numbers: Int1D
    table: Float3D
    which: Int1D

    @property
    def points(self) -> int:
        """Number of points."""
        return self.table.shape[2]

    def against_others(self) -> Float3D:
        """Return (k, s, p, 3) every point's residual minus the mean of the other points' at the same step."""
        total = self.table.sum(axis=2, keepdims=True)
        return np.asarray(self.table - (total - self.table) / max(self.points - 1, 1))


def shape_of(residual: Float2D, readings: Readings, axes: Float3D) -> Shape:
    """Arrange residuals by configuration, step and point.

    Args:
        residual: (m, 3) m, base axes.
        readings: The same readings.
        axes: (m, 3, 3) rows are the flange axes in the base frame.
    """
    local = np.einsum("mia,ma->mi", axes, residual)
    numbers = numbers_in_time(readings.configuration)
    steps = np.unique(readings.step)
    table = np.full((len(numbers), len(steps), len(readings.points), 3), np.nan)
    place = {int(number): k for k, number in enumerate(numbers)}
    rows = np.array([place[int(number)] for number in readings.configuration])
    table[rows, np.searchsorted(steps, readings.step), readings.point] = local
    present = np.isfinite(table).any(axis=(0, 1, 3))
    return Shape(numbers, table[:, :, present], np.flatnonzero(present))


def own_variances(squares: Float1D) -> Float1D:
    """Return the (p,) variance per coordinate that each point has of its own.

    The contrast of point i to the mean of the others has the variance a_i + sum of the others' over (p - 1)^2
    (three-cornered hat).

    Args:
        squares: (p,) mean square per coordinate of every point's contrast.
    """
    p = len(squares)
    system = np.full((p, p), 1 / (p - 1) ** 2)
    np.fill_diagonal(system, 1.0)
    return np.asarray(np.linalg.solve(system, squares))


# --- A target or the tracker that moved part-way through a recording, found as a change point over the ----------------


RANK = 1e-9  # of the largest singular value: what depends on other columns
FEWEST = 6  # degrees of freedom that must be left to fit the geometry beside a step
EDGE = 2  # configurations on either side of a change, at least


@dataclasses.dataclass(frozen=True, eq=False)
class Step:
    """A change between two configurations.

    Attributes:
        first: Index of the first configuration after it; of one that creeps, at which half of it is done.
        point: Which point moved; -1: all of them.
        shift: (3,) m, after minus before.
        size: m.
        course: (k,) which share of it each configuration has.
    """

    first: int
    point: int
    shift: Float1D
    size: float
    course: Float1D

    @property
    def creeps(self) -> bool:
        """Whether the point comes to its new place little by little."""
        return len(np.unique(self.course)) > 2


def target_step(shape: Shape) -> Step | None:
    """Find the point that stands elsewhere against the others from one configuration on, or creeps there."""
    means = np.nanmean(shape.against_others(), axis=1)
    time = np.arange(len(means))
    courses = [_step_at(first, len(time)) for first in range(EDGE, len(time) - EDGE + 1)]
    courses += [1 - np.exp(-time / lasts) for lasts in CREEP]
    best: tuple[float, Step] | None = None
    for point in range(shape.points):
        good = np.isfinite(means[:, point]).all(axis=1)
        for course in courses:
            half = int(np.argmax(course >= course.max() / 2))
            if min(good[:half].sum(), good[half:].sum()) < EDGE:
                continue
            shift, explained, chance = _explained(means[good, point], course[good])
            if chance * shape.points * len(time) < FAULT_CHANCE and (best is None or explained > best[0]):
                shift = shift * np.ptp(course)
                best = explained, Step(half, point, shift, float(np.linalg.norm(shift)), course)
    return None if best is None else best[1]


def _step_at(first: int, count: int) -> Float1D:
    return (np.arange(count) >= first).astype(np.float64)


def _explained(series: Float2D, course: Float1D) -> tuple[Float1D, float, float]:
    """Return what (k, d) values change per unit of a course over time, (k,), the squares that explains, and the chance
    of so much (F test).
    """
    course, series = course - course.mean(), series - series.mean(axis=0)
    power = float(course @ course)
    slope = course @ series / power
    explained = float(slope @ slope) * power
    d, freedom = len(slope), series.shape[1] * (len(series) - 2)
    left = float((series**2).sum()) - explained
    return slope, explained, f_tail(explained / d / max(left / freedom, 1e-30), d, freedom)


@dataclasses.dataclass(frozen=True, eq=False)
class Averages:
    """What is left of every point in every configuration, r / 3 in all, and what frames and points could make of it.

    Attributes:
        target: (r,) m, mean residuals, coordinate by coordinate, base axes.
        motion: (r, 6) of the tracker.
        tools: (r, 3 p) of the points on the flange.
        owner: (r,) index of the configuration.
        count: Number of configurations.
        reading: (r / 3,) index of the first reading of each.
        centre: (3,) m, of all readings.
    """

    target: Float1D
    motion: Float2D
    tools: Float2D
    owner: Int1D
    count: int
    reading: Int1D
    centre: Float1D

    def with_step(self, step: Step) -> Float2D:
        """Return the columns of a step: the tracker's motion, or that of the point, from its configuration on."""
        moved = self.motion if step.point < 0 else self.tools[:, 3 * step.point : 3 * step.point + 3]
        return moved * step.course[self.owner][:, None]


def averages(residual: Float2D, place: Float2D, axes: Float3D, readings: Readings) -> Averages:
    """Average readings: configurations count, not readings, for their geometric errors are shared.

    Args:
        residual: (m, 3) m, measured - predicted, base axes.
        place: (m, 3) m, predicted.
        axes: (m, 3, 3) rows are the flange axes in the base frame.
        readings: The same readings.
    """
    numbers = numbers_in_time(readings.configuration)
    points = np.unique(readings.point)
    rows, targets, tools, group, reading = [], [], [], [], []
    for index, number in enumerate(numbers):
        for column, point in enumerate(points):
            inside = (readings.configuration == number) & (readings.point == point)
            if inside.any():
                targets.append(residual[inside].mean(axis=0))
                rows.append(_motion(place[inside].mean(axis=0)))
                tool = np.zeros((3, 3 * len(points)))
                tool[:, 3 * column : 3 * column + 3] = axes[inside][0].T
                tools.append(tool)
                group.append(index)
                reading.append(int(np.flatnonzero(inside)[0]))
    return Averages(
        target=np.concatenate(targets),
        motion=np.concatenate(rows),
        tools=np.concatenate(tools),
        owner=np.repeat(group, 3),
        count=len(numbers),
        reading=np.array(reading),
        centre=place.mean(axis=0),
    )


def tracker_step(seen: Averages, geometry: Float3D, noise: float) -> Step | None:
    """Find a configuration from which on all points stand elsewhere in space; None if there is none.

    Frames and points are refitted in every test.  The geometry may be right, so that few configurations tell a step, or
    wrong by more than the step: both are tried.  Geometry takes up part of any physics that is missing, and what is
    left of that goes up and down, too: beside it a step is believed where nothing but noise is left.

    Args:
        seen: Averages of m readings.
        geometry: (m, 3, g) movement of these readings by errors of the geometry.
        noise: Claimed standard deviation of one coordinate of a reading, m.
    """
    if seen.count < 3 * EDGE + 4:
        return None
    found = _tracker_step(seen, np.hstack([seen.motion, seen.tools]))
    if found is not None and stands_beside_geometry(found, seen, geometry):
        return found
    base = _with_geometry(seen, geometry)
    found = _tracker_step(seen, base)
    if found is None:
        return None
    explained, _, _ = _fit(np.hstack([base, seen.with_step(found)]), seen.target)
    return found if float(np.sqrt(np.mean((seen.target - explained) ** 2))) < NOTHING_ELSE * noise else None


def _tracker_step(seen: Averages, base: Float2D) -> Step | None:
    """Find the step of the tracker beside columns (r, b); None where it is not certain, or too small."""
    k = seen.count
    basis = _span(base)
    target, motion = seen.target - basis @ (basis.T @ seen.target), seen.motion
    freedom = 3 * k - basis.shape[1] - motion.shape[1]
    if freedom < FEWEST:
        return None
    best: tuple[float, int] | None = None
    for first in range(EDGE, k - EDGE + 1):
        own = motion * (seen.owner >= first)[:, None]
        own = own - basis @ (basis.T @ own)
        left = float(((target - own @ np.linalg.lstsq(own, target, rcond=RANK)[0]) ** 2).sum())
        if best is None or left < best[0]:
            best = (left, first)
    assert best is not None  # noqa: S101 - k is large enough
    left, first = best
    stepped = motion * (seen.owner >= first)[:, None]
    values = _fit(np.hstack([base, stepped]), seen.target)[1][-6:]
    ratio = (float(target @ target) - left) / 6 / max(left / freedom, 1e-30)
    shift = _motion(seen.centre) @ values
    size = float(np.linalg.norm(shift))
    if f_tail(ratio, 6, freedom) * k > FAULT_CHANCE or size < SLIGHT_STEP:
        return None
    return Step(first, -1, shift, size, _step_at(first, k))


def _with_geometry(seen: Averages, geometry: Float3D) -> Float2D:
    """Return frames, points and geometry, (r, b), columns of length one."""
    errors = geometry[seen.reading].reshape(len(seen.target), -1)
    base = np.hstack([seen.motion, seen.tools, errors])
    return np.asarray(base / np.maximum(np.linalg.norm(base, axis=0), 1e-300))


def _span(columns: Float2D) -> Float2D:
    """Return orthonormal columns that span columns, of which some may depend on others."""
    left, size, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), full_matrices=False)
    return np.asarray(left[:, size > RANK * size[0]])


def stands_beside_geometry(step: Step, seen: Averages, geometry: Float3D) -> bool:
    """Say whether a step is still there where errors of the robot's geometry are fitted beside it.

    Configurations that follow each other are often near each other, and so are their geometric errors: over many of
    them these go up and down like steps.  Where the configurations are too few to fit the geometry, the step stands.

    Args:
        step: What was found without.
        seen: What it was found in.
        geometry: (m, 3, g) movement of the same m readings by errors of the geometry.
    """
    base, stepped = _with_geometry(seen, geometry), seen.with_step(step)
    fitted, _, rank = _fit(base, seen.target)
    before = float(((seen.target - fitted) ** 2).sum())
    fitted, _, with_step = _fit(np.hstack([base, stepped]), seen.target)
    left = float(((seen.target - fitted) ** 2).sum())
    added, freedom = with_step - rank, 3 * seen.count - with_step
    if freedom < FEWEST:
        return True
    return added > 0 and f_tail((before - left) / added / max(left / freedom, 1e-30), added, freedom) < CONFIRMED


def _motion(place: Float1D) -> Float2D:
    x, y, z = place
    return np.hstack([np.eye(3), np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])])


def _fit(columns: Float2D, target: Float1D) -> tuple[Float1D, Float1D, int]:
    """Return what columns explain of the target, their factors, and how many of them are independent."""
    values, _, rank, _ = np.linalg.lstsq(columns, target, rcond=RANK)
    return np.asarray(columns @ values), np.asarray(values), int(rank)


# --- what is wrong with the data, before any physics ------------------------------------------------------------------


LOOSE = 4.0  # times the variance of the other points
SWINGING = 4.0  # times the variance that the other configurations have
UNSEEN = 0.1  # times the claimed noise: common movements of that size are rounding, as of a simulation without noise
UNDERSTATED = 1.1  # times the claim


@dataclasses.dataclass(frozen=True, eq=False)
class Checked:
    """What was found, and what physics may be searched in.

    Attributes:
        sound: (m,) readings that physics may use.
    """

    anomalies: tuple[Anomaly, ...]
    sound: Bool1D


def check_each(prepared: PreparedLoaded, state_of: Callable[[LoadedProblem], State]) -> Checked:
    """Look at every recording by itself: each has points, a tracker and a quiet of its own."""
    readings = prepared.problem.readings
    found: list[Anomaly] = []
    sound = np.ones(len(readings), dtype=bool)
    for rows in readings.each():
        part = prepared.select(rows)
        checked = check_loaded(part, state_of(part.problem))
        found += checked.anomalies
        sound[rows] = checked.sound
    return Checked(tuple(found), sound)


def check_loaded(prepared: PreparedLoaded, state: State) -> Checked:
    """Look for targets and a tracker that moved, loose targets and restless configurations."""
    readings = prepared.problem.readings
    sound = np.ones(len(readings), dtype=bool)
    if prepared.frames is None:
        return Checked((), sound)
    residual = prepared.problem.linearise(prepared.fit.compliance).residual
    noise = float(np.sqrt(np.mean(np.einsum("mii->m", prepared.problem.noise)) / 3))
    shifts = find_shifts(readings, residual, state, noise)
    found, shape, sound = list(shifts.anomalies), shifts.shape, sound & ~shifts.target
    loose = _loose_target(prepared, state, shape) if shape.points >= 3 else None
    if loose is not None:
        found.append(loose[0])
        sound &= readings.point != loose[1]
    restless = _unsettled(prepared, state, loose)
    if restless is not None:
        found.append(restless[0])
        sound &= ~np.isin(readings.configuration, restless[1])
    return Checked(tuple(found), sound)


@dataclasses.dataclass(frozen=True, eq=False)
class Shifts:
    """Where a target or the tracker stands elsewhere than in most of a recording.

    Attributes:
        target: (m,) readings of a target that moved, in the configurations before or after it: the fewer.
        tracker: (m,) readings before or after the tracker moved: the fewer.
    """

    anomalies: tuple[Anomaly, ...]
    shape: Shape
    target: Bool1D
    tracker: Bool1D


def find_shifts(readings: Readings, residual: Float2D, state: State, noise: float) -> Shifts:
    """Look for a target and a tracker that moved part-way.

    Args:
        readings: m readings, in the order of time.
        residual: (m, 3) m, measured - predicted, base axes; frames fitted.
        state: The null model's, of the same readings.
        noise: Claimed standard deviation of one coordinate of a reading, m.
    """
    axes = np.moveaxis(state.at.flange, -1, 0)
    found: list[Anomaly] = []
    target, tracker = np.zeros(len(readings), dtype=bool), np.zeros(len(readings), dtype=bool)
    shape = shape_of(residual, readings, axes)
    point, geometry = None, _geometry(state)
    seen = averages(residual, state.point.T, axes, readings)
    if shape.points >= 2:
        step = target_step(shape)
        if step is not None and stands_beside_geometry(step, seen, geometry):
            found.append(_target_moved(step, shape, readings))
            point = int(shape.which[step.point])
            target = np.isin(readings.configuration, _minority(step, shape)) & (readings.point == point)
    if point is not None:
        others = readings.point != point
        seen = averages(residual[others], state.point.T[others], axes[others], readings.select(others))
        geometry = geometry[others]
    bumped = tracker_step(seen, geometry, noise)
    if bumped is not None:
        found.append(_tracker_moved(bumped, shape))
        tracker = np.isin(readings.configuration, _minority(bumped, shape))
    return Shifts(tuple(found), shape, target, tracker)


def _geometry(state: State) -> Float3D:
    """Return the (m, 3, g) movement of the readings by errors of the geometry, per unit."""
    candidates = effect_named("geometry_error").candidates(state)
    return np.concatenate([one.columns(state) for one in candidates], axis=2)


def noise_understated(seen: Scatter, claimed: float) -> tuple[Anomaly, ...]:
    """Say whether readings scatter more than the instrument claims (standard deviation `claimed`, m)."""
    certain = seen.freedom > 0 and f_tail(seen.total**2, seen.freedom, 10**6) < FAULT_CHANCE
    if not certain or seen.least < UNDERSTATED:
        return ()
    text = (
        f"claimed {1e6 * claimed:.1f} µm per coordinate, seen {1e6 * claimed * seen.total:.1f} µm from step to step: "
        "the noise is larger than claimed, and what is seen is used."
    )
    return (Anomaly("noise_understated", {"tracker": "tracker"}, None, claimed * seen.total, "m", text),)


def outlier_readings(excluded: Bool1D, size: float, readings: Readings) -> tuple[Anomaly, ...]:
    """Name the gross errors that the extended model sets aside; `size` is the largest, m."""
    rows = np.flatnonzero(excluded)
    if not len(rows):
        return ()
    keys = [(int(readings.configuration[i]), int(readings.step[i]), readings.points[readings.point[i]]) for i in rows]
    text = outlier_text(keys, size, "the others of the same configuration under the model of the diagnosis")
    where = {"tracker": "tracker"}
    return (Anomaly(OUTLIERS, where, (keys[0][0], keys[-1][0]), size, "m", text),)


def _target_moved(step: Step, shape: Shape, readings: Readings) -> Anomaly:
    name = readings.points[shape.which[step.point]]
    first, last = int(shape.numbers[step.first]), int(shape.numbers[-1])
    vector = ", ".join(f"{1e3 * x:+z.2f}" for x in step.shift)
    text = (
        f"from configuration {first} on, {name} stands {1e3 * step.size:.2f} mm from where it stood before against the "
        f"other points ({vector} mm, flange axes)."
    )
    if step.creeps:
        text = (
            f"{name} creeps by {1e3 * step.size:.2f} mm against the other points ({vector} mm, flange axes), half of "
            f"it before configuration {first}: it is no longer where it was glued."
        )
    return Anomaly("target_moved", {"point": name}, (first, last), step.size, "m", text)


def _tracker_moved(step: Step, shape: Shape) -> Anomaly:
    first, last = int(shape.numbers[step.first]), int(shape.numbers[-1])
    text = (
        f"from configuration {first} on, all points stand {1e3 * step.size:.2f} mm from where they stood before: the "
        "tracker, or the robot's base, was moved. Offsets are free, so the load steps stay usable."
    )
    return Anomaly("tracker_moved", {"tracker": "tracker"}, (first, last), step.size, "m", text)


def _minority(step: Step, shape: Shape) -> np.ndarray:
    before, after = shape.numbers[: step.first], shape.numbers[step.first :]
    return np.asarray(before if len(before) < len(after) else after)


def _loose_target(prepared: PreparedLoaded, state: State, shape: Shape) -> tuple[Anomaly, int] | None:
    """See whether one point scatters against the others from step to step."""
    groups = left_over(prepared.problem, state, prepared.rejection.used).values()
    contrasts = [rest - (rest.sum(axis=1, keepdims=True) - rest) / (shape.points - 1) for rest in groups]
    if not contrasts:
        return None
    usual = np.median([(c**2).mean(axis=(0, 2)) for c in contrasts], axis=0)  # single wild readings do not count
    variances = own_variances(usual)
    freedom = 3 * sum(len(c) for c in contrasts)
    worst = int(np.argmax(variances))
    others = float(np.median(np.delete(np.clip(variances, 0.0, None), worst)))
    floor = _claimed(prepared) * 0.25
    ratio = float(variances[worst]) / max(others, floor)
    if ratio < LOOSE or f_tail(ratio / 2, freedom, freedom) > FAULT_CHANCE:
        return None
    size = float(np.sqrt(variances[worst]))
    kinds = np.unique(prepared.problem.readings.point)
    point = int(kinds[worst])
    name = prepared.problem.readings.points[point]
    text = (
        f"{name} scatters by {1e6 * size:.0f} µm per coordinate against the other points from step to step, they by "
        f"{1e6 * np.sqrt(max(others, floor)):.0f} µm: it sits loose. Its readings are not used for physics."
    )
    return Anomaly("loose_target", {"point": name}, None, size, "m", text), point


def _unsettled(
    prepared: PreparedLoaded, state: State, loose: tuple[Anomaly, int] | None
) -> tuple[Anomaly, np.ndarray] | None:
    """See configurations in which all points move together from step to step, beyond what the others show.

    A swing has no direction; what jumps along the line of one joint, the same in all of them, is that joint's law.
    """
    steady = np.ones(state.m, dtype=bool) if loose is None else prepared.problem.readings.point != loose[1]
    groups = left_over(prepared.problem, state, prepared.rejection.used & steady)
    if len(groups) < 4:
        return None
    common = [np.median(rest, axis=1) for rest in groups.values()]  # one wild reading of three points does not count
    power = np.array([float((rest**2).mean()) for rest in common])
    quiet = max(float(np.median(np.sort(power)[: max(len(power) // 2 + 1, 2)])), UNSEEN**2 * _claimed(prepared))
    freedom = np.array([rest.size for rest in common])
    restless = _beyond(power, freedom, quiet)
    if restless.any():
        across = _across_joints(common, list(groups), prepared.problem.readings.configuration, state)
        left = [restless & _beyond(one * 3 / 2, freedom * 2 / 3, quiet) for one in across.T]
        restless = min(left, key=np.count_nonzero)
    if not restless.any():
        return None
    known = numbers_in_time(prepared.problem.readings.configuration)
    numbers = known[np.isin(known, np.array(list(groups))[restless])]
    size = float(np.sqrt(power[restless].mean()))
    text = (
        f"in configurations {', '.join(map(str, numbers))} all points move together from step to step by "
        f"{1e6 * size:.0f} µm per coordinate, not with the load: the arm, or what carries it, had not come to rest. "
        "These configurations are not used for physics."
    )
    span = (int(numbers[0]), int(numbers[-1]))
    return Anomaly("unsettled", {"robot": "robot"}, span, size, "m", text), numbers


def _claimed(prepared: PreparedLoaded) -> float:
    """Return the claimed variance of one coordinate, m^2, the mean of all readings."""
    return float(np.mean(np.einsum("mii->m", prepared.problem.noise)) / 3)


def _beyond(power: Float1D, freedom: Float1D, quiet: float) -> Bool1D:
    """Return which configurations move more than what is quiet, by their mean squares and degrees of freedom."""
    ratio = power / quiet
    chance = np.array([f_tail(r, f, float(freedom.sum()) / 2) for r, f in zip(ratio, freedom, strict=True)])
    return np.asarray((ratio > SWINGING) & (chance * len(power) < FAULT_CHANCE))


def _across_joints(common: list[Float2D], numbers: list[int], configuration: Int1D, state: State) -> Float2D:
    """Return the mean squares per coordinate, (k, n), of movements less what lies along the line of each joint.

    Args:
        common: Per configuration (l, 3) m, flange axes.
        numbers: Those configurations.
        configuration: (m,) of all readings.
        state: Their state.
    """
    found = []
    for rest, number in zip(common, numbers, strict=True):
        inside = np.flatnonzero(configuration == number)
        lines = np.einsum("iam,anm->in", state.at.flange[:, :, inside], state.answer[:, :, inside])
        length = np.linalg.norm(lines, axis=0)
        lines = lines / np.where(length > 0, length, 1.0)
        found.append((rest**2).mean() - ((rest @ lines) ** 2).sum(axis=0) / rest.size)
    return np.array(found)
