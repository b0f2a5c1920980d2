"""Everything small is present a little: gains beside many small effects, as large as suits the recording best.

The whole catalogue enters the covariance of the rows, flat columns projected out,

    V = v (I + sum_l w_l^2 A_l A_l'),

each place with the same signal-to-noise ratio c, and a finding must stand out from it.  c is not fixed beforehand: a
hypothesis is judged at the level that suits it best, against what was accepted at the level that suits that best, so
that neither can a crowd of small effects pass for a large one, nor a large one raise the level and hide in the crowd.
With G = A'A everything follows from Gram matrices: at a level G becomes G - G W M^(-1) W G with M = I + W G W, which
is W^(-1) (I - M^(-1)) W^(-1) among the columns that have small effects, and G W M^(-1) W^(-1) between others and these.
Source: Kennedy and O'Hagan 2001 with a physical kernel; Kass and Raftery 1995 (Bayes factors).
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from scipy.linalg import cholesky
from scipy.linalg.lapack import dpotri

from calibration_core.estimation.hypotheses import Offered
from calibration_core.estimation.likelihood.gains import LEAST_LEFT, Gains, Grouped, Seen, beside, gains
from calibration_core.estimation.likelihood.restricted import Gram, Sizes, fit_sizes
from calibration_core.estimation.shifts import FAMILY
from calibration_core.model.effects.candidate import Candidate
from calibration_core.timeseries import Float1D, Float2D, Int1D

NONE = (0.0,)
LEVELS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.5, 6.5)  # signal-to-noise ratios of every place
MOST = 1.0  # in typical sizes: how large the small effects may make any


@dataclasses.dataclass(frozen=True, eq=False)
class LevelFit:
    """Accepted hypotheses beside small effects of one level.

    Attributes:
        level: c.
        gram: The rows beside the small effects.
        blocks: Columns of the hypotheses.
        sizes: The optimum; its value is comparable between levels.
    """

    level: float
    gram: Gram
    blocks: tuple[Int1D, ...]
    sizes: Sizes

    @functools.cached_property
    def seen(self) -> Seen:
        """What is seen beside them."""
        return beside(self.gram, self.blocks, self.sizes)


class SmallEffects:
    """The rows beside small effects of every level that is asked for.

    Args:
        gram: The rows.
        offered: The hypotheses; readings that moved are no small effects.
        levels: From which the most probable is taken, rising; the first is 0, the rows themselves.
    """

    def __init__(self, gram: Gram, offered: Offered, levels: tuple[float, ...] = NONE) -> None:
        self.levels, self.gram = levels, gram
        self._unit = shared_power(np.diag(gram.matrix), offered.candidates, offered.blocks)
        self._known: dict[float, tuple[Gram, float]] = {0.0: (gram, 0.0)}

    def fits(self, blocks: Sequence[Int1D], start: Sizes | None) -> tuple[LevelFit, ...]:
        """Return hypotheses beside small effects of the levels up to one above the most probable."""
        found: list[LevelFit] = []
        for level in self.levels:
            gram, value = self.at(level)
            sizes = fit_sizes(gram, blocks, start)
            found.append(LevelFit(level, gram, tuple(blocks), dataclasses.replace(sizes, value=sizes.value + value)))
            if most_probable(found).level < level:
                break
        return tuple(found)

    def at(self, level: float) -> tuple[Gram, float]:
        """Return the rows beside small effects of a level, and what these add to the log likelihood."""
        if level not in self._known:
            size = np.minimum(level * self._unit, MOST)
            small, other = np.flatnonzero(size), np.flatnonzero(size == 0)
            weight, one = size[small], np.eye(len(small))
            matrix, vector = self.gram.matrix.copy(), self.gram.vector.copy()
            lower = cholesky(one + weight[:, None] * matrix[np.ix_(small, small)] * weight, lower=True)
            inverse = np.tril(dpotri(lower, lower=True)[0])
            inverse += np.tril(inverse, -1).T
            beside = matrix[np.ix_(other, small)] * weight
            through, along = beside @ inverse, inverse @ (weight * vector[small])
            matrix[np.ix_(small, small)] = (one - inverse) / np.outer(weight, weight)
            matrix[np.ix_(other, small)] = through / weight
            matrix[np.ix_(small, other)] = (through / weight).T
            matrix[np.ix_(other, other)] -= through @ beside.T
            square = self.gram.square - float(weight * vector[small] @ along)
            vector[small], vector[other] = along / weight, vector[other] - beside @ along
            left = Gram(matrix, vector, square, self.gram.freedom)
            self._known[level] = left, -float(np.log(np.diag(lower)).sum())
        return self._known[level]


def most_probable(fits: Sequence[LevelFit]) -> LevelFit:
    """Return the fit at the level at which the recording is most probable; of several the lowest."""
    return max(fits, key=lambda fit: (fit.sizes.value, -fit.level))


def best_gains(fits: Sequence[LevelFit], blocks: Grouped) -> Gains:
    """Return what every block gains, each at the level that suits it best, against the most probable level, (h,) each.

    Sizes and what is left are those beside the noise of the most probable level.
    """
    known = most_probable(fits).sizes
    several = []
    for fit in fits:
        found = gains(fit.seen, blocks)
        louder = fit.sizes.variance / known.variance
        several.append((found.nats + (fit.sizes.value - known.value), found.size / louder**0.5, found.left * louder))
    nats, size, left = (np.stack(one)[:, :, 0] for one in zip(*several, strict=True))
    best = nats.argmax(axis=0)[None]
    return Gains(*(np.take_along_axis(one, best, axis=0)[0] for one in (nats, size, left)))


def visible(fits: Sequence[LevelFit], block: Int1D) -> tuple[float, float]:
    """Return the level that suits a block best, and its signal-to-noise ratio beside small effects of that level."""
    found = [gains(fit.seen, Grouped.of([block])) for fit in fits]
    best = int(np.argmax([fit.sizes.value + float(one.nats[0, 0]) for fit, one in zip(fits, found, strict=True)]))
    matrix, vector = _own(fits[best], block)
    size, left = float(found[best].size[0, 0]), float(found[best].left[0, 0])
    mean = np.linalg.solve(np.eye(len(block)) / size**2 + matrix, vector)
    return fits[best].level, float(np.sqrt(max(float(mean @ matrix @ mean), 0.0) / left))


def likelihood_at(fits: Sequence[LevelFit], block: Int1D, size: float) -> float:
    """Return the log likelihood of a block of some size, typical ones, at the level that suits it best, nats."""
    several = []
    for fit in fits:
        matrix, vector = _own(fit, block)
        inner = np.eye(len(block)) + size**2 * matrix
        taken = size**2 * float(vector @ np.linalg.solve(inner, vector))
        left = max(1.0 - taken / fit.seen.square, LEAST_LEFT)
        several.append(
            fit.sizes.value - 0.5 * fit.gram.freedom * np.log(left) - 0.5 * float(np.linalg.slogdet(inner)[1])
        )
    return float(max(several))


def _own(fit: LevelFit, block: Int1D) -> tuple[Float2D, Float1D]:
    """Return A' V^-1 A (k, k) and A' V^-1 y (k,) of a block beside what was accepted."""
    taken, vector = fit.seen.of(block)
    return (fit.gram.matrix[np.ix_(block, block)] - taken.T @ taken) / fit.sizes.variance, vector


def shared_power(power: Float1D, candidates: Sequence[Candidate], blocks: Sequence[slice]) -> Float1D:
    """Return the sizes at which every place moves the points by as much as the noise, its forms together, (p,).

    Args:
        power: (p,) squares of the columns, in units of the noise.
        candidates: The effects; readings that moved are none.
        blocks: Their columns.
    """
    places: dict[object, list[slice]] = {}
    for candidate, block in zip(candidates, blocks, strict=True):
        if candidate.family != FAMILY:
            places.setdefault(candidate.place, []).append(block)
    size = np.zeros(len(power))
    for forms in places.values():
        for block in forms:
            whole = float(power[block].sum()) * len(forms)
            size[block] = whole**-0.5 if whole > 0 else 0.0
    return size
