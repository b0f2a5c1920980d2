"""What positions at rest tell, and what further postures would show of it.

A posture is judged for effects that depend on the posture alone: a proposal does not determine from where it is
reached, when, and at which temperature.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.proposals.candidates import Offer, Offers
from calibration_core.diagnosis.proposals.choose import Knowledge, OfferTable, Proposals, Uncertain, choose
from calibration_core.diagnosis.proposals.information import HypothesisPosterior
from calibration_core.estimation.field import Field
from calibration_core.estimation.hypotheses import Hypothesis, typical_sizes
from calibration_core.estimation.rows import NullModel, state_at
from calibration_core.estimation.shifts import FAMILY
from calibration_core.identification.geometry.problem import problem_of
from calibration_core.model.effects import effects_with
from calibration_core.model.effects.candidate import Trait
from calibration_core.model.effects.words import effect_sentence
from calibration_core.model.robot import chain_of
from calibration_core.observations.covariance import position_covariance
from calibration_core.timeseries import Float2D, Float3D

NOTHING_FOUND = "Nothing was found in the positions that further postures would make more certain."
NO_POSTURE = "No posture that the cell file allows could be drawn; nothing is proposed."


@dataclasses.dataclass(frozen=True, eq=False)
class Known:
    """What the recording tells, as the search left it.

    Attributes:
        field: Rows and hypotheses.
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
