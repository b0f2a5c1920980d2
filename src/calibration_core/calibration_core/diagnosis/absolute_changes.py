"""A target or the tracker that moved part-way through an absolute recording, found as a change point.

Each hypothesis is a step at one configuration: of a target in the flange frame, or of the tracker in the base frame
(six parameters).  What is constant after the change tells which of the two it is.  A step is an anomaly, not physics;
it is claimed only if it dwarfs the rest or stands out beside the physics found (where a recording turns to other
postures, what is missing makes a step in the rest, too).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from calibration_core.diagnosis.absolute_design import PRIOR_WIDTH, AbsoluteDesign
from calibration_core.diagnosis.absolute_evidence import evidence, project
from calibration_core.diagnosis.absolute_fit import AbsoluteExtended
from calibration_core.diagnosis.blocks import Blocks
from calibration_core.identification.estimate import Anomaly
from calibration_core.model.effects.candidate import Candidate, Parameter
from calibration_core.model.effects.springs import stacked
from calibration_core.model.effects.state import State
from calibration_core.model.kinematics import cross
from calibration_core.timeseries import Bool1D, Float3D, Int1D, Readings

FAMILY = "anomaly"
MOVED, TURNED = 1e-3, 1e-3  # m, rad: typical
POSITIONS = 60  # change points tried
EDGE = 3  # configurations at either end that show no change
LEAST = 5e-5  # m; smaller steps are not worth a word
LEAST_SHARE = {True: 0.5, False: 0.1}  # of the squared rest, that a step must explain (dwarfing, beside physics)
MOST = 3  # steps
EQUIVALENT = 5.0  # nats
AXES = ("x", "y", "z")


def changes(readings: Readings, near: Int1D | None = None) -> tuple[Candidate, ...]:
    """Return the steps to be tried: evenly over the configurations, or the given ones.

    Args:
        readings: The recording, in the order of time.
        near: Positions (index of the first configuration after the change, in the order of time).
    """
    order = _in_time(readings.configuration)
    count = int(order.max()) + 1
    if near is None:
        near = np.unique(np.linspace(EDGE, count - EDGE, POSITIONS).astype(np.int64))
    inside = [int(k) for k in near if EDGE <= k <= count - EDGE]
    found = []
    for k in inside:
        after = order >= k
        for point, name in enumerate(readings.points):
            found.append(_target(name, k, after & (readings.point == point)))
        found.append(_tracker(k, after))
    return tuple(found)


def position_of(candidate: Candidate) -> int:
    """Return the index, in the order of time, of the first configuration after the change."""
    return int(candidate.variant.removeprefix("from position "))


def anomaly_of(
    candidate: Candidate, extended: AbsoluteExtended, index: int, readings: Readings, beside: Sequence[str]
) -> Anomaly:
    """Say in words which rows are concerned, in which frame the step is constant and how far it goes.

    Args:
        candidate: The step.
        extended: The extended model that contains it.
        index: Its position there.
        readings: The recording.
        beside: Other kinds of step that fit nearly as well.
    """
    value, _ = extended.values_of(index)
    shift = extended.shift(extended.state, (index,))
    concerned = np.any(shift != 0, axis=1)
    size = float(np.sqrt(np.mean(np.sum(shift[concerned] ** 2, axis=1))))
    order = _in_time(readings.configuration)
    numbers = readings.configuration
    k, last = position_of(candidate), int(order.max())
    later = last + 1 - k <= k
    rows = order >= k if later else order < k
    span = (int(numbers[rows][0]), int(numbers[rows][-1]))
    frame = "the flange" if candidate.effect == "target_moved" else "the base"
    vector = ", ".join(f"{1e3 * v:+.2f}" for v in value[:3])
    doubt = f" A step of {' or '.join(beside)} fits nearly as well." if beside else ""
    before, after = int(numbers[order == k - 1][-1]), int(numbers[order == k][0])
    text = (
        f"between configurations {before} and {after} the readings step by "
        f"{1e3 * size:.2f} mm, constant in the frame of {frame} ({vector} mm); configurations {span[0]} to {span[1]} "
        f"stand apart from the others.{doubt}"
    )
    return Anomaly(candidate.effect, dict(_location(candidate)), span, size, "m", text)


@dataclasses.dataclass(frozen=True, eq=False)
class Steps:
    """Steps that stand out.

    Attributes:
        found: One hypothesis per step, most evident first.
        beside: Key of a step -> other kinds of step that fit nearly as well.
    """

    found: tuple[Candidate, ...]
    beside: dict[object, tuple[str, ...]]


def select_changes(
    build: Callable[[tuple[Candidate, ...]], AbsoluteDesign],
    readings: Readings,
    partitions: Sequence[Blocks],
    known: tuple[Candidate, ...],
    *,
    dwarfing: bool,
) -> Steps:
    """Look for steps beside what is known.

    Args:
        build: Sets up the linear model for given hypotheses.
        readings: The recording.
        partitions: Of the model's readings.
        known: Effects and steps that are part of the model.
        dwarfing: Only steps that explain more than half of the squared rest; else a tenth is enough.
    """
    found: list[Candidate] = []
    beside: dict[object, tuple[str, ...]] = {}
    for _ in range(MOST):
        first = (*known, *found)
        best = _best(build((*first, *changes(readings))), len(first), partitions, LEAST_SHARE[dwarfing])
        if best is None:
            break
        near = np.arange(position_of(best[0]) - _spacing(readings), position_of(best[0]) + _spacing(readings) + 1)
        best = _best(build((*first, *changes(readings, near))), len(first), partitions, LEAST_SHARE[dwarfing])
        if best is None:
            break
        found.append(best[0])
        beside[best[0].key] = best[1]
    return Steps(tuple(found), beside)


def _best(
    design: AbsoluteDesign, first: int, partitions: Sequence[Blocks], share: float
) -> tuple[Candidate, tuple[str, ...]] | None:
    """Return the most evident step that passes, large enough, and other kinds that fit nearly as well."""
    accepted = tuple(range(first))
    scores = evidence(design, accepted, partitions)
    plain = np.where(scores.passing, scores.plain, -np.inf)
    index = int(np.argmax(plain)) if len(plain) else -1
    if index < 0 or not np.isfinite(plain[index]):
        return None
    at = project(design, accepted)
    own = at.columns[:, design.blocks[index]]
    value = np.linalg.lstsq(own, at.residual, rcond=1e-9)[0]
    explained = float(np.sum((own @ value) ** 2) / np.sum(at.residual**2))
    size = float(np.linalg.norm(PRIOR_WIDTH * MOVED * value[:3]))
    if explained < share or size < LEAST:
        return None
    scale = min(scores.weakest(index) / scores.plain[index], 1.0)
    mine = design.candidates[index]
    others: dict[str, None] = {}
    for i, candidate in enumerate(design.candidates[first:], start=first):
        near = abs(position_of(candidate) - position_of(mine)) <= EDGE
        close = scale * (scores.plain[index] - scores.plain[i]) < EQUIVALENT
        if near and close and candidate.place != mine.place:
            others[f"{candidate.effect} ({', '.join(str(v) for v in candidate.location.values())})"] = None
    return mine, tuple(others)


def _spacing(readings: Readings) -> int:
    return max(len(np.unique(readings.configuration)) // POSITIONS, 1)


def _location(candidate: Candidate) -> dict[str, str | int]:
    return {key: value for key, value in candidate.location.items() if isinstance(value, str)}


def _in_time(configuration: Int1D) -> Int1D:
    _, first, index = np.unique(configuration, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[index.reshape(-1)].astype(np.int64)


def _target(name: str, position: int, after: Bool1D) -> Candidate:
    parameters = tuple(Parameter(axis, "m", MOVED) for axis in AXES)
    columns = partial(_target_columns, after=after)
    return Candidate("target_moved", FAMILY, {"point": name}, f"from position {position}", parameters, columns)


def _tracker(position: int, after: Bool1D) -> Candidate:
    shifts = tuple(Parameter(axis, "m", MOVED) for axis in AXES)
    turns = tuple(Parameter(f"r{axis}", "rad", TURNED) for axis in AXES)
    columns = partial(_tracker_columns, after=after)
    location = {"tracker": "tracker"}
    return Candidate("tracker_moved", FAMILY, location, f"from position {position}", (*shifts, *turns), columns)


def _target_columns(state: State, after: Bool1D) -> Float3D:
    return stacked(*((axis * after).T for axis in state.at.flange))


def _tracker_columns(state: State, after: Bool1D) -> Float3D:
    unit = np.eye(3)[:, :, None] * after
    arm = state.point - state.point.mean(axis=1, keepdims=True)
    turns = [cross(np.broadcast_to(axis[:, None], arm.shape), arm) * after for axis in np.eye(3)]
    return stacked(*(axis.T for axis in unit), *(turn.T for turn in turns))
