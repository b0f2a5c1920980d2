"""What one more block of columns gains beside what is accepted, at the size that suits it best.

With g = A_k' V^-1 A_k = U diag(l) U', w = A_k' V^-1 y and Q = y' V^-1 y a block of size t takes
q = sum((U'w)^2 t^2/(1 + t^2 l)) off Q.  V then shrinks by the same share, so that the gain is

    -n/2 log(1 - q/Q) - 1/2 sum(log(1 + t^2 l)),

maximised over t.  (At a fixed noise all large effects would look alike.)  Sizes beyond what the catalogue calls typical
pay for it.

A wide block, as all orders of all gears, keeps the eigenvectors of its own part of A'A (`restricted.Gram.basis`): what
is accepted changes g by as many ranks as it has columns, so that they serve beside everything (Woodbury).

Everything small is present a little: gains beside many small effects, as large as suits the recording best.

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
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.lapack import dpotri, dpstrf

from calibration_core.estimation.hypotheses import Offered
from calibration_core.estimation.likelihood.restricted import LEAST, MOST, Gram, Sizes, basis_serves, fit_sizes, price
from calibration_core.estimation.shifts import FAMILY
from calibration_core.model.effects.candidate import Candidate
from calibration_core.policy import FALSE_ALARM
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Int1D, Int2D

GRID = np.exp(np.linspace(np.log(LEAST), np.log(MOST), 36))
SHOWN = 1e-7  # of the largest eigenvalue: directions below it are rounding errors
BATCH = 100  # blocks at a time
SEED = 17384
TAIL = 0.25  # of the recordings drawn: those by which the threshold is extrapolated
LEAST_LEFT = 1e-9  # share of the squared residual that a block may leave, against rounding errors
DEPENDENT = 1e-8  # of the square of a column: one of which the others leave less depends on them
ROUNDING = 1e-12  # of one
SQUARED, PRICE = GRID**2, price(GRID)


@dataclasses.dataclass(frozen=True, eq=False)
class Seen:
    """Columns and the residual as seen through V^-1, V holding the noise and what is accepted.

    Attributes:
        gram: The rows.
        members: (a,) columns of what is accepted.
        size: (a,) their sizes.
        lower: (a, a) Cholesky factor of L, as in the module's first lines.
        right: (a,) L^(-1/2) of what the residual shows of them.
        variance: v.
    """

    gram: Gram
    members: Int1D
    size: Float1D
    lower: Float2D
    right: Float1D
    variance: float

    @property
    def square(self) -> float:
        """Y' V^-1 y."""
        return float(self.gram.square - self.right @ self.right) / self.variance

    def of(self, columns: Int1D) -> tuple[Float2D, Float1D]:
        """Return what is accepted takes of some columns, (a, c), and A' V^-1 y of them, (c,).

        A' V^-1 A is what they have in `gram` less the square of what is taken, over the variance.
        """
        if not len(self.members):
            return np.zeros((0, len(columns))), self.gram.vector[columns] / self.variance
        half = self.gram.matrix[np.ix_(self.members, columns)] * self.size[:, None]
        taken = solve_triangular(self.lower, half, lower=True, overwrite_b=True, check_finite=False)
        return taken, (self.gram.vector[columns] - self.right @ taken) / self.variance


def beside(gram: Gram, blocks: Sequence[Int1D], sizes: Sizes) -> Seen:
    """Return what is seen beside accepted blocks at their sizes."""
    members = np.concatenate([np.zeros(0, dtype=np.int64), *blocks])
    d = np.repeat(sizes.size, [len(block) for block in blocks])
    inner = sizes.variance * np.eye(len(d)) + d[:, None] * gram.matrix[np.ix_(members, members)] * d
    lower = cholesky(inner, lower=True) if len(d) else inner
    right = solve_triangular(lower, d * gram.vector[members], lower=True) if len(d) else np.zeros(0)
    return Seen(gram, members, d, lower, right, sizes.variance)


@dataclasses.dataclass(frozen=True, eq=False)
class Gains:
    """What every block does at its best size, (h, s) each.

    Attributes:
        nats: Gain.
        size: The size, typical ones.
        left: Share of the squared residual that is left.
    """

    nats: Float2D
    size: Float2D
    left: Float2D


@dataclasses.dataclass(frozen=True, eq=False)
class Alike:
    """Blocks of one width.

    Attributes:
        which: (c,) indices of the blocks.
        columns: (c, k) of each.
        place: (c, k) where these stand among all that are asked for.
    """

    which: Int1D
    columns: Int2D
    place: Int2D


@dataclasses.dataclass(frozen=True, eq=False)
class Grouped:
    """Blocks by their widths, for what is asked of them many times.

    Attributes:
        count: Number of blocks.
        asked: (a,) all their columns, each once.
        groups: Of blocks of one width each.
    """

    count: int
    asked: Int1D
    groups: tuple[Alike, ...]

    @staticmethod
    def of(blocks: Sequence[Int1D]) -> Grouped:
        """Group blocks, given as columns (k,) each."""
        asked = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *blocks]))
        count = np.array([len(block) for block in blocks], dtype=np.int64)
        groups = []
        for width in np.unique(count):
            which = np.flatnonzero(count == width)
            columns = np.stack([blocks[int(h)] for h in which])
            groups.append(Alike(which, columns, np.searchsorted(asked, columns)))
        return Grouped(len(blocks), asked, tuple(groups))

    def without(self, some: Int1D) -> Grouped:
        """Return the same blocks, some of which, given as indices, are not asked for."""
        kept = [(one, ~np.isin(one.which, some)) for one in self.groups]
        groups = (Alike(one.which[rows], one.columns[rows], one.place[rows]) for one, rows in kept)
        return dataclasses.replace(self, groups=tuple(groups))


def gains(seen: Seen, blocks: Grouped) -> Gains:
    """Return what every block gains at its best size."""
    taken, vector = seen.of(blocks.asked)
    nats, best, left = np.zeros((blocks.count, 1)), np.zeros((blocks.count, 1)), np.ones((blocks.count, 1))
    for chosen, worth, paid in _worth(seen, blocks, taken, vector[:, None], seen.square):
        top = worth.argmin(axis=1)[:, None]
        least = np.take_along_axis(worth, top, axis=1)[:, 0]
        nats[chosen] = -0.5 * seen.gram.freedom * np.log(least)
        left[chosen] = least / np.take_along_axis(paid[:, :, None], top, axis=1)[:, 0]
        best[chosen] = GRID[top[:, 0]]
    return Gains(nats, best, left)


def _worth(
    seen: Seen, blocks: Grouped, taken: Float2D, vectors: Float2D, square: float | Float1D
) -> Iterator[tuple[Int1D, Float3D, Float2D]]:
    """Yield, for one batch of blocks after the other, the numbers whose logarithm times -n/2 is the gain at every size.

    Args:
        seen: The columns beside what is accepted.
        blocks: The h blocks.
        taken: (a, c) what is accepted takes of their columns.
        vectors: (c, s) A' V^-1 y of several data.
        square: (s,) y' V^-1 y of these.

    Yields:
        chosen: (b,) which blocks; (b, g, s) the share of the squares that is left, times what the size costs; (b, g)
        the latter alone.
    """
    freedom = seen.gram.freedom
    for group in blocks.groups:
        wide = basis_serves(group.columns.shape[1], len(seen.members))
        together = 1 if wide else BATCH
        for part in range(0, len(group.which), together):
            some = slice(part, part + together)
            columns, place = group.columns[some], group.place[some]
            seen_by, shown = taken[:, place], vectors[place]
            if wide:
                worth, lost = _of_wide(seen, columns[0], seen_by[:, 0], shown[0])
            else:
                worth, lost = _of_narrow(seen, columns, seen_by, shown)
            worth /= -square
            worth += 1.0
            np.maximum(worth, LEAST_LEFT, out=worth)
            paid = np.exp(2 / freedom * lost)
            worth *= paid[:, :, None]
            yield group.which[some], worth, paid


def _of_narrow(seen: Seen, columns: Int2D, taken: Float3D, vectors: Float3D) -> tuple[Float3D, Float2D]:
    """Return what c blocks take off y' V^-1 y at every size, (c, g, s), and what they cost, (c, g) nats.

    Args:
        seen: The columns beside what is accepted.
        columns: (c, k) of the blocks.
        taken: (a, c, k) what is accepted takes of them.
        vectors: (c, k, s) A' V^-1 y.
    """
    seen_by = taken.transpose(1, 0, 2)  # (c, a, k)
    among = seen.gram.matrix[columns[:, :, None], columns[:, None]]
    own, turn = np.linalg.eigh((among - seen_by.transpose(0, 2, 1) @ seen_by) / seen.variance)
    shown = own > SHOWN * own[:, -1:]
    along = (turn.transpose(0, 2, 1) @ vectors) ** 2 * shown[:, :, None]
    wide = 1.0 + SQUARED[:, None] * np.where(shown, own, 0.0)[:, None]  # (c, g, k)
    return (SQUARED[:, None] / wide) @ along, 0.5 * np.log(wide).sum(axis=2) + PRICE


def _of_wide(seen: Seen, block: Int1D, taken: Float2D, vectors: Float2D) -> tuple[Float3D, Float2D]:
    """Return the same of a wide block, (1, g, s) and (1, g).

    Args:
        seen: The columns beside what is accepted.
        block: (k,) columns.
        taken: (a, k) what is accepted takes of them.
        vectors: (k, s) A' V^-1 y.
    """
    own, turn = seen.gram.basis(block)
    shown = own > SHOWN * own[-1]
    own, along = np.where(shown, own, 0.0) / seen.variance, (turn.T @ vectors) * shown[:, None]
    by = (taken @ turn) * shown / np.sqrt(seen.variance)  # (a, k)
    wide = 1.0 + SQUARED[:, None] * own  # (g, k)
    off = (SQUARED[:, None] / wide) @ along**2
    lost = 0.5 * np.log(wide).sum(axis=1) + PRICE
    if len(by):
        weighted = by / wide[:, None]  # (g, a, k)
        inner = (1.0 + ROUNDING) * np.eye(len(by)) - SQUARED[:, None, None] * (weighted @ by.T)
        rest = weighted @ along
        off += SQUARED[:, None] ** 2 * (rest * np.linalg.solve(inner, rest)).sum(axis=1)
        lost += 0.5 * np.linalg.slogdet(inner)[1]
    return off[None], lost[None]


def chance_gain(gram: Gram, clear: Bool1D, blocks: Grouped, draws: int) -> float:
    """Return what the best block gains in one per cent of recordings with the null model alone, nats.

    A parametric bootstrap; beyond its upper quartile the largest gain of a recording falls off exponentially, as twice
    the gain of a few columns does by chi-square's law (peaks over a threshold, Pickands 1975).

    Args:
        gram: The rows.
        clear: (p,) columns of which the null model leaves enough.
        blocks: The blocks.
        draws: Number of recordings that are drawn; of 60 the answer scatters by 0.7 nats, of 240 by half of that.
    """
    if not blocks.count:
        return 0.0
    kept = np.flatnonzero(clear)
    scale = np.sqrt(np.where(clear, np.diag(gram.matrix), 1.0))
    part = gram.matrix[np.ix_(kept, kept)]
    part /= scale[kept]
    part /= scale[kept, None]
    lower, order, rank, _ = dpstrf(part.T, lower=1, tol=DEPENDENT, overwrite_a=1)  # in place: tens of megabytes
    rng, order = np.random.default_rng(SEED), kept[order - 1]
    seen = rng.standard_normal((rank, draws))  # y along the columns; what is left of y stands at right angles to them
    square = (seen**2).sum(axis=0) + 2.0 * rng.standard_gamma(0.5 * max(gram.freedom - rank, 0), draws)
    drawn = np.zeros((len(scale), draws))
    drawn[order] = scale[order, None] * (np.tril(lower)[:, :rank] @ seen)
    null = Seen(gram, np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 0)), np.zeros(0), 1.0)
    vectors, least = drawn[blocks.asked], np.full(draws, np.inf)
    taken = np.zeros((0, len(blocks.asked)))
    for _, worth, _ in _worth(null, blocks, taken, vectors, square):
        np.minimum(least, worth.min(axis=(0, 1)), out=least)
    largest = -0.5 * gram.freedom * np.log(least)
    threshold = float(np.quantile(largest, 1 - TAIL))
    return threshold + float(np.mean(largest[largest > threshold] - threshold)) * float(np.log(TAIL / FALSE_ALARM))


# --- everything small is present a little -----------------------------------------------------------------------------


NONE = (0.0,)
LEVELS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.5, 6.5)  # signal-to-noise ratios of every place
MOST_TYPICAL = 1.0  # in typical sizes: how large the small effects may make any


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
            size = np.minimum(level * self._unit, MOST_TYPICAL)
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
