"""How hypotheses do beside accepted ones: every question is answered once."""

from __future__ import annotations

import dataclasses
import math
import weakref
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from calibration_core.estimation.controls import CHANCE
from calibration_core.estimation.field import Accepted, Field, Trial
from calibration_core.estimation.leave_out import LeftOut
from calibration_core.estimation.likelihood.gains import (
    LEVELS,
    NONE,
    Gains,
    Grouped,
    LevelFit,
    Seen,
    SmallEffects,
    beside,
    best_gains,
    chance_gain,
    likelihood_at,
    most_probable,
)
from calibration_core.estimation.likelihood.restricted import USUAL, WIDE, Sizes
from calibration_core.timeseries import Float1D

KEPT = 2  # models with blocks left out, for what is tried beside them: tens of megabytes each


@dataclasses.dataclass(frozen=True)
class Demands:
    """What a hypothesis must show, by the kind of recording.

    Attributes:
        least: Nats that any must gain,
        first: the first cause: where noise lasts over some configurations, the best of all has gained 16 by it, and
        further: a further cause: what is accepted is seldom of quite the right form.
        draws: Recordings that are drawn to see what chance gains.
        levels: Of the small effects that are part of the noise.
        by_density: Whether blocks are few, so that some show an effect far better than others: those left out are then
            judged by the density of their readings (Sundararajan and Keerthi 2001), not by their squares, and sizes
            beyond the usual are no evidence.
        narrow: Columns of a hypothesis that is tried in another's stead; wider ones come in by themselves.
    """

    least: float
    first: float
    further: float
    draws: int
    levels: tuple[float, ...]
    by_density: bool
    narrow: int


POSITIONS: Demands = Demands(least=CHANCE, first=20.0, further=20.0, draws=60, levels=NONE, by_density=False, narrow=24)
STEPS: Demands = Demands(least=5.0, first=5.0, further=8.0, draws=240, levels=LEVELS, by_density=True, narrow=48)


@dataclasses.dataclass(frozen=True, eq=False)
class Scores:
    """How hypotheses do beside accepted ones, (j,) each.

    Attributes:
        nats: Gain at the best size; minus infinity where it was not asked for.
        size: That size, typical ones, at the noise before.
        left: Share of the squared residual that is left.
    """

    nats: Float1D
    size: Float1D
    left: Float1D

    @property
    def size_after(self) -> Float1D:
        """The best size, (j,) typical ones, at the noise that each hypothesis leaves."""
        return self.size * np.sqrt(self.left)


class Comparisons:
    """Rows and hypotheses, and all that was asked of them; what was accepted is the same in whatever order."""

    def __init__(self, field: Field, demands: Demands, limit: float | None = None) -> None:
        """Prepare; limit: what chance gains, nats, as another search of the recording found it."""
        self.field, self.demands = field, demands
        self.small = SmallEffects(field.gram, field.offered, demands.levels)
        self.judged = field.judged
        self.place = {index: k for k, index in enumerate(self.judged)}
        several = [len(one.columns) - len(one.chance) for one in (field.offered.hypotheses[i] for i in self.judged)]
        self.narrow = np.flatnonzero(np.array(several, dtype=np.int64) <= demands.narrow)
        self.alone = np.array([len(field.offered.hypotheses[index].members) == 1 for index in self.judged], dtype=bool)
        self._narrow = frozenset(map(int, self.narrow))
        self.fits: dict[Accepted, tuple[LevelFit, ...]] = {}
        self.held_out: dict[Accepted, list[Float1D]] = {}
        self.known: dict[tuple[Accepted, bool], Scores] = {}
        self.trials: dict[tuple[Accepted, int], Trial] = {}
        self.alone_known: dict[tuple[Accepted, int], tuple[float, float, float]] = {}
        self._left_out: dict[Accepted, LeftOut] = {}
        self._grouped: dict[bool, Grouped] = {}
        if limit is None:
            limit = max(chance_gain(field.gram, field.clear, self.grouped(narrow=False), demands.draws), demands.least)
        self.limit = limit

    def level(self, accepted: Accepted) -> float:
        """Return the signal-to-noise ratio of the small effects beside hypotheses, each."""
        return most_probable(self.fitted(accepted)).level

    def sizes(self, accepted: Accepted) -> Sizes:
        """Return the sizes of hypotheses together, those of smaller indices first."""
        return most_probable(self.fitted(accepted)).sizes

    def fitted(self, accepted: Accepted) -> tuple[LevelFit, ...]:
        """Return hypotheses together, beside small effects of the levels that come into question."""
        accepted = tuple(sorted(accepted))
        if accepted not in self.fits:
            self.fits[accepted] = self.small.fits(self.field.blocks(accepted), self._start(accepted))
        return self.fits[accepted]

    def seen(self, accepted: Accepted) -> Seen:
        """Return what is seen beside hypotheses alone, whatever small effects are part of the noise."""
        fit = most_probable(self.fitted(accepted))
        return fit.seen if fit.gram is self.field.gram else beside(self.field.gram, fit.blocks, fit.sizes)

    def squares(self, accepted: Accepted) -> list[Float1D]:
        """Return the squares of blocks left out."""
        accepted = tuple(sorted(accepted))
        if accepted not in self.held_out:
            self.held_out[accepted] = self.field.in_blocks(self.left_out(accepted).errors)
        return self.held_out[accepted]

    def left_out(self, accepted: Accepted) -> LeftOut:
        """Return the model of the accepted ones with every block left out; only the last few are kept."""
        accepted = tuple(sorted(accepted))
        if accepted not in self._left_out:
            while len(self._left_out) >= KEPT:
                self._left_out.pop(next(iter(self._left_out)))
            self._left_out[accepted] = self.field.left_out(accepted, self.sizes(accepted))
        return self._left_out[accepted]

    def release(self) -> None:
        """Free the models with blocks left out; one that is asked for later is made again."""
        self._left_out.clear()

    def scores(self, accepted: Accepted, *, narrow: bool = False) -> Scores:
        """Return how every judged hypothesis does beside the accepted ones; narrow: those of few columns alone."""
        accepted = tuple(sorted(accepted))
        key = accepted, narrow
        if key not in self.known:
            if narrow and (accepted, False) in self.known:
                return self.known[accepted, False]
            chosen = self.narrow if narrow else np.arange(len(self.judged))
            every = Scores(*(np.full(len(self.judged), fill) for fill in (-np.inf, 1.0, 1.0)))
            blocks, again = self.grouped(narrow=narrow), [self.place[i] for i in accepted if i in self.place]
            if any(len(self.field.offered.hypotheses[i].columns) >= WIDE for i in accepted):  # they gain nothing more
                blocks = blocks.without(np.flatnonzero(np.isin(chosen, again)))
            found = self.gains(accepted, blocks)
            every.nats[chosen], every.size[chosen], every.left[chosen] = found.nats, found.size, found.left
            self.known[key] = every
        return self.known[key]

    def grouped(self, *, narrow: bool) -> Grouped:
        """Return the columns of all judged hypotheses; narrow: of those of few columns alone."""
        if narrow not in self._grouped:
            chosen = self.narrow if narrow else np.arange(len(self.judged))
            self._grouped[narrow] = Grouped.of(self.field.blocks(tuple(self.judged[k] for k in chosen)))
        return self._grouped[narrow]

    def gains(self, accepted: Accepted, blocks: Grouped) -> Gains:
        """Return what blocks gain beside the accepted ones, (h,) each."""
        return best_gains(self.fitted(accepted), blocks)

    def several(self, accepted: Accepted, indices: Accepted) -> Scores:
        """Return how some hypotheses do beside the accepted ones, in their order."""
        accepted, place = tuple(sorted(accepted)), [self.place[i] for i in indices]
        for narrow in (False, True):
            known = self.known.get((accepted, narrow))
            if known is not None and (not narrow or self._narrow.issuperset(place)):
                return Scores(known.nats[place], known.size[place], known.left[place])
        found = self.gains(accepted, Grouped.of(self.field.blocks(indices)))
        return Scores(found.nats, found.size, found.left)

    def score(self, accepted: Accepted, index: int) -> tuple[float, float, float]:
        """Return how one hypothesis does beside the accepted ones: nats, size and what is left, as `Scores`."""
        accepted = tuple(sorted(accepted))
        if (accepted, index) not in self.alone_known:
            found = self.several(accepted, (index,))
            self.alone_known[accepted, index] = float(found.nats[0]), float(found.size[0]), float(found.left[0])
        return self.alone_known[accepted, index]

    def least(self, accepted: Accepted) -> Float1D:
        """Return what every judged hypothesis must gain beside the accepted ones, nats, (j,).

        A joint that needs two forms of law has another one, of which something is left; at several joints that adds up,
        and a cause of another kind must gain more beside it.
        """
        hypotheses, demands = self.field.offered.hypotheses, self.demands
        places, effects = {hypotheses[i].place for i in accepted}, {hypotheses[i].effect for i in accepted}
        laws = Counter(one.location["joint"] for one in (hypotheses[i] for i in accepted) if one.is_law_of_a_joint)
        opened = max(1, sum(several > 1 for several in laws.values()))
        least = []
        for hypothesis in (hypotheses[i] for i in self.judged):
            further = demands.further * (1 if hypothesis.effect in effects else opened)
            new = further if accepted else demands.first
            least.append(self.limit if hypothesis.place in places else max(self.limit, new))
        return np.array(least)

    def usual(self, accepted: Accepted, several: Sequence[int]) -> dict[int, float]:
        """Return the log likelihood of hypotheses were their sizes usual ones, nats."""
        fits = self.fitted(accepted)
        return {i: likelihood_at(fits, self.field.blocks((i,))[0], USUAL) for i in several}

    def laws_of(self, location: Mapping[str, object]) -> list[int]:
        """Return the judged laws of the joint at a location, in all their forms."""
        return [i for i in self.judged if self.field.offered.hypotheses[i].is_law_of(location)]

    def strongest_law(self, accepted: Accepted, location: Mapping[str, object]) -> int:
        """Return the law of the joint at a location that gains most beside the accepted ones."""
        nats = self.scores(accepted, narrow=True).nats
        return max(self.laws_of(location), key=lambda i: nats[self.place[i]])

    def most_probable_law(self, accepted: Accepted, close: list[int]) -> dict[int, float]:
        """Return the forms of that law of a joint which is most probable, with their log likelihoods, nats.

        A law is as probable as its forms are on average (MacKay 1992): one that is offered in many shapes, or with
        many parameters, comes near to any other.  A kind of law that other joints follow is the more probable: one
        make of gears is in all of them (Laplace's rule of succession).
        """
        hypotheses = self.field.offered.hypotheses
        forms: dict[str, list[int]] = {}
        for i in self.laws_of(hypotheses[close[0]].location):
            forms.setdefault(hypotheses[i].effect, []).append(i)
        asked = {hypotheses[i].effect for i in close if i in forms.get(hypotheses[i].effect, [])}
        nats = {effect: self.usual(accepted, forms[effect]) for effect in sorted(asked)}

        def probability(effect: str) -> float:
            each = list(nats[effect].values())
            others = sum(len(hypotheses[i].members) for i in accepted if hypotheses[i].effect == effect)
            return float(np.logaddexp.reduce(each)) - math.log(len(each)) + math.log1p(others)

        return nats[max(nats, key=probability)]

    def trial(self, accepted: Accepted, index: int) -> Trial:
        """Put one more hypothesis beside the accepted ones, at the size that suits it best."""
        accepted = tuple(sorted(accepted))
        if (accepted, index) not in self.trials:
            self.trials[accepted, index] = self._trial(accepted, index)
        return self.trials[accepted, index]

    def _trial(self, accepted: Accepted, index: int) -> Trial:
        at = self.sizes(accepted)
        nats, own, left = self.score(accepted, index)
        sizes = Sizes(at.variance * left, np.append(at.size, own) * np.sqrt(left), float("nan"))
        search = weakref.proxy(self)  # which keeps the trial: neither would be freed while they hold each other

        def squares() -> tuple[list[Float1D], list[Float1D]]:
            columns = search.field.columns((index,))
            before, ridge = search.left_out(accepted), np.full(columns.shape[1], at.variance / own**2)
            if search.demands.by_density:
                return before.scores(sizes.variance), before.scores(sizes.variance, columns, ridge)
            return search.squares(accepted), search.field.in_blocks(before.beside(columns, ridge))

        def score(others: Accepted, one: int) -> float:
            return float(search.score(others, one)[0]) if one in search.place else -math.inf

        model, seen = (lambda: search.left_out(accepted)), (lambda: search.seen(accepted))
        return Trial(self.field, accepted, index, sizes, nats, squares, model, seen, score)

    def _start(self, accepted: Accepted) -> Sizes | None:
        """Return sizes to begin with: those of a fit with most of the same hypotheses, and what suits the new ones."""
        known = max(self.fits, key=lambda other: len(set(other) & set(accepted)), default=None)
        if known is None or not known:
            scores = self.known.get(((), False))
            usual = {} if scores is None else dict(zip(self.judged, scores.size, strict=True))
            null = self.fits.get(())
            variance = (
                self.field.gram.square / self.field.gram.freedom if null is None else most_probable(null).sizes.variance
            )
            return Sizes(variance, np.array([max(usual.get(i, 0.3), 1e-2) for i in accepted]), float("nan"))
        last = most_probable(self.fits[known]).sizes
        fit = dict(zip(known, last.size, strict=True))
        new = tuple(i for i in accepted if i not in fit and i in self.place)
        beyond = dict(zip(new, self.several(known, new).size, strict=True)) if new else {}
        size = np.array([fit.get(i, max(beyond.get(i, 0.3), 1e-2)) for i in accepted])
        return Sizes(last.variance, size, float("nan"))
