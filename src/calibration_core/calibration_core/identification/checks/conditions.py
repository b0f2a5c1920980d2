"""The conditions that the standard puts on a measurement, judged while it is made (CWA 17384, 5.1 to 5.3).

Each has a limit, a value and a verdict.  What cannot be seen is unknown, which is no violation: the guard decides
whether the robot may move, and what it does not know it takes as a no.
"""

from __future__ import annotations

import dataclasses
import datetime as dt
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from calibration_core.cell import REDUCED_SPEED, Cell
from calibration_core.identification.result.estimate import OperatingSpace, Precondition
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.simulation.simulate import Loading, Schedule, predict_schedule, tracker_covariance
from calibration_core.observations.kinds import loaded_configurations, relative_pull, unloaded_visits
from calibration_core.timeseries import Condition, Float2D, Override, Readings

MIN_CONFIGURATIONS = 12
STANDARD_GRAVITY = 9.80665  # m/s^2, where the cell file states none
AMBIENT, TOLERANCE = 20.0, 2.0  # degrees Celsius
TEST_UNCERTAINTY_RATIO = 5.0
NO_STIFFNESS = "its stiffness is not stated"
SAME = 0.01  # rad, m: postures whose joints differ by less are one
MANY = 2_000  # configurations from which on nobody asks whether twelve of them differ
UNLOADED = 0.1  # of the range of the force: less above the smallest one is no load
TEMPERATURE = "temperature"
NEAR_SINGULAR = 0.02  # smallest singular value of the scaled Jacobian
UNSEEN = (  # what only a live measurement shows
    ("5.1", "maximum Cartesian speed 250 mm/s, manual mode, servos on, brakes released"),
    ("5.2", "start-up cycle before the test, repeated periodically"),
)


def check_preconditions(
    readings: Readings, cell: Cell, space: OperatingSpace, sigma: float, *, k_csm: bool = True
) -> tuple[Precondition, ...]:
    """Check what a recording can show; what it cannot show is said to be unknown.

    Args:
        readings: What was measured.
        cell: The cell file.
        space: Configurations, deflections and the share of K_CSM.
        sigma: Standard deviation of one coordinate of one reading, m.
        k_csm: Whether the method takes the complementary stiffness into account.
    """
    temperature = _recorded_temperature(readings)  # of postures without load, too
    readings, space = _under_load(readings, space)
    checks = [_configurations(space), _spread(space), temperature]
    if space.force is not None:
        checks.append(_recorded_load(cell, space))
        checks += _unloaded(readings, cell)
    calibrated = _calibrated(cell, readings.provenance.start)
    checks += [_recorded_ratio(space, sigma), *calibrated, _singularities(space, k_csm=k_csm)]
    seen = {condition.name: condition for condition in readings.conditions}
    checks = [_with_override(check, seen.pop(check.name, None)) for check in checks]
    watched = [_watched(condition) for condition in seen.values()]
    if "end_effector" not in seen:
        watched.append(_recorded_end_effector(cell))
    if not readings.conditions:
        watched += [Precondition(*row, "not contained in the evaluated data", None) for row in UNSEEN]
    return (*checks, *watched)


def with_temperature_of(checks: Sequence[Precondition], readings: Readings) -> tuple[Precondition, ...]:
    """Return the same checks with the temperature of further readings of the same measurement judged, too."""
    seen = next((condition for condition in readings.conditions if condition.name == TEMPERATURE), None)
    whole = _with_override(_recorded_temperature(readings), seen)
    return tuple(whole if check.name == TEMPERATURE else check for check in checks)


def _under_load(readings: Readings, space: OperatingSpace) -> tuple[Readings, OperatingSpace]:
    """Return the configurations that were loaded alone, where a loaded recording holds others beside them.

    Postures at rest are for frames and geometry, and a reference configuration, visited without load, is for drift.
    """
    if space.force is None:
        return readings, space
    loaded = set(loaded_configurations(readings)) - set(unloaded_visits(readings))
    kept = np.isin(space.configuration, sorted(loaded))
    if kept.all() or not kept.any():
        return readings, space
    fields = ("configuration", "joint_origins", "flange", "wrench_point", "force", "deflection", "q", "singularity",
              "k_csm_share")  # fmt: skip
    parts: dict[str, Any] = {name: getattr(space, name) for name in fields}
    rows: dict[str, Any] = {name: None if values is None else values[kept] for name, values in parts.items()}
    points = {name: at[kept] for name, at in space.points.items()}
    rows_kept = np.isin(readings.configuration, space.configuration[kept])
    return readings.select(rows_kept), dataclasses.replace(space, points=points, **rows)


def _with_override(check: Precondition, seen: Condition | None) -> Precondition:
    """Add what was seen live to what the readings show: a violation then counts, and so does who overrode it."""
    if seen is None:
        return check
    if seen.met is False and check.met is not False:
        check = dataclasses.replace(check, found=f"{check.found}; while measuring: {seen.value}", met=False)
    return dataclasses.replace(check, override=_who(seen.override))


def _watched(condition: Condition) -> Precondition:
    requirement = f"{condition.requirement}: {condition.limit}"
    who = _who(condition.override)
    return Precondition(
        condition.clause, requirement, condition.value, condition.met, condition.name, condition.shall, who
    )


def _who(override: Override | None) -> str:
    return "" if override is None else f"{override.operator}: {override.reason}"


def _recorded_end_effector(cell: Cell) -> Precondition:
    tool = cell.end_effector
    stated = tool is not None and tool.states_stiffness
    found = f"its compliance is accounted for ({tool.source})" if tool is not None and stated else NO_STIFFNESS
    requirement = "end effector considerably stiffer than the robot, or its compliance accounted for"
    return Precondition("5.1", requirement, found, True if stated else None, "end_effector")


def _configurations(space: OperatingSpace) -> Precondition:
    count, distinct = len(space.configuration), _distinct(space.q)
    found = f"{count} configurations" + (f" in {distinct} different postures" if distinct < count else "")
    return Precondition(
        "5.1", f"at least {MIN_CONFIGURATIONS} manipulator configurations", found, distinct >= MIN_CONFIGURATIONS
    )


def _distinct(q: Float2D) -> int:
    """Return how many postures, (k, n) rad or m, differ from all before them."""
    if len(q) > MANY:
        return len(q)
    apart = np.abs(q[:, None] - q).max(axis=2) > SAME
    return int(np.count_nonzero((apart | (np.tri(len(q)) == 0) | np.eye(len(q), dtype=bool)).all(axis=1)))


def _spread(space: OperatingSpace) -> Precondition:
    box = np.ptp(space.flange, axis=0)
    found = " × ".join(f"{1e3 * side:.0f}" for side in box)
    return Precondition(
        "5.1",
        "configurations evenly spaced in the operating space",
        f"flange positions span {found} mm (x, y, z)",
        None,
    )


def _recorded_temperature(readings: Readings) -> Precondition:
    requirement = f"{AMBIENT:.0f} °C ± {TOLERANCE:.0f} °C"
    known = readings.temperature[np.isfinite(readings.temperature)]
    if not len(known):
        return Precondition("5.1", requirement, "no temperature recorded", None, TEMPERATURE)
    low, high = float(known.min()), float(known.max())
    inside = abs(low - AMBIENT) <= TOLERANCE and abs(high - AMBIENT) <= TOLERANCE
    found, whole = f"{low:.1f} to {high:.1f} °C", len(known) == len(readings)
    if not whole:
        found += f", known of {len(known):,} of {len(readings):,} readings"
    return Precondition("5.1", requirement, found, (True if whole else None) if inside else False, TEMPERATURE)


def _recorded_load(cell: Cell, space: OperatingSpace) -> Precondition:
    assert space.force is not None  # noqa: S101 - asked for only with a load
    largest = float(np.linalg.norm(space.force + cell.tool_weight, axis=1).max())
    rated = cell.robot.rated_load * (float(np.linalg.norm(cell.gravity)) or STANDARD_GRAVITY)
    sensor = cell.instruments.force_torque
    expanded = 2 * np.sqrt(3) * (0.0 if sensor is None else sensor.sigma_force)  # k = 2, three axes
    weight = float(np.linalg.norm(cell.tool_weight))
    found = f"largest force {largest:,.0f} N, {100 * largest / rated:.1f} %"
    found += f", with the end effector's weight of {weight:,.0f} N" if weight else ", without the end effector's weight"
    if rated < largest <= rated + expanded:
        found = (
            f"largest reading {largest:.0f} N, above the limit by {largest - rated:.1f} N, which is within the "
            f"measurement uncertainty of the force (± {expanded:.1f} N, k = 2): whether it is met stays open"
        )
    return Precondition(
        "5.1",
        f"load at most 100 % of the rated load ({cell.robot.rated_load:g} kg, {rated:,.0f} N)",
        f"{found} (torques are not part of this check)",
        True if largest <= rated else None if largest <= rated + expanded else False,
        "rated_load",
    )


def _unloaded(readings: Readings, cell: Cell) -> list[Precondition]:
    """Say whether every loaded configuration was measured without load, too; displacements are differences already."""
    if readings.wrench is None or cell.measurements.points == "displacement":
        return []
    light = relative_pull(readings) <= UNLOADED
    bare, every = len(np.unique(readings.configuration[light])), len(np.unique(readings.configuration))
    found = f"{bare} of {every} configurations"
    return [Precondition("7.6", "the unloaded position measured in every configuration", found, bare == every)]


def _recorded_ratio(space: OperatingSpace, sigma: float) -> Precondition:
    requirement = "test uncertainty ratio not lower than 1:5"
    if space.deflection is None:
        found = "no deflection is measured in an absolute recording"
        return Precondition("5.3", requirement, found, None, "uncertainty_ratio", shall=False)
    size = float(np.sqrt(np.mean(np.sum(space.deflection**2, axis=1))))
    expanded = 2 * np.sqrt(2 * 3) * sigma  # of the length of a difference of two readings, three coordinates
    ratio = size / expanded
    found = (
        f"1:{ratio:.1f} (deflection {1e3 * size:.3f} mm rms, "
        f"expanded uncertainty of a deflection {1e6 * expanded:.0f} µm, k = 2)"
    )
    met = bool(ratio >= TEST_UNCERTAINTY_RATIO)
    return Precondition("5.3", requirement, found, met, "uncertainty_ratio", shall=False)


def _calibrated(cell: Cell, start: str) -> list[Precondition]:
    """Say of each instrument whether it was calibrated before the measurement, whose start is in ISO 8601."""
    instruments = (
        ("laser tracker", cell.instruments.tracker),
        ("force/torque sensor", cell.instruments.force_torque),
        ("thermometer", cell.instruments.temperature),
    )
    return [
        Precondition("5.3", f"{label} calibrated", *_calibrated_before(instrument.calibrated, start))
        for label, instrument in instruments
        if instrument is not None
    ]


def _calibrated_before(stated: str, start: str) -> tuple[str, bool | None]:
    if not stated:
        return "no calibration date in the cell file", None
    calibrated, measured = day_of(stated), day_of(start)
    if calibrated is None:
        return f"“{stated}” in the cell file, which is no date (YYYY-MM-DD)", None
    if measured is None:
        return f"{stated}; the recording does not say when it was measured", None
    if calibrated > measured:
        return f"{stated}, which is after the measurement of {measured}", False
    return stated, True


def day_of(text: str) -> dt.date | None:
    """Return the day at which a text in ISO 8601 begins; None where it begins otherwise."""
    try:
        return dt.date.fromisoformat(text[:10])
    except ValueError:
        return None


def _singularities(space: OperatingSpace, *, k_csm: bool) -> Precondition:
    worst = int(np.argmin(space.singularity))
    distance = float(space.singularity[worst])
    found = f"nearest: configuration {int(space.configuration[worst])}, smallest singular value {distance:.3f}"
    if space.k_csm_share is not None:
        share = 1e6 * float(space.k_csm_share.max())
        moves = "neglecting K_CSM would move" if k_csm else "K_CSM, which this method neglects, moves"
        found += f"; {moves} points by up to {share:.1f} µm"
    met = bool(distance >= NEAR_SINGULAR)
    return Precondition("6.2", "configurations far from kinematic singularities", found, met, shall=False)


# --- the conditions that the standard puts on a measurement, judged while it is made (CWA 17384, 5.1 to ---------------


STABLE = 1.0  # K: largest change of temperature over STABLE_TIME (the standard gives no figure)
STABLE_TIME = 3600.0  # s
OVERDUE = 1.5  # periods without a start-up cycle that are overdue: one may run out within a configuration
ROUNDING = 1.001  # a planned load may exceed the rated one by the rounding of the plan file
MUCH_STIFFER = 10.0  # times as stiff as the robot is "considerably stiffer" (the standard gives no figure)
NAMES = (
    "temperature", "temperature_stable", "start_up", "rated_load", "uncertainty_ratio", "end_effector", "servo",
    "manual_mode", "reduced_speed",
)  # fmt: skip
MANUAL = {"MANUAL_REDUCED", "MANUAL_HIGH", "MANUAL_UNSPECIFIED"}


@dataclasses.dataclass(frozen=True, eq=False)
class CellState:
    """What is known of the cell now.

    Attributes:
        temperature: (k, 2) s and degrees Celsius, in the order of time, the last row as of now: NaN where the
            thermometer is silent; empty without a thermometer.
        mode: Operating mode by its name in `motion.robot_status`; empty: unknown.
        drives: Whether the servos are on; None: unknown.
        warm_up_age: s since the start-up cycle ended; NaN: it has not been driven through.
        warm_up_period: s, after which it has to be repeated; infinite: never.
        largest_force: N, of the plan.
        uncertainty_ratio: Expected deflection over its expanded uncertainty; NaN: unknown.
        tool_stiffness: Stiffness of the end effector over that of the robot; NaN: unknown.
        speed: m/s, that no monitored point exceeds as planned.
    """

    temperature: Float2D
    mode: str = ""
    drives: bool | None = None
    warm_up_age: float = math.nan
    warm_up_period: float = math.inf
    largest_force: float = 0.0
    uncertainty_ratio: float = math.nan
    tool_stiffness: float = math.nan
    speed: float = math.nan


def judge(state: CellState, cell: Cell, overrides: Iterable[Override] = ()) -> tuple[Condition, ...]:
    """Judge every condition."""
    found = (
        _temperature(state),
        _stable(state),
        _start_up(state),
        _rated_load(state, cell),
        _uncertainty_ratio(state),
        _end_effector(state),
        _servo(state),
        _manual(state),
        _speed(state),
    )
    by_name = {override.condition: override for override in overrides}
    return tuple(dataclasses.replace(one, override=by_name.get(one.name)) for one in found)


def _temperature(state: CellState) -> Condition:
    limit = f"{AMBIENT:.0f} °C ± {TOLERANCE:.0f} °C"
    if not len(state.temperature):
        return Condition("temperature", "5.1", "test temperature", limit, "no thermometer is heard", None, shall=True)
    now = float(state.temperature[-1, 1])
    if math.isnan(now):
        return Condition("temperature", "5.1", "test temperature", limit, "the thermometer is silent", None, shall=True)
    met = abs(now - AMBIENT) <= TOLERANCE
    return Condition("temperature", "5.1", "test temperature", limit, f"{now:.1f} °C", met, shall=True)


def _stable(state: CellState) -> Condition:
    what, limit = "thermally stable condition", f"change of at most {STABLE:g} K in an hour"
    row = state.temperature[np.isfinite(state.temperature[:, 1])]
    recent = row[row[:, 0] >= row[-1, 0] - STABLE_TIME] if len(row) else row
    if len(recent) < 2:
        return Condition("temperature_stable", "5.1", what, limit, "not known yet", None, shall=False)
    change, span = float(np.ptp(recent[:, 1])), float(np.ptp(recent[:, 0]))
    value = f"{change:.2f} K in the last {span / 60:.0f} min"
    steady = change <= STABLE * min(span / STABLE_TIME, 1.0)  # so far it would not change by more in an hour
    met = False if change > STABLE else (True if steady else None)
    return Condition("temperature_stable", "5.1", what, limit, value, met, shall=False)


def _start_up(state: CellState) -> Condition:
    what = "start-up cycle before the test, repeated periodically"
    never = math.isinf(state.warm_up_period)
    period = state.warm_up_period / 60
    limit = (
        "before the first reading"
        if never
        else f"repeated after {period:.0f} min, at the latest after {OVERDUE * period:.0f} min"
    )
    if math.isnan(state.warm_up_age):
        return Condition("start_up", "5.2", what, limit, "none has been driven through here", None, shall=True)
    value, met = f"{state.warm_up_age / 60:.0f} min ago", state.warm_up_age <= OVERDUE * state.warm_up_period
    return Condition("start_up", "5.2", what, limit, value, met, shall=True)


def _rated_load(state: CellState, cell: Cell) -> Condition:
    rated = cell.robot.rated_load * (float(np.linalg.norm(cell.gravity)) or STANDARD_GRAVITY)
    force = state.largest_force + float(np.linalg.norm(cell.tool_weight))
    value, met = f"{force:.0f} N at most", force <= ROUNDING * rated
    return Condition("rated_load", "5.1", "load within the rated load", f"{rated:.0f} N", value, met, shall=True)


def _uncertainty_ratio(state: CellState) -> Condition:
    what, limit = "test uncertainty ratio", f"1:{TEST_UNCERTAINTY_RATIO:.0f}"
    if math.isnan(state.uncertainty_ratio):
        return Condition("uncertainty_ratio", "5.3", what, limit, "no stiffness to expect from", None, shall=False)
    met = state.uncertainty_ratio >= TEST_UNCERTAINTY_RATIO
    value = f"1:{state.uncertainty_ratio:.0f} expected under the full load"
    return Condition("uncertainty_ratio", "5.3", what, limit, value, met, shall=False)


def _end_effector(state: CellState) -> Condition:
    what = "end effector considerably stiffer than the robot, or its compliance accounted for"
    limit = f"{MUCH_STIFFER:.0f} times as stiff, or accounted for"
    if math.isnan(state.tool_stiffness):
        return Condition("end_effector", "5.1", what, limit, "its stiffness is not stated", None, shall=True)
    stiff = state.tool_stiffness >= MUCH_STIFFER
    value = f"{state.tool_stiffness:.3g} times as stiff" + ("" if stiff else "; stated, and accounted for")
    return Condition("end_effector", "5.1", what, limit, value, met=True, shall=True)


def _servo(state: CellState) -> Condition:
    value = {True: "on", False: "off", None: "unknown"}[state.drives]
    return Condition("servo", "5.1", "servos activated, brakes deactivated", "on", value, state.drives, shall=True)


def _manual(state: CellState) -> Condition:
    value = state.mode.lower().replace("_", " ") or "unknown"
    met = None if not state.mode else state.mode in MANUAL
    return Condition("manual_mode", "5.1", "measured in manual mode", "manual", value, met, shall=True)


def _speed(state: CellState) -> Condition:
    what, limit = "safety-rated reduced speed of every monitored point", f"{1e3 * REDUCED_SPEED:.0f} mm/s"
    if math.isnan(state.speed):
        return Condition("reduced_speed", "5.1", what, limit, "unknown", None, shall=True)
    value = f"planned for at most {1e3 * state.speed:.0f} mm/s"
    return Condition("reduced_speed", "5.1", what, limit, value, state.speed <= REDUCED_SPEED, shall=True)


def expected_ratio(planned: Sequence[Loading], cell: Cell) -> float:
    """Return the expected deflection over its expanded uncertainty (k = 2), rms over configurations and points.

    Returns:
        The test uncertainty ratio, NaN where stiffness, load or the tracker's uncertainty is not known.
    """
    parameters, tracker = nominal_parameters(cell), cell.instruments.tracker
    known = cell.frames.tracker is not None or tracker.sigma is not None
    if not (planned and known and np.any(parameters.compliance) and parameters.wrench_point is not None):
        return math.nan
    schedule = Schedule.of(planned)
    position = predict_schedule(schedule, cell, parameters).position
    sizes = []
    for number in np.unique(schedule.configuration):
        rows = np.flatnonzero(schedule.configuration == number)
        full = rows[np.argmax(np.linalg.norm(schedule.wrench[rows, :3], axis=1))]
        sizes.append(np.sum((position[full] - position[rows[0]]) ** 2, axis=1))
    deflection = float(np.sqrt(np.mean(sizes)))
    variance = np.einsum("mii->m", tracker_covariance(cell, position.reshape(-1, 3)))  # of a length, as the deflection
    return deflection / (2 * math.sqrt(2) * float(np.sqrt(variance.mean()))) if deflection > 0.0 else math.nan
