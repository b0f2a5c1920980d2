"""Rows, hypotheses and the sums that a search needs; one hypothesis tried beside others."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from calibration_core.estimation.blocks import Blocks
from calibration_core.estimation.hypotheses import Hypothesis, Offered
from calibration_core.estimation.leave_out import LeftOut, Proof, block_squares, proof
from calibration_core.estimation.likelihood.gains import Seen
from calibration_core.estimation.likelihood.restricted import JITTER, Gram, Sizes
from calibration_core.identification.statistics import FINEST
from calibration_core.model.effects.candidate import Candidate
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Int1D

LEAST_REST = 0.02  # share of a column that frames and geometry must leave
MOSTLY = 0.5  # share of a hypothesis's columns of which so much is left
LEAST_MOVED = 1e-4  # squared movement per typical size over all rows, in units of the noise
Accepted = tuple[int, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Field:
    """All rows and hypotheses of one search.

    Attributes:
        residual: (r,) whitened.
        wide: (r, f + p) whitened columns: of the null model, of length one, then of all candidates, per typical size.
        flat_scale: (f,) lengths by which the null model's columns were divided.
        partitions: Of the readings, into blocks.
        basis: (r, b) orthonormal columns that span those of the null model.
        in_flat: (b, p) what the columns of candidates have in them.
        gram: Condensed, flat columns projected out.
        clear: (p,) whether frames and geometry leave enough of a column.
    """

    residual: Float1D
    wide: Float2D
    flat_scale: Float1D
    offered: Offered
    partitions: tuple[Blocks, ...]
    basis: Float2D
    in_flat: Float2D
    gram: Gram
    clear: Bool1D

    @staticmethod
    def of(
        residual: Float1D,
        flat: Float2D,
        usual: Float2D,
        columns: Sequence[Float2D],
        offered: Offered,
        partitions: tuple[Blocks, ...],
        unit: float = 1.0,
    ) -> Field:
        """Condense the rows.

        Args:
            residual: (r,) whitened.
            flat: (r, f) whitened columns of the null model.
            usual: (r, u) whitened columns of what is always a little wrong, per standard deviation: refitted likewise,
                each with a row of its own that holds it to its size.
            columns: Whitened columns of all candidates, in parts, (r, k) each.
            offered: What they are.
            partitions: Of the readings, into blocks; the rows of priors are in none.
            unit: Typical sizes per which the columns of candidates are given.
        """
        r, f = flat.shape
        u = usual.shape[1]
        residual = np.concatenate([residual, np.zeros(u)])
        ends = list(itertools.accumulate((part.shape[1] for part in columns), initial=f + u))
        wide = np.zeros((r + u, ends[-1]))
        wide[:r, :f], wide[:r, f : f + u], wide[r:, f : f + u] = flat, usual, np.eye(u)
        for part, (start, stop) in zip(columns, itertools.pairwise(ends), strict=True):
            np.divide(part, unit, out=wide[:r, start:stop])
        return Field.within(residual, wide, f + u, offered, partitions)

    @staticmethod
    def within(residual: Float1D, wide: Float2D, flat: int, offered: Offered, partitions: tuple[Blocks, ...]) -> Field:
        """Condense rows that are all in one array, which becomes the field's own.

        Args:
            residual: (r,) whitened, the rows of priors among them.
            wide: (r, flat + p) whitened columns: of what is refitted, then of all candidates.
            flat: Number of the former.
            offered: What the candidates are.
            partitions: Of the readings, into blocks; the rows of priors, which are the last, are in none.
        """
        length = np.linalg.norm(wide[:, :flat], axis=0)
        scale = np.where(length > 0, length, 1.0)
        wide[:, :flat] /= scale
        left, s, _ = np.linalg.svd(wide[:, :flat], full_matrices=False)
        basis, columns = left[:, s > 1e-7 * s[0]], wide[:, flat:]
        in_flat = basis.T @ columns
        matrix = columns.T @ columns
        whole = np.diag(matrix).copy()
        matrix -= in_flat.T @ in_flat
        clear = _is_clear(whole, np.diag(matrix))
        return _condensed(residual, wide, scale, offered, partitions, basis, in_flat, matrix, clear)

    def offering(self, offered: Offered, columns: Callable[[Sequence[Candidate]], Float2D]) -> Field:
        """Return the same rows for other hypotheses: what their candidates have in common with these is taken over.

        Args:
            offered: The other hypotheses.
            columns: Candidates -> (r, k) their whitened columns, per typical size, the rows of priors apart.
        """
        f, mine = self.flat_count, dict(zip(map(id, self.offered.candidates), self.offered.blocks, strict=True))
        was = np.full(offered.count, -2)  # where a column stood; of a new one, -2, which no other follows
        for one, block in zip(offered.candidates, offered.blocks, strict=True):
            if (before := mine.get(id(one))) is not None:
                was[block] = np.arange(before.start, before.stop)
        fresh, ends = np.flatnonzero(was < 0), [0, *(np.flatnonzero(np.diff(was) != 1) + 1), offered.count]
        runs = [(slice(a, b), slice(was[a], was[a] + b - a)) for a, b in itertools.pairwise(ends) if was[a] >= 0]
        more = np.zeros((len(self.residual), len(fresh)))
        own = columns([one for one in offered.candidates if id(one) not in mine])
        more[: len(own)] = own
        wide, in_flat = np.empty((len(self.residual), f + offered.count)), np.empty((len(self.in_flat), offered.count))
        wide[:, :f], wide[:, f + fresh], in_flat[:, fresh] = self.wide[:, :f], more, self.basis.T @ more
        matrix, clear = np.empty((offered.count, offered.count)), np.empty(offered.count, dtype=np.bool_)
        for here, there in runs:
            wide[:, f + here.start : f + here.stop] = self.wide[:, f + there.start : f + there.stop]
            in_flat[:, here], clear[here] = self.in_flat[:, there], self.clear[there]
            for other, stood in runs:
                matrix[here, other] = self.gram.matrix[there, stood]
        matrix[fresh] = more.T @ wide[:, f:] - in_flat[:, fresh].T @ in_flat
        matrix[:, fresh] = matrix[fresh].T
        clear[fresh] = _is_clear((more**2).sum(axis=0), np.diag(matrix)[fresh])
        return _condensed(
            self.residual, wide, self.flat_scale, offered, self.partitions, self.basis, in_flat, matrix, clear
        )

    @property
    def flat_count(self) -> int:
        """Number of the null model's columns."""
        return len(self.flat_scale)

    @property
    def judged(self) -> tuple[int, ...]:
        """Hypotheses of most of which the recording shows more than frames and geometry take up.

        What they take up of a hypothesis, as the turn of a tool about the last joint's axis, is theirs.
        """
        seen = (self.clear[hypothesis.columns] for hypothesis in self.offered.hypotheses)
        return tuple(i for i, clear in enumerate(seen) if clear.mean() > MOSTLY)

    def blocks(self, accepted: Accepted) -> list[Int1D]:
        """Return the columns of hypotheses."""
        return [self.offered.hypotheses[i].columns for i in accepted]

    def columns(self, accepted: Accepted) -> Float2D:
        """Return the whitened columns of hypotheses, (r, k)."""
        return self.wide.take(self._places(accepted), axis=1)

    def _own(self, accepted: Accepted) -> Int1D:
        return np.concatenate([np.zeros(0, dtype=np.int64), *self.blocks(accepted)])

    def _places(self, accepted: Accepted) -> Int1D:
        return self.flat_count + self._own(accepted)

    def left_out(self, accepted: Accepted, sizes: Sizes) -> LeftOut:
        """Return the null model with hypotheses of some sizes, every block left out."""
        t = np.repeat(sizes.size, [len(block) for block in self.blocks(accepted)])
        index = np.concatenate([np.arange(self.flat_count), self._places(accepted)])
        ridge = np.concatenate([np.zeros(self.flat_count), sizes.variance / t**2])
        columns = self.wide.take(index, axis=1)
        return LeftOut(columns, self.residual, self.partitions, ridge, self.products(columns, self._own(accepted)))

    def products(self, columns: Float2D, own: Int1D) -> Float2D:
        """Return the products, (f + k, f + k), of the null model's columns and some others.

        Args:
            columns: (r, f + k) those of `wide`.
            own: (k,) which of the candidates' columns the others are.
        """
        f, k = self.flat_count, len(own)
        result = np.empty((f + k, f + k))
        result[:f] = columns[:, :f].T @ columns
        result[f:, :f] = result[:f, f:].T
        in_flat, lost = self.in_flat[:, own], f + np.flatnonzero(~self.clear[own])
        result[f:, f:] = self.gram.matrix[own].take(own, axis=1) + in_flat.T @ in_flat
        result[lost, f:] = columns[:, lost].T @ columns[:, f:]  # of which the condensed rows keep nothing
        result[f:, lost] = result[lost, f:].T
        return result

    def in_blocks(self, errors: Sequence[Float1D]) -> list[Float1D]:
        """Return per partition the squares of blocks left out, (b,)."""
        return [block_squares(error, one) for error, one in zip(errors, self.partitions, strict=True)]


def _is_clear(whole: Float1D, left: Float1D) -> Bool1D:
    """Say of columns whether enough is left beside the null model; arguments are their squares, whole and left."""
    return np.asarray((whole > LEAST_MOVED) & (left > LEAST_REST**2 * whole))


def _condensed(
    residual: Float1D,
    wide: Float2D,
    scale: Float1D,
    offered: Offered,
    partitions: tuple[Blocks, ...],
    basis: Float2D,
    in_flat: Float2D,
    matrix: Float2D,
    clear: Bool1D,
) -> Field:
    """Put a field together; of columns that are not clear nothing stays in the condensed rows.

    No recording is judged finer than `FINEST`: what a simulation without noise leaves is rounding, and no physics.
    """
    seen = basis.T @ residual
    vector = wide[:, len(scale) :].T @ residual - in_flat.T @ seen
    matrix[~clear] = matrix[:, ~clear] = vector[~clear] = 0.0
    freedom = len(residual) - basis.shape[1]
    square = float(residual @ residual - seen @ seen) + FINEST**2 * freedom
    gram = Gram(matrix, vector, square, freedom)
    return Field(residual, wide, scale, offered, partitions, basis, in_flat, gram, clear)


@dataclasses.dataclass(frozen=True, eq=False)
class Trial:
    """A hypothesis beside accepted ones.

    Attributes:
        accepted: The ones before it.
        index: The hypothesis.
        sizes: Of all of them, its own last.
        gain: Of the hypothesis beside the others, nats.
        squares: Returns squares of blocks left out, or -2 v times their log densities, per partition, (b,), without the
            hypothesis and with it; they cost more than everything else, and not every question needs them.
        model: Returns the accepted ones with every block left out.
        seen: Returns what is seen beside the accepted ones.
        score: Returns what any hypothesis gains beside others, nats; minus infinity where it is not judged.
    """

    field: Field
    accepted: Accepted
    index: int
    sizes: Sizes
    gain: float
    squares: Callable[[], tuple[list[Float1D], list[Float1D]]]
    model: Callable[[], LeftOut]
    seen: Callable[[], Seen]
    score: Callable[[Accepted, int], float]

    @functools.cached_property
    def left_out(self) -> tuple[list[Float1D], list[Float1D]]:
        """What `squares` returns."""
        return self.squares()

    @property
    def hypothesis(self) -> Hypothesis:
        """The hypothesis."""
        return self.field.offered.hypotheses[self.index]

    @property
    def proofs(self) -> tuple[Proof, ...]:
        """What blocks left out say, per partition."""
        pairs = zip(*self.left_out, strict=True)
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
        own, seen = self.hypothesis.columns, self.seen()
        taken, right, factor = self._own
        mean = cho_solve(factor, right)
        rest = seen.right - taken @ mean
        others = solve_triangular(seen.lower, rest, lower=True, trans=1)  # per size, as D G D = L - v I is
        squares = mean @ self.field.gram.matrix[np.ix_(own, own)] @ mean, rest @ rest - seen.variance * others @ others
        return float(np.sqrt(np.abs(squares[0]))), float(np.sqrt(np.abs(squares[1])))

    @functools.cached_property
    def _own(self) -> tuple[Float2D, Float1D, tuple[Float2D, bool]]:
        """Of its k columns what the accepted ones take, (a, k), and their normal equations beside these."""
        own, seen = self.hypothesis.columns, self.seen()
        taken, vector = seen.of(own)
        matrix = self.field.gram.matrix[np.ix_(own, own)]
        lost = JITTER * np.diag(matrix)
        matrix -= taken.T @ taken
        matrix[np.diag_indices_from(matrix)] += self.sizes.variance / self.sizes.size[-1] ** 2 + lost
        return taken, seen.variance * vector, cho_factor(matrix)

    def posterior(self, members: Sequence[int], *, alone: bool = False) -> tuple[Float1D, Float2D]:
        """Return mean (k,) and covariance (k, k) of the parameters of some candidates, typical sizes.

        Args:
            members: Candidates, each in one hypothesis at least; what several hypotheses say of one is added up.
            alone: Without the hypothesis, the accepted ones alone.
        """
        seen = self.seen()
        asked = np.concatenate([np.arange(s.start, s.stop) for s in (self.field.offered.blocks[k] for k in members)])
        others = solve_triangular(seen.lower, seen.size[:, None] * (seen.members[:, None] == asked), lower=True)
        mean, covariance = others.T @ seen.right, others.T @ others
        if not alone:
            taken, right, factor = self._own
            apart = (self.hypothesis.columns[:, None] == asked) - taken.T @ others
            solved = cho_solve(factor, np.column_stack([right, apart]))
            mean, covariance = mean + apart.T @ solved[:, 0], covariance + apart.T @ solved[:, 1:]
        return mean, self.sizes.variance * covariance
