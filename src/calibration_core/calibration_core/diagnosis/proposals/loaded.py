"""What a recording of loaded steps tells, and what further configurations with loads would show of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.data_checks.noise import Scatter, claimed
from calibration_core.diagnosis.evidence.design import build_design
from calibration_core.diagnosis.evidence.extended import (
    ExtendedLoadedModel,
    extend,
    loaded_state,
    structured_discrepancy,
)
from calibration_core.diagnosis.evidence.selection import LoadedSelection
from calibration_core.diagnosis.proposals.candidates import Offer, Offers
from calibration_core.diagnosis.proposals.choose import Knowledge, OfferTable, Proposals, Uncertain, choose
from calibration_core.diagnosis.proposals.information import HypothesisPosterior
from calibration_core.identification.geometry.frames import FrameFit
from calibration_core.identification.stiffness.loaded import PreparedLoaded
from calibration_core.identification.stiffness.problem import build_problem
from calibration_core.model.effects.words import effect_sentence
from calibration_core.timeseries import Float1D, Int1D


def propose_loads(prepared: PreparedLoaded, believed: Float1D, used: Int1D, cell: Cell, offers: Offers) -> Proposals:
    """Choose among configurations with loads for the stiffnesses alone, as the loaded steps of a recording show them.

    A joint that gave way in no step is taken for as stiff as it is believed to be.

    Args:
        prepared: The loaded steps of the recording.
        believed: (n,) rad/(N*m), compliances by the cell file, or by the model to start from.
        used: Indices of the readings used.
        cell: The cell file.
        offers: What could be measured; configurations without loads tell nothing of it.
    """
    pulled = tuple(offer for offer in offers.each if np.any(offer.steps))
    if not pulled:
        return Proposals((), "")
    problem, fitted = prepared.problem, prepared.fit.compliance
    start = np.where(fitted > 0, fitted, believed)
    rows = problem.linearise(start).rows.select(used)
    nothing = LoadedSelection((), (), 0.0, ())
    extended = extend(problem, cell, start, rows, used, (), prepared.frames, nothing)
    extended = dataclasses.replace(extended, base_compliance=start)
    return choose(LoadedKnowledge(extended, nothing, offers, cell, claimed(1.0), prepared.frames), pulled)


class LoadedKnowledge(Knowledge):
    """The designs of recording and offers; hypotheses are the indices of their candidates."""

    worth = 0.02
    nothing_offered = "No configuration that the cell file allows could be drawn; nothing is proposed."

    def __init__(
        self,
        extended: ExtendedLoadedModel,
        selection: LoadedSelection,
        offers: Offers,
        cell: Cell,
        seen: Scatter,
        frames: FrameFit | None,
    ) -> None:
        """Keep what the recording tells.

        Args:
            extended: The extended model.
            selection: What was accepted, and what does as well.
            offers: What could be measured.
            cell: The cell file.
            seen: The noise.
            frames: Refitted frames; None for displacement recordings.
        """
        self.extended, self.expected = extended, offers.expected
        self.cell, self.seen, self.frames = cell, seen, frames
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
        extended, compliance = self.extended, self.extended.base_compliance
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
        """Return the stiffnesses of the joints that give way in this recording."""
        compliances = zip(self.extended.state.chain.joints, self.extended.base_compliance, strict=True)
        return [Uncertain(f"the stiffness of {name}", (j,), c) for j, (name, c) in enumerate(compliances) if c > 0]

    def inseparable(self, names: Sequence[str]) -> str:
        """Return a sentence on candidates that no load at the flange separates from their rivals."""
        return (
            f"No load at the flange distinguishes “{'” and “'.join(names)}” from the explanations that do as well: a "
            "target on the link before, another sensor or another place of the load is needed."
        )
