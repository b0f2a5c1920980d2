"""Which measurement would separate what is confounded now, and if nothing is ambiguous, sharpen what was found.

Every offer is judged by what is expected of it (see `information`); its gain is stated beside that of an offer taken at
random.  What a recording tells, and what offers would show of it, comes from `Knowledge`: loaded steps (`loaded.py`) or
postures (`postures.py`).

What a recording, and measurements that are only imagined yet, tell about a hypothesis.

A hypothesis is a linear model y = X theta + noise of unit variance with a normal prior on theta; X holds the null
model, the effects that are not in question, the structured discrepancy and the effect in question.  The prediction of a
measurement not yet made is then normal, and so is the expected log Bayes factor between two hypotheses:

    D(h, g) = (tr(S_g^-1 S_h) - d + (m_g - m_h)' S_g^-1 (m_g - m_h) + log det S_g - log det S_h) / 2,

with mean m and covariance S of the predictions.  All parameters, those of the null model too, are refitted in it.
Source: Box and Hill 1967; Atkinson and Fedorov 1975 (T-optimality).
"""

from __future__ import annotations

import dataclasses
import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.linalg import cholesky
from scipy.linalg.lapack import dtrtri

from calibration_core.cell import Cell
from calibration_core.diagnosis.result.finding import ProposedMeasurement, odds_words
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.simulation.simulate import simulate_plan
from calibration_core.timeseries import Float1D, Float2D, Float3D, Readings, read_only

FREE = 1e-9  # prior precision of the null model's columns, these being of length one
LEAST_SCALE = 1e-2  # of the longest of these: a shorter one counts as so long, one that no load has shown as any other


@dataclasses.dataclass(frozen=True, eq=False)
class Predictions:
    """Means (k, d) and covariances (k, d, d) of k measurements not yet made, noise included."""

    mean: Float2D
    covariance: Float3D


@dataclasses.dataclass(frozen=True, eq=False)
class HypothesisPosterior:
    """Posterior of one hypothesis.

    Attributes:
        scale: (p,) by which columns are divided.
        matrix: (p, p) posterior precision of the scaled parameters.
        vector: (p,) its product with the mean.
    """

    scale: Float1D
    matrix: Float2D
    vector: Float1D

    @staticmethod
    def of(columns: Float2D, residual: Float1D, free: int) -> HypothesisPosterior:
        """Learn from a recording.

        Args:
            columns: (r, p) whitened, the first `free` without a prior, the others per standard deviation of theirs.
            residual: (r,).
            free: How many have no prior.
        """
        return HypothesisPosterior.from_products(columns.T @ columns, columns.T @ residual, free)

    @staticmethod
    def from_products(matrix: Float2D, vector: Float1D, free: int) -> HypothesisPosterior:
        """Learn the same from the products of the columns with each other, (p, p), and with the residual, (p,)."""
        length = np.sqrt(np.diag(matrix))
        length[:free] = np.maximum(length[:free], LEAST_SCALE * length[:free].max(initial=0.0))
        scale = np.where(length > 0, length, 1.0)
        prior = 1 / scale**2
        prior[:free] = FREE
        return HypothesisPosterior(scale, matrix / np.outer(scale, scale) + np.diag(prior), vector / scale)

    @functools.cached_property
    def mean(self) -> Float1D:
        """(p,) in the units of the columns."""
        return np.asarray(self._root.T @ (self._root @ self.vector) / self.scale)

    @functools.cached_property
    def covariance(self) -> Float2D:
        """(p, p) in the units of the columns."""
        root = self._root / self.scale
        return np.asarray(root.T @ root)

    @functools.cached_property
    def _root(self) -> Float2D:
        """(p, p) R with R'R the inverse of the matrix."""
        return np.asarray(dtrtri(cholesky(self.matrix, lower=True), lower=True, overwrite_c=True)[0])

    def after(self, columns: Float2D, values: Float1D) -> HypothesisPosterior:
        """Return what is known after a measurement with these columns, (d, p), and values, (d,)."""
        scaled = columns / self.scale
        return HypothesisPosterior(self.scale, self.matrix + scaled.T @ scaled, self.vector + scaled.T @ values)

    def predict(self, columns: Float3D) -> Predictions:
        """Predict k measurements with columns (k, d, p)."""
        spread = self._spread(columns) @ columns.transpose(0, 2, 1)
        return Predictions(columns @ self.mean, spread + np.eye(columns.shape[1]))

    def variances_after(self, columns: Float3D, chosen: list[int]) -> Float2D:
        """Return (k, c) the variances of the chosen parameters after each of k measurements with columns (k, d, p)."""
        d, p = columns.shape[1:]
        if d > p:
            scaled = columns / self.scale
            known = self.matrix + scaled.transpose(0, 2, 1) @ scaled
            found = np.linalg.solve(known, np.eye(p)[:, chosen])
            return np.asarray(found[:, chosen, np.arange(len(chosen))] / self.scale[chosen] ** 2)
        spread = self._spread(columns)
        response = spread[:, :, chosen]  # (k, d, c)
        whole = spread @ columns.transpose(0, 2, 1) + np.eye(d)
        gained = np.einsum("kdc,kdc->kc", response, np.linalg.solve(whole, response))
        return np.asarray(np.diag(self.covariance)[chosen] - gained)

    def _spread(self, columns: Float3D) -> Float3D:
        """Return the columns, (k, d, p), times the covariance, in one product: one by one it would be read k times."""
        return np.asarray(columns.reshape(-1, columns.shape[2]) @ self.covariance).reshape(columns.shape)


def expected_log_bayes_factor(truth: Predictions, other: Predictions) -> Float1D:
    """Return (k,) nats by which each measurement is expected to favour the truth over the other hypothesis."""
    d = truth.mean.shape[1]
    inverse = np.linalg.inv(other.covariance)
    apart = other.mean - truth.mean
    _, log_other = np.linalg.slogdet(other.covariance)
    _, log_truth = np.linalg.slogdet(truth.covariance)
    trace = np.einsum("kij,kji->k", inverse, truth.covariance)
    distance = np.einsum("ki,kij,kj->k", apart, inverse, apart)
    return np.asarray(0.5 * (trace - d + distance + log_other - log_truth))


# --- what could be measured next --------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class Offer:
    """One configuration with the loads of its steps.

    Attributes:
        number: As it would be counted.
        q: (n,) rad.
        steps: (k, 6) N and N*m, base axes, at the wrench point; the first unloaded.
    """

    number: int
    q: Float1D
    steps: Float2D

    def __post_init__(self) -> None:
        """Copy to read-only arrays."""
        object.__setattr__(self, "q", read_only(self.q))
        object.__setattr__(self, "steps", read_only(self.steps))

    @property
    def full(self) -> Float1D:
        """(6,) N and N*m, the largest load."""
        return np.asarray(self.steps[int(np.argmax(np.linalg.norm(self.steps[:, :3], axis=1)))])

    @functools.cached_property
    def alternating(self) -> Offer:
        """The offer with as many steps, that after the first go to and fro between its extreme loads.

        What grows with the load shows most between extremes, what depends on its path or size in between does not:
        which of the two tells more has to be judged.
        """
        levels = self.steps[:, :3] @ self.full[:3]
        highest, lowest = self.steps[int(np.argmax(levels))], self.steps[int(np.argmin(levels))]
        turns = np.arange(1, len(self.steps)) % 2 == 1
        return dataclasses.replace(self, steps=np.vstack([self.steps[:1], np.where(turns[:, None], highest, lowest)]))


Expected = Callable[[Sequence[Offer], ModelParameters], Readings]


@dataclasses.dataclass(frozen=True, eq=False)
class Offers:
    """What could be measured next in one set-up.

    Attributes:
        each: The offers; none where no posture is fit to be measured.
        expected: (offers, model) -> the readings of these offers that the model expects, without noise, with points and
            frames as those of the recording that they would be added to; configurations counted from 1.
    """

    each: tuple[Offer, ...]
    expected: Expected

    @staticmethod
    def of(each: Sequence[Offer], readings: Readings, cell: Cell) -> Offers:
        """Return offers that would be added to a recording."""

        def expected(several: Sequence[Offer], parameters: ModelParameters) -> Readings:
            numbered = [dataclasses.replace(offer, number=k) for k, offer in enumerate(several, start=1)]
            loaded = any(np.any(offer.steps) for offer in several)
            model = parameters if loaded else parameters.replace(wrench_point=None)
            return _of_points(simulate_plan(numbered, cell, model), readings)

        return Offers(tuple(each), expected)


def _of_points(readings: Readings, recorded: Readings) -> Readings:
    """Return the rows of the points that the recording holds, numbered as there."""
    present = [recorded.points[k] for k in np.unique(recorded.point)]
    kept = np.array([readings.points[k] in present for k in readings.point])
    some = readings.select(kept)
    index = np.array([recorded.points.index(readings.points[k]) for k in some.point])
    return dataclasses.replace(some, points=recorded.points, point=index)


# --- which measurement would separate what is confounded now, and if nothing is ambiguous, sharpen what ---------------


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
