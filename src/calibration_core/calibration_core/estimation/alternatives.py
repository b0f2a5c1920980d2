"""Other places that one recording cannot distinguish from what was accepted.

What a recording leaves open about the structure that gives way, in the covariance of everything beside it.

That a bearing tilts may be sure, and at which joint, or about which axes, may not be: where axes meet in one point, one
joint tilts as another one turns.  Compliances depend on which of the places is taken, so that the values of one place
alone are too sure.

    places:  C + sum_k w_k ((a_k - a)(a_k - a)' + (C_k - C)+),  a_k and C_k with the effect at place k, w_k its
             probability, ()+ the part by which less is known
    forms:   what a form takes for equal or zero is normal about it, with a share of the effect as its size

Source: Bayesian model averaging (Hoeting, Madigan, Raftery and Volinsky 1999); consider parameters (Schmidt 1966).

Which hypotheses are forms of one cause: the same family at the same joint, or at neighbouring parts.

What small effects that were not named leave open is in the covariance of everything beside them, too.

Every robot bends a little everywhere.  Each place by itself may be too small to be named, and yet together they move
the compliances of the joints by more than the noise does.  How much of it there is, the recording says: all structural
places have the same signal-to-noise ratio, each of those that are tried with its probability w_l; that there is nothing
is beforehand as probable as that there is something.  And the law of a joint that was accepted is known to a share
only: other laws of that joint may hold the rest.

    C + sum_l w_l gain (C_b + b b') gain',  b and C_b the mean and the covariance of the small effects of level l, given
    what is left

Source: Kennedy and O'Hagan 2001 with a physical kernel; Bayesian model averaging (Hoeting, Madigan, Raftery and
Volinsky 1999); consider parameters (Schmidt 1966).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from calibration_core.estimation.field import Accepted
from calibration_core.estimation.hypotheses import LAW, Offered, typical_sizes
from calibration_core.estimation.leave_out import RIDGE
from calibration_core.estimation.likelihood.gains import (
    LEVELS,
    MOST_TYPICAL,
    SmallEffects,
    beside,
    shared_power,
    visible,
)
from calibration_core.estimation.likelihood.restricted import USUAL, Gram, Sizes
from calibration_core.estimation.refit import Extended
from calibration_core.estimation.search import Search, Selection
from calibration_core.estimation.shifts import FAMILY
from calibration_core.model.effects import effects_with
from calibration_core.model.effects.candidate import Candidate, Trait, link_name
from calibration_core.model.effects.structure import pose_dependent_stiffness
from calibration_core.policy import EQUIVALENT, LISTED, PLAUSIBLE
from calibration_core.timeseries import Float1D, Float2D, Int1D

ASKED = 8  # alternatives that are refitted together with everything else
EXACT = 1e-6  # share of what is seen of an effect that an exact alias may leave: rounding errors
ROUNDING = 1e-10  # of the largest eigenvalue


def equivalents(search: Search, selection: Selection, members: Sequence[int]) -> tuple[tuple[int, float], ...]:
    """Return single other places that explain the data as well as the accepted hypotheses of a finding, all refitted.

    What is far more probable than the finding is none of them: the search tried it, and refused it.

    Returns:
        Hypothesis and its log Bayes factor, nats; at most five, nearest first.
    """
    hypotheses = search.field.offered.hypotheses
    others = tuple(i for i in selection.accepted if i not in members)
    scores = search.scores(others)
    gain, size = scores.nats, scores.size_after
    whole = search.sizes((*others, *members)).value  # beside small effects of the level that is left
    stated = sum(selection.gain[selection.accepted.index(i)] for i in members)
    together = stated if len(members) == 1 else whole - search.sizes(others).value
    places = {hypotheses[i].place for i in members}
    best: dict[object, tuple[int, float]] = {}
    asked = 0
    for k in np.argsort(-gain, kind="stable"):
        i = search.judged[int(k)]
        other = hypotheses[i]
        if gain[k] < together - 2 * EQUIVALENT or asked == ASKED:
            break
        if other.family == FAMILY or other.place in places | set(best) or size[k] > PLAUSIBLE:
            continue
        asked += 1
        instead = min(search.fitted((*others, i)), key=lambda fit: abs(fit.level - selection.level))
        behind = whole - instead.sizes.value
        if abs(behind) <= EQUIVALENT and not search.objection(search.trial(others, i)):
            best[other.place] = i, float(stated - behind)
    return nearest_first(best.values(), stated)[:LISTED]


def other_places(search: Search, selection: Selection, index: int) -> tuple[tuple[int, float], ...]:
    """Return single other places that do as well as an accepted hypothesis, or would had its fit been the truth.

    Returns:
        Hypothesis and its log Bayes factor, nats: one for every place, nearest first.
    """
    hypotheses = search.field.offered.hypotheses
    both = (*equivalents(search, selection, (index,)), *resembling(search, selection, index))
    taken = {hypotheses[i].place for i in selection.accepted}
    best: dict[object, tuple[int, float]] = {}
    for i, nats in nearest_first(both, selection.gain[selection.accepted.index(index)]):
        if hypotheses[i].place not in taken:
            best.setdefault(hypotheses[i].place, (i, nats))
    return tuple(best.values())


def nearest_first(several: Iterable[tuple[int, float]], stated: float) -> tuple[tuple[int, float], ...]:
    """Return hypotheses and their log Bayes factors, nats, in the order of how near they come to a stated one."""
    return tuple(sorted(several, key=lambda pair: abs(pair[1] - stated)))


def resembling(search: Search, selection: Selection, index: int) -> tuple[tuple[int, float], ...]:
    """Return single other places that would explain the data as well had the accepted hypothesis's fit been the truth.

    Between exact aliases the sizes that are usual decide alone, which the recording knows nothing of.

    Returns:
        Hypothesis and its log Bayes factor, nats: that of the accepted one less what would be lost.
    """
    hypotheses = search.field.offered.hypotheses
    others = tuple(i for i in selection.accepted if i != index)
    size = dict(zip(selection.accepted, selection.sizes.size, strict=True))
    known = Sizes(selection.sizes.variance, np.array([size[i] for i in others]), float("nan"))
    gram, block = search.small.at(selection.level)[0], search.field.blocks((index,))[0]
    taken, vector = beside(gram, search.field.blocks(others), known).of(np.arange(len(gram.vector)))
    seen = (gram.matrix[:, block] - taken.T @ taken[:, block]) / known.variance
    mean = np.linalg.solve(np.eye(len(block)) / size[index] ** 2 + seen[block], vector[block])
    image = seen @ mean
    power, stated = float(mean @ image[block]), selection.gain[selection.accepted.index(index)]
    scores = search.scores(others)
    found = []
    for k, i in enumerate(search.judged):
        other = hypotheses[i]
        same = other.place == hypotheses[index].place or len(other.members) > 1 or other.family == FAMILY
        if same or scores.nats[k] <= 0:
            continue
        own = taken[:, other.columns]
        matrix = (gram.matrix[np.ix_(other.columns, other.columns)] - own.T @ own) / known.variance
        alike, lost = image[other.columns], np.inf
        if scores.nats[k] > stated / 2:  # far less is no alias
            lost = 0.5 * (power - float(alike @ np.linalg.pinv(matrix, rcond=ROUNDING, hermitian=True) @ alike))
        if lost > EXACT * power:
            lost = 0.5 * (power - float(alike @ np.linalg.solve(matrix + np.eye(len(matrix)) / USUAL**2, alike)))
        if lost < EQUIVALENT and not search.objection(search.trial(others, i)):
            found.append((i, float(stated - max(lost, 0.0))))
    return tuple(found)


# --- what a recording leaves open about the structure that gives way, in the covariance of everything -----------------


STRUCTURE = "structure"
UNEQUAL = 0.3  # share of an effect that its form may take for equal or zero, one standard deviation
ROUNDED = 1e-13  # of the largest eigenvalue: less is a rounding error
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
    left = np.maximum(beside, max(ROUNDED * beside[-1], 0.0)) + max(variance, 1e-300)
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


# --- which hypotheses are forms of one cause --------------------------------------------------------------------------


TOOL = 1 << 20  # beyond the last joint
# What is confounded with something found is the same cause under another form where it is this much weaker.
CONFOUNDED_SHARE = 0.15
# Under load, what a joint's law of another shape than the catalogue's leaves is weaker than the law, and seldom sure.
LEFT_SHARE, SURE = 0.45, 30.0  # of the law's evidence; nats
KNOWN = 0.15  # share to which the law of an effect is known
BY_ANGLE = pose_dependent_stiffness.EFFECT.name


def are_confounded(first: Candidate, second: Candidate, joints: Sequence[str]) -> bool:
    """Say whether two candidates could be one cause under two laws.

    Joint laws: the same joint, both with memory or both without.  Structure: the same or neighbouring parts.  Load
    chain and point chain: always.  What a law with memory leaves goes on in time, as a drift does.
    """
    effects, memory = {first.effect, second.effect}, effects_with(Trait.MEMORY)
    if effects & memory and effects & effects_with(Trait.DRIFT):
        return True
    if first.family != second.family:
        return False
    if first.family in {"load chain", "point chain"}:
        return True
    if first.family == LAW and (first.effect in memory) != (second.effect in memory):
        return False
    reach = 0 if first.family == LAW else 1
    return any(abs(i - j) <= reach for i in parts(first.location, joints) for j in parts(second.location, joints))


def same_deflection(first: Candidate, second: Candidate) -> bool:
    """Say whether two candidates describe how one joint deflects about its own axis.

    Where the true law has another shape than the catalogue's, such a candidate takes up what that of the joint leaves.
    """
    own = all(one.family == LAW or one.effect == BY_ANGLE for one in (first, second))
    return own and first.location == second.location


def strongest_first(search: Search, accepted: Accepted, joints: Sequence[str]) -> Accepted:
    """Return accepted hypotheses, of several laws that are one cause at a joint the strongest before the others.

    Each of them gains little beside the others: which one is the cause shows what its forms gain without them.
    """
    offered, ordered = search.field.offered, list(accepted)
    laws = ((i, offered.hypotheses[i]) for i in accepted)
    of_joints = {i: offered.candidates[one.members[0]] for i, one in laws if one.is_law_of_a_joint}
    for own in of_joints.values():
        alike = (i for i, one in of_joints.items() if one.location == own.location and are_confounded(own, one, joints))
        forms = sorted(alike, key=ordered.index)
        if len({of_joints[i].effect for i in forms}) > 1:
            law = search.strongest_law(tuple(i for i in accepted if i not in forms), own.location)
            first = next((i for i in forms if of_joints[i].effect == offered.hypotheses[law].effect), forms[0])
            place = ordered.index(forms[0])
            ordered.remove(first)
            ordered.insert(place, first)
    return tuple(ordered)


def parts(location: Mapping[str, str | tuple[str, ...]], joints: Sequence[str]) -> tuple[int, ...]:
    """Return the numbers of the joints, from 1, between which a place lies; the base is before the first joint."""
    if "base" in location:
        return (0, 1)
    if "tool" in location:
        return (TOOL,)
    if "link" in location:
        links = [link_name(index) for index in range(len(joints))]
        number = 1 + links.index(str(location["link"]))
        return (number, number + 1)
    names = location.get("joints", location.get("joint", ()))
    return tuple(1 + joints.index(name) for name in ((names,) if isinstance(names, str) else names))


def lent(search: Search, accepted: Accepted, index: int, joints: Sequence[str]) -> Float1D:
    """Return the signal-to-noise ratios, (c,), that an accepted hypothesis lends to what is confounded with it."""
    others = tuple(i for i in accepted if i != index)
    without_small_effects = search.fitted(others)[:1]
    seen = visible(without_small_effects, search.field.blocks((index,))[0])[1]
    candidates = search.field.offered.candidates
    own = candidates[search.field.offered.hypotheses[index].members[0]]
    return np.array([KNOWN * seen * are_confounded(own, one, joints) for one in candidates])


# --- what small effects that were not named leave open, in the covariance of everything beside them -------------------


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
        size = np.minimum(np.repeat(ratio, [block.stop - block.start for block in offered.blocks]) * unit, MOST_TYPICAL)
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
