"""Which measurement would separate what is confounded now, and if nothing is ambiguous, sharpen what was found.

Every offer is judged by what is expected of it (see `information`); its gain is stated beside that of an offer taken at
random.  What a recording tells, and what offers would show of it, comes from `Knowledge`: loaded steps (`loaded.py`) or
postures (`postures.py`).
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from calibration_core.diagnosis.proposals.candidates import Offer
from calibration_core.diagnosis.proposals.information import HypothesisPosterior, expected_log_bayes_factor
from calibration_core.diagnosis.result.finding import ProposedMeasurement, odds_words
from calibration_core.timeseries import Float1D, Float3D

PROPOSED = 3
JUDGED = 24  # offers that are judged in full
ALTERNATED = 12  # of these, with loads that alternate between the extremes besides
SEPARABLE = 0.5  # nats: an offer that is expected to give less separates nothing
NO_GAIN = "Further measurements of this kind would gain nothing worth the time."


@dataclasses.dataclass(frozen=True)
class Proposals:
    """What to measure next.

    Attributes:
        measurements: Most useful first.
        text: What no measurement of this kind can decide, or why nothing is proposed; empty if there is nothing to say.
    """

    measurements: tuple[ProposedMeasurement, ...]
    text: str


NONE_ASKED = Proposals((), "")


@dataclasses.dataclass(frozen=True, eq=False)
class OfferTable:
    """Columns of k offers with d rows each, in units of the noise.

    Attributes:
        offers: The offers.
        null: (k, d, n) of the null model.
        own: Hypothesis -> (k, d, p), per standard deviation of its prior.
        always: (k, d, a) of what is always a little wrong, likewise.
    """

    offers: tuple[Offer, ...]
    null: Float3D
    own: Mapping[int, Float3D]
    always: Float3D

    def of(self, chosen: Sequence[int]) -> Float3D:
        """Return the (k, d, p) columns under some hypotheses together."""
        return np.concatenate([self.null, *(self.own[index] for index in chosen), self.always], axis=2)

    def select(self, rows: Sequence[int]) -> OfferTable:
        """Return the table of some of the offers."""
        rows = list(rows)
        own = {index: columns[rows] for index, columns in self.own.items()}
        return OfferTable(tuple(self.offers[k] for k in rows), self.null[rows], own, self.always[rows])

    def and_also(self, more: OfferTable) -> OfferTable:
        """Return the table of these offers and of more."""
        own = {index: np.concatenate([columns, more.own[index]]) for index, columns in self.own.items()}
        null, always = np.concatenate([self.null, more.null]), np.concatenate([self.always, more.always])
        return OfferTable((*self.offers, *more.offers), null, own, always)


@dataclasses.dataclass(frozen=True)
class Uncertain:
    """Parameters of which a measurement may make more certain.

    Attributes:
        words: What they are.
        places: Among all parameters.
        size: Of all of them together, in their units.
    """

    words: str
    places: tuple[int, ...]
    size: float


class Knowledge(ABC):
    """What a recording tells, and what offers would show of it; hypotheses by their indices.

    Attributes:
        accepted: In the model.
        rivals: Accepted hypothesis -> what explains the recording as well.
        worth: Share by which an offer lowers the worst standard deviation at least, to be worth its time.
        nothing_offered: Sentence where there is no offer.
    """

    accepted: tuple[int, ...]
    rivals: Mapping[int, tuple[int, ...]]
    worth: float
    nothing_offered: str

    @abstractmethod
    def name(self, index: int) -> str:
        """Return a hypothesis in words."""

    @abstractmethod
    def posterior(self, chosen: Sequence[int]) -> HypothesisPosterior:
        """Return what the recording tells under some hypotheses together, columns as those of `OfferTable.of`."""

    @abstractmethod
    def table(self, offers: tuple[Offer, ...]) -> OfferTable:
        """Return the columns of some offers, for the accepted hypotheses and their rivals."""

    @abstractmethod
    def parameters(self, index: int) -> list[tuple[str, tuple[int, ...]]]:
        """Return words and places (among its own) of the parameters of a hypothesis that are judged together."""

    @abstractmethod
    def otherwise(self) -> list[Uncertain]:
        """Return what is made more certain where no parameter of a finding is."""

    @abstractmethod
    def inseparable(self, names: Sequence[str]) -> str:
        """Return a sentence on hypotheses that no offer separates from their rivals."""


def choose(known: Knowledge, offers: Sequence[Offer]) -> Proposals:
    """Propose an offer for every ambiguous hypothesis, then for what is known worst."""
    if not offers:
        return Proposals((), known.nothing_offered)
    return _Choice(known, tuple(offers)).made()


@dataclasses.dataclass(frozen=True, eq=False)
class _Judged:
    """Offers judged for one purpose: higher scores first, and what to say of each."""

    score: Float1D
    gain: Float1D
    useful: bool = True


Judge = Callable[[OfferTable], _Judged]


class _Choice:
    """The offers, and those that were taken."""

    def __init__(self, known: Knowledge, offers: tuple[Offer, ...]) -> None:
        self.known, self.offers = known, offers
        self.rough = known.table(tuple(map(_rough, offers)))
        self.full: OfferTable | None = None
        self.taken: list[OfferTable] = []

    def made(self) -> Proposals:
        """Return the proposals."""
        measurements: list[ProposedMeasurement] = []
        undecided: list[str] = []
        for index, rivals in self.known.rivals.items():
            if rivals and len(measurements) < PROPOSED:
                found = self._separating(index, rivals)
                if found is None:
                    undecided.append(self.known.name(index))
                else:
                    measurements.append(found)
        while len(measurements) < PROPOSED and (sharper := self._sharpening()) is not None:
            measurements.append(sharper)
        text = "" if measurements else NO_GAIN
        return Proposals(tuple(measurements), self.known.inseparable(undecided) if undecided else text)

    def _best(self, judge: Judge) -> tuple[Offer, float, float] | None:
        """Judge all offers roughly, the best and some taken at random in full; return the best, its gain, the usual.

        They are judged with the load levels of the recording, the best of them alternating between the extremes, too.
        """
        rough = judge(self.rough)
        if not rough.useful:
            return None
        taken = {table.offers[0].number for table in self.taken}
        free = np.array([offer.number not in taken for offer in self.offers])
        order = np.argsort(np.where(free, -rough.score, np.inf), kind="stable")[: min(JUDGED, int(free.sum()))]
        if not len(order):
            return None
        chosen = [self.offers[k] for k in order]
        chosen += [offer.alternating for offer in chosen[:ALTERNATED] if len(offer.steps) > 1]
        table = self._in_full([*chosen, *self.offers[:JUDGED]])
        full = judge(table)
        best = int(np.argmax(full.score[: len(chosen)]))
        self.taken.append(table.select([best]))
        return table.offers[best], float(full.gain[best]), float(np.median(full.gain[len(chosen) :]))

    def _in_full(self, several: Sequence[Offer]) -> OfferTable:
        """Return the table of some offers with all their steps; what was asked before is not computed again."""
        known = {} if self.full is None else {offer: k for k, offer in enumerate(self.full.offers)}
        new = tuple(offer for offer in dict.fromkeys(several) if offer not in known)
        if new:
            known |= {offer: len(known) + k for k, offer in enumerate(new)}
            more = self.known.table(new)
            self.full = more if self.full is None else self.full.and_also(more)
        assert self.full is not None  # noqa: S101 - some offers were asked for
        return self.full.select([known[offer] for offer in several])

    def _posterior(self, chosen: Sequence[int], truth: Sequence[int]) -> HypothesisPosterior:
        """Return what is known under hypotheses, the offers taken already measured as the truth predicts them."""
        known = self.known.posterior(chosen)
        if self.taken:
            mean = self.known.posterior(truth).mean
            for table in self.taken:
                known = known.after(table.of(chosen)[0], table.of(truth)[0] @ mean)
        return known

    def _separating(self, index: int, rivals: tuple[int, ...]) -> ProposedMeasurement | None:
        """Return the offer that separates a hypothesis from its rivals; None if none does."""
        others = tuple(i for i in self.known.accepted if i != index)
        hypotheses = [(*others, index), *((*others, rival) for rival in rivals)]
        posteriors = [self._posterior(h, hypotheses[0]) for h in hypotheses]

        def judge(table: OfferTable) -> _Judged:
            predicted = [k.predict(table.of(h)) for k, h in zip(posteriors, hypotheses, strict=True)]
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
        names = [self.known.name(i) for i in (index, *rivals)]
        why = (
            f"shows whether {', or '.join(names)}: the odds between the two nearest of them that it can "
            f"distinguish are expected to change {odds_words(gain)} "
            f"(a configuration taken at random: {odds_words(usual)})"
        )
        return _measurement(offer, why, gain, usual, "nats")

    def _sharpening(self) -> ProposedMeasurement | None:
        """Return the offer that makes more certain what is known worst; None where that is not worth it."""
        accepted = self.known.accepted
        posterior = self._posterior(accepted, accepted)
        variance = np.diag(posterior.covariance)
        asked = self._uncertain(posterior.mean, variance) or self.known.otherwise()
        if not asked:
            return None
        relative = [float(np.sqrt(variance[list(one.places)].sum())) / one.size for one in asked]
        now, worst = max(zip(relative, asked, strict=True), key=lambda pair: pair[0])
        unknown, now = now > 1.0, min(now, 1.0)

        def judge(table: OfferTable) -> _Judged:
            left = posterior.variances_after(table.of(accepted), list(worst.places)).sum(axis=1)
            after = np.sqrt(np.maximum(left, 1e-300)) / worst.size
            return _Judged(-after, -after)

        found = self._best(judge)
        if found is None:
            return None
        offer, then, usual = found[0], -found[1], -found[2]
        if now - then < self.known.worth * now:
            return None
        how = f"makes {worst.words} more certain: the standard deviation falls from {100 * now:.2f} %"
        if unknown:
            how = f"shows {worst.words}, of which the recording says nothing: the standard deviation falls"
        why = f"{how} to {100 * then:.2f} % (a configuration taken at random: {100 * usual:.2f} %)"
        return _measurement(offer, why, 100 * (now - then), 100 * (now - usual), "%")

    def _uncertain(self, mean: Float1D, variance: Float1D) -> list[Uncertain]:
        """Return the parameters of the accepted hypotheses that are larger than their standard deviation."""
        found, start = [], self.rough.null.shape[2]
        for index in self.known.accepted:
            for words, own in self.known.parameters(index):
                places = tuple(start + k for k in own)
                size = float(np.linalg.norm(mean[list(places)]))
                if size**2 > variance[list(places)].sum():
                    found.append(Uncertain(words, places, size))
            start += self.rough.own[index].shape[2]
        return found


def _rough(offer: Offer) -> Offer:
    """Return an offer with the first step, that of the largest load and the last, enough to judge it roughly."""
    full = int(np.argmax(np.linalg.norm(offer.steps[:, :3], axis=1)))
    rows = np.unique([0, full, len(offer.steps) - 1])
    return dataclasses.replace(offer, steps=offer.steps[rows])


def _measurement(offer: Offer, why: str, gain: float, usual: float, unit: str) -> ProposedMeasurement:
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
