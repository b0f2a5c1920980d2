"""All robots of a plant together: which stand out and why, what a type is like, what to measure next."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np

from calibration_core.fleet.ageing import History, Life, history, life
from calibration_core.fleet.findings import effect_shares, found_in
from calibration_core.fleet.pooling import Pooled, Population, pool
from calibration_core.fleet.reasons import RankingReason, law_reasons, stiffness_reasons
from calibration_core.fleet.recordings.rows import Row
from calibration_core.fleet.series import STIFFNESS, Quantity, quantities
from calibration_core.identification.statistics import normal_quantile

LEVEL = 0.002  # probability that a robot like its sisters stands out anywhere
TESTS_PER_QUANTITY = 3  # the population, steps and slope
SOFTER = math.log(0.8)  # limit of a stiffness: 20 % below the first measurement
LAW_LIMIT = 3e-4  # rad, limit of a backlash or hysteresis
LAW_SHOWN = 1e-4  # rad: the share of robots beyond it is stated
CONSPICUOUS, INCONSPICUOUS, UNKNOWN = "conspicuous", "inconspicuous", "unknown"


@dataclasses.dataclass(frozen=True, eq=False)
class JointState:
    """One quantity of one robot: raw and pooled side by side.

    Attributes:
        type, robot, kind, joint: Whose.
        raw: What its own dates tell; N*m/rad (N/m), or rad (m).
        raw_low, raw_high: 95 % interval.
        pooled: The same with what its sisters tell; the raw value where pooling is refused.
        pooled_low, pooled_high: 95 % interval.
        is_pooled: Whether sisters were used.
        deviation: Standard deviations from the population, measurement included; NaN where there is none.
        belongs: Whether the robot belongs to the population.
        history: Over its dates, in logarithms for a stiffness.
        life: Until the limit.
    """

    type: str
    robot: str
    kind: str
    joint: str
    raw: float
    raw_low: float
    raw_high: float
    pooled: float
    pooled_low: float
    pooled_high: float
    is_pooled: bool
    deviation: float
    belongs: bool
    history: History
    life: Life


@dataclasses.dataclass(frozen=True)
class FleetRobot:
    """One robot.

    Attributes:
        type, robot: Which.
        state: `conspicuous`, `inconspicuous`, or `unknown` where nothing usable was measured.
        score: Standard deviations of its strongest reason; 0 without.
        reasons: Strongest first.
        dates: Of usable recordings.
        failures: Recordings that failed or are not usable.
        last_failure: Why the last one was not, if the last recording was not usable.
    """

    type: str
    robot: str
    state: str
    score: float
    reasons: tuple[RankingReason, ...]
    dates: tuple[str, ...]
    failures: int
    last_failure: str


@dataclasses.dataclass(frozen=True, eq=False)
class PooledQuantity:
    """A quantity of a type with its population; None where too few robots belong together."""

    quantity: Quantity
    population: Population | None
    shares: Mapping[str, float]


@dataclasses.dataclass(frozen=True, eq=False)
class Plant:
    """What all rows say together.

    Attributes:
        robots: The most conspicuous first.
        states: Every quantity of every robot, sorted by type, robot, kind and joint.
        quantities: Every quantity of every type.
        effects: Type -> effect and place -> share of its robots whose last recording shows it.
        rows: Number of recordings.
        failed: Number of those that failed or are not usable.
    """

    robots: tuple[FleetRobot, ...]
    states: tuple[JointState, ...]
    quantities: tuple[PooledQuantity, ...]
    effects: Mapping[str, Mapping[str, float]]
    rows: int
    failed: int

    @property
    def types(self) -> tuple[str, ...]:
        """Names of the types, sorted."""
        return tuple(sorted({robot.type for robot in self.robots}))


def evaluate_plant(rows: Sequence[Row], alone: Collection[str] = ()) -> Plant:
    """Compare the robots of every type with each other, and each with itself over time; no recording is read again.

    Args:
        rows: Of the data set.
        alone: Names of robots that are not pooled: they stand for themselves.
    """
    found = quantities(rows)
    critical = _critical(found)
    states: list[JointState] = []
    pooled: list[PooledQuantity] = []
    for quantity in found:
        one, members = _evaluate(quantity, critical[quantity.type], alone)
        pooled.append(one)
        states += members
    states.sort(key=lambda state: (state.type, state.robot, state.kind, state.joint))
    effects = effect_shares(rows)
    robots = _robots(rows, states, effects, critical)
    failed = sum(not _usable(row) for row in rows)
    return Plant(robots, tuple(states), tuple(pooled), effects, len(rows), failed)


def _usable(row: Row) -> bool:
    return row.measured and row.usable != "no"


def _critical(found: Iterable[Quantity]) -> dict[str, float]:
    """Return, per type, the deviation that a quantity must have so that a robot stands out by chance in `LEVEL`."""
    counts: dict[str, int] = {}
    for quantity in found:
        counts[quantity.type] = counts.get(quantity.type, 0) + TESTS_PER_QUANTITY
    return {kind: normal_quantile(1 - LEVEL / (2 * count)) for kind, count in counts.items()}


def _evaluate(quantity: Quantity, critical: float, alone: Collection[str]) -> tuple[PooledQuantity, list[JointState]]:
    histories = [history(one.years, one.value, one.std, critical) for one in quantity.series]
    value = np.array([one.value for one in histories])
    std = np.array([one.std for one in histories])
    refused = np.array([one.robot in alone for one in quantity.series], dtype=bool)
    together = pool(value, std, critical, refused, judge_only=quantity.kind != STIFFNESS)
    shares = {} if quantity.kind == STIFFNESS else _shares(value, std)
    states = [
        _state(quantity, k, histories[k], together, refused=bool(refused[k])) for k in range(len(quantity.series))
    ]
    return PooledQuantity(quantity, None if together is None else together.population, shares), states


def _shares(value: np.ndarray, std: np.ndarray) -> dict[str, float]:
    """Return the expected share of robots whose law is larger than what is shown as such."""
    return {f"above_{LAW_SHOWN:g}_rad": float(np.mean([_above(v, s) for v, s in zip(value, std, strict=True)]))}


def _above(value: float, std: float) -> float:
    return 0.5 * math.erfc((LAW_SHOWN - value) / (math.sqrt(2) * std))


def _state(quantity: Quantity, k: int, found: History, together: Pooled | None, *, refused: bool) -> JointState:
    half = 1.959964 * found.std
    raw = (found.value, found.value - half, found.value + half)
    pooled, deviation, belongs, used = raw, math.nan, True, False
    if together is not None:
        pooled = (float(together.value[k]), float(together.low[k]), float(together.high[k]))
        deviation, belongs = float(together.deviation[k]), bool(together.belongs[k])
        used = belongs and not refused and quantity.kind == STIFFNESS
    series = quantity.series[k]
    if quantity.kind == STIFFNESS:
        raw, pooled = (tuple(math.exp(x) for x in three) for three in (raw, pooled))  # type: ignore[assignment]
        limit = float(series.value[0]) + SOFTER
    else:
        limit = LAW_LIMIT
    return JointState(
        quantity.type, series.robot, quantity.kind, quantity.joint, *raw, *pooled, used, deviation, belongs,
        found, life(found, limit),
    )  # fmt: skip


def _robots(
    rows: Sequence[Row],
    states: Iterable[JointState],
    effects: Mapping[str, Mapping[str, float]],
    critical: Mapping[str, float],
) -> tuple[FleetRobot, ...]:
    of_robot: dict[tuple[str, str], list[Row]] = {}
    for row in sorted(rows, key=lambda row: (row.date, row.recording)):
        of_robot.setdefault((row.type, row.robot), []).append(row)
    of_state: dict[tuple[str, str], list[JointState]] = {}
    for state in states:
        of_state.setdefault((state.type, state.robot), []).append(state)
    found = []
    for (kind, robot), members in of_robot.items():
        usable = [row for row in members if _usable(row)]
        dates = tuple(row.date for row in usable)
        reasons: list[RankingReason] = []
        for state in of_state.get((kind, robot), ()):
            make = stiffness_reasons if state.kind == STIFFNESS else law_reasons
            reasons += make(state, dates, critical[kind])
        reasons += [
            RankingReason(text, math.sqrt(2 * evidence), "finding")
            for text, evidence in found_in(usable, effects.get(kind, {}))
        ]
        reasons.sort(key=lambda reason: (-reason.score, reason.text))
        state_ = UNKNOWN if not usable else CONSPICUOUS if reasons else INCONSPICUOUS
        last = members[-1]
        failure = "" if _usable(last) else (last.error or last.reason)
        score = reasons[0].score if reasons else 0.0
        found.append(FleetRobot(kind, robot, state_, score, tuple(reasons), dates, len(members) - len(usable), failure))
    return tuple(sorted(found, key=lambda one: (-one.score, one.state != UNKNOWN, one.type, one.robot)))
