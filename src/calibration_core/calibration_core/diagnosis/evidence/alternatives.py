"""What loaded steps leave open about the structure that gives way, in the covariance of everything beside it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from calibration_core.diagnosis.evidence.design import PRIOR_WIDTH, Design
from calibration_core.diagnosis.evidence.extended import ExtendedLoadedModel
from calibration_core.diagnosis.evidence.selection import Choice, LoadedSelection
from calibration_core.estimation.alternatives.covariance import (
    STRUCTURE,
    fuller_form,
    instead,
    left_open,
    neglected,
    shares,
)
from calibration_core.identification.statistics.offsets import whitened
from calibration_core.model.effects.candidate import Candidate
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


def with_alternatives(extended: ExtendedLoadedModel, selection: LoadedSelection) -> ExtendedLoadedModel:
    """Return the model with a covariance that says what place and form of structural effects leave open."""
    design = extended.design
    choices = [one for one in selection.choices if design.candidates[one.candidate].family == STRUCTURE]
    if not choices:
        return extended
    fit = _fitted(design, extended.accepted)
    ways = [way for choice in choices for way in (*_elsewhere(extended, fit, choice), *_unequal(extended, fit, choice))]
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


def _elsewhere(extended: ExtendedLoadedModel, fit: _Fit, choice: Choice) -> Iterator[Float2D]:
    """Yield (q, c) for each place and form that does as well: what everything else may be off by, by its probability.

    Of one at another place no form is known: the fullest freedom that it may have is taken.
    """
    candidates, own = extended.design.candidates, fit.own[choice.candidate]
    moved = fit.columns[:, own] @ fit.value[own]
    as_well = (*((index, nats - choice.log_bayes_factor) for index, nats in choice.equivalents), *choice.forms)
    for (index, _), share in zip(as_well, shares([nats for _, nats in as_well]), strict=True):
        if index in fit.own:
            continue
        other = fuller_form(candidates[index], candidates) or candidates[index]
        columns = _white(extended, other) * (PRIOR_WIDTH * np.array([one.typical for one in other.parameters]))
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
    """Yield (q, c): what everything else may be off by where a form has more sizes in truth."""
    design = extended.design
    mine = design.candidates[choice.candidate]
    fuller = fuller_form(mine, design.candidates)
    if fuller is None:
        return
    value = fit.value[fit.own[choice.candidate]] * design.prior[design.blocks[choice.candidate]]
    columns = neglected(_white(extended, mine), _white(extended, fuller), mine, fuller, value)
    yield left_open(fit.normal, 1.0, fit.columns.T @ columns, columns.T @ columns, columns.T @ fit.rest)


def _white(extended: ExtendedLoadedModel, candidate: Candidate) -> Float2D:
    """Return the whitened columns of a candidate, (r, k), per unit of its parameters."""
    return whitened(extended.rows, candidate.columns(extended.state), extended.used)[0]
