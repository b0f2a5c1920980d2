"""What is wrong with the data, before any physics: no model of the robot's elasticity is needed for it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from calibration_core.diagnosis.data_checks.change_points import (
    Step,
    averages,
    stands_beside_geometry,
    target_step,
    tracker_step,
)
from calibration_core.diagnosis.data_checks.noise import Scatter, left_over
from calibration_core.diagnosis.data_checks.tool_shape import Shape, own_variances, shape_of
from calibration_core.identification.checks.exclusion_anomalies import OUTLIERS, outlier_text
from calibration_core.identification.result.estimate import Anomaly
from calibration_core.identification.statistics.distributions import f_tail
from calibration_core.identification.stiffness.loaded import PreparedLoaded
from calibration_core.identification.stiffness.problem import LoadedProblem
from calibration_core.model.effects import effect_named
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Int1D, Readings, numbers_in_time

LOOSE = 4.0  # times the variance of the other points
SWINGING = 4.0  # times the variance that the other configurations have
UNSEEN = 0.1  # times the claimed noise: common movements of that size are rounding, as of a simulation without noise
CERTAIN = 1e-6
UNDERSTATED = 1.1  # times the claim


@dataclasses.dataclass(frozen=True, eq=False)
class Checked:
    """What was found, and what physics may be searched in.

    Attributes:
        anomalies: What was found.
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
        anomalies: What was found.
        shape: The residuals as a table.
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
    certain = seen.freedom > 0 and f_tail(seen.total**2, seen.freedom, 10**6) < CERTAIN
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
    if ratio < LOOSE or f_tail(ratio / 2, freedom, freedom) > CERTAIN:
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
    return np.asarray((ratio > SWINGING) & (chance * len(power) < CERTAIN))


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
