"""Other places that one recording cannot distinguish from what was accepted."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from calibration_core.estimation.controls import EQUIVALENT
from calibration_core.estimation.likelihood.gains import beside
from calibration_core.estimation.likelihood.restricted import USUAL, Sizes
from calibration_core.estimation.search import Search, Selection
from calibration_core.estimation.shifts import FAMILY

LISTED = 5
ASKED = 8  # alternatives that are refitted together with everything else
PLAUSIBLE = 6.0  # typical sizes
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
