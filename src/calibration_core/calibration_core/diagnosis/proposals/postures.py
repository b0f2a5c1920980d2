"""Which postures would separate what absolute positions cannot tell apart, or make more certain what was found.

Every posture is judged by what is expected of it (see `information`), beside one taken at random.  It is judged for
effects that depend on the posture alone: from where it is reached, when and how warm, no proposal can promise.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.proposals.candidates import Offers
from calibration_core.diagnosis.proposals.information import HypothesisPosterior, expected_log_bayes_factor
from calibration_core.diagnosis.proposals.measurements import PROPOSED, SEPARABLE, Proposals, measurement_of
from calibration_core.diagnosis.result.evidence_words import odds_words
from calibration_core.diagnosis.result.finding import ProposedMeasurement
from calibration_core.estimation.field import Field
from calibration_core.estimation.hypotheses import Hypothesis, typical_sizes
from calibration_core.estimation.rows import NullModel, state_at
from calibration_core.estimation.shifts import FAMILY
from calibration_core.identification.geometry.problem import absolute_problem
from calibration_core.model.effects.words import listed_location
from calibration_core.model.robot import chain_of
from calibration_core.observations.covariance import position_covariance
from calibration_core.timeseries import Float1D, Float2D, Float3D

HISTORY = frozenset({"approach_direction", "thermal_growth", "tracker_drift", "clock_offset"})
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
        return self.of(index).effect not in HISTORY and self.of(index).family != FAMILY


def propose_postures(known: Known, cell: Cell, offers: Offers) -> Proposals:
    """Choose among postures.

    Args:
        known: What the recording tells.
        cell: The cell file.
        offers: Postures that could be measured; their loads are not looked at.
    """
    if not any(known.by_posture(index) for index in known.accepted):
        return Proposals((), NOTHING_FOUND)
    if not offers.each:
        return Proposals((), NO_POSTURE)
    return _Search(known, cell, offers).run()


class _Search:
    """The columns of recording and offers; hypotheses are tuples of indices of candidates."""

    def __init__(self, known: Known, cell: Cell, offers: Offers) -> None:
        self.known, self.offers = known, offers.each
        equal = (index for several in known.equivalents.values() for index, _ in several)
        self.members = tuple(dict.fromkeys([*known.accepted, *equal]))
        self.null, self.columns = _offered(known, self.members, cell, offers)
        self.taken: list[int] = []

    def run(self) -> Proposals:
        """Propose a posture for every ambiguous finding, then make certain what is known worst."""
        found: list[ProposedMeasurement] = []
        undecided: list[str] = []
        for index in self.known.accepted:
            rivals = self.known.equivalents.get(index, ())
            if rivals and len(found) < PROPOSED:
                measurement = self._separating(index, rivals)
                if measurement is None:
                    undecided.append(_name(self.known.of(index)))
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

    def _posterior(self, chosen: Sequence[int], truth: Sequence[int]) -> HypothesisPosterior:
        """Return what is known under a hypothesis, the postures taken already measured as the truth predicts them."""
        result = self._from_recording(chosen)
        mean = self._from_recording(truth).mean
        for index in self.taken:
            result = result.after(self._of(chosen)[index], self._of(truth)[index] @ mean)
        return result

    def _from_recording(self, chosen: Sequence[int]) -> HypothesisPosterior:
        field, f = self.known.field, self.known.field.flat_count
        own = (field.wide[:, f + self.known.of(i).columns] * self.known.sizes[i] for i in chosen)
        columns = np.concatenate([field.wide[:, :f], *own], axis=1)
        return HypothesisPosterior.of(columns / self.known.noise, field.residual / self.known.noise, f)

    def _separating(self, index: int, rivals: tuple[tuple[int, float], ...]) -> ProposedMeasurement | None:
        """Return the posture that is expected to part a finding from the nearest rival; None if none does."""
        others = tuple(i for i in self.known.accepted if i != index)
        hypotheses = [(*others, index), *((*others, rival) for rival, _ in rivals)]
        predicted = [self._posterior(h, hypotheses[0]).predict(self._of(h)) for h in hypotheses]
        apart = np.array([expected_log_bayes_factor(predicted[0], other) for other in predicted[1:]])
        separable = apart.max(axis=1) > SEPARABLE
        if not separable.any():
            return None
        gain = apart[separable].min(axis=0)
        names = [_name(self.known.of(i)) for i in (index, *(rival for rival, _ in rivals))]
        best, usual = self._take(gain)
        why = (
            f"separates {names[0]} from {'; '.join(names[1:])}: the odds between the two nearest of them that it "
            f"can separate are expected to change {odds_words(gain[best])} "
            f"(a posture taken at random: {odds_words(usual)})"
        )
        return measurement_of(self.offers[best], why, float(gain[best]), usual, "nats")

    def _sharpening(self) -> ProposedMeasurement:
        """Return the posture that makes the finding that is known worst more certain."""
        accepted = self.known.accepted
        posterior = self._posterior(accepted, accepted)
        columns = self._of(accepted)
        blocks = self._blocks(accepted)
        mean, covariance = posterior.mean, posterior.covariance
        relative = {
            index: float(np.sqrt(np.trace(covariance[block, block])) / np.linalg.norm(mean[block]))
            for index, block in blocks.items()
            if self.known.by_posture(index)
        }
        worst = max(relative, key=relative.__getitem__)
        chosen = list(range(blocks[worst].start, blocks[worst].stop))
        left = np.clip(posterior.variances_after(columns, chosen).sum(axis=1), 0.0, None)
        after = np.sqrt(left) / float(np.linalg.norm(mean[blocks[worst]]))
        gain = 100 * (relative[worst] - after)
        best, usual = self._take(gain)
        why = (
            f"makes {_name(self.known.of(worst))} more certain: its standard deviation falls from "
            f"{100 * relative[worst]:.2f} % to {100 * after[best]:.2f} % (a posture taken at random: "
            f"{100 * relative[worst] - usual:.2f} %)"
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


def _offered(known: Known, members: Sequence[int], cell: Cell, offers: Offers) -> tuple[Float3D, dict[int, Float3D]]:
    """Return the columns of the null model, (k, d, n), and of every member, (k, d, p), in units of what remains."""
    model, parameters = known.model, known.model.parameters
    unloaded = [dataclasses.replace(offer, steps=np.zeros((1, 6))) for offer in offers.each]
    seen = offers.expected(unloaded, parameters)
    problem = absolute_problem(seen, cell, chain_of(cell), parameters, position_covariance(seen, cell))
    names, k = model.problem.names, len(unloaded)
    point = np.array([names.index(seen.points[p]) for p in seen.point]) if len(names) > 1 else None
    problem = dataclasses.replace(problem, names=names, point=point)
    there = dataclasses.replace(
        model,
        readings=seen,
        problem=problem,
        state=state_at(problem, parameters, seen, cell),
        used=np.ones(len(seen), dtype=bool),
    )
    every = np.arange(len(seen))

    def per_offer(columns: Float2D) -> Float3D:
        return np.asarray(columns / known.noise).reshape(k, -1, columns.shape[1])

    null, _ = there.flat(every)
    found = {}
    for index in members:
        several = [known.field.offered.candidates[m] for m in known.of(index).members]
        columns = np.zeros((3 * len(seen), len(known.of(index).columns)))
        if known.by_posture(index):
            scaled = [there.moves(one, every) * typical_sizes(one) for one in several]
            columns = known.sizes[index] * np.concatenate(scaled, axis=1)
        found[index] = per_offer(columns)
    sensor = np.zeros((len(null), known.field.flat_count - null.shape[1]))  # errors of a sensor that nothing pulls at
    return per_offer(np.concatenate([null, sensor], axis=1) / known.field.flat_scale), found


def _name(one: Hypothesis) -> str:
    return f"{one.effect.replace('_', ' ')} ({one.variant}) at {listed_location(one.location)}"
