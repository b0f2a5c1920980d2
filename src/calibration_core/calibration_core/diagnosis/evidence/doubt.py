"""What loaded steps leave open about the structure that gives way, in the covariance of everything beside it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from calibration_core.diagnosis.evidence.design import Design
from calibration_core.diagnosis.evidence.extended import ExtendedLoadedModel
from calibration_core.diagnosis.evidence.selection import Choice, LoadedSelection
from calibration_core.estimation.doubt import STRUCTURE, fuller_form, instead, left_open, neglected, shares
from calibration_core.identification.statistics.offsets import whitened
from calibration_core.timeseries import Float1D, Float2D


@dataclasses.dataclass(frozen=True, eq=False)
class _Fit:
    """Compliances, accepted effects, and what instruments and chance do, by least squares.

    Attributes:
        columns: (r, q) whitened, of effects per standard deviation of the prior.
        normal: (q, q) their products, with the precision of the priors.
        value: (q,) the solution.
        rest: (r,) what it leaves.
        own: Candidate -> its columns.
    """

    columns: Float2D
    normal: Float2D
    value: Float1D
    rest: Float1D
    own: dict[int, slice]


def doubted(extended: ExtendedLoadedModel, selection: LoadedSelection) -> ExtendedLoadedModel:
    """Return the model with a covariance that says what place and form of structural effects leave open.

    Args:
        extended: The model.
        selection: What was accepted, and what does as well at other places.
    """
    design = extended.design
    choices = [one for one in selection.choices if design.candidates[one.candidate].family == STRUCTURE]
    if not choices:
        return extended
    fit = _fitted(design, extended.accepted)
    ways = [way for choice in choices for way in (*_elsewhere(design, fit, choice), *_unequal(extended, fit, choice))]
    count = len(extended.covariance)
    unit = np.concatenate([np.ones(design.n), *(design.prior[design.blocks[i]] for i in extended.accepted)])
    more = np.column_stack([np.zeros((count, 0)), *(way[:count] * unit[:, None] for way in ways)])
    return dataclasses.replace(extended, covariance=extended.covariance + more @ more.T)


def _fitted(design: Design, accepted: tuple[int, ...]) -> _Fit:
    own, start = {}, design.n
    for index in accepted:
        width = design.blocks[index].stop - design.blocks[index].start
        own[index] = slice(start, start + width)
        start += width
    chances = [design.columns[:, design.chances[index]] for index in accepted]
    columns = np.column_stack([design.fitted(accepted), design.columns[:, design.discrepancy], *chances])
    normal = columns.T @ columns + np.diag(np.where(np.arange(columns.shape[1]) < design.n, 0.0, 1.0))
    unit = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    value = np.linalg.pinv(normal / np.outer(unit, unit), hermitian=True) @ (columns.T @ design.residual / unit) / unit
    return _Fit(columns, normal, value, design.residual - columns @ value, own)


def _elsewhere(design: Design, fit: _Fit, choice: Choice) -> Iterator[Float2D]:
    """Yield (q, c) for each place that does as well: what everything else may be off by, by its probability."""
    own = fit.own[choice.candidate]
    moved = fit.columns[:, own] @ fit.value[own]
    nats = [one - choice.log_bayes_factor for _, one in choice.equivalents]
    for (index, _), share in zip(choice.equivalents, shares(nats), strict=True):
        columns = design.columns[:, design.blocks[index]]
        if not columns.shape[1] or index in fit.own:
            continue
        ways = instead(
            fit.normal,
            np.arange(own.start, own.stop),
            fit.columns.T @ moved,
            fit.columns.T @ columns,
            columns.T @ columns + np.eye(columns.shape[1]),
            columns.T @ (moved + fit.rest),
            1.0,
        )
        yield np.sqrt(share) * ways


def _unequal(extended: ExtendedLoadedModel, fit: _Fit, choice: Choice) -> Iterator[Float2D]:
    """Yield (q, c): what everything else may be off by where a form of one size has several in truth."""
    design, state = extended.design, extended.state
    mine = design.candidates[choice.candidate]
    fuller = fuller_form(mine, design.candidates)
    if fuller is None:
        return
    data = np.concatenate([mine.columns(state), fuller.columns(state)], axis=2)
    white, _ = whitened(extended.rows, data, extended.used)
    own = fit.own[choice.candidate]
    value = float(fit.value[own][0] * design.prior[design.blocks[choice.candidate]][0])
    columns = neglected(white[:, 0], white[:, 1:], mine, fuller, value)
    yield left_open(fit.normal, 1.0, fit.columns.T @ columns, columns.T @ columns, columns.T @ fit.rest)
