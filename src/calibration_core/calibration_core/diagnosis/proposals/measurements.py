"""Which measurement would separate what is confounded now, and if nothing is ambiguous, sharpen what was found.

Every offered configuration is judged by what is expected of it (see `information`); the gain is said beside that of
an offer taken at random.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.data_checks.noise import Scatter
from calibration_core.diagnosis.evidence.design import Design, build_design
from calibration_core.diagnosis.evidence.discrepancy import structured_discrepancy
from calibration_core.diagnosis.evidence.extended import ExtendedLoadedModel, loaded_state
from calibration_core.diagnosis.evidence.selection import Choice, LoadedSelection
from calibration_core.diagnosis.proposals.candidates import Expected, Offer, Offers, alternating
from calibration_core.diagnosis.proposals.information import HypothesisPosterior, expected_log_bayes_factor
from calibration_core.diagnosis.result.evidence_words import odds_words
from calibration_core.diagnosis.result.finding import ProposedMeasurement
from calibration_core.identification.geometry.frames import FrameFit
from calibration_core.identification.stiffness.problem import build_problem
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.words import effect_sentence
from calibration_core.timeseries import Float1D, Float3D

PROPOSED = 3
ROUGH = 5  # steps by which all offers are judged
JUDGED = 24  # offers that are judged in full
WORTH = 0.02  # share by which a proposal lowers the worst standard deviation at least
SEPARABLE = 0.5  # nats: an offer that is expected to give less separates nothing


@dataclasses.dataclass(frozen=True)
class Proposals:
    """What to measure next.

    Attributes:
        measurements: Most useful first.
        text: What no measurement of this kind can decide, or why nothing is proposed; empty if there is nothing to say.
    """

    measurements: tuple[ProposedMeasurement, ...]
    text: str


def propose(
    extended: ExtendedLoadedModel,
    selection: LoadedSelection,
    offers: Offers,
    cell: Cell,
    seen: Scatter,
    frames: FrameFit | None,
) -> Proposals:
    """Choose among offers.

    Args:
        extended: The extended model.
        selection: What was accepted, and what does as well.
        offers: What could be measured.
        cell: The cell file.
        seen: The noise.
        frames: Refitted frames; None for displacement recordings.
    """
    if not offers.each:
        return Proposals((), "No configuration that the cell file allows could be drawn; nothing is proposed.")
    return _Search(extended, selection, offers, cell, seen, frames).run()


NONE_ASKED = Proposals((), "")


@dataclasses.dataclass(frozen=True, eq=False)
class _Table:
    """Columns of some offers, whitened.

    Attributes:
        offers: The k offers.
        design: Where which candidate's columns are.
        columns: (k, d, n + p) null model, candidates in the order of `members`, structured discrepancy.
        members: Their indices in the recording's design.
    """

    offers: tuple[Offer, ...]
    design: Design
    columns: Float3D
    members: tuple[int, ...]

    def of(self, chosen: Sequence[int]) -> Float3D:
        """Return (k, d, p) columns under a hypothesis."""
        n, blocks = self.design.n, [self.design.blocks[self.members.index(i)] for i in chosen]
        parts = [self.columns[:, :, :n], *(self.columns[:, :, n + b.start : n + b.stop] for b in blocks)]
        tail = self.columns[:, :, n + self.design.discrepancy.start : n + self.design.discrepancy.stop]
        return np.concatenate([*parts, tail], axis=2)


@dataclasses.dataclass(frozen=True, eq=False)
class _Judged:
    """Offers judged for one purpose: higher scores first, and what to say of each."""

    score: Float1D
    gain: Float1D
    useful: bool = True


Judge = Callable[[_Table], _Judged]


class _Search:
    """The designs of recording and offers, hypotheses by the indices of their candidates."""

    def __init__(
        self,
        extended: ExtendedLoadedModel,
        selection: LoadedSelection,
        offers: Offers,
        cell: Cell,
        seen: Scatter,
        frames: FrameFit | None,
    ) -> None:
        self.extended, self.selection, self.offers, self.expected = extended, selection, offers.each, offers.expected
        self.cell, self.seen, self.frames = cell, seen, frames
        equal = (index for choice in selection.choices for index, _ in choice.equivalents)
        self.members = tuple(dict.fromkeys([*selection.accepted, *equal]))
        self.recorded = extended.design
        self.coarse = self._table(tuple(_coarse(offer) for offer in self.offers))
        self.taken: list[_Table] = []

    def run(self) -> Proposals:
        """Propose one offer for every ambiguous finding, then sharpen what is known worst."""
        measurements: list[ProposedMeasurement] = []
        undecided: list[str] = []
        for choice in self.selection.choices:
            if choice.equivalents and len(measurements) < PROPOSED:
                found = self._separating(choice)
                if found is None:
                    undecided.append(_name(self.recorded.candidates[choice.candidate]))
                else:
                    measurements.append(found)
        while len(measurements) < PROPOSED and (sharper := self._sharpening()) is not None:
            measurements.append(sharper)
        text = ""
        if undecided:
            text = (
                f"No load at the flange distinguishes “{'” and “'.join(undecided)}” from what does as well: a target "
                "on the link before, another sensor or another place of the load is needed."
            )
        elif not measurements:
            text = "Further measurements of this kind would gain nothing worth the time."
        return Proposals(tuple(measurements), text)

    def _table(self, offers: tuple[Offer, ...]) -> _Table:
        chosen = tuple(self.recorded.candidates[i] for i in self.members)
        design, columns = _offered(self.extended, chosen, offers, self.expected, self.cell, self.seen, self.frames)
        return _Table(offers, design, columns, self.members)

    def _best(self, judge: Judge) -> tuple[Offer, float, float] | None:
        """Judge all offers roughly, the best and some taken at random in full; return the best, its gain, the usual.

        The best ones are judged with the load levels of the recording, and alternating between the extremes of these.
        """
        rough = judge(self.coarse)
        if not rough.useful:
            return None
        order = np.argsort(-rough.score, kind="stable")[:JUDGED]
        chosen = [self.offers[k] for k in order]
        chosen += [alternating(offer) for offer in chosen]
        table = self._table((*chosen, *self.offers[:JUDGED]))
        full = judge(table)
        best = int(np.argmax(full.score[: len(chosen)]))
        self.taken.append(dataclasses.replace(table, offers=(table.offers[best],), columns=table.columns[[best]]))
        return table.offers[best], float(full.gain[best]), float(np.median(full.gain[len(chosen) :]))

    def _knowledge(self, chosen: Sequence[int], truth: Sequence[int]) -> HypothesisPosterior:
        """Return what is known under a hypothesis, the offers taken already measured as the truth predicts them."""
        known = self._from_recording(chosen)
        if self.taken:
            mean = self._from_recording(truth).mean
            for table in self.taken:
                known = known.after(table.of(chosen)[0], table.of(truth)[0] @ mean)
        return known

    def _from_recording(self, chosen: Sequence[int]) -> HypothesisPosterior:
        design = self.recorded
        parts = [design.columns[:, design.blocks[i]] for i in chosen]
        columns = np.column_stack([design.null, *parts, design.columns[:, design.discrepancy]])
        return HypothesisPosterior.of(columns, design.residual, design.n)

    def _separating(self, choice: Choice) -> ProposedMeasurement | None:
        """Return the offer that separates a finding from what does as well; None if none does."""
        others = tuple(i for i in self.selection.accepted if i != choice.candidate)
        hypotheses = [(*others, choice.candidate), *((*others, index) for index, _ in choice.equivalents)]
        known = [self._knowledge(h, hypotheses[0]) for h in hypotheses]

        def judge(table: _Table) -> _Judged:
            predicted = [k.predict(table.of(h)) for k, h in zip(known, hypotheses, strict=True)]
            nearest = np.full(len(table.offers), np.inf)
            for other in predicted[1:]:
                apart = expected_log_bayes_factor(predicted[0], other)
                if float(apart.max()) > SEPARABLE:
                    nearest = np.minimum(nearest, apart)
            return _Judged(nearest, nearest, bool(np.isfinite(nearest).any()))

        found = self._best(judge)
        if found is None:
            return None
        offer, gain, usual = found
        names = [_name(self.recorded.candidates[i]) for i in (choice.candidate, *(i for i, _ in choice.equivalents))]
        why = (
            f"shows whether {', or '.join(names)}: the odds between the two nearest of them that it can "
            f"distinguish are expected to change {odds_words(gain)} "
            f"(a configuration taken at random: {odds_words(usual)})"
        )
        return measurement_of(offer, why, gain, usual, "nats")

    def _sharpening(self) -> ProposedMeasurement | None:
        """Return the offer that makes what is known worst more certain: a finding's parameters, else a stiffness.

        None where nothing is known, for no joint gives way in this recording, or where the gain is not worth it.
        """
        accepted = self.selection.accepted
        known = self._knowledge(accepted, accepted)
        words, chosen, value = self._uncertain(known)
        if not words:
            return None
        before = np.sqrt(np.diag(known.covariance)[chosen])
        worst = int(np.argmax(before / value))

        def judge(table: _Table) -> _Judged:
            after = np.sqrt(np.maximum(known.variances_after(table.of(accepted), chosen), 1e-300)) / value
            return _Judged(-after[:, worst], -after[:, worst])

        found = self._best(judge)
        assert found is not None  # noqa: S101 - this judge calls every offer useful
        offer, then, usual = found[0], -found[1], -found[2]
        now = float(before[worst] / value[worst])
        if now - then < WORTH * now:
            return None
        why = (
            f"makes {words[worst]} more certain: its standard deviation falls from {100 * now:.2f} % to "
            f"{100 * then:.2f} % (a configuration taken at random: {100 * usual:.2f} %)"
        )
        return measurement_of(offer, why, 100 * (now - then), 100 * (now - usual), "%")

    def _uncertain(self, known: HypothesisPosterior) -> tuple[list[str], list[int], Float1D]:
        """Return names, places and sizes of the parameters in question: of the findings, else all stiffnesses."""
        n, design = self.recorded.n, self.recorded
        words = [
            f"{parameter.name.replace('_', ' ')} ({_name(design.candidates[i])})"
            for i in self.selection.accepted
            for parameter in design.candidates[i].parameters
        ]
        size = np.abs(known.mean[n : n + len(words)])
        reported = np.flatnonzero(size > np.sqrt(np.diag(known.covariance)[n : n + len(words)]))
        if len(reported):
            return [words[k] for k in reported], [n + int(k) for k in reported], size[reported]
        joints = [f"the stiffness of {joint}" for joint in self.extended.state.chain.joints]
        bending = np.flatnonzero(self.extended.base_compliance > 0)
        return [joints[k] for k in bending], list(map(int, bending)), self.extended.base_compliance[bending]


def _coarse(offer: Offer) -> Offer:
    """Return an offer with few steps, enough to judge it roughly."""
    rows = np.unique(np.linspace(0, len(offer.steps) - 1, ROUGH).round().astype(int))
    return dataclasses.replace(offer, steps=offer.steps[rows])


def _offered(
    extended: ExtendedLoadedModel,
    chosen: tuple[Candidate, ...],
    offers: tuple[Offer, ...],
    expected: Expected,
    cell: Cell,
    seen: Scatter,
    frames: FrameFit | None,
) -> tuple[Design, Float3D]:
    """Evaluate the linear model on offers; return it, and its columns (k, d, n + p) offer by offer."""
    problem = extended.problem
    parameters = problem.parameters.replace(compliance=extended.base_compliance)
    readings = expected(offers, parameters)
    would = build_problem(readings, cell, problem.chain, parameters)
    linear = would.linearise(extended.base_compliance)
    rows = dataclasses.replace(linear.rows, noise=linear.rows.noise * seen.total**2)
    state = loaded_state(would, cell, extended.base_compliance)
    state = dataclasses.replace(state, reference_torque=extended.state.largest_torques())
    extra = structured_discrepancy(state, frames)
    design = build_design(state, rows, linear.residual, linear.columns, chosen, extra, chance=False)
    table = np.column_stack([design.null, design.columns])
    return design, table.reshape(len(offers), -1, table.shape[1])


def measurement_of(offer: Offer, why: str, gain: float, usual: float, unit: str) -> ProposedMeasurement:
    """Return an offer as a proposal: why, its gain, that of a usual offer, and their unit."""
    full: Float1D = offer.full
    return ProposedMeasurement(
        q=tuple(map(float, offer.q)),
        wrench=tuple(map(float, full)),
        why=why,
        steps=tuple(tuple(map(float, step)) for step in offer.steps),
        gain=gain,
        gain_at_random=usual,
        gain_unit=unit,
    )


def _name(candidate: Candidate) -> str:
    return effect_sentence(candidate.effect, candidate.location)
