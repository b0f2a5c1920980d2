"""Which effects does the recording ask for?  One at a time, over a threshold and proven on left-out configurations.

After each acceptance the chosen ones are refined: every one may be swapped for another hypothesis, given the others,
before a further cause is added.  Candidates that come close are kept as an equivalence set.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.diagnosis.cross_validation import log_predictive_density, passes
from calibration_core.diagnosis.design import PRIOR_WIDTH, Design
from calibration_core.diagnosis.evidence import Field, field, log_bayes_factors, posterior, threshold

MOST = 5  # effects
TRIED = 5  # candidates per round that may try the gate
WITHIN = 8.0  # nats of the best, to be tried
EQUIVALENT = 5.0  # nats of the best, to be called indistinguishable
PLAUSIBLE = 6.0  # typical sizes: an equivalent must not need more
SWAP = 0.5  # nats by which a swap must be better
KIN_SHARE = 0.15  # a later effect of the same family next door, this much weaker, is the same cause under another law


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
class Selection:
    """What was accepted.

    Attributes:
        choices: In the order of evidence.
        accepted: All accepted candidates, refinements included.
        level: Signal-to-noise ratio of the small effects that remain, each.
        limit: Threshold in force when the search stopped, nats.
        best_rejected: The best candidate that was not accepted, and why.
    """

    choices: tuple[Choice, ...]
    accepted: tuple[int, ...]
    level: float
    limit: float
    best_rejected: str


def select(design: Design) -> Selection:
    """Search greedily, with refinement, threshold and gate."""
    accepted: tuple[int, ...] = ()
    rejected, limit = "nothing came near the threshold", 0.0
    while len(accepted) < MOST:
        f = field(design, accepted)
        scores = _open_scores(f)
        limit = threshold(f)
        found, rejected = _first_that_passes(f, scores, limit)
        if found is None:
            break
        accepted = _refined(design, (*accepted, found))
    level = field(design, accepted).level
    return Selection(_choices(design, accepted, level), accepted, level, limit, rejected)


def _open_scores(f: Field) -> np.ndarray:
    scores = log_bayes_factors(f)
    places = {f.design.candidates[index].place for index in f.accepted}
    taken = [index for index, candidate in enumerate(f.design.candidates) if candidate.place in places]
    scores[taken] = -np.inf
    return scores


def _first_that_passes(f: Field, scores: np.ndarray, limit: float) -> tuple[int | None, str]:
    order = np.argsort(-scores, kind="stable")[:TRIED]
    best = float(scores[order[0]]) if len(order) else -np.inf
    if best <= limit:
        return None, f"best log Bayes factor {best:.1f}, threshold {limit:.1f}"
    before = log_predictive_density(f, f.accepted)
    for index in order:
        if scores[index] <= limit or scores[index] < best - WITHIN:
            break
        if passes(before, log_predictive_density(f, (*f.accepted, int(index)))):
            return int(index), ""
    name = f.design.candidates[int(order[0])].effect
    return None, f"{name}: log Bayes factor {best:.1f}, but no gain on configurations left out"


def _refined(design: Design, accepted: tuple[int, ...]) -> tuple[int, ...]:
    for _ in range(3):
        level = field(design, accepted).level
        changed = False
        for position, current in enumerate(accepted):
            others = accepted[:position] + accepted[position + 1 :]
            scores = _open_scores(field(design, others, level))
            best = int(np.argmax(scores))
            if best != current and scores[best] > scores[current] + SWAP:
                accepted = (*accepted[:position], best, *accepted[position + 1 :])
                changed = True
        if not changed:
            break
    return accepted


def _choices(design: Design, accepted: tuple[int, ...], level: float) -> tuple[Choice, ...]:
    alone = {}
    for position, index in enumerate(accepted):
        others = accepted[:position] + accepted[position + 1 :]
        f = field(design, others, level)
        scores = log_bayes_factors(f)
        alone[index] = (float(scores[index]), _equivalents(f, scores, index, others))
    order = sorted(accepted, key=lambda index: -alone[index][0])
    choices: list[Choice] = []
    for index in order:
        evidence = alone[index][0]
        for k, choice in enumerate(choices):
            if evidence < KIN_SHARE * choice.log_bayes_factor and kin(design, choice.candidate, index):
                choices[k] = dataclasses.replace(choice, refinements=(*choice.refinements, index))
                break
        else:
            choices.append(Choice(index, evidence, alone[index][1]))
    return tuple(choices)


def _equivalents(f: Field, scores: np.ndarray, chosen: int, others: tuple[int, ...]) -> tuple[tuple[int, float], ...]:
    candidates = f.design.candidates
    taken = {candidates[index].place for index in (*others, chosen)}
    best: dict[object, tuple[int, float]] = {}
    for index in np.argsort(-scores, kind="stable"):
        score, place = float(scores[index]), candidates[index].place
        if score < scores[chosen] - EQUIVALENT or score <= 0:
            break
        if place not in taken and place not in best and _plausible(f, int(index)):
            best[place] = (int(index), score)
    return tuple(best.values())


def _plausible(f: Field, index: int) -> bool:
    mean, _ = posterior(f, index)
    prior = f.design.prior[f.design.blocks[index]] / PRIOR_WIDTH
    return bool(np.sqrt(np.mean((mean / prior) ** 2)) <= PLAUSIBLE)


def kin(design: Design, first: int, second: int) -> bool:
    """Say whether two candidates belong to one family at one joint or at neighbouring parts of the structure."""
    a, b = design.candidates[first], design.candidates[second]
    if a.family != b.family:
        return False
    if a.family in {"load chain", "point chain"}:
        return True
    return any(
        abs(i - j) <= (0 if a.family == "joint law" else 1) for i in parts(design, first) for j in parts(design, second)
    )


def parts(design: Design, index: int) -> tuple[int, ...]:
    """Return the joints (0 is the base) that a candidate touches, for neighbourhood."""
    place = design.candidates[index].location
    last = max((_number(name) for c in design.candidates for name in _names(c.location)), default=0)
    if "base" in place:
        return (0, 1)
    if "tool" in place:
        return (last, last + 1)
    return tuple(_number(name) for name in _names(place))


def _names(place: object) -> tuple[str, ...]:
    names: list[str] = []
    for key, value in dict(place).items():  # type: ignore[call-overload]
        if key in {"joint", "link", "joints"}:
            names += [value] if isinstance(value, str) else list(value)
    return tuple(names)


def _number(name: str) -> int:
    digits = "".join(character for character in name if character.isdigit())
    return int(digits) if digits else 0
