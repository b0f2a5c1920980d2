"""The conditions that the standard puts on a measurement, judged while it is made (CWA 17384, 5.1 to 5.3).

Each has a limit, a value and a verdict.  What cannot be seen is unknown, which is no violation: the guard decides
whether the robot may move, and what it does not know it takes as a no.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence

import numpy as np

from calibration_core.cell import REDUCED_SPEED, Cell
from calibration_core.identification.checks.preconditions import (
    AMBIENT,
    STANDARD_GRAVITY,
    TEST_UNCERTAINTY_RATIO,
    TOLERANCE,
)
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.simulation.simulate import Loading, Schedule, predict_schedule, tracker_covariance
from calibration_core.timeseries import Condition, Float2D, Override

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
