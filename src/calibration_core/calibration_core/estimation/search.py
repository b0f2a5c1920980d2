"""Which hypotheses enter: likelihood proposes, whole blocks left out dispose.

One at a time the hypothesis that gains most beside what is accepted is proposed; it enters if it exceeds what the best
of all gains in one per cent of recordings without it (parametric bootstrap of the fitted model, Westfall and Young
1993), predicts blocks left out in time and in posture better, and passes the controls of its kind.  After each
acceptance all sizes are fitted together.  What is accepted is swapped or dropped where others make it needless.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import numpy as np

from calibration_core.estimation.blocks import Blocks
from calibration_core.estimation.hypotheses import Hypothesis, Offered
from calibration_core.estimation.leave_out import Proof, block_squares, left_out_blocks, proof
from calibration_core.estimation.likelihood import Gram, Sizes, beside, fit_sizes, gains
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Int1D

LEAST_REST = 0.02  # share of a column that frames and geometry must leave
LEAST_MOVED = 1e-4  # squared movement per typical size over all rows, in units of the noise
FALSE_ALARM = 0.01
DRAWS = 60
FLOOR = 10.0  # nats: the threshold is never lower
SEED = 17384
TRIED = 6  # proposals per round that may try
EQUIVALENT = 5.0  # nats
SWAP = 5.0  # nats by which a swap must be better
MOST = 16  # hypotheses
ROUNDS = 3  # of refinement
FEW = 6  # members of a family that are tried in its stead
EULER = 0.5772156649015329
Accepted = tuple[int, ...]
Control = Callable[["Trial"], str]


@dataclasses.dataclass(frozen=True, eq=False)
class Field:
    """All rows and hypotheses of one search.

    Attributes:
        residual: (r,) whitened.
        wide: (r, f + p) whitened columns: of the null model, of length one, then of all candidates, per typical size.
        flat_scale: (f,) lengths by which the null model's columns were divided.
        offered: What they are.
        partitions: Of the readings, into blocks.
        gram: Condensed, flat columns projected out.
        clear: (p,) whether frames and geometry leave enough of a column.
    """

    residual: Float1D
    wide: Float2D
    flat_scale: Float1D
    offered: Offered
    partitions: tuple[Blocks, ...]
    gram: Gram
    clear: Bool1D

    @staticmethod
    def of(
        residual: Float1D,
        flat: Float2D,
        usual: Float2D,
        columns: Float2D,
        offered: Offered,
        partitions: tuple[Blocks, ...],
    ) -> Field:
        """Condense the rows.

        Args:
            residual: (r,) whitened.
            flat: (r, f) whitened columns of the null model.
            usual: (r, u) whitened columns of what is always a little wrong, per standard deviation: refitted likewise,
                each with a row of its own that holds it to its size.
            columns: (r, p) whitened columns of all candidates, per typical size.
            offered: What they are.
            partitions: Of the readings, into blocks; the rows of priors are in none.
        """
        u = usual.shape[1]
        residual = np.concatenate([residual, np.zeros(u)])
        flat = np.block([[flat, usual], [np.zeros((u, flat.shape[1])), np.eye(u)]])
        columns = np.concatenate([columns, np.zeros((u, columns.shape[1]))])
        length = np.linalg.norm(flat, axis=0)
        scale = np.where(length > 0, length, 1.0)
        flat = flat / scale
        u, s, _ = np.linalg.svd(flat, full_matrices=False)
        basis = u[:, s > 1e-7 * s[0]]
        in_flat = basis.T @ columns
        whole = np.einsum("ij,ij->j", columns, columns)
        matrix = columns.T @ columns - in_flat.T @ in_flat
        seen = basis.T @ residual
        gram = Gram(
            matrix, columns.T @ residual - in_flat.T @ seen, float(residual @ residual - seen @ seen),
            len(residual) - basis.shape[1],
        )  # fmt: skip
        clear = (whole > LEAST_MOVED) & (np.diag(matrix) > LEAST_REST**2 * whole)
        matrix[~clear] = matrix[:, ~clear] = gram.vector[~clear] = 0.0
        return Field(residual, np.concatenate([flat, columns], axis=1), scale, offered, partitions, gram, clear)

    @property
    def flat_count(self) -> int:
        """Number of the null model's columns."""
        return len(self.flat_scale)

    @property
    def judged(self) -> tuple[int, ...]:
        """Hypotheses of which the recording shows more than frames and geometry take up."""
        seen = ((h, self.clear[h.columns]) for h in self.offered.hypotheses)
        return tuple(i for i, (h, clear) in enumerate(seen) if clear.mean() > (0.5 if len(h.members) > 1 else 0.99))

    def blocks(self, accepted: Accepted) -> list[Int1D]:
        """Return the columns of hypotheses."""
        return [self.offered.hypotheses[i].columns for i in accepted]

    def squares(
        self, accepted: Accepted, sizes: Sizes, more: Float2D | None = None, size: float = 1.0
    ) -> list[Float1D]:
        """Return per partition the squares of blocks left out, (b,).

        Args:
            accepted: Hypotheses.
            sizes: Theirs.
            more: (r, k) further columns.
            size: Theirs.
        """
        f = self.flat_count
        index = np.concatenate([np.zeros(0, dtype=np.int64), *self.blocks(accepted)])
        t = np.repeat(sizes.size, [len(block) for block in self.blocks(accepted)])
        parts, ridge = [self.wide[:, :f], self.wide[:, f + index]], [np.zeros(f), sizes.variance / t**2]
        if more is not None:
            parts.append(more)
            ridge.append(np.full(more.shape[1], sizes.variance / size**2))
        columns, weights = np.concatenate(parts, axis=1), np.concatenate(ridge)
        errors = left_out_blocks(columns, self.residual, self.partitions, weights)
        return [block_squares(error, p) for error, p in zip(errors, self.partitions, strict=True)]


@dataclasses.dataclass(frozen=True, eq=False)
class Trial:
    """A hypothesis beside accepted ones.

    Attributes:
        field: Rows and hypotheses.
        accepted: The ones before it.
        index: The hypothesis.
        sizes: Of all of them, its own last.
        before, after: Squares of blocks left out, per partition, (b,).
    """

    field: Field
    accepted: Accepted
    index: int
    sizes: Sizes
    before: list[Float1D]
    after: list[Float1D]

    @property
    def hypothesis(self) -> Hypothesis:
        """The hypothesis."""
        return self.field.offered.hypotheses[self.index]

    @property
    def proofs(self) -> tuple[Proof, ...]:
        """What blocks left out say, per partition."""
        pairs = zip(self.before, self.after, strict=True)
        return tuple(proof(one, other, self.sizes.variance) for one, other in pairs)

    @property
    def proven(self) -> bool:
        """Whether it holds in every partition."""
        return all(one.holds for one in self.proofs)

    @property
    def movement(self) -> float:
        """Root of the squared movement that the hypothesis makes, beyond the null model, in units of the noise."""
        return self._moved[0]

    @property
    def movement_of_others(self) -> float:
        """The same of what was accepted before."""
        return self._moved[1]

    @functools.cached_property
    def _moved(self) -> tuple[float, float]:
        gram, blocks = self.field.gram, self.field.blocks((*self.accepted, self.index))
        index = np.concatenate(blocks)
        prior = np.repeat(self.sizes.size, [len(block) for block in blocks])
        matrix = gram.matrix[np.ix_(index, index)]
        mean = np.linalg.solve(matrix + self.sizes.variance * np.diag(1 / prior**2), gram.vector[index])
        parts = (slice(len(index) - len(blocks[-1]), None), slice(0, len(index) - len(blocks[-1])))
        own, others = (float(np.sqrt(np.abs(mean[p] @ matrix[p, p] @ mean[p]))) for p in parts)
        return own, others

    def posterior(self) -> tuple[Float1D, Float2D]:
        """Return mean (k,) and covariance (k, k) of its parameters beside the others, typical sizes."""
        gram, blocks = self.field.gram, self.field.blocks((*self.accepted, self.index))
        index = np.concatenate(blocks)
        prior = np.repeat(self.sizes.size, [len(block) for block in blocks])
        matrix = gram.matrix[np.ix_(index, index)] + self.sizes.variance * np.diag(1 / prior**2)
        inverse = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
        own = slice(len(index) - len(blocks[-1]), len(index))
        return (inverse @ gram.vector[index])[own], self.sizes.variance * inverse[own, own]


@dataclasses.dataclass(frozen=True, eq=False)
class Selection:
    """What was accepted.

    Attributes:
        accepted: Hypotheses, in the order of acceptance.
        sizes: Of all of them together.
        gain: (k,) nats, of each beside the others.
        proofs: Of each beside the others, per partition.
        limit: Threshold, nats.
        refused: Sentences on strong hypotheses that failed.
    """

    accepted: Accepted
    sizes: Sizes
    gain: tuple[float, ...]
    proofs: tuple[tuple[Proof, ...], ...]
    limit: float
    refused: tuple[str, ...]


class Search:
    """The steps of the search, and what they refuse."""

    def __init__(self, field: Field, control: Control) -> None:
        self.field, self.control = field, control
        self.judged = field.judged
        self.place = {index: k for k, index in enumerate(self.judged)}
        self.fits: dict[Accepted, Sizes] = {}
        self.held_out: dict[Accepted, list[Float1D]] = {}
        self.known: dict[Accepted, tuple[Float1D, Float1D]] = {}
        self.trials: dict[tuple[Accepted, int], Trial] = {}
        self.refused: dict[str, None] = {}
        self.limit = self._threshold()

    def sizes(self, accepted: Accepted) -> Sizes:
        """Return the sizes of hypotheses together."""
        if accepted not in self.fits:
            self.fits[accepted] = fit_sizes(self.field.gram, self.field.blocks(accepted), self._start(accepted))
        return self.fits[accepted]

    def squares(self, accepted: Accepted) -> list[Float1D]:
        """Return the squares of blocks left out."""
        if accepted not in self.held_out:
            self.held_out[accepted] = self.field.squares(accepted, self.sizes(accepted))
        return self.held_out[accepted]

    def scores(self, accepted: Accepted) -> tuple[Float1D, Float1D]:
        """Return gain, nats, and size of every judged hypothesis beside the accepted ones, (j,) each."""
        if accepted not in self.known:
            matrix, vector = beside(self.field.gram, self.field.blocks(accepted), self.sizes(accepted))
            value, size = gains(matrix, vector[:, None], self.field.blocks(self.judged))
            self.known[accepted] = value[:, 0], size[:, 0]
        return self.known[accepted]

    def trial(self, accepted: Accepted, index: int) -> Trial:
        """Put one more hypothesis beside the accepted ones, at the size that suits it best."""
        if (accepted, index) not in self.trials:
            self.trials[accepted, index] = self._trial(accepted, index)
        return self.trials[accepted, index]

    def _trial(self, accepted: Accepted, index: int) -> Trial:
        at = self.sizes(accepted)
        size = np.append(at.size, self.scores(accepted)[1][self.place[index]])
        variance = self.fits.get((*accepted, index), at).variance
        sizes = Sizes(variance, size, float("nan"))
        return Trial(
            self.field, accepted, index, sizes, self.squares(accepted), self.field.squares((*accepted, index), sizes)
        )

    def run(self, accepted: Accepted = ()) -> Selection:
        """Search, beginning with some hypotheses."""
        accepted = self.grow(accepted)
        for _ in range(ROUNDS):
            refined = self.refine(accepted)
            if refined == accepted:
                break
            accepted = self.grow(refined)
        return self.result(accepted)

    def grow(self, accepted: Accepted) -> Accepted:
        """Add hypotheses one at a time until none passes."""
        while len(accepted) < MOST:
            gain, _ = self.scores(accepted)
            order = [k for k in np.argsort(-gain, kind="stable") if gain[k] > self.limit][:TRIED]
            found = next((k for k in order if self._passes(accepted, self.judged[k])), None)
            if found is None:
                break
            close = [k for k in order[order.index(found) :] if gain[k] > gain[found] - EQUIVALENT]
            accepted = (*accepted, self._best_proven(accepted, [self.judged[k] for k in close]))
        return accepted

    def refine(self, accepted: Accepted) -> Accepted:
        """Drop what others make needless, swap what another does better, or a few of a family do as well."""
        for index in accepted:
            others = tuple(i for i in accepted if i != index)
            if len(self.field.offered.hypotheses[index].members) > 1:
                few = self._few(others, index)
                if few:
                    accepted = (*others, *few)
                    continue
            gain, _ = self.scores(others)
            own, best = gain[self.place[index]], int(np.argmax(gain))
            if own < self.limit or not self.trial(others, index).proven:
                accepted = others
            elif self.judged[best] != index and gain[best] > own + SWAP and self._passes(others, self.judged[best]):
                accepted = tuple(self.judged[best] if i == index else i for i in accepted)
        return accepted

    def _few(self, others: Accepted, family: int) -> Accepted:
        """Return members of a family that alone do as well as all of it; empty where they do not."""
        whole, members = self.sizes((*others, family)).value, set(self.field.offered.hypotheses[family].members)
        alone = [i for i in self.judged if len(m := self.field.offered.hypotheses[i].members) == 1 and m[0] in members]
        few: Accepted = ()
        while len(few) < FEW and len(few) < len(members) - 1:
            gain, _ = self.scores((*others, *few))
            left = [i for i in alone if i not in few]
            best = left[int(np.argmax([gain[self.place[i]] for i in left]))] if left else -1
            if best < 0 or gain[self.place[best]] < self.limit:
                break
            few = (*few, best)
            if self.sizes((*others, *few)).value > whole - EQUIVALENT and all(
                self.trial((*others, *(j for j in few if j != i)), i).proven for i in few
            ):
                return few
        return ()

    def result(self, accepted: Accepted) -> Selection:
        """Say how each stands beside the others."""
        trials = [self.trial(tuple(i for i in accepted if i != index), index) for index in accepted]
        gain = tuple(float(self.scores(trial.accepted)[0][self.place[trial.index]]) for trial in trials)
        proofs = tuple(trial.proofs for trial in trials)
        return Selection(accepted, self.sizes(accepted), gain, proofs, self.limit, tuple(self.refused))

    def _best_proven(self, accepted: Accepted, close: list[int]) -> int:
        """Return which of hypotheses that are as probable predicts blocks left out best; the first passes."""
        worth = {i: min(one.nats for one in self.trial(accepted, i).proofs) for i in close if len(close) > 1}
        for index in sorted(worth, key=lambda i: -worth[i]):
            if index == close[0] or self._passes(accepted, index):
                return index
        return close[0]

    def _start(self, accepted: Accepted) -> Sizes | None:
        """Return sizes to begin with: those of a fit with most of the same hypotheses, and what suits the new ones."""
        known = max(self.fits, key=lambda other: len(set(other) & set(accepted)), default=None)
        if known is None or not known:
            usual = {} if () not in self.known else dict(zip(self.judged, self.known[()][1], strict=True))
            null = self.fits.get(())
            variance = self.field.gram.square / self.field.gram.freedom if null is None else null.variance
            return Sizes(variance, np.array([max(usual.get(i, 0.3), 1e-2) for i in accepted]), float("nan"))
        fit = dict(zip(known, self.fits[known].size, strict=True))
        beyond = dict(zip(self.judged, self.scores(known)[1], strict=True))
        size = np.array([fit.get(i, max(beyond.get(i, 0.3), 1e-2)) for i in accepted])
        return Sizes(self.fits[known].variance, size, float("nan"))

    def _passes(self, accepted: Accepted, index: int) -> bool:
        trial = self.trial(accepted, index)
        words = f"{trial.hypothesis.effect} ({', '.join(map(str, trial.hypothesis.location.values()))})"
        if not trial.proven:
            self.refused[f"{words} does not improve blocks left out"] = None
            return False
        why = self.control(trial)
        if why:
            self.refused[f"{words}: {why}"] = None
        return not why

    def _threshold(self) -> float:
        """Return what the best hypothesis gains in one per cent of recordings with the null model alone, nats."""
        field = self.field
        clear = np.flatnonzero(field.clear)
        matrix = field.gram.matrix
        scale = np.sqrt(np.where(field.clear, np.diag(matrix), 1.0))
        part = (matrix / np.outer(scale, scale))[np.ix_(clear, clear)]
        lower = np.linalg.cholesky(part + 1e-8 * np.eye(len(clear)))
        drawn = np.zeros((len(scale), DRAWS))
        drawn[clear] = scale[clear, None] * (lower @ np.random.default_rng(SEED).standard_normal((len(clear), DRAWS)))
        largest = gains(matrix, drawn, field.blocks(self.judged))[0].max(axis=0)
        width = float(np.std(largest)) * np.sqrt(6) / np.pi
        return max(float(np.mean(largest) - EULER * width - width * np.log(-np.log(1 - FALSE_ALARM))), FLOOR)
