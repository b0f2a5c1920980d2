"""Which few poses decide whether an old calibration still holds.

A calibration no longer holds where something has changed: a joint's zero, the frame of a joint, a stiffness.  Such a
change moves the tool by a field of errors over the operating space.  Poses decide if every single change whose errors
reach the tolerance in 5 % of the operating space shows an error of the tolerance at one of them, after the tracker's
pose is fitted anew; a robot that has not changed must conform there.  Both then hold with a probability of one less the
risk, by the decision rule of `decision`.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.acceptance.decision import guard_factor
from calibration_core.acceptance.verification import frame_columns, verify
from calibration_core.cell import Cell
from calibration_core.identification.statistics import normal_quantile
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.identified.calibrated import CalibratedModel
from calibration_core.model.identified.named_values import value_of, with_values
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D, Readings

FEWEST, MOST = 5, 8  # poses
REACHED = 0.95  # share of the operating space in which the errors of a change stay below its size
UNSEEN = 1e-6  # of the largest: a change that a new pose of the tracker takes up moves nothing
STARTS = 3
PASSES = 4
STEP = 1e-5  # m and rad of geometry, for derivatives
SHARE = 1e-2  # of a compliance, likewise


@dataclasses.dataclass(frozen=True, eq=False)
class Recheck:
    """What the chosen poses can decide.

    Attributes:
        chosen: Numbers of the configurations, ascending.
        coverage: Change -> largest error at the poses over the size of the change; at least 1 where it is decided.
        tolerance: m.
        risk: Of either wrong answer.
        least_tolerance: m, smallest tolerance at which an unchanged robot conforms with these poses and instruments.
        uncertainty: m, standard uncertainty of the least certain reading.
    """

    chosen: Int1D
    coverage: dict[str, float]
    tolerance: float
    risk: float
    least_tolerance: float
    uncertainty: float

    @property
    def needed(self) -> float:
        """What the coverage must reach for the risk to hold."""
        return 1.0 + (normal_quantile(1 - self.risk) - guard_factor()) * self.uncertainty / self.tolerance

    @property
    def missed(self) -> tuple[str, ...]:
        """Changes that these poses do not decide, the worst first."""
        open_ = {name: share for name, share in self.coverage.items() if share < self.needed}
        return tuple(sorted(open_, key=open_.__getitem__))


def recheck(
    readings: Readings, cell: Cell, model: CalibratedModel, tolerance: float, risk: float, seed: int = 0
) -> Recheck:
    """Choose the smallest set of 5 to 8 poses that decides; the best of 8 where none does.

    Args:
        readings: What the model predicts at all configurations that could be measured: the operating space.
        cell: The cell.
        model: The calibration in question.
        tolerance: m.
        risk: Probability of either wrong answer.
        seed: Of the search.
    """
    names, fields = changes_of(readings, cell, model)
    numbers = np.unique(readings.configuration)
    rows = [np.flatnonzero(readings.configuration == number) for number in numbers]
    frame = frame_columns(readings)
    sizes = _sizes(_without_frame(fields, frame))
    kept = sizes > UNSEEN * sizes.max()
    names = tuple(name for name, keep in zip(names, kept, strict=True) if keep)
    scaled = fields[:, :, kept] / sizes[kept]
    rng = np.random.default_rng(seed)
    best: list[int] = []
    found: Recheck | None = None
    for count in range(min(FEWEST, len(rows)), min(MOST, len(rows)) + 1):
        best = _searched(scaled, frame, rows, count, best, rng)
        coverage = _coverage(scaled, frame, rows, best)
        some = readings.select(np.concatenate([rows[k] for k in best]))
        judged = verify(some, cell, model, tolerance, fit_tracker=True)
        uncertainty = float(judged.uncertainty.max())
        each = (1 - risk) ** (1 / len(some))  # all readings of an unchanged robot conform
        least = uncertainty * (guard_factor() + normal_quantile(each))
        shares = dict(zip(names, map(float, coverage), strict=True))
        found = Recheck(np.sort(numbers[best]), shares, tolerance, risk, least, uncertainty)
        if not found.missed:
            break
    assert found is not None  # noqa: S101 - there are poses
    return found


def changes_of(readings: Readings, cell: Cell, model: CalibratedModel) -> tuple[tuple[str, ...], Float3D]:
    """Return the changes that are looked for, and (m, 3, k) m per unit, how they move the predictions, tracker frame.

    They are the zero of every joint, every number of the geometry that was identified, and every stiffness.
    """
    parameters = model.parameters
    known = () if model.estimate is None else model.estimate.names
    zeros = [
        f"geometry.{j}.{'z' if slides else 'rz'}" for j, slides in zip(parameters.joints, cell.prismatic, strict=True)
    ]
    names = [*zeros, *(name for name in known if name.startswith("geometry.") and name not in zeros)]
    if readings.wrench is not None:
        names += [f"compliance.{j}" for j, c in zip(parameters.joints, parameters.compliance, strict=True) if c > 0]
    columns = []
    for name in names:
        value = value_of(parameters, name)
        step = SHARE * value if name.startswith("compliance.") else STEP
        ends = [
            predict_readings(readings, cell, with_values(parameters, {name: value + sign * step}))
            for sign in (1.0, -1.0)
        ]
        columns.append((ends[0] - ends[1]) / (2 * step))
    return tuple(names), np.stack(columns, axis=-1)


def _searched(
    scaled: Float3D, frame: Float3D, rows: list[Int1D], count: int, start: list[int], rng: np.random.Generator
) -> list[int]:
    """Return poses with the largest smallest coverage: exchanges from several starts, one of them the smaller set's."""
    starts = [list(map(int, rng.permutation(len(rows))[:count])) for _ in range(STARTS)]
    if start:
        free = [k for k in range(len(rows)) if k not in start]
        starts.append([*start, *map(int, rng.permutation(free)[: count - len(start)])])
    found = [_exchanged(scaled, frame, rows, one) for one in starts]
    return max(found, key=lambda one: one[0])[1]


def _exchanged(
    scaled: Float3D, frame: Float3D, rows: list[Int1D], chosen: list[int]
) -> tuple[tuple[float, float], list[int]]:
    score = _score(scaled, frame, rows, chosen)
    for _ in range(PASSES):
        before = score
        for place in range(len(chosen)):
            for other in range(len(rows)):
                if other in chosen:
                    continue
                trial = [*chosen[:place], other, *chosen[place + 1 :]]
                reached = _score(scaled, frame, rows, trial)
                if reached > score:
                    chosen, score = trial, reached
        if score == before:
            break
    return score, chosen


def _score(scaled: Float3D, frame: Float3D, rows: list[Int1D], chosen: list[int]) -> tuple[float, float]:
    coverage = _coverage(scaled, frame, rows, chosen)
    return min(float(coverage.min()), 1.2), float(np.mean(np.log(np.maximum(coverage, 1e-9))))


def _coverage(scaled: Float3D, frame: Float3D, rows: list[Int1D], chosen: list[int]) -> Float1D:
    taken = np.concatenate([rows[k] for k in chosen])
    return np.linalg.norm(_without_frame(scaled[taken], frame[taken]), axis=1).max(axis=0)


def _without_frame(fields: Float3D, frame: Float3D) -> Float3D:
    """Return fields of errors (m, 3, k) less what the best rigid movement of the tracker takes up."""
    basis, _ = np.linalg.qr(frame.reshape(-1, 6))
    flat = fields.reshape(len(basis), -1)
    return np.asarray((flat - basis @ (basis.T @ flat)).reshape(fields.shape))


def _sizes(fields: Float3D) -> Float1D:
    """Return the (k,) sizes that the errors of each change stay below in 95 % of the operating space."""
    lengths: Float2D = np.linalg.norm(fields, axis=1)
    return np.asarray(np.quantile(lengths, REACHED, axis=0))
