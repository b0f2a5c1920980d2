"""What positions at rest tell, and what further postures would show of it.

A posture is judged for effects that depend on the posture alone: a proposal does not determine from where it is
reached, when, and at which temperature.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.data_checks.noise import Scatter, claimed
from calibration_core.diagnosis.evidence.design import LoadedSelection, build_design
from calibration_core.diagnosis.evidence.extended import (
    ExtendedLoadedModel,
    extend,
    loaded_state,
    structured_discrepancy,
)
from calibration_core.diagnosis.proposals.choose import (
    HypothesisPosterior,
    Knowledge,
    Offer,
    Offers,
    OfferTable,
    Proposals,
    Uncertain,
    choose,
)
from calibration_core.estimation.field import Field
from calibration_core.estimation.hypotheses import Hypothesis, typical_sizes
from calibration_core.estimation.rows import NullModel, state_at
from calibration_core.estimation.shifts import FAMILY
from calibration_core.identification.geometry.fit import problem_of
from calibration_core.identification.stiffness.loaded import PreparedLoaded
from calibration_core.identification.stiffness.problem import build_problem
from calibration_core.model.effects import effects_with
from calibration_core.model.effects.candidate import Trait
from calibration_core.model.effects.words import effect_sentence
from calibration_core.model.robot import chain_of
from calibration_core.observations.average import position_covariance
from calibration_core.timeseries import Float2D, Float3D, Int1D

NOTHING_FOUND = "Nothing was found in the positions that further postures would make more certain."
NO_POSTURE = "No posture that the cell file allows could be drawn; nothing is proposed."


@dataclasses.dataclass(frozen=True, eq=False)
class Known:
    """What the recording tells, as the search left it.

    Attributes:
        sizes: Hypothesis -> standard deviation of its prior, typical sizes; of the accepted ones and of their rivals.
        accepted: Hypotheses in the model.
        equivalents: Accepted hypothesis -> what explains the data as well: (index, log Bayes factor).
        model: The null model, about which all is linear.
        noise: Standard deviation of an independent row.
    """

    field: Field
    sizes: Mapping[int, float]
    accepted: tuple[int, ...]
    equivalents: Mapping[int, tuple[tuple[int, float], ...]]
    model: NullModel
    noise: float

    def of(self, index: int) -> Hypothesis:
        """Return a hypothesis."""
        return self.field.offered.hypotheses[index]

    def by_posture(self, index: int) -> bool:
        """Return whether a hypothesis depends on the posture alone."""
        return self.of(index).effect not in effects_with(Trait.HISTORY) and self.of(index).family != FAMILY


def propose_postures(known: Known, cell: Cell, offers: Offers) -> Proposals:
    """Choose among postures."""
    if not any(known.by_posture(index) for index in known.accepted):
        return Proposals((), NOTHING_FOUND)
    unloaded = tuple(dataclasses.replace(offer, steps=np.zeros((1, 6))) for offer in offers.each)
    return choose(_Postures(known, cell, offers), unloaded)


class _Postures(Knowledge):
    """The rows of the search, and those of offers; hypotheses are those of the search."""

    worth = 0.02
    nothing_offered = NO_POSTURE

    def __init__(self, known: Known, cell: Cell, offers: Offers) -> None:
        self.known, self.cell, self.expected = known, cell, offers.expected
        self.accepted = known.accepted
        self.rivals = {one: tuple(index for index, _ in several) for one, several in known.equivalents.items()}
        self.members = tuple(dict.fromkeys([*self.accepted, *(i for several in self.rivals.values() for i in several)]))

    def name(self, index: int) -> str:
        one = self.known.of(index)
        return f"{effect_sentence(one.effect, one.location)} ({one.variant})"

    def posterior(self, chosen: Sequence[int]) -> HypothesisPosterior:
        field, f = self.known.field, self.known.field.flat_count
        own = np.concatenate([np.zeros(0, dtype=np.int64), *(self.known.of(i).columns for i in chosen)])
        columns = field.wide.take(np.concatenate([np.arange(f), f + own]), axis=1)
        sizes = [np.full(len(self.known.of(i).columns), self.known.sizes[i]) for i in chosen]
        scale = np.concatenate([np.ones(f), *sizes]) / self.known.noise
        matrix = field.products(columns, own) * np.outer(scale, scale)
        vector = field.residual @ columns * scale / self.known.noise
        return HypothesisPosterior.from_products(matrix, vector, f)

    def table(self, offers: tuple[Offer, ...]) -> OfferTable:
        there, k = self._at(offers), len(offers)
        every = np.arange(len(there.readings))

        def per_offer(columns: Float2D) -> Float3D:
            return np.asarray(columns / self.known.noise).reshape(k, -1, columns.shape[1])

        flat, _ = there.flat(every)
        sensor = np.zeros((len(flat), self.known.field.flat_count - flat.shape[1]))  # nothing pulls at the sensor
        own = {}
        for index in self.members:
            several = [self.known.field.offered.candidates[m] for m in self.known.of(index).members]
            columns = np.zeros((len(flat), len(self.known.of(index).columns)))
            if self.known.by_posture(index):
                scaled = np.concatenate([typical_sizes(one) for one in several])
                columns = self.known.sizes[index] * there.moves(several, every) * scaled
            own[index] = per_offer(columns)
        null = per_offer(np.concatenate([flat, sensor], axis=1) / self.known.field.flat_scale)
        return OfferTable(offers, null, own, null[:, :, :0])

    def _at(self, offers: tuple[Offer, ...]) -> NullModel:
        """Return the null model of the readings that offers would give."""
        model, parameters = self.known.model, self.known.model.parameters
        seen = self.expected(offers, parameters)
        problem = problem_of(seen, self.cell, chain_of(self.cell), parameters, position_covariance(seen, self.cell))
        names = model.problem.names
        point = np.array([names.index(seen.points[p]) for p in seen.point]) if len(names) > 1 else None
        problem = dataclasses.replace(problem, names=names, point=point)
        state, used = state_at(problem, parameters, seen, self.cell), np.ones(len(seen), dtype=bool)
        return dataclasses.replace(model, readings=seen, problem=problem, state=state, used=used)

    def parameters(self, index: int) -> list[tuple[str, tuple[int, ...]]]:
        width = len(self.known.of(index).columns)
        return [(f"“{self.name(index)}”", tuple(range(width)))] if self.known.by_posture(index) else []

    def otherwise(self) -> list[Uncertain]:
        return []

    def inseparable(self, names: Sequence[str]) -> str:
        return f"No posture alone distinguishes “{'” and “'.join(names)}” from the explanations that do as well."


# --- what a recording of loaded steps tells, and what further configurations with loads would show of it --------------


def propose_loads(prepared: PreparedLoaded, used: Int1D, cell: Cell, offers: Offers) -> Proposals:
    """Choose among configurations with loads for the stiffnesses alone, as the loaded steps of a recording show them.

    Args:
        prepared: The loaded steps of the recording.
        used: Indices of the readings used.
        cell: The cell file.
        offers: What could be measured; configurations without loads tell nothing of it.
    """
    pulled = tuple(offer for offer in offers.each if np.any(offer.steps))
    if not pulled:
        return Proposals((), "")
    problem, fitted = prepared.problem, prepared.fit.compliance
    start = np.where(fitted > 0, fitted, prepared.nominal.compliance)
    rows = problem.linearise(start).rows.select(used)
    nothing = LoadedSelection((), (), 0.0, ())
    extended = extend(problem, cell, start, rows, used, (), prepared.frames, nothing)
    extended = dataclasses.replace(extended, base_compliance=start)
    return choose(LoadedKnowledge(extended, nothing, offers, cell, claimed(1.0), prepared), pulled)


class LoadedKnowledge(Knowledge):
    """The designs of recording and offers; hypotheses are the indices of their candidates.

    A joint that gave way in no step is taken for as stiff as it is believed to be.
    """

    worth = 0.02
    nothing_offered = "No configuration that the cell file allows could be drawn; nothing is proposed."

    def __init__(
        self,
        extended: ExtendedLoadedModel,
        selection: LoadedSelection,
        offers: Offers,
        cell: Cell,
        seen: Scatter,
        prepared: PreparedLoaded,
    ) -> None:
        """Keep what the recording tells.

        Args:
            extended: The extended model.
            selection: What was accepted, and what does as well.
            offers: What could be measured.
            cell: The cell file.
            seen: The noise.
            prepared: Refitted frames, and what was believed of the joints.
        """
        self.extended, self.expected, found = extended, offers.expected, extended.base_compliance
        self.cell, self.seen, self.frames = cell, seen, prepared.frames
        self.compliance = np.where(found > 0, found, prepared.nominal.compliance)
        self.accepted = selection.accepted
        self.rivals = {one.candidate: tuple(index for index, _ in one.equivalents) for one in selection.choices}
        self.members = tuple(dict.fromkeys([*self.accepted, *(i for several in self.rivals.values() for i in several)]))

    def name(self, index: int) -> str:
        """Return effect and place of a candidate in words."""
        candidate = self.extended.design.candidates[index]
        return effect_sentence(candidate.effect, candidate.location)

    def posterior(self, chosen: Sequence[int]) -> HypothesisPosterior:
        """Return what the whitened recording tells under some candidates together."""
        design = self.extended.design
        columns = np.column_stack([design.fitted(chosen), design.columns[:, design.discrepancy]])
        return HypothesisPosterior.of(columns, design.residual, design.n)

    def table(self, offers: tuple[Offer, ...]) -> OfferTable:
        """Return the whitened columns of some offers, for the accepted candidates and their rivals."""
        extended, compliance = self.extended, self.compliance
        readings = self.expected(offers, extended.problem.parameters.replace(compliance=compliance))
        would = build_problem(readings, self.cell, extended.problem.chain, extended.problem.parameters)
        linear = would.linearise(compliance)
        rows = dataclasses.replace(linear.rows, noise=linear.rows.noise * self.seen.total**2)
        state = loaded_state(would, self.cell, compliance)
        state = dataclasses.replace(state, reference_torque=extended.state.largest_torques())
        chosen = tuple(extended.design.candidates[i] for i in self.members)
        extra = structured_discrepancy(state, self.frames)
        design = build_design(state, rows, linear.residual, linear.columns, chosen, extra, chance=False)
        null, columns = (part.reshape(len(offers), -1, part.shape[1]) for part in (design.null, design.columns))
        own = {i: columns[:, :, block] for i, block in zip(self.members, design.blocks, strict=True)}
        return OfferTable(offers, null, own, columns[:, :, design.discrepancy])

    def parameters(self, index: int) -> list[tuple[str, tuple[int, ...]]]:
        """Return words and place of every parameter of a candidate: each is judged by itself."""
        several = self.extended.design.candidates[index].parameters
        return [(f"{one.name.replace('_', ' ')} of “{self.name(index)}”", (k,)) for k, one in enumerate(several)]

    def otherwise(self) -> list[Uncertain]:
        """Return the stiffnesses of the joints that give way."""
        compliances = zip(self.extended.state.chain.joints, self.compliance, strict=True)
        return [Uncertain(f"the stiffness of {name}", (j,), c) for j, (name, c) in enumerate(compliances) if c > 0]

    def inseparable(self, names: Sequence[str]) -> str:
        """Return a sentence on candidates that no load at the flange separates from their rivals."""
        return (
            f"No load at the flange distinguishes “{'” and “'.join(names)}” from the explanations that do as well: a "
            "target on the link before, another sensor or another place of the load is needed."
        )
