"""The recording and all hypotheses about it as one whitened linear model.

Rows are in units of the noise, offsets eliminated; columns are the null model's parameters, then those of every
candidate in units of its prior's standard deviation (three times the typical size), then the structured
discrepancy: what instruments and geometry are known to do and nobody would call a finding, in units of how large it is
expected to be; last, what candidates leave to chance in each configuration.

Which effects do loaded steps ask for?  The search of the estimation core, on rows whose offsets are eliminated.

Rows, null model and small errors of instruments and geometry come from `design.py`; the search, its threshold, its
small effects and its proofs are those of every recording (`estimation/search.py`).  Of what it accepts, laws of one
joint that are no causes of their own become refinements of the strongest.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Collection, Sequence

import numpy as np

from calibration_core.estimation.alternatives import (
    CONFOUNDED_SHARE,
    LEFT_SHARE,
    SURE,
    are_confounded,
    lent,
    other_forms,
    other_places,
    same_deflection,
    strongest_first,
)
from calibration_core.estimation.blocks import Blocks
from calibration_core.estimation.comparisons import STEPS
from calibration_core.estimation.controls import Controls
from calibration_core.estimation.field import Accepted, Field
from calibration_core.estimation.hypotheses import LAW, Hypothesis, Offered, offer
from calibration_core.estimation.likelihood.gains import NONE
from calibration_core.estimation.search import PART, Search
from calibration_core.identification.statistics import Rows, whitened
from calibration_core.model.effects import effects_with
from calibration_core.model.effects.candidate import Candidate, Trait
from calibration_core.model.effects.state import State
from calibration_core.policy import PRIOR_WIDTH
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D

HELD = 1e30  # weight, 1/(rad/(N*m))^2, of a compliance that is zero by declaration


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """Residual, null model and candidates, whitened.

    Attributes:
        residual: (r,) measured - null model.
        null: (r, n) columns of the null model's parameters.
        columns: (r, p) columns of all candidates, per standard deviation of the prior, of the discrepancy, of chance.
        configuration: (r,) index of the configuration of every row.
        blocks: Their columns.
        prior: (p,) standard deviation of every parameter, in its unit.
        discrepancy: Columns of the structured discrepancy.
        chances: Of every candidate, the columns of what it leaves to chance.
        joints: Names of the robot's joints, from the base on.
    """

    residual: Float1D
    null: Float2D
    columns: Float2D
    configuration: Int1D
    candidates: tuple[Candidate, ...]
    blocks: tuple[slice, ...]
    prior: Float1D
    discrepancy: slice
    chances: tuple[slice, ...]
    joints: tuple[str, ...]

    @property
    def n(self) -> int:
        """Number of null parameters."""
        return self.null.shape[1]

    def own(self, candidate: int) -> Int1D:
        """Return the (k,) columns that a candidate brings with it: its parameters, and what it leaves to chance."""
        parts = (self.blocks[candidate], self.chances[candidate])
        return np.concatenate([np.arange(part.start, part.stop) for part in parts])

    def known(self, accepted: Sequence[int]) -> Float2D:
        """Return the (r, q) columns of null model, accepted candidates with their chance, and discrepancy."""
        own = [self.columns[:, self.own(index)] for index in accepted]
        return np.column_stack([self.null, *own, self.columns[:, self.discrepancy]])

    def fitted(self, accepted: Sequence[int]) -> Float2D:
        """Return the (r, n + k) columns of null model and accepted candidates alone."""
        return np.column_stack([self.null, *(self.columns[:, self.blocks[index]] for index in accepted)])

    def gram(self) -> Float2D:
        """Return the Gram matrix of [null, columns, residual]; a rigid joint is held at zero."""
        everything = np.column_stack([self.null, self.columns, self.residual])
        gram = everything.T @ everything
        held = np.flatnonzero(np.diag(gram)[: self.n] == 0.0)
        gram[held, held] = HELD
        return gram


def build_design(
    state: State,
    rows: Rows,
    residual: Float2D,
    null: Float3D,
    candidates: tuple[Candidate, ...],
    discrepancy: Float3D | None = None,
    used: Int1D | None = None,
    *,
    among: Collection[int] | None = None,
    chance: bool = True,
) -> Design:
    """Evaluate candidates' columns on all m readings (history needs them all), and whiten those used.

    Args:
        state: The null model.
        rows: Grouping and noise of the readings used.
        residual: (m, 3) m, measured - predicted.
        null: (m, 3, n) derivatives of the prediction by the null model's parameters.
        candidates: The hypotheses.
        discrepancy: (m, 3, k) m per expected size; None where there are none.
        used: Indices of the readings used; None: all.
        among: Indices of the hypotheses that are evaluated, the others have no columns; None: all.
        chance: Whether to evaluate what candidates leave to chance; offers, of which there are thousands, do without.
    """
    blocks, prior, columns, start = [], [], [], 0
    evaluated = frozenset(range(len(candidates)) if among is None else among)
    for index, candidate in enumerate(candidates):
        if index in evaluated:
            scale = PRIOR_WIDTH * np.array([parameter.typical for parameter in candidate.parameters])
            columns.append(candidate.columns(state) * scale)
            prior.append(scale)
        k = len(candidate.parameters) if index in evaluated else 0
        blocks.append(slice(start, start + k))
        start += k
    extra = np.zeros((len(residual), 3, 0)) if discrepancy is None else discrepancy
    random, places = _chances(state, candidates, evaluated if chance else frozenset(), start + extra.shape[2])
    columns += [extra, *random]
    more = sum(part.shape[2] for part in (extra, *random))
    prior.append(np.ones(more))
    data = np.concatenate([null, *columns, residual[:, :, None]], axis=2)
    white, configuration = whitened(rows, data, used)
    n = null.shape[2]
    return Design(
        residual=white[:, -1],
        null=white[:, :n],
        columns=white[:, n:-1],
        configuration=configuration,
        candidates=candidates,
        blocks=tuple(blocks),
        prior=np.concatenate(prior),
        discrepancy=slice(start, start + extra.shape[2]),
        chances=places,
        joints=state.chain.joints,
    )


def _chances(
    state: State, candidates: tuple[Candidate, ...], evaluated: frozenset[int], start: int
) -> tuple[list[Float3D], tuple[slice, ...]]:
    """Return the columns of what is left to chance, once for all with the same function, and whose they are."""
    several = [candidate.chances if index in evaluated else None for index, candidate in enumerate(candidates)]
    functions = dict.fromkeys(function for function in several if function is not None)
    columns = [function(state) for function in functions]
    ends = list(itertools.accumulate((part.shape[2] for part in columns), initial=start))
    own = dict(zip(functions, itertools.starmap(slice, itertools.pairwise(ends)), strict=True))
    nothing = slice(start, start)
    return columns, tuple(nothing if function is None else own[function] for function in several)


# --- which effects do loaded steps ask for?  The search of the estimation core, on rows whose offsets -----------------


BLOCKS = 20  # of whole configurations, left out one after the other


@dataclasses.dataclass(frozen=True)
class Choice:
    """An accepted candidate.

    Attributes:
        candidate: Its index.
        log_bayes_factor: Given all other accepted ones, nats.
        held_out_gain: Share of the squared error on blocks left out that it saves with its refinements.
        equivalents: Other places that come within five nats at a plausible size, nearest first, and their log Bayes
            factors.
        refinements: Accepted candidates that are this one's law or neighbour, not causes of their own.
        forms: Other forms at its place that come within five nats, and by how much they are more probable, nats.
    """

    candidate: int
    log_bayes_factor: float
    held_out_gain: float = 0.0
    equivalents: tuple[tuple[int, float], ...] = ()
    refinements: tuple[int, ...] = ()
    forms: tuple[tuple[int, float], ...] = ()


@dataclasses.dataclass(frozen=True, eq=False)
class LoadedSelection:
    """What was accepted.

    Attributes:
        accepted: All accepted candidates, refinements included.
        level: Signal-to-noise ratio of the small effects that remain, each.
        unsure: For each accepted candidate the (c,) signal-to-noise ratios that it lends to every candidate's place:
            its law is known to a share only, and the places that are confounded with it may hold the rest.
    """

    choices: tuple[Choice, ...]
    accepted: tuple[int, ...]
    level: float
    unsure: tuple[Float1D, ...]

    @property
    def share(self) -> Float1D:
        """(c,) signal-to-noise ratio of every candidate's place in the covariance of the estimate, or one of all."""
        return np.maximum(self.level, np.max(np.array(self.unsure), axis=0, initial=0.0))

    @property
    def named(self) -> frozenset[int]:
        """Candidates that are accepted, or do as well as one that is."""
        return frozenset((*self.accepted, *(index for choice in self.choices for index, _ in choice.equivalents)))

    @property
    def with_size(self) -> frozenset[int] | None:
        """Candidates that are accepted or in the covariance of the estimate; None: all."""
        share = self.share
        if not share.ndim and share:
            return None
        return frozenset((*self.accepted, *np.flatnonzero(share).tolist()))

    def without(self, left_out: Sequence[Choice]) -> LoadedSelection:
        """Return the selection without some of its choices."""
        gone = {index for choice in left_out for index in (choice.candidate, *choice.refinements)}
        choices = tuple(choice for choice in self.choices if choice.candidate not in gone)
        kept = [k for k, index in enumerate(self.accepted) if index not in gone]
        accepted, unsure = tuple(self.accepted[k] for k in kept), tuple(self.unsure[k] for k in kept)
        return dataclasses.replace(self, choices=choices, accepted=accepted, unsure=unsure)


def select(design: Design, *, noise_known: bool = True) -> LoadedSelection:
    """Search loaded steps for what their null model leaves out.

    Args:
        design: The whitened model.
        noise_known: Whether the noise was seen without a model; where it is what the model leaves, small effects are
            part of it.
    """
    demands = STEPS if noise_known else dataclasses.replace(STEPS, levels=NONE)
    search = Search(field_of(design), Controls({}), demands)
    accepted = _by_joint(search, search.run().accepted)
    found = search.result(accepted)
    hypotheses = search.field.offered.hypotheses
    choices: list[Choice] = []
    own: list[list[int]] = []  # hypotheses of each
    gains = dict(zip(found.accepted, found.gain, strict=True))
    for index in strongest_first(search, found.accepted, design.joints):
        candidate, gain = hypotheses[index].members[0], gains[index]
        for k, choice in enumerate(choices):
            if _is_refinement(design, choice, candidate, gain):
                choices[k] = dataclasses.replace(choice, refinements=(*choice.refinements, candidate))
                own[k].append(index)
                break
        else:
            forms = tuple((hypotheses[i].members[0], nats) for i, nats in other_forms(search, found, index))
            elsewhere = [(hypotheses[i], nats) for i, nats in other_places(search, found, index)]
            single = tuple((one.members[0], nats) for one, nats in elsewhere if len(one.members) == 1)
            choices.append(Choice(candidate, gain, equivalents=single, forms=forms))
            own.append([index])
    chosen = tuple(hypotheses[index].members[0] for index in found.accepted)
    unsure = tuple(lent(search, found.accepted, index, design.joints) for index in found.accepted)
    several = tuple(
        dataclasses.replace(choice, held_out_gain=_saved(search, found.accepted, mine))
        for choice, mine in zip(choices, own, strict=True)
    )
    return LoadedSelection(several, chosen, found.level, unsure)


def _saved(search: Search, accepted: Accepted, some: Collection[int]) -> float:
    """Return the share of the squared error on blocks left out that some accepted hypotheses save."""
    others = tuple(i for i in accepted if i not in some)
    without, whole = (sum(float(part.sum()) for part in search.squares(one)) for one in (others, accepted))
    return 1 - whole / without


def field_of(design: Design) -> Field:
    """Return rows and hypotheses of a design for the search; what a candidate leaves to chance has its size."""
    own, usual = design.discrepancy.start, design.discrepancy
    offered = offer(design.candidates)
    hypotheses = tuple(_with_chance(one, design) for one in offered.hypotheses)
    columns = design.columns[:, :own], design.columns[:, usual.stop :]
    return Field.of(
        design.residual, design.null, design.columns[:, usual], columns,
        Offered(offered.candidates, offered.blocks, hypotheses), (_blocks(design.configuration),), PRIOR_WIDTH,
    )  # fmt: skip


def _with_chance(one: Hypothesis, design: Design) -> Hypothesis:
    """Return a single hypothesis with its columns of chance; a family, which is wide without, as it is."""
    if len(one.members) > 1:
        return one
    before = design.discrepancy.stop - design.discrepancy.start
    parts = [np.arange(design.chances[k].start, design.chances[k].stop) - before for k in one.members]
    chance = np.unique(np.concatenate(parts))
    return dataclasses.replace(one, columns=np.concatenate([one.columns, chance]), chance=chance)


def _blocks(configuration: Int1D) -> Blocks:
    """Return blocks of whole configurations, in their order; every three rows count as a reading."""
    numbers, place = np.unique(configuration[::3], return_inverse=True)
    return Blocks("time", place.reshape(-1) * min(BLOCKS, len(numbers)) // len(numbers))


def _by_joint(search: Search, accepted: Accepted) -> Accepted:
    """Return every family as those of its members that gain beside the others: a finding for each joint."""
    hypotheses = search.field.offered.hypotheses
    single = {one.members[0]: i for i, one in enumerate(hypotheses) if len(one.members) == 1}
    members = [single[k] for i in accepted for k in hypotheses[i].members]
    several = tuple(i for i in dict.fromkeys(members) if i in search.place)
    new = set(several) - set(accepted)
    while new:
        beside = {i: tuple(k for k in several if k != i) for i in several}
        gain = {i: search.score(rest, i)[0] for i, rest in beside.items() if i in new}
        weakest = min(gain, key=lambda i: gain[i])
        if gain[weakest] >= PART:
            break
        several, new = beside[weakest], new - {weakest}
    return search.possible(several)


def _is_refinement(design: Design, choice: Choice, candidate: int, gain: float) -> bool:
    """Say whether an accepted candidate is a form of a stronger one, no cause of its own."""
    first, second = design.candidates[choice.candidate], design.candidates[candidate]
    alike = first.family == second.family == LAW or {first.effect, second.effect} <= effects_with(Trait.MEMORY)
    weaker = gain < CONFOUNDED_SHARE * choice.log_bayes_factor
    left = first.family == LAW and gain < min(LEFT_SHARE * choice.log_bayes_factor, SURE)
    if left and same_deflection(first, second):
        return True
    return (alike or weaker or first.place == second.place) and are_confounded(first, second, design.joints)
