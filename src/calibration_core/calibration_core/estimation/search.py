"""Which hypotheses enter: likelihood proposes, whole blocks left out dispose.

One at a time the hypothesis that gains most beside what is accepted is proposed; it enters if it exceeds what the best
of all gains in one per cent of recordings without it (parametric bootstrap of the fitted model, Westfall and Young
1993), predicts blocks left out in time and in posture better, and passes the controls of its kind.  One cause is
preferred to two: where another form or place instead of an accepted one gains as much as the proposal beside it, it is
swapped and nothing is added.  After each acceptance all sizes are fitted together.  What is accepted is swapped or
dropped where others make it needless.  Where small effects are part of the noise (`likelihood/gains.py`), a
proposal must stand out from them, too.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from calibration_core.estimation.comparisons import POSITIONS, Comparisons, Demands
from calibration_core.estimation.controls import impossible
from calibration_core.estimation.field import Accepted, Field, Trial
from calibration_core.estimation.hypotheses import LAW, Hypothesis
from calibration_core.estimation.leave_out import LEAST_NATS, Proof
from calibration_core.estimation.likelihood.gains import Grouped, likelihood_at, visible
from calibration_core.estimation.likelihood.restricted import USUAL, Sizes
from calibration_core.model.effects.structure.gravity_compensator import OPEN
from calibration_core.policy import EQUIVALENT
from calibration_core.timeseries import Float1D

TRIED = 6  # proposals per round that may try
PART = 3.0  # nats that a member must gain to stand, with a few others, in an accepted family's stead
SWAP = 5.0  # nats by which a swap must be better
MOST = 16  # hypotheses
ROUNDS = 3  # of refinement
DIGITS = 6  # after the decimal point, of nats or of a share of squares, in which hypotheses are compared
FEW = 6  # members of a family that are tried in its stead
STANDS_OUT = 2.5  # times the signal-to-noise ratio of small effects
OVERWHELMING = 50.0  # nats beside small effects, more than the best of any crowd gains by chance
CROWD_GONE = 1.0  # signal-to-noise ratio of the small effects that may be left beside several strong ones
Control = Callable[[Trial], str]


@dataclasses.dataclass(frozen=True, eq=False)
class Selection:
    """What was accepted.

    Attributes:
        accepted: Hypotheses, in the order of acceptance.
        sizes: Of all of them together.
        gain: (k,) nats, of each beside the others.
        proofs: Of each beside the others, per partition.
        refused: Sentences on strong hypotheses that failed, one for each effect and place, none for accepted ones.
        level: Signal-to-noise ratio of the small effects beside them, each.
    """

    accepted: Accepted
    sizes: Sizes
    gain: tuple[float, ...]
    proofs: tuple[tuple[Proof, ...], ...]
    refused: tuple[str, ...]
    level: float


class Search(Comparisons):
    """The steps of the search, and what they refuse."""

    def __init__(
        self, field: Field, control: Control, demands: Demands = POSITIONS, limit: float | None = None
    ) -> None:
        """Prepare a search; limit: what chance gains, nats, as another search of the recording found it."""
        super().__init__(field, demands, limit)
        self.control = control
        self.refused: dict[object, str] = {}  # by effect and place, with the last reason
        self.objections: dict[tuple[Accepted, int], str] = {}
        self.in_stead: set[int] = set()  # hypotheses that stand in an accepted family's stead

    def run(self, accepted: Accepted = ()) -> Selection:
        """Search, beginning with some hypotheses: those of which the recording shows anything.

        A family explains a little of everything, waves of many orders resemble any law of a joint, and what is
        accepted first bends what comes later.  So the search is made once more with few single hypotheses, and its
        answer taken where it predicts blocks left out better.  Where small effects are part of the noise, single
        hypotheses come first, and families only where such effects are left.
        """
        accepted = tuple(index for index in accepted if index in self.place)
        if len(self.small.levels) > 1:
            few = self._grown(accepted, narrow=True)
            crowd = self.level(few) > 0
            return self.result(self._grown(few, narrow=False) if crowd else few)
        found = self._grown(accepted, narrow=False)
        if len(found) > 1 or any(len(self.field.offered.hypotheses[i].members) > 1 for i in found):
            few = self._grown(accepted, narrow=True)
            if set(few) != set(found) and self._better(few, found):
                found = few
        return self.result(found)

    def _better(self, one: Accepted, other: Accepted) -> bool:
        """Return whether hypotheses predict blocks left out clearly better than others do, in every partition.

        Of more effects than the others are, they must be as much more probable as one more effect must be.
        """
        effects = [len({self.field.offered.hypotheses[i].effect for i in several}) for several in (one, other)]
        if effects[0] > effects[1] and self.sizes(one).value < self.sizes(other).value + self.demands.further:
            return False
        pairs = zip(self.squares(one), self.squares(other), strict=True)
        least = 2 * self.sizes(one).variance * LEAST_NATS
        return all(a.sum() < b.sum() - least for a, b in pairs)

    def _grown(self, accepted: Accepted, *, narrow: bool) -> Accepted:
        """Return hypotheses with what passes beside them; where that goes round in circles, the most probable of it."""
        accepted, seen = self.grow(accepted, narrow=narrow), list[Accepted]()
        for _ in range(ROUNDS):
            refined = self.possible(self.refine(accepted, narrow=narrow))
            if refined == accepted:
                break
            accepted = self.grow(refined, narrow=narrow)
            seen.append(accepted)
        else:
            accepted = max(seen, key=lambda one: self.sizes(one).value)
        return self.possible(self._needed(accepted))

    def _needed(self, accepted: Accepted) -> Accepted:
        """Drop what others have made needless, the weakest first."""
        while len(accepted) > 1:
            others = {i: tuple(k for k in accepted if k != i) for i in accepted}
            gain = {i: self._beside(accepted, i) - self._asked(others[i], i) for i in accepted}
            weakest = min(accepted, key=lambda i: gain[i])
            if gain[weakest] >= 0:
                break
            accepted = others[weakest]
        return accepted

    def _asked(self, others: Accepted, index: int) -> float:
        """Return what an accepted hypothesis must gain beside others, nats."""
        return PART if index in self.in_stead else float(self.least(others)[self.place[index]])

    def possible(self, accepted: Accepted) -> Accepted:
        """Drop what physics forbids beside the others: what comes later may turn a compliance negative."""
        while True:
            gain = {i: self._beside(accepted, i) for i in accepted}
            others = {i: tuple(k for k in accepted if k != i) for i in sorted(accepted, key=lambda i: gain[i])}
            forbidden = next((i for i, rest in others.items() if not self._allowed(rest, i)), None)
            if forbidden is None:
                return accepted
            accepted = others[forbidden]

    def grow(self, accepted: Accepted, *, narrow: bool = False) -> Accepted:
        """Add hypotheses one at a time until none passes; narrow: few, and no family.

        Several strong effects make each other look like two of a crowd; with all of them in the model it is gone.
        """
        while len(accepted) < (FEW if narrow else MOST):
            gain = self._gain(accepted, narrow=narrow)
            least = self.least(accepted)
            order = self._to_try([int(k) for k in np.argsort(-gain, kind="stable") if gain[k] > least[k]])
            found = next((k for k in order if self._passes(accepted, self.judged[k])), None)
            if found is None:
                together = self._together(accepted) if len(self.small.levels) > 1 else ()
                if not together:
                    break
                accepted = together
                continue
            close = [k for k in order[order.index(found) :] if gain[k] > gain[found] - EQUIVALENT]
            instead = self._instead(accepted, float(gain[found]), narrow=narrow)
            accepted = instead or (*accepted, self._best_proven(accepted, [self.judged[k] for k in close]))
        return accepted

    def _together(self, accepted: Accepted) -> Accepted:
        """Return the accepted ones and others that pass beside each other, though none does alone; else nothing."""
        trial = accepted
        while len(trial) < FEW:
            gain = np.where(self.alone, self.scores(trial, narrow=True).nats, -np.inf)
            best = int(np.argmax(gain))
            if gain[best] <= self.least(trial)[best]:
                break
            trial = self._best_forms((*trial, self.judged[best]))
            more = tuple(i for i in trial if i not in accepted)
            others = {i: tuple(k for k in trial if k != i) for i in more}
            gone = len(more) > 1 and self.level(trial) <= CROWD_GONE
            if gone and all(self._gains_enough(rest, i) and self._passes(rest, i) for i, rest in others.items()):
                return trial
        return ()

    def _best_forms(self, accepted: Accepted) -> Accepted:
        """Return hypotheses, each as the form of its effect, at its place, that gains most beside the others."""
        hypotheses = self.field.offered.hypotheses
        for index in accepted:
            others = tuple(i for i in accepted if i != index)
            forms = [i for i in self.judged if hypotheses[i].place == hypotheses[index].place and i not in others]
            best = max(forms, key=lambda i: self.score(others, i)[0])
            accepted = tuple(best if i == index else i for i in accepted)
        return accepted

    def _gains_enough(self, others: Accepted, index: int) -> bool:
        """Say whether a hypothesis gains beside others what it must."""
        return self.score(others, index)[0] > self._asked(others, index)

    def _to_try(self, order: list[int]) -> list[int]:
        """Return the first few of some hypotheses, and the neighbours of those whose law may lie at another form's."""
        hypotheses, candidates = self.field.offered.hypotheses, self.field.offered.candidates
        one = {k: hypotheses[self.judged[k]] for k in order}
        first = order[:TRIED]
        reaching = (k for k in first if any(p.reach < math.inf for p in candidates[one[k].members[0]].parameters))
        near = {one[k].place for k in reaching}
        joints = {one[k].location.get("joint") for k in first}  # a spring of any law moves a joint as waves do
        sprung = {k for k in order if one[k].variant == OPEN and one[k].location["joint"] in joints}
        return [*first, *(k for k in order[TRIED:] if one[k].place in near or k in sprung)]

    def _gain(self, accepted: Accepted, *, narrow: bool) -> Float1D:
        """Return what hypotheses gain, nats; narrow: single ones, minus infinity for families."""
        nats = self.scores(accepted, narrow=narrow).nats
        return np.where(self.alone, nats, -np.inf) if narrow else nats

    def _instead(self, accepted: Accepted, gained: float, *, narrow: bool) -> Accepted:
        """Return the accepted ones, one of them swapped, where that gains as much as one more; else nothing.

        Args:
            accepted: Hypotheses.
            gained: What one more would gain, nats; more than `EQUIVALENT`, so that every swap gains.
            narrow: Swap in single hypotheses alone.
        """
        for index in accepted:
            others = tuple(i for i in accepted if i != index)
            own = self.score(others, index)[0]
            gain = self._gain(others, narrow=narrow) if narrow else self.scores(others, narrow=True).nats
            better = [int(k) for k in np.argsort(-gain, kind="stable")[:TRIED] if gain[k] > own + gained - EQUIVALENT]
            for k in better:
                if self.judged[k] not in accepted and self._passes(others, self.judged[k]):
                    return tuple(self.judged[k] if i == index else i for i in accepted)
        return ()

    def refine(self, accepted: Accepted, *, narrow: bool = False) -> Accepted:
        """Drop what others make needless, swap what another does better, or a few of a family do as well."""
        hypotheses = self.field.offered.hypotheses
        for index in accepted:
            others = tuple(i for i in accepted if i != index)
            if len(hypotheses[index].members) > 1:
                few = self._few(others, index)
                if few:
                    self.in_stead.update(few)
                    accepted = (*others, *few)
                    continue
            gain = self._gain(others, narrow=narrow)
            own, best = gain[self.place[index]], int(np.argmax(gain))
            if own < self._asked(others, index) or not self.trial(others, index).proven:
                accepted = others
            elif self.judged[best] != index and gain[best] > own + SWAP and self._passes(others, self.judged[best]):
                accepted = tuple(self.judged[best] if i == index else i for i in accepted)
        return accepted

    def _few(self, others: Accepted, family: int) -> Accepted:
        """Return members of a family that alone do as well as all of it; empty where they do not.

        The family is accepted already, so that its members compete among themselves alone; where they are more than
        half of it, each must pass by itself.  Those that blocks left out do not prove, or physics forbids, beside the
        others go, the last first.
        """
        whole, members = self.sizes((*others, family)).value, set(self.field.offered.hypotheses[family].members)
        alone = [i for i in self.judged if len(m := self.field.offered.hypotheses[i].members) == 1 and m[0] in members]
        few: Accepted = ()
        while len(few) < FEW and len(few) < len(members) - 1:
            left = tuple(i for i in alone if i not in few)
            gain = self.several((*others, *few), left).nats
            least = PART if 2 * (len(few) + 1) <= len(members) else self.limit
            if gain.max(initial=-np.inf) < least:
                break
            few = (*few, left[int(gain.argmax())])
        while few and self.sizes((*others, *few)).value > whole - EQUIVALENT:
            beside = {i: (*others, *(j for j in few if j != i)) for i in few}
            asked = ((i, self.trial(beside[i], i).proven and self._allowed(beside[i], i)) for i in reversed(few))
            doubtful = next((i for i, stands in asked if not stands), None)
            if doubtful is None:
                return few
            few = tuple(i for i in few if i != doubtful)
        return ()

    def result(self, accepted: Accepted) -> Selection:
        """Say how each stands beside the others."""
        accepted = tuple(sorted(accepted, key=lambda one: -self._beside(accepted, one)))  # whatever led to them
        trials = [self.trial(tuple(i for i in accepted if i != index), index) for index in accepted]
        gain = tuple(self._beside(accepted, index) for index in accepted)
        proofs, sizes = tuple(trial.proofs for trial in trials), self.sizes(accepted)
        sizes = dataclasses.replace(sizes, size=sizes.size[np.argsort(np.argsort(accepted))])
        named = {self.field.offered.hypotheses[index].place for index in accepted}
        refused = tuple(text for place, text in self.refused.items() if place not in named)
        return Selection(accepted, sizes, gain, proofs, refused, self.level(accepted))

    def _stands(self, hypothesis: Hypothesis, why_not: str) -> bool:
        """Say whether a hypothesis stands: nothing is said against it; keep what is."""
        if why_not:
            self.refused[hypothesis.place] = f"Rejected: “{hypothesis.words}”: {why_not}."
        return not why_not

    def _beside(self, accepted: Accepted, index: int) -> float:
        """Return what one of the accepted hypotheses gains beside the others, nats."""
        return self.score(tuple(i for i in accepted if i != index), index)[0]

    def _best_proven(self, accepted: Accepted, close: list[int]) -> int:
        """Return which of hypotheses that are as probable predicts blocks left out best; the first passes.

        Where blocks are few they do not distinguish: it is the one that is most probable were its size a usual one.
        So it is with the laws of a joint, of whose shape a few steps tell, wherever they are left out.
        Of hypotheses that are equal in this the one with the fewest parameters comes first: a further parameter, of
        which the recording shows nothing, leaves the likelihood as it was.
        """
        if len(close) == 1:
            return close[0]
        if self.field.offered.hypotheses[close[0]].family == LAW:
            worth = self.most_probable_law(accepted, close)
        elif self.demands.by_density:
            worth = self.usual(accepted, close)
        else:
            worth = {i: min(one.share for one in self.trial(accepted, i).proofs) for i in close}
        for index in sorted(worth, key=lambda i: (-round(worth[i], DIGITS), len(self.field.blocks((i,))[0]))):
            if index == close[0] or self._passes(accepted, index):
                return index
        return close[0]

    def _passes(self, accepted: Accepted, index: int) -> bool:
        trial = self.trial(accepted, index)
        if not trial.proven:
            why = "it does not predict blocks of configurations left out any better"
            return self._stands(trial.hypothesis, why)
        if self._one_does(accepted, trial):
            return False
        return self._stands(trial.hypothesis, self._hidden(accepted, trial) or self.objection(trial))

    def _hidden(self, accepted: Accepted, trial: Trial) -> str:
        """Say why a hypothesis is none by itself: one of many small effects, far too large, or a matter of chance.

        What it leaves to chance in each configuration explains much of anything: that is no evidence by itself.
        """
        chance = trial.hypothesis.chance
        if len(chance) and trial.gain - float(self.gains(accepted, Grouped.of([chance])).nats[0]) <= PART:
            return "what it leaves to chance in each configuration explains as much"
        if not self.demands.by_density:
            return ""
        fits, block = self.fitted(accepted), self.field.blocks((trial.index,))[0]
        if trial.sizes.size[-1] > USUAL:
            gain = likelihood_at(fits, block, USUAL) - self.sizes(accepted).value
            if gain <= self._asked(accepted, trial.index):
                return "it would have to be far larger than it usually is"
        level, seen = visible(fits, block)
        out = seen >= STANDS_OUT * level or trial.gain > OVERWHELMING
        return "" if out else "it does not stand out from many small effects"

    def _one_does(self, accepted: Accepted, trial: Trial) -> bool:
        """Say whether one joint explains so much of what all joints explain that the rest is no further cause.

        The others must gain what any hypothesis must; where the one passes by itself, what a further cause must.
        """
        if not trial.hypothesis.everywhere:
            return False
        hypotheses, nats = self.field.offered.hypotheses, self.scores(accepted, narrow=True).nats
        members, least = set(trial.hypothesis.members), self.least(accepted)
        alone = [k for k in np.flatnonzero(self.alone) if hypotheses[self.judged[k]].members[0] in members]
        best = max(alone, key=lambda k: nats[k], default=None)
        if best is None:
            return False
        return bool(trial.gain - nats[best] < (self.demands.further if nats[best] > least[best] else self.limit))

    def objection(self, trial: Trial) -> str:
        """Return what physics or the controls of its kind say against a hypothesis; empty if nothing."""
        key = trial.accepted, trial.index
        if key not in self.objections:
            self.objections[key] = impossible(trial) or self.control(trial)
        return self.objections[key]

    def _allowed(self, accepted: Accepted, index: int) -> bool:
        """Say whether physics allows a hypothesis beside the accepted ones."""
        trial = self.trial(accepted, index)
        return self._stands(trial.hypothesis, impossible(trial))
