"""Which effects does the recording ask for?  One at a time, over a threshold and proven on left-out configurations.

After each acceptance the chosen ones are refined: every one may be swapped for another hypothesis, given the others,
before a further cause is added, and what the others made superfluous is dropped.  At last one law in every joint at
once is tried, for small effects of many joints hide each other.  Candidates that come close are kept as an equivalence
set.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.diagnosis.evidence.bayes_factors import (
    LEVELS,
    GramCache,
    MarginalModel,
    at_its_level,
    chance_alone,
    gram_cache,
    judge,
    law_share,
    log_bayes_factors,
    marginal_model,
    posterior,
    visible_size,
    without_confounded,
)
from calibration_core.diagnosis.evidence.confounding import MEMORY, are_confounded
from calibration_core.diagnosis.evidence.design import PRIOR_WIDTH, Design
from calibration_core.diagnosis.evidence.predictive_density import GATE, log_predictive_densities, passes
from calibration_core.diagnosis.evidence.threshold import threshold
from calibration_core.model.effects.possible import forbidden, impossibility
from calibration_core.timeseries import Float1D

MOST = 4  # effects
TRIED = 5  # candidates per round that may try the gate
WITHIN = 8.0  # nats of the best, to be tried
LEAST = 5.0  # nats: the threshold is never lower
EQUIVALENT = 5.0  # nats of the best, to be called indistinguishable
PLAUSIBLE = 6.0  # typical sizes: an equivalent must not need more
STANDS_OUT = 2.5  # times the signal-to-noise ratio of the small effects
CROWD_GONE = 1.0  # signal-to-noise ratio of the small effects that may be left beside several strong ones
SWAP = 0.5  # nats by which a swap must be better
TIE = 1e-6  # nats a parameter: of two forms that explain as much, the one with fewer parameters is the better
FEWEST = 3  # joints that make every joint
LAW = "joint law"
# A later effect that is confounded with it is the same cause under another law where it is this much weaker; of two
# laws with memory at one joint always.
CONFOUNDED_SHARE = 0.15


@dataclasses.dataclass(frozen=True)
class Choice:
    """An accepted candidate.

    Attributes:
        candidate: Its index.
        log_bayes_factor: Given all other accepted ones, nats.
        equivalents: Other places that come within five nats at a plausible size: (index, log Bayes factor), best first.
        refinements: Accepted candidates that are this one's law or neighbour, not causes of their own.
    """

    candidate: int
    log_bayes_factor: float
    equivalents: tuple[tuple[int, float], ...] = ()
    refinements: tuple[int, ...] = ()


@dataclasses.dataclass(frozen=True, eq=False)
class LoadedSelection:
    """What was accepted.

    Attributes:
        choices: In the order of evidence.
        accepted: All accepted candidates, refinements included.
        level: Signal-to-noise ratio of the small effects that remain, each.
        limit: Threshold in force when the search stopped, nats.
    """

    choices: tuple[Choice, ...]
    accepted: tuple[int, ...]
    level: float
    limit: float

    def without(self, left_out: Sequence[Choice]) -> LoadedSelection:
        """Return the selection without some of its choices."""
        gone = {index for choice in left_out for index in (choice.candidate, *choice.refinements)}
        choices = tuple(choice for choice in self.choices if choice.candidate not in gone)
        accepted = tuple(index for index in self.accepted if index not in gone)
        return dataclasses.replace(self, choices=choices, accepted=accepted)


def select(design: Design, levels: tuple[float, ...] = LEVELS, freedom: int = 0) -> LoadedSelection:
    """Search greedily, with refinement, threshold and gate.

    Args:
        design: The whitened model.
        levels: Of the small effects, to choose from.
        freedom: Degrees of freedom on which the noise rests; 0: it is known.
    """
    cache = gram_cache(design)
    accepted: tuple[int, ...] = ()
    while True:
        at = judge(cache, accepted, levels)
        scores = _open_scores(cache, accepted, levels)
        limit = max(threshold(_beside(cache, accepted, at.level), freedom), LEAST)
        found = _first_that_passes(cache, accepted, scores, at.levels, limit)
        more = _together(cache, accepted, limit, levels) if found is None else (found,)
        if not more or len(accepted) + len(more) > MOST:
            break
        refined = _refined(cache, (*accepted, *more), limit, levels)
        if set(refined) == set(accepted):
            break
        accepted = refined
    everywhere = _in_every_joint(cache, accepted, limit, levels) if at.level > 0 else accepted
    if everywhere != accepted:
        accepted, at = everywhere, judge(cache, everywhere, levels)
    return LoadedSelection(_choices(cache, accepted, at.level), accepted, at.level, limit)


def _beside(cache: GramCache, accepted: tuple[int, ...], level: float) -> MarginalModel:
    return marginal_model(cache, accepted, level, law_share(cache, accepted))


def _open_scores(cache: GramCache, accepted: tuple[int, ...], levels: tuple[float, ...]) -> Float1D:
    """Return the log Bayes factors of all candidates beside the accepted ones, (l,); -inf where a place is taken."""
    candidates = cache.design.candidates
    places = {candidates[index].place for index in accepted}
    taken = [candidate.place in places for candidate in candidates]
    longer = TIE * np.array([len(candidate.parameters) for candidate in candidates])
    return np.where(taken, -np.inf, judge(cache, accepted, levels).scores - longer)


def _first_that_passes(
    cache: GramCache, accepted: tuple[int, ...], scores: Float1D, levels: Float1D, limit: float
) -> int | None:
    order = np.argsort(-scores, kind="stable")[:TRIED]
    best = float(scores[order[0]]) if len(order) else -np.inf
    if best <= limit:
        return None
    for index in order:
        if scores[index] <= limit or scores[index] < best - WITHIN:
            break
        if _proven(_beside(cache, accepted, float(levels[index])), int(index)):
            return int(index)
    return None


def _proven(here: MarginalModel, index: int) -> bool:
    """Return whether a candidate stands out from the small effects and predicts configurations left out."""
    if visible_size(here, index) < STANDS_OUT * here.level or not _possible(here, index):
        return False
    return passes(*log_predictive_densities(without_confounded(here, index), index))


def _possible(here: MarginalModel, index: int) -> bool:
    """Return whether physics allows values of a candidate that are nearly as probable as its estimate.

    What a candidate leaves to chance in each configuration explains much of anything: it is no evidence by itself.
    """
    evidence = float(log_bayes_factors(here)[index])
    if evidence - chance_alone(here, index) <= GATE:
        return False
    mean, covariance = posterior(here, index)
    nats = impossibility(here.design.candidates[index].parameters, mean, covariance)
    return not forbidden(nats, evidence)


def _together(cache: GramCache, accepted: tuple[int, ...], limit: float, levels: tuple[float, ...]) -> tuple[int, ...]:
    """Return candidates that pass beside each other, though none does alone; empty if there are none.

    Several strong effects make each other look like two of a crowd; with all of them in the model the crowd is gone.
    """
    trial = accepted
    while len(trial) < MOST:
        scores = _open_scores(cache, trial, levels)
        best = int(np.argmax(scores))
        if scores[best] <= limit:
            break
        trial = (*trial, best)
        more = trial[len(accepted) :]
        left = judge(cache, trial, levels).level
        if (
            len(more) > 1
            and left <= CROWD_GONE
            and all(_passes_beside(cache, trial, index, limit, levels) for index in more)
        ):
            return more
    return ()


def _in_every_joint(
    cache: GramCache, accepted: tuple[int, ...], limit: float, levels: tuple[float, ...]
) -> tuple[int, ...]:
    """Return what is accepted where one law acts in many joints, if that explains more; else what was accepted.

    Joints that do not need it are left out again, and each of those that stay must pass the gate beside the others.
    """
    candidates = cache.design.candidates
    laws: dict[tuple[str, str], list[int]] = {}
    for index, candidate in enumerate(candidates):
        if candidate.family == LAW:
            laws.setdefault((candidate.effect, candidate.variant), []).append(index)
    trials = []
    for members in laws.values():
        joints = {candidates[index].location["joint"] for index in members}
        others = (i for i in accepted if candidates[i].family != LAW or candidates[i].location["joint"] not in joints)
        if len(members) >= FEWEST:
            trials.append((*others, *members))
    if not trials:
        return accepted
    trial = max(trials, key=lambda several: marginal_model(cache, several, 0.0).likelihood)
    enough = at_its_level(cache, accepted, levels).likelihood + limit
    whole = at_its_level(cache, trial, levels)
    if whole.likelihood <= enough:
        return accepted
    effect = candidates[trial[-1]].effect
    trial = _refined(cache, trial, limit, levels[: levels.index(whole.level) + 2], effect)
    while True:
        failed = [i for i in trial if i not in accepted and not _passes_beside(cache, trial, i, limit, levels)]
        if not failed:
            break
        weakest = min(failed, key=lambda i: judge(cache, tuple(j for j in trial if j != i), levels).scores[i])
        trial = tuple(i for i in trial if i != weakest)
    return trial if at_its_level(cache, trial, levels).likelihood > enough else accepted


def _passes_beside(
    cache: GramCache, trial: tuple[int, ...], index: int, limit: float, levels: tuple[float, ...]
) -> bool:
    others = tuple(other for other in trial if other != index)
    beside = judge(cache, others, levels)
    return bool(beside.scores[index] > limit) and _proven(_beside(cache, others, float(beside.levels[index])), index)


def _refined(
    cache: GramCache, accepted: tuple[int, ...], limit: float, levels: tuple[float, ...], effect: str | None = None
) -> tuple[int, ...]:
    """Swap each accepted candidate for a better one, given the others; drop what is too weak or physics forbids.

    Args:
        cache: The prepared design.
        accepted: Candidates in the model.
        limit: Log Bayes factor that each must exceed, nats.
        levels: Of the small effects, to choose from.
        effect: Effect of which the better one must be; None: any.
    """
    other = np.array([effect is not None and candidate.effect != effect for candidate in cache.design.candidates])

    def possible(others: tuple[int, ...], index: int) -> bool:
        return _possible(_beside(cache, others, float(judge(cache, others, levels).levels[index])), index)

    for _ in range(3):
        changed = False
        position = 0
        while position < len(accepted):
            current = accepted[position]
            others = accepted[:position] + accepted[position + 1 :]
            kept = judge(cache, others, levels).scores[current]
            scores = np.where(other, -np.inf, _open_scores(cache, others, levels))
            best = int(np.argmax(scores))
            better = best != current and scores[best] > kept + SWAP and possible(others, best)
            nothing = max(scores[best], kept) <= limit or not (better or possible(others, current))
            if len(accepted) > 1 and nothing:
                accepted, changed = others, True
                continue
            if better:
                accepted = (*accepted[:position], best, *accepted[position + 1 :])
                changed = True
            position += 1
        if not changed or len(accepted) == 1:
            break
    return accepted


def _choices(cache: GramCache, accepted: tuple[int, ...], level: float) -> tuple[Choice, ...]:
    design = cache.design
    alone = {}
    for position, index in enumerate(accepted):
        others = accepted[:position] + accepted[position + 1 :]
        f = _beside(cache, others, level)
        scores = log_bayes_factors(f)
        alone[index] = (float(scores[index]), _equivalents(f, scores, index, others))
    order = sorted(accepted, key=lambda index: -alone[index][0])
    choices: list[Choice] = []
    for index in order:
        evidence = alone[index][0]
        for k, choice in enumerate(choices):
            first, second = design.candidates[choice.candidate], design.candidates[index]
            weaker = evidence < CONFOUNDED_SHARE * choice.log_bayes_factor
            weaker = weaker or {first.effect, second.effect} <= MEMORY
            if weaker and are_confounded(first, second, design.joints):
                choices[k] = dataclasses.replace(choice, refinements=(*choice.refinements, index))
                break
        else:
            choices.append(Choice(index, evidence, alone[index][1]))
    return tuple(choices)


def _equivalents(
    f: MarginalModel, scores: Float1D, chosen: int, others: tuple[int, ...]
) -> tuple[tuple[int, float], ...]:
    """Return other places that do as well, or that would do as well had the fitted effect been the truth.

    The second catches exact aliases between which the prior alone decides.
    """
    candidates = f.design.candidates
    taken = {candidates[index].place for index in (*others, chosen)}
    near = scores >= scores[chosen] - EQUIVALENT
    near |= _lost(f, chosen) < EQUIVALENT
    best: dict[object, tuple[int, float]] = {}
    for index in np.argsort(-scores, kind="stable"):
        score, place = float(scores[index]), candidates[index].place
        if near[index] and score > 0 and place not in taken and place not in best and _plausible(f, int(index)):
            best[place] = (int(index), score)
    return tuple(best.values())


def _lost(f: MarginalModel, chosen: int) -> Float1D:
    """Return by how many nats every candidate falls short of describing the chosen one's fitted effect, (l,)."""
    design = f.design
    block = design.blocks[chosen]
    mean = posterior(f, chosen)[0] / design.prior[block]
    image = f.schur[:-1, block] @ mean
    power = float(mean @ image[block])
    result = np.empty(len(design.blocks))
    for index, other in enumerate(design.blocks):
        matrix = f.schur[other, other] + np.eye(other.stop - other.start)
        result[index] = 0.5 * (power - float(image[other] @ np.linalg.solve(matrix, image[other])))
    return result


def _plausible(f: MarginalModel, index: int) -> bool:
    mean, _ = posterior(f, index)
    prior = f.design.prior[f.design.blocks[index]] / PRIOR_WIDTH
    return bool(np.sqrt(np.mean((mean / prior) ** 2)) <= PLAUSIBLE)
