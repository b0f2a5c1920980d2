"""Rows, hypotheses and the sums that a search needs; one hypothesis tried beside others."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from calibration_core.estimation.blocks import Blocks
from calibration_core.estimation.hypotheses import Hypothesis, Offered
from calibration_core.estimation.leave_out import LeftOut, Proof, block_squares, proof
from calibration_core.estimation.likelihood.restricted import Gram, Sizes
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
        offered: What they are.
        partitions: Of the readings, into blocks.
        products: (f + p, f + p) of the columns in `wide`.
        gram: Condensed, flat columns projected out.
        clear: (p,) whether frames and geometry leave enough of a column.
    """

    residual: Float1D
    wide: Float2D
    flat_scale: Float1D
    offered: Offered
    partitions: tuple[Blocks, ...]
    products: Float2D
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
        r, f = flat.shape
        u = usual.shape[1]
        residual = np.concatenate([residual, np.zeros(u)])
        wide = np.zeros((r + u, f + u + columns.shape[1]))
        wide[:r, :f], wide[:r, f : f + u], wide[r:, f : f + u] = flat, usual, np.eye(u)
        wide[:r, f + u :] = columns
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
        return _condensed(residual, wide, scale, offered, partitions, wide.T @ wide)

    def offering(self, offered: Offered, columns: Callable[[Sequence[Candidate]], Float2D]) -> Field:
        """Return the same rows for other hypotheses: what their candidates have in common with these is taken over.

        Args:
            offered: The other hypotheses.
            columns: Candidates -> (r, k) their whitened columns, per typical size, the rows of priors apart.
        """
        f, mine = self.flat_count, dict(zip(map(id, self.offered.candidates), self.offered.blocks, strict=True))
        new = [one for one in offered.candidates if id(one) not in mine]
        added = columns(new)
        wide = np.zeros((len(self.residual), f + offered.count))
        was = np.full(f + offered.count, -1)  # where a column stood
        was[:f], at = np.arange(f), 0
        for one, block in zip(offered.candidates, offered.blocks, strict=True):
            here, before = slice(f + block.start, f + block.stop), mine.get(id(one))
            if before is not None:
                was[here] = np.arange(f + before.start, f + before.stop)
                continue
            wide[: len(added), here] = added[:, at : at + len(one.parameters)]
            at += len(one.parameters)
        kept, fresh = np.flatnonzero(was >= 0), np.flatnonzero(was < 0)
        wide[:, kept] = self.wide[:, was[kept]]
        products = np.empty((len(was), len(was)))
        products[np.ix_(kept, kept)] = self.products[np.ix_(was[kept], was[kept])]
        products[fresh] = wide[:, fresh].T @ wide
        products[:, fresh] = products[fresh].T
        return _condensed(self.residual, wide, self.flat_scale, offered, self.partitions, products)

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

    def _places(self, accepted: Accepted) -> Int1D:
        return self.flat_count + np.concatenate([np.zeros(0, dtype=np.int64), *self.blocks(accepted)])

    def left_out(self, accepted: Accepted, sizes: Sizes) -> LeftOut:
        """Return the null model with hypotheses of some sizes, every block left out."""
        t = np.repeat(sizes.size, [len(block) for block in self.blocks(accepted)])
        index = np.concatenate([np.arange(self.flat_count), self._places(accepted)])
        ridge = np.concatenate([np.zeros(self.flat_count), sizes.variance / t**2])
        products = self.products[index].take(index, axis=1)
        return LeftOut(self.wide.take(index, axis=1), self.residual, self.partitions, ridge, products)

    def in_blocks(self, errors: Sequence[Float1D]) -> list[Float1D]:
        """Return per partition the squares of blocks left out, (b,)."""
        return [block_squares(error, one) for error, one in zip(errors, self.partitions, strict=True)]


def _condensed(
    residual: Float1D,
    wide: Float2D,
    scale: Float1D,
    offered: Offered,
    partitions: tuple[Blocks, ...],
    products: Float2D,
) -> Field:
    """Project the null model's columns out; arguments are those of the field."""
    f = len(scale)
    left, s, _ = np.linalg.svd(wide[:, :f], full_matrices=False)
    basis, columns = left[:, s > 1e-7 * s[0]], wide[:, f:]
    in_flat = basis.T @ columns
    matrix = in_flat.T @ in_flat
    np.subtract(products[f:, f:], matrix, out=matrix)
    whole = np.diag(products)[f:]
    seen = basis.T @ residual
    gram = Gram(
        matrix, columns.T @ residual - in_flat.T @ seen, float(residual @ residual - seen @ seen),
        len(residual) - basis.shape[1],
    )  # fmt: skip
    clear = (whole > LEAST_MOVED) & (np.diag(matrix) > LEAST_REST**2 * whole)
    matrix[~clear] = matrix[:, ~clear] = gram.vector[~clear] = 0.0
    return Field(residual, wide, scale, offered, partitions, products, gram, clear)


@dataclasses.dataclass(frozen=True, eq=False)
class Trial:
    """A hypothesis beside accepted ones.

    Attributes:
        field: Rows and hypotheses.
        accepted: The ones before it.
        index: The hypothesis.
        sizes: Of all of them, its own last.
        gain: Of the hypothesis beside the others, nats.
        squares: Returns squares of blocks left out, or -2 v times their log densities, per partition, (b,), without the
            hypothesis and with it; they cost more than everything else, and not every question needs them.
        model: Returns the accepted ones with every block left out.
    """

    field: Field
    accepted: Accepted
    index: int
    sizes: Sizes
    gain: float
    squares: Callable[[], tuple[list[Float1D], list[Float1D]]]
    model: Callable[[], LeftOut]

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
        gram, blocks = self.field.gram, self.field.blocks((*self.accepted, self.index))
        index = np.concatenate(blocks)
        prior = np.repeat(self.sizes.size, [len(block) for block in blocks])
        matrix = gram.matrix[np.ix_(index, index)]
        mean = np.linalg.solve(matrix + self.sizes.variance * np.diag(1 / prior**2), gram.vector[index])
        parts = (slice(len(index) - len(blocks[-1]), None), slice(0, len(index) - len(blocks[-1])))
        own, others = (float(np.sqrt(np.abs(mean[p] @ matrix[p, p] @ mean[p]))) for p in parts)
        return own, others

    def posterior(self, members: Sequence[int], *, alone: bool = False) -> tuple[Float1D, Float2D]:
        """Return mean (k,) and covariance (k, k) of the parameters of some candidates, typical sizes.

        Args:
            members: Candidates, each in one hypothesis at least; what several hypotheses say of one is added up.
            alone: Without the hypothesis, the accepted ones alone.
        """
        blocks = self.field.blocks(self.accepted if alone else (*self.accepted, self.index))
        index = np.concatenate(blocks)
        prior = np.repeat(self.sizes.size[: len(blocks)], [len(block) for block in blocks])
        matrix = self.field.gram.matrix[np.ix_(index, index)] + self.sizes.variance * np.diag(1 / prior**2)
        asked = np.concatenate([np.arange(s.start, s.stop) for s in (self.field.offered.blocks[k] for k in members)])
        adds = (asked[:, None] == index).astype(np.float64)
        solved = cho_solve(cho_factor(matrix), np.column_stack([self.field.gram.vector[index], adds.T]))
        return adds @ solved[:, 0], self.sizes.variance * (adds @ solved[:, 1:])
