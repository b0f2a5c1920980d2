"""Which postures would separate what absolute positions cannot tell apart, or make more certain what was found.

Every posture is judged by what is expected of it (see `next_knowledge`), beside one taken at random.  It is judged for
effects that depend on the posture alone: from where it is reached, when and how warm, no proposal can promise.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.absolute_design import (
    PRIOR_WIDTH,
    AbsoluteDesign,
    absolute_state,
    null_columns,
    weighted,
)
from calibration_core.diagnosis.finding import Measurement
from calibration_core.diagnosis.next_knowledge import Knowledge, expected_log_bayes_factor
from calibration_core.diagnosis.next_measurements import PROPOSED, SEPARABLE, Proposals, measurement_of
from calibration_core.diagnosis.next_offers import Offer
from calibration_core.identification.absolute_problem import absolute_problem
from calibration_core.identification.predict import predict_readings
from calibration_core.identification.terms import Term
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.observations.covariance import position_covariance
from calibration_core.timeseries import Float1D, Float3D, Readings

HISTORY = frozenset({"approach_direction", "thermal_growth", "tracker_drift", "clock_offset"})
NOTHING_FOUND = "Nothing was found in the positions that further postures would make more certain."
NO_POSTURE = "No posture that the cell file allows could be drawn; nothing is proposed."


@dataclasses.dataclass(frozen=True, eq=False)
class Known:
    """What the recording tells, as the search left it.

    Attributes:
        design: The linear model on the recording.
        accepted: Candidates in the model.
        equivalents: Accepted candidate -> what explains the data as well: (index, log Bayes factor).
        parameters: The null model's values, at which the design is linear.
        terms: What it fits.
        nuisances: Hypotheses that are part of it.
        noise: Standard deviation of what remains, in units of the claimed noise.
    """

    design: AbsoluteDesign
    accepted: tuple[int, ...]
    equivalents: Mapping[int, tuple[tuple[int, float], ...]]
    parameters: ModelParameters
    terms: Sequence[Term]
    nuisances: Sequence[Candidate]
    noise: float

    def by_posture(self, index: int) -> bool:
        """Return whether a candidate depends on the posture alone."""
        candidate = self.design.candidates[index]
        return candidate.effect not in HISTORY and candidate.family != "anomaly"


def propose_postures(known: Known, readings: Readings, cell: Cell, offers: Sequence[Offer]) -> Proposals:
    """Choose among postures.

    Args:
        known: What the recording tells.
        readings: The recording; its points are measured in every posture.
        cell: The cell file.
        offers: Postures that could be measured; their loads are not looked at.
    """
    if not any(known.by_posture(index) for index in known.accepted):
        return Proposals((), NOTHING_FOUND)
    if not offers:
        return Proposals((), NO_POSTURE)
    return _Search(known, readings, cell, offers).run()


class _Search:
    """The columns of recording and offers; hypotheses are tuples of indices of candidates."""

    def __init__(self, known: Known, readings: Readings, cell: Cell, offers: Sequence[Offer]) -> None:
        self.known, self.offers = known, tuple(offers)
        equal = (index for several in known.equivalents.values() for index, _ in several)
        self.members = tuple(dict.fromkeys([*known.accepted, *equal]))
        self.null, self.columns = _offered(known, self.members, readings, cell, self.offers)
        self.taken: list[int] = []

    def run(self) -> Proposals:
        """Propose a posture for every ambiguous finding, then make certain what is known worst."""
        found: list[Measurement] = []
        undecided: list[str] = []
        for index in self.known.accepted:
            rivals = self.known.equivalents.get(index, ())
            if rivals and len(found) < PROPOSED:
                measurement = self._separating(index, rivals)
                if measurement is None:
                    undecided.append(_name(self.known.design.candidates[index]))
                else:
                    found.append(measurement)
        while len(found) < PROPOSED:
            found.append(self._sharpening())
        text = ""
        if undecided:
            text = f"No posture alone separates {' and '.join(undecided)} from what does as well."
        return Proposals(tuple(found), text)

    def _of(self, chosen: Sequence[int]) -> Float3D:
        """Return the (k, d, p) columns of all offers under a hypothesis."""
        return np.concatenate([self.null, *(self.columns[index] for index in chosen)], axis=2)

    def _knowledge(self, chosen: Sequence[int], truth: Sequence[int]) -> Knowledge:
        """Return what is known under a hypothesis, the postures taken already measured as the truth predicts them."""
        result = self._from_recording(chosen)
        mean = self._from_recording(truth).mean
        for index in self.taken:
            result = result.after(self._of(chosen)[index], self._of(truth)[index] @ mean)
        return result

    def _from_recording(self, chosen: Sequence[int]) -> Knowledge:
        design = self.known.design
        columns = np.column_stack([design.null, *(design.columns[:, design.blocks[index]] for index in chosen)])
        return Knowledge.of(columns / self.known.noise, design.residual / self.known.noise, design.null.shape[1])

    def _separating(self, index: int, rivals: tuple[tuple[int, float], ...]) -> Measurement | None:
        """Return the posture that is expected to part a finding from the nearest rival; None if none does."""
        others = tuple(i for i in self.known.accepted if i != index)
        hypotheses = [(*others, index), *((*others, rival) for rival, _ in rivals)]
        predicted = [self._knowledge(h, hypotheses[0]).predict(self._of(h)) for h in hypotheses]
        apart = np.array([expected_log_bayes_factor(predicted[0], other) for other in predicted[1:]])
        separable = apart.max(axis=1) > SEPARABLE
        if not separable.any():
            return None
        gain = apart[separable].min(axis=0)
        names = [_name(self.known.design.candidates[i]) for i in (index, *(rival for rival, _ in rivals))]
        best, usual = self._take(gain)
        why = (
            f"separates {names[0]} from {'; '.join(names[1:])}: the log Bayes factor between the two nearest of them "
            f"that it can separate is expected to grow by {gain[best]:.1f} (a posture taken at random: {usual:.1f})"
        )
        return measurement_of(self.offers[best], why, float(gain[best]), usual, "nats")

    def _sharpening(self) -> Measurement:
        """Return the posture that makes the finding that is known worst more certain."""
        accepted = self.known.accepted
        knowledge = self._knowledge(accepted, accepted)
        columns = self._of(accepted)
        blocks = self._blocks(accepted)
        mean, covariance = knowledge.mean, knowledge.covariance
        doubt = {
            index: float(np.sqrt(np.trace(covariance[block, block])) / np.linalg.norm(mean[block]))
            for index, block in blocks.items()
            if self.known.by_posture(index)
        }
        worst = max(doubt, key=doubt.__getitem__)
        chosen = list(range(blocks[worst].start, blocks[worst].stop))
        left = np.clip(knowledge.variances_after(columns, chosen).sum(axis=1), 0.0, None)
        after = np.sqrt(left) / float(np.linalg.norm(mean[blocks[worst]]))
        gain = 100 * (doubt[worst] - after)
        best, usual = self._take(gain)
        why = (
            f"makes {_name(self.known.design.candidates[worst])} more certain: its standard deviation falls from "
            f"{100 * doubt[worst]:.2f} % to {100 * after[best]:.2f} % (a posture taken at random: "
            f"{100 * doubt[worst] - usual:.2f} %)"
        )
        return measurement_of(self.offers[best], why, float(gain[best]), usual, "%")

    def _blocks(self, chosen: Sequence[int]) -> dict[int, slice]:
        """Return where the columns of the chosen candidates stand behind those of the null model."""
        blocks, start = {}, self.null.shape[2]
        for index in chosen:
            blocks[index] = slice(start, start + self.columns[index].shape[2])
            start = blocks[index].stop
        return blocks

    def _take(self, gain: Float1D) -> tuple[int, float]:
        """Take the best posture that is not taken yet; return it and the gain of a usual one."""
        open_gain = gain.copy()
        open_gain[self.taken] = -np.inf
        best = int(np.argmax(open_gain))
        self.taken.append(best)
        return best, float(np.median(gain))


def _offered(
    known: Known, members: Sequence[int], readings: Readings, cell: Cell, offers: Sequence[Offer]
) -> tuple[Float3D, dict[int, Float3D]]:
    """Return the columns of the null model, (k, d, n), and of every member, (k, d, p), in units of what remains."""
    present = np.unique(readings.point)
    k, points = len(offers), len(present)
    blank = Readings(
        points=readings.points,
        configuration=np.repeat(np.arange(1, k + 1), points),
        step=np.zeros(k * points, dtype=np.int64),
        point=np.tile(present, k),
        q=np.repeat(np.stack([offer.q for offer in offers]), points, axis=0),
        position=np.zeros((k * points, 3)),
        wrench=None,
        time=np.full(k * points, np.nan),
        temperature=np.full(k * points, np.nan),
        provenance=readings.provenance,
    )
    parameters = known.parameters
    seen = dataclasses.replace(blank, position=predict_readings(blank, cell, parameters))
    problem = absolute_problem(seen, cell, chain_of(cell), parameters, position_covariance(seen, cell))
    state = absolute_state(problem, parameters, seen, cell)

    def per_offer(columns: np.ndarray) -> Float3D:
        return np.asarray(columns / known.noise).reshape(k, 3 * points, columns.shape[1])

    null, _ = null_columns(problem, parameters, known.terms)
    extra = [weighted(problem, parameters, nuisance.columns(state)) for nuisance in known.nuisances]
    found = {}
    for index in members:
        candidate = known.design.candidates[index]
        scale = PRIOR_WIDTH * np.array([parameter.typical for parameter in candidate.parameters])
        columns = np.zeros((3 * len(seen), len(scale)))
        if known.by_posture(index):
            columns = weighted(problem, parameters, candidate.columns(state) * scale)
        found[index] = per_offer(columns)
    return per_offer(np.concatenate([null, *extra], axis=1)), found


def _name(candidate: Candidate) -> str:
    place = ", ".join(v if isinstance(v, str) else " and ".join(v) for v in candidate.location.values())
    return f"{candidate.effect.replace('_', ' ')} ({candidate.variant}) at {place}"
