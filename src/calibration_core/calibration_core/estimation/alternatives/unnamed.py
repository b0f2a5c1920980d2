"""What small effects that were not named leave open, in the covariance of everything beside them.

Every robot bends a little everywhere.  Each place by itself may be too small to be named, and yet together they move
the compliances of the joints by more than the noise does.  How much of it there is, the recording says: all structural
places have the same signal-to-noise ratio, each of those that are tried with its probability w_l; that there is nothing
is beforehand as probable as that there is something.  And the law of a joint that was accepted is known to a share
only: other laws of that joint may hold the rest.  (What place and form of a structural effect leave open is in
`covariance.py`.)

    C + sum_l w_l gain (C_b + b b') gain',  b and C_b the mean and the covariance of the small effects of level l, given
    what is left

Source: Kennedy and O'Hagan 2001 with a physical kernel; Bayesian model averaging (Hoeting, Madigan, Raftery and
Volinsky 1999); consider parameters (Schmidt 1966).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.estimation.alternatives.confounding import lent
from calibration_core.estimation.alternatives.covariance import STRUCTURE, left_open, white_columns
from calibration_core.estimation.hypotheses import LAW, Offered, typical_sizes
from calibration_core.estimation.likelihood.restricted import Gram
from calibration_core.estimation.likelihood.small_effects import (
    LEVELS,
    MOST,
    SmallEffects,
    shared_power,
)
from calibration_core.estimation.refit import Extended
from calibration_core.estimation.search import Search, Selection
from calibration_core.timeseries import Float1D, Float2D

SELDOM = 0.05  # probability below which a level is no part of a 95 % interval


def with_unnamed(extended: Extended, search: Search, selection: Selection) -> Extended:
    """Return the extended model with a covariance that says what small effects leave open."""
    offered, small = search.field.offered, _small(search, selection)
    unit = shared_power(np.diag(search.field.gram.matrix), offered.candidates, offered.blocks)
    of_laws = _of_laws(search, selection, extended.parameters.joints)
    ways = [np.zeros((len(extended.length), 0))]
    for level, weight in _levels(search, selection, small):
        ratio = of_laws.copy()
        ratio[small] = np.maximum(ratio[small], level)
        size = np.minimum(np.repeat(ratio, [block.stop - block.start for block in offered.blocks]) * unit, MOST)
        if weight > SELDOM and size.any():
            ways.append(np.sqrt(weight) * _open(extended, offered, size))
    more = np.column_stack(ways)
    return dataclasses.replace(extended, covariance=extended.covariance + more @ more.T)


def _open(extended: Extended, offered: Offered, size: Float1D) -> Float2D:
    """Return (f + p, c): what everything may be off by where candidates act a little, `size` (p,) typical ones."""
    some = [k for k, block in enumerate(offered.blocks) if size[block].any()]
    candidates = [offered.candidates[k] for k in some]
    each = np.concatenate([size[offered.blocks[k]] * typical_sizes(offered.candidates[k]) for k in some])
    columns = white_columns(extended, *candidates) * each
    rest = np.where(np.repeat(extended.model.used, 3), extended.rest, 0.0)
    return (
        left_open(
            extended.gram + np.diag(extended.ridge),
            extended.variance,
            extended.linear.white.against(columns) / extended.length[:, None],
            columns.T @ columns,
            columns.T @ rest,
        )
        / extended.length[:, None]
    )


def _small(search: Search, selection: Selection) -> list[int]:
    """Return the structural candidates that were not named, and that the recording shows."""
    field = search.field
    named = {member for i in selection.accepted for member in field.offered.hypotheses[i].members}
    return [
        k
        for k, (one, block) in enumerate(zip(field.offered.candidates, field.offered.blocks, strict=True))
        if one.family == STRUCTURE and k not in named and field.clear[block].any()
    ]


def _of_laws(search: Search, selection: Selection, joints: Sequence[str]) -> Float1D:
    """Return the signal-to-noise ratio of every candidate, (c,), that laws of joints that were accepted lend to it."""
    hypotheses, accepted = search.field.offered.hypotheses, selection.accepted
    ratio = np.zeros(len(search.field.offered.candidates))
    for index in accepted:
        if hypotheses[index].family == LAW and len(hypotheses[index].members) == 1:
            ratio = np.maximum(ratio, lent(search, accepted, index, joints))
    ratio[[member for index in accepted for member in hypotheses[index].members]] = 0.0
    return ratio


def _levels(search: Search, selection: Selection, small: Sequence[int]) -> list[tuple[float, float]]:
    """Return signal-to-noise ratios of some candidates, each with its probability beside what was accepted."""
    if not small:
        return [(0.0, 1.0)]
    field, own = search.field, search.field.blocks(selection.accepted)
    held = [np.arange(block.start, block.stop) for block in (field.offered.blocks[k] for k in small)]
    kept = np.unique(np.concatenate([*held, *own]))
    gram = Gram(field.gram.matrix[np.ix_(kept, kept)], field.gram.vector[kept], field.gram.square, field.gram.freedom)
    first = [int(np.searchsorted(kept, one[0])) for one in held]
    blocks = tuple(slice(at, at + len(one)) for at, one in zip(first, held, strict=True))
    effects = SmallEffects(gram, Offered(tuple(field.offered.candidates[k] for k in small), blocks, ()), LEVELS)
    fits = effects.fits([np.searchsorted(kept, block) for block in own], selection.sizes)
    nats = np.array([fit.sizes.value for fit in fits])
    odds = np.exp(nats - nats.max()) * np.array([1.0 if fit.level == 0 else 1 / (len(LEVELS) - 1) for fit in fits])
    return list(zip((fit.level for fit in fits), map(float, odds / odds.sum()), strict=True))
