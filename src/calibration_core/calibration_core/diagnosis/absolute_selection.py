"""Which effects do absolute positions ask for?  One at a time, over the threshold, proven on blocks left out.

The candidates are ranked by plain evidence; one is accepted if it exceeds the threshold in every partition, saves
squared error on blocks left out in every partition, and passes the controls of its kind.  Accepted ones are refined
by swapping and dropped when others make them needless, until nothing changes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from calibration_core.diagnosis.absolute_design import AbsoluteDesign
from calibration_core.diagnosis.absolute_evidence import Evidence, evidence
from calibration_core.diagnosis.blocks import Blocks
from calibration_core.diagnosis.left_out import block_squares, left_out, saves
from calibration_core.timeseries import Float1D

MOST_PARAMETERS = 20
LEAST_SHARE = 0.03  # of the null model's squared error on blocks left out, that a place must save to be named
TRIED = 5  # candidates per round that may try
SWAP = 0.5  # nats of plain evidence by which a swap must be better
ROUNDS = 4  # of refinement
REDRAWN = 3  # rounds after which the thresholds are drawn anew
Control = Callable[[AbsoluteDesign, tuple[int, ...], int], str]


@dataclasses.dataclass(frozen=True, eq=False)
class AbsoluteSelection:
    """What was accepted.

    Attributes:
        accepted: Candidates, in the order of acceptance.
        scores: Log Bayes factor of each when it entered, or last was refined, nats (the smaller over the partitions).
        limit: Threshold in force when the search stopped, nats (the larger over the partitions).
        refused: Sentences on strong candidates that failed.
        small: Places that pass every test but are too small to be named.
        stopped: Why the search stopped.
    """

    accepted: tuple[int, ...]
    scores: tuple[float, ...]
    limit: float
    refused: tuple[str, ...]
    small: tuple[str, ...]
    stopped: str


def select_absolute(
    design: AbsoluteDesign, partitions: Sequence[Blocks], control: Control, accepted: tuple[int, ...] = ()
) -> AbsoluteSelection:
    """Search.

    Args:
        design: The linear model.
        partitions: Of its readings.
        control: Says why a candidate is refused beside the accepted ones; empty if it is not.
        accepted: Candidates to begin with.
    """
    search = _Search(design, partitions, control)
    accepted, limits, stopped = search.grow(accepted)
    for _ in range(ROUNDS):
        refined = search.without_small(search.refine(accepted, limits))
        if refined == accepted:
            break
        accepted, limits, stopped = search.grow(refined)
    accepted = search.without_small(accepted)
    beside = [evidence(design, _without(accepted, index), partitions, limits, index) for index in accepted]
    scores = tuple(found.weakest(index) for found, index in zip(beside, accepted, strict=True))
    return AbsoluteSelection(
        accepted, scores, max(limits.values()), tuple(search.refused), tuple(search.small.values()), stopped
    )


def parameter_count(design: AbsoluteDesign, accepted: Sequence[int]) -> int:
    """Return how many parameters the accepted candidates have; steps of a target or the tracker do not count."""
    physics = [index for index in accepted if design.candidates[index].family != "anomaly"]
    return sum(len(design.candidates[index].parameters) for index in physics)


def held_out_squares(design: AbsoluteDesign, selection: AbsoluteSelection, partition: Blocks) -> float:
    """Return the squared error on blocks left out, with what was accepted."""
    left = left_out(design.of(selection.accepted), design.residual, partition)
    return float(block_squares(left, partition).sum())


class _Search:
    """The steps of the search, and what they refuse."""

    def __init__(self, design: AbsoluteDesign, partitions: Sequence[Blocks], control: Control) -> None:
        self.design, self.partitions, self.control = design, partitions, control
        self.refused: dict[str, None] = {}
        self.small: dict[object, str] = {}

    def grow(self, accepted: tuple[int, ...]) -> tuple[tuple[int, ...], dict[str, float], str]:
        """Add candidates one at a time until none passes or there is no room."""
        limits: dict[str, float] | None = None
        turn = 0
        while True:
            known = limits if turn % REDRAWN else None
            scores = evidence(self.design, accepted, self.partitions, known)
            limits = scores.limit
            turn += 1
            order = [int(i) for i in np.argsort(-scores.plain, kind="stable") if self._open(scores, int(i))]
            fitting = [i for i in order if self._fits(accepted, i)]
            if not order:
                return accepted, scores.limit, "no further candidate exceeds the threshold"
            if not fitting:
                return accepted, scores.limit, f"{MOST_PARAMETERS} parameters are reached; further ones would pass"
            found = self._first(accepted, fitting[:TRIED])
            if found is None:
                words = "what exceeds the threshold does not improve blocks left out or fails its control"
                return accepted, scores.limit, words
            accepted = (*accepted, found)

    def refine(self, accepted: tuple[int, ...], limits: dict[str, float]) -> tuple[int, ...]:
        """Swap every accepted candidate for a better one beside the others, or drop it."""
        for index in accepted:
            others = _without(accepted, index)
            scores = evidence(self.design, others, self.partitions, limits, index)
            open_ones = np.array([self._open(scores, i) for i in range(len(scores.plain))])
            best = int(np.argmax(np.where(open_ones, scores.plain, -np.inf)))
            better = best != index and open_ones[best] and scores.plain[best] > scores.plain[index] + SWAP
            if better and self._fits(others, best) and not self._fails(others, best):
                accepted = tuple(best if i == index else i for i in accepted)
            elif not scores.passing[index]:
                accepted = others
        return accepted

    def without_small(self, accepted: tuple[int, ...]) -> tuple[int, ...]:
        """Take out places that save too little to matter; they are not tried again."""
        partition = self.partitions[0]
        null = float(self._squares((), partition).sum())
        whole = float(self._squares(accepted, partition).sum())
        physics = [i for i in accepted if self.design.candidates[i].family != "anomaly"]
        for place in dict.fromkeys(self.design.candidates[i].place for i in physics):
            others = tuple(i for i in accepted if self.design.candidates[i].place != place)
            share = (float(self._squares(others, partition).sum()) - whole) / null
            if share < LEAST_SHARE:
                effect, location = place
                where = ", ".join(str(value) for _, value in location)
                self.small[place] = f"{effect} ({where}): {100 * share:.1f} % of the squared error"
        return tuple(i for i in accepted if self.design.candidates[i].place not in self.small)

    def _open(self, scores: Evidence, index: int) -> bool:
        return bool(scores.passing[index]) and self.design.candidates[index].place not in self.small

    def _fits(self, accepted: tuple[int, ...], index: int) -> bool:
        return parameter_count(self.design, (*accepted, index)) <= MOST_PARAMETERS

    def _first(self, accepted: tuple[int, ...], offered: Sequence[int]) -> int | None:
        for index in offered:
            why = self._fails(accepted, index)
            if not why:
                return index
            self.refused[why] = None
        return None

    def _fails(self, accepted: tuple[int, ...], index: int) -> str:
        """Return why a candidate is refused; empty if it is not."""
        candidate = self.design.candidates[index]
        place = ", ".join(str(value) for value in candidate.location.values())
        for partition in self.partitions:
            if not saves(self._squares(accepted, partition), self._squares((*accepted, index), partition)):
                return f"{candidate.effect} ({place}) does not improve blocks left out ({partition.kind})"
        return self.control(self.design, accepted, index)

    def _squares(self, accepted: tuple[int, ...], partition: Blocks) -> Float1D:
        return block_squares(left_out(self.design.of(accepted), self.design.residual, partition), partition)


def _without(accepted: tuple[int, ...], index: int) -> tuple[int, ...]:
    return tuple(i for i in accepted if i != index)
