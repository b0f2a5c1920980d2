"""What a recording leaves open about the structure that gives way, in the covariance of everything beside it.

That a bearing tilts may be sure, and at which joint, or about which axes, may not be: where axes meet in one point, one
joint tilts as another one turns.  Compliances depend on which of the places is taken, so that the values of one place
alone are too sure.

    places:  C + sum_k w_k ((a_k - a)(a_k - a)' + (C_k - C)+),  a_k and C_k with the effect at place k, w_k its
             probability, ()+ the part by which less is known
    forms:   what a form takes for equal or zero is normal about it, with a share of the effect as its size

Source: Bayesian model averaging (Hoeting, Madigan, Raftery and Volinsky 1999); consider parameters (Schmidt 1966).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from calibration_core.estimation.alternatives.equivalents import other_places
from calibration_core.estimation.controls import EQUIVALENT
from calibration_core.estimation.hypotheses import typical_sizes
from calibration_core.estimation.leave_out import RIDGE
from calibration_core.estimation.refit import Extended
from calibration_core.estimation.search import Search, Selection
from calibration_core.model.effects.candidate import Candidate
from calibration_core.timeseries import Float1D, Float2D, Int1D

STRUCTURE = "structure"
UNEQUAL = 0.3  # share of an effect that its form may take for equal or zero, one standard deviation
ROUNDING = 1e-13  # of the largest eigenvalue: less is a rounding error
SEEN = 1e-9  # of the squared length of a form's columns: what is left of less is rounding


def with_alternatives(
    extended: Extended, search: Search, selection: Selection, members: Mapping[int, Sequence[int]]
) -> Extended:
    """Return the extended model with a covariance that says what place and form of structural effects leave open."""
    hypotheses = search.field.offered.hypotheses
    ways = [np.zeros((len(extended.length), 0))]
    for index in selection.accepted:
        if hypotheses[index].family != STRUCTURE or len(members[index]) != 1:
            continue
        ways += list(_elsewhere(extended, search, selection, index, members[index][0]))
        ways += list(_unequal(extended, search.field.offered.candidates, members[index][0]))
    more = np.column_stack(ways)
    return dataclasses.replace(extended, covariance=extended.covariance + more @ more.T)


def _elsewhere(extended: Extended, search: Search, selection: Selection, index: int, part: int) -> Iterator[Float2D]:
    """Yield (f + p, c) for each place and form that does as well: what everything may be off by, by its probability.

    Of one at another place no form is known: the fullest freedom that it may have is taken.  Its size is that which the
    search finds there, or that of the accepted effect where this is larger, both in typical sizes.
    """
    candidates, hypotheses = search.field.offered.candidates, search.field.offered.hypotheses
    stated = selection.gain[selection.accepted.index(index)]
    as_well = [(i, nats - stated) for i, nats in other_places(search, selection, index)]
    as_well += other_forms(search, selection, index)
    several = [(i, nats) for i, nats in as_well if len(hypotheses[i].members) == 1]
    size = search.scores(tuple(i for i in selection.accepted if i != index)).size_after
    white, used, length = extended.linear.white, np.repeat(extended.model.used, 3), extended.length
    moved = np.where(used, white.effects @ extended.of_part(part), 0.0)
    own = np.arange(len(length))[extended.flat :][extended.block(part)]
    for (i, _), share in zip(several, shares([nats for _, nats in several]), strict=True):
        other = candidates[hypotheses[i].members[0]]
        candidate = fuller_form(other, candidates) or other
        columns = white_columns(extended, candidate)
        prior = max(float(size[search.place[i]]), extended.parts[part].size) * typical_sizes(candidate)
        ways = instead(
            extended.gram + np.diag(extended.ridge),
            own,
            white.against(moved) / length,
            white.against(columns) / length[:, None],
            columns.T @ columns + np.diag(extended.variance / prior**2),
            columns.T @ (moved + np.where(used, extended.rest, 0.0)),
            extended.variance,
        )
        yield np.sqrt(share) * ways / length[:, None]


def other_forms(search: Search, selection: Selection, index: int) -> list[tuple[int, float]]:
    """Return other forms of an accepted hypothesis at its own place, and by how much they are more probable, nats."""
    hypotheses = search.field.offered.hypotheses
    gain = search.scores(tuple(i for i in selection.accepted if i != index)).nats
    own = gain[search.place[index]]
    same = [
        (i, float(gain[k] - own)) for i, k in search.place.items() if hypotheses[i].place == hypotheses[index].place
    ]
    return [(i, nats) for i, nats in same if i != index and abs(nats) <= EQUIVALENT]


def shares(nats: Sequence[float]) -> Float1D:
    """Return the probabilities of places, (k,), from how much more probable they are than the one that was taken.

    None is taken for more probable than that one: the search has judged it, and taken another.
    """
    odds = np.exp(np.minimum(np.array(nats, dtype=np.float64), 0.0))
    return np.asarray(odds / (1.0 + odds.sum()))


def instead(
    normal: Float2D, own: Int1D, moved: Float1D, taken: Float2D, other: Float2D, seen: Float1D, variance: float
) -> Float2D:
    """Return (q, c) what q parameters may be off by where another effect stands in the stead of an accepted one.

    The first column is by how much they change, the square of the others by how much less is known of them.

    Args:
        normal: (q, q) products of all columns, with the precision of their priors.
        own: Which of the columns are those of the accepted effect; they do not change.
        moved: (q,) products of all columns with what that effect moves.
        taken: (q, k) products of all columns with those of the other effect.
        other: (k, k) products of the latter, with the precision of their priors.
        seen: (k,) their products with what the accepted effect moves and what everything leaves.
        variance: Of a row.
    """
    others = np.setdiff1d(np.arange(len(normal)), own)
    count, across = len(others), taken[others]
    unit = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    known = np.linalg.inv(normal / np.outer(unit, unit) + RIDGE * np.eye(len(unit)))[np.ix_(others, others)]
    whole = np.block([[normal[np.ix_(others, others)], across], [across.T, other]])
    scale = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    inverse = np.linalg.inv(whole / np.outer(scale, scale) + RIDGE * np.eye(len(scale)))
    change = (inverse @ (np.concatenate([moved[others], seen]) / scale))[:count]
    std = np.sqrt(np.diag(known))
    less, turn = np.linalg.eigh((inverse[:count, :count] - known) / np.outer(std, std))
    some = less > SEEN
    root = np.sqrt(variance) * std[:, None] * turn[:, some] * np.sqrt(less[some])
    ways = np.zeros((len(normal), 1 + int(some.sum())))
    ways[others] = np.column_stack([change, root]) / scale[:count, None]
    return ways


def fuller_form(mine: Candidate, candidates: Sequence[Candidate]) -> Candidate | None:
    """Return the form of an effect at its place that has the most sizes, more than its own; None: there is none."""
    fuller = [one for one in candidates if one.place == mine.place and one.shape == mine.shape]
    fuller = [one for one in fuller if len(one.parameters) > len(mine.parameters)]
    return max(fuller, key=lambda one: len(one.parameters), default=None)


def neglected(mine: Float2D, fuller: Float2D, mine_one: Candidate, fuller_one: Candidate, value: Float1D) -> Float2D:
    """Return the columns, (r, k - c), of what a form of c sizes takes for equal or zero, as large as it usually is.

    Args:
        mine: (r, c) columns of the form, per unit.
        fuller: (r, k) columns of the one with k sizes, per unit.
        mine_one: The form.
        fuller_one: The other one.
        value: (c,) sizes of the effect.
    """
    usual, typical = typical_sizes(mine_one), typical_sizes(fuller_one)
    along, *_ = np.linalg.lstsq(fuller * typical, mine * usual, rcond=SEEN)
    across = np.linalg.svd(along.T)[2][len(usual) :].T  # combinations that leave what is fitted as it is
    return np.asarray(UNEQUAL * np.abs(value / usual).max() * (fuller * typical) @ across)


def left_open(normal: Float2D, variance: float, taken: Float2D, own: Float2D, seen: Float1D) -> Float2D:
    """Return (q, c + 1) what q parameters may be off by: their covariance less what is known is its square.

    Args:
        normal: (q, q) products of all columns, with the precision of their priors.
        variance: Of a row.
        taken: (q, c) products of all columns with those of what is neglected, as large as one standard deviation.
        own: (c, c) products of the latter.
        seen: (c,) their products with what everything leaves.
    """
    unit = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    gain = np.linalg.solve(normal / np.outer(unit, unit) + RIDGE * np.eye(len(unit)), taken / unit[:, None])
    gain /= unit[:, None]
    beside, turn = np.linalg.eigh(own - taken.T @ gain)  # none is negative but by rounding
    left = np.maximum(beside, max(ROUNDING * beside[-1], 0.0)) + max(variance, 1e-300)
    turned = gain @ turn
    return np.asarray(np.column_stack([turned * np.sqrt(variance / left), turned @ (turn.T @ seen / left)]))


def _unequal(extended: Extended, candidates: Sequence[Candidate], part: int) -> Iterator[Float2D]:
    """Yield (f + p, c): what everything else may be off by where a part has more sizes in truth."""
    mine = extended.parts[part].candidate
    fuller = fuller_form(mine, candidates)
    if fuller is None:
        return
    value = extended.value[extended.block(part)]
    columns = neglected(white_columns(extended, mine), white_columns(extended, fuller), mine, fuller, value)
    white, length = extended.linear.white, extended.length
    rest = np.where(np.repeat(extended.model.used, 3), extended.rest, 0.0)
    yield (
        left_open(
            extended.gram + np.diag(extended.ridge),
            extended.variance,
            white.against(columns) / length[:, None],
            columns.T @ columns,
            columns.T @ rest,
        )
        / length[:, None]
    )


def white_columns(extended: Extended, *candidates: Candidate) -> Float2D:
    """Return the columns of candidates per unit, (3 m, k), as independent rows; zero where a reading is not used."""
    model = extended.model
    columns = extended.whitening(model.moves(candidates, np.arange(len(model.readings))))
    return np.asarray(columns * np.repeat(model.used, 3)[:, None])
