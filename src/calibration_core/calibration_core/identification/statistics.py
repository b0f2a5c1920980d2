"""From normal equations to compliances that are not negative, with their covariance.

Generalised least squares with one free offset per configuration and measurement point.

Absolute readings of one configuration share their unknown unloaded position.  Subtracting one unloaded reading and
treating the differences as independent would correlate them all with its error; a free offset is the exact answer
(equal to generalised least squares on the differences).  Readings of one step that share one wrench reading
share its error too.  Both are handled per configuration; configurations are independent.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator

import numpy as np
from scipy.special import betaincinv, chdtrc, chdtri, fdtrc, ndtri, stdtrit

from calibration_core.policy import FALSE_EXCLUSION
from calibration_core.timeseries import Bool1D, Bool2D, Float1D, Float2D, Float3D, Float4D, FloatND, Int1D, Int2D


def column_scale(matrix: Float2D) -> Float1D:
    """Return 1 over the length of every column, (p,), given J^T J; 1 for a column of zeros."""
    diagonal = np.diag(matrix)
    return 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))


def scaled_inverse(matrix: Float2D) -> Float2D:
    """Return the inverse of J^T J, (p, p).

    Raises:
        numpy.linalg.LinAlgError: It has none.
    """
    scale = column_scale(matrix)
    return np.asarray(np.linalg.inv(matrix * np.outer(scale, scale)) * np.outer(scale, scale), dtype=np.float64)


SINGULAR = 1e-12  # eigenvalue of the column-scaled normal matrix, relative: condition number 1e6 of the columns


@dataclasses.dataclass(frozen=True, eq=False)
class Solution:
    """Compliances and how well the data determine them.

    Attributes:
        value: (n,) solution under x >= 0.
        unbounded: (n,) solution without the bound.
        covariance: (n, n) for unit weight, without the bound; infinite variance where undetermined.
        at_bound: (n,) whether the bound holds a parameter at zero.
        determined: (n,) whether the data say anything about a parameter.
        condition_number: Of the column-scaled observation matrix.
        eigenvalues: (n,) of the column-scaled normal matrix, ascending.
        eigenvectors: (n, n) their directions as columns, scaled parameters.
    """

    value: Float1D
    unbounded: Float1D
    covariance: Float2D
    at_bound: Bool1D
    determined: Bool1D
    condition_number: float
    eigenvalues: Float1D
    eigenvectors: Float2D


def solve_non_negative(matrix: Float2D, vector: Float1D, fallback: Float1D) -> Solution:
    """Solve min |A x - b| under x >= 0, given A^T A and A^T b.

    Columns are scaled to length one first, so that the outcome does not depend on units.  Directions in which the
    scaled matrix is singular keep the value of `fallback`.

    Args:
        matrix: (n, n) A^T A.
        vector: (n,) A^T b.
        fallback: (n,) values for what the data do not determine.
    """
    n = len(vector)
    norms = np.sqrt(np.clip(np.diag(matrix), 0.0, None))
    loaded = norms > 1e-12 * norms.max(initial=0.0)
    scale = np.where(loaded, norms, 1.0)
    scaled = matrix / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    kept = values > SINGULAR * max(float(values[-1]), 0.0)
    right = vector / scale - scaled @ (fallback * scale)
    weights = np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)
    free = vectors @ (weights * (vectors.T @ right)) / scale + fallback
    lost = (vectors[:, ~kept] ** 2).sum(axis=1) > 1e-6
    bounded = _bounded(scaled, vector / scale, scale, np.where(loaded & ~lost, np.nan, fallback))
    inverse = (vectors * weights) @ vectors.T / np.outer(scale, scale)
    inverse[np.diag_indices(n)] = np.where(loaded & ~lost, np.diag(inverse), np.inf)
    smallest = float(values[0])
    condition = float(np.sqrt(values[-1] / smallest)) if smallest > 0 else float("inf")
    return Solution(
        bounded, free, inverse, loaded & ~lost & (bounded <= 0.0), loaded & ~lost, condition, values, vectors
    )


def _bounded(scaled: Float2D, vector: Float1D, scale: Float1D, fixed: Float1D) -> Float1D:
    """Solve the scaled problem for the entries of `fixed` that are NaN, the others held."""
    result = np.clip(fixed, 0.0, None)
    free = np.isnan(fixed)
    if not free.any():
        return result
    right = vector[free] - scaled[np.ix_(free, ~free)] @ (result[~free] * scale[~free])
    values, vectors = np.linalg.eigh(scaled[np.ix_(free, free)])
    root = np.sqrt(np.clip(values, 1e-300, None))
    solution = vectors @ ((vectors.T @ right) / root**2)
    if values[0] <= SINGULAR * values[-1] or (solution < 0).any():
        from scipy.optimize import nnls  # slow to load, and few recordings meet the bound

        solution, _ = nnls(root[:, None] * vectors.T, (vectors.T @ right) / root)
    result[free] = solution / scale[free]
    return result


# --- tails and quantiles of the distributions that the tests need, on `scipy.special` alone (quick to -----------------


LEVEL = 0.01  # a claim, or agreement, is rejected at this level


def normal_quantile(probability: float) -> float:
    """Return the value that a standard normal variable stays below with this probability."""
    return float(ndtri(probability))


def student_quantile(probability: float, freedom: float) -> float:
    """Return the value that Student's t stays below with this probability."""
    return float(stdtrit(freedom, probability))


def chi2_tail(value: float, freedom: float) -> float:
    """Return the probability that chi-square exceeds a value."""
    return float(chdtrc(freedom, value))


def chi2_limit(probability: float, freedom: float) -> float:
    """Return the value that chi-square exceeds with this probability."""
    return float(chdtri(freedom, probability))


def f_tail(value: float, upper: float, lower: float) -> float:
    """Return the probability that F, with these degrees of freedom above and below the line, exceeds a value."""
    return 1.0 if value <= 0 else float(fdtrc(upper, lower, value))


def f_limit(probability: float, upper: float, lower: float) -> float:
    """Return the value that F exceeds with this probability.

    By way of the beta distribution, whose lower tail keeps its digits where the probability is tiny.
    """
    share = float(betaincinv(lower / 2, upper / 2, probability))
    return lower * (1 - share) / (upper * share)


SIGNIFICANT = 0.001  # chance of calling noise a residual
FINEST = 1e-3  # of the claimed noise: what is smaller is rounding, as of a simulation without noise
SMALLEST_EXCESS = 1.05  # of the noise: a smaller residual does not matter, however certain


def beyond_noise(seen: float, freedom: float, noise: float, noise_freedom: float = math.inf) -> tuple[float, bool]:
    """Return by how much a residual exceeds the noise, m rms, and whether that is beyond chance and of any importance.

    F test against noise that was seen; chi-square test against noise that is stated.

    Args:
        seen: Standard deviation of one coordinate of the residual, m.
        freedom: Its degrees of freedom.
        noise: Standard deviation of one coordinate of the noise, m, known without the model.
        noise_freedom: Degrees of freedom from which it is known; infinity: it is stated.
    """
    excess = math.sqrt(max(seen**2 - noise**2, 0.0))
    if not seen > SMALLEST_EXCESS * noise:
        return excess, False
    if noise <= 0:
        return excess, True
    ratio = (seen / noise) ** 2
    stated = math.isinf(noise_freedom)
    tail = chi2_tail(ratio * freedom, freedom) if stated else f_tail(ratio, freedom, max(noise_freedom, 1.0))
    return excess, tail < SIGNIFICANT


# --- root mean squares ------------------------------------------------------------------------------------------------


def rms(values: Float1D | Float2D | Float3D) -> float:
    """Return the root mean square over all values, for example per coordinate."""
    return float(np.sqrt(np.mean(values**2)))


def rms_length(vectors: Float2D) -> float:
    """Return the root mean square of the lengths of (m, 3) vectors."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


# --- generalised least squares with one free offset per configuration and measurement point ---------------------------


SET_ASIDE = 1e12  # factor on the variance of a row that does not count


@dataclasses.dataclass(frozen=True, eq=False)
class Rows:
    """Which rows belong together, and how noisy they are.

    Attributes:
        configuration: (m,) int64, 0 ... k-1, the index (not the number) of the configuration.
        offset: (m,) int64, which free offset of its configuration a row has: its measurement point.
        load: (m,) int64; rows of one configuration with the same value share one wrench reading.
        noise: (m, d, d) covariance of the row's own reading (d = 3 for points, 6 for poses).
        shared: (m, d, w) square root of the covariance that comes from the shared wrench reading.
    """

    configuration: Int1D
    offset: Int1D
    load: Int1D
    noise: Float3D
    shared: Float3D

    def select(self, rows: Int1D) -> Rows:
        """Return some of the rows; the same ones as before are the same value, with what is known of it."""
        if np.array_equal(rows, np.arange(len(self.configuration))):
            return self
        key = ("select", rows.tobytes())
        if key not in self._derived:
            self._derived[key] = self._some(rows)
        return self._derived[key]

    def without(self, aside: Int1D) -> Rows:
        """Return the other rows; what is known of configurations of which all rows stay is not found again.

        Args:
            aside: (a,) indices of the rows to leave out.
        """
        stays = np.ones(len(self.configuration), dtype=bool)
        stays[aside] = False
        left = self._some(np.flatnonzero(stays))
        place = np.cumsum(stays) - 1
        changed = np.unique(self.configuration[aside])
        again = np.flatnonzero(np.isin(left.configuration, changed))
        new = left._some(again)
        whole = [~np.isin(group, changed) for group, *_ in self.groups]
        cuts = [slice(None) if same.all() else same for same in whole]  # a slice copies nothing
        known = zip(self.groups, self.predictors, whole, cuts, strict=True)
        kept = [
            ((group[cut], place[index[cut]], white[cut], basis[cut]), tuple(one[cut] for one in predictor))
            for (group, index, white, basis), predictor, same, cut in known
            if same.any()
        ]
        found = [(group, again[index], white, basis) for group, index, white, basis in new.groups]
        left.__dict__["groups"] = (*(one for one, _ in kept), *found)
        left.__dict__["predictors"] = (*(one for _, one in kept), *new.predictors)
        return left

    def _some(self, rows: Int1D) -> Rows:
        return Rows(*(getattr(self, field.name)[rows] for field in dataclasses.fields(self)))

    def counting(self, used: Int1D | Bool1D) -> Rows:
        """Return the same rows, of which those not used (mask or indices) do not count for the offsets."""
        aside = np.ones(len(self.noise), dtype=bool)
        aside[used] = False
        if not aside.any():
            return self
        key = ("counting", aside.tobytes())
        if key not in self._derived:
            noise = self.noise * np.where(aside, SET_ASIDE, 1.0)[:, None, None]
            self._derived[key] = dataclasses.replace(self, noise=noise)
        return self._derived[key]

    @functools.cached_property
    def _derived(self) -> dict[tuple[str, bytes], Rows]:
        """What `select` and `counting` returned."""
        return {}

    @functools.cached_property
    def groups(self) -> tuple[tuple[Int1D, Int1D, Float3D, Float3D], ...]:
        """Configurations of equal size: their indices (b,), their rows (b, m), and as `_whiten` of these."""
        return tuple((group, index, *_whiten(self, index)) for group, index in _groups(self))

    @functools.cached_property
    def predictors(self) -> tuple[tuple[Float3D, Float4D, Bool2D], ...]:
        """Configurations of equal size: what whitens their rows and removes their offsets, (b, md, md); the covariance
        of every row about what the others of its configuration say of it, (b, m, d, d); whether they say it, (b, m).
        """
        return tuple(_predictor(self.noise[index], white, basis) for _, index, white, basis in self.groups)

    @functools.cached_property
    def contrasts(self) -> tuple[tuple[Int1D, Int1D, Float3D], ...]:
        """Configurations of equal size: their indices (b,), their rows (b, m), and what whitens these, (b, r, m d).

        The designs of one search share their rows, so that this is found once.
        """
        return tuple((group, index, _contrast(white, basis)) for group, index, white, basis in self.groups)


@dataclasses.dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations per configuration, offsets eliminated.

    Attributes:
        matrix: (k, p, p) per configuration.
        vector: (k, p).
        chi2: (k,) weighted sum of squares of what the offsets alone leave.
        freedom: (k,) rows times d minus offsets.
    """

    matrix: Float3D
    vector: Float2D
    chi2: Float1D
    freedom: Int1D


def normal_equations(rows: Rows, residual: Float2D, columns: Float3D) -> Normal:
    """Return the normal equations of `residual` ~ `columns` x + offsets.

    Args:
        rows: Grouping and noise of the m rows.
        residual: (m, d).
        columns: (m, d, p).
    """
    k = int(rows.configuration.max()) + 1
    p = columns.shape[2]
    matrix, vector = np.zeros((k, p, p)), np.zeros((k, p))
    chi2, freedom = np.zeros(k), np.zeros(k, dtype=np.int64)
    for group, index, white, basis in rows.groups:
        data = np.concatenate([columns[index], residual[index][..., None]], axis=-1)
        b, m, d, _ = data.shape
        projected = white @ data.reshape(b, m * d, p + 1)
        projected = projected - basis @ (basis.transpose(0, 2, 1) @ projected)
        gram = projected.transpose(0, 2, 1) @ projected
        matrix[group], vector[group] = gram[:, :p, :p], gram[:, :p, p]
        chi2[group], freedom[group] = gram[:, p, p], m * d - basis.shape[2]
    return Normal(matrix, vector, chi2, freedom)


def whitened(rows: Rows, data: Float3D, places: Int1D | None = None) -> tuple[Float2D, Int1D]:
    """Return data without offsets in units of its noise: independent rows of unit variance.

    Args:
        rows: Grouping and noise of the m rows.
        data: (m, d, p) p columns, all treated alike.
        places: (m,) where in the data each of the rows is; None: in their order.

    Returns:
        white: (r, p) rows of unit variance; configurations follow each other.
        configuration: (r,) index of the configuration of every row.
    """
    several = rows.contrasts
    configuration = np.sort(np.concatenate([np.repeat(group, one.shape[1]) for group, _, one in several]))
    white = np.empty((len(configuration), data.shape[2]))
    for group, index, contrast in several:
        flat = data[index if places is None else places[index]].reshape(*contrast.shape[::2], data.shape[2])
        first = np.searchsorted(configuration, group)
        for one, own, start in zip(contrast, flat, first, strict=True):
            np.matmul(one, own, out=white[start : start + len(one)])
    return white, configuration


def without_offsets(rows: Rows, residual: Float2D) -> Float2D:
    """Return the (m, d) residuals after the best offsets of every configuration."""
    left = np.empty_like(residual)
    for _, index, white, basis in rows.groups:
        flat, incidence = residual[index].reshape(len(index), -1, 1), _incidence(rows, index)
        seen = basis.transpose(0, 2, 1) @ white
        offsets = np.linalg.solve(seen @ incidence, seen @ flat)
        left[index] = (flat - incidence @ offsets).reshape(*index.shape, -1)
    return left


def deleted(rows: Rows, residual: Float2D) -> tuple[Float1D, Float2D, Float3D]:
    """Predict every row from the other rows of its configuration.

    Returns:
        squared: (m,) squared prediction error in units of its covariance, chi-squared with d degrees of freedom.
        error: (m, d) prediction error.
        covariance: (m, d, d) its covariance; infinite where no other row could predict it.

    Source: deletion residuals (Q_ii)^-1 (Q r)_i with Q the precision after elimination of the offsets.
    """
    m_all, d = residual.shape
    squared, error = np.zeros(m_all), np.zeros((m_all, d))
    covariance = np.full((m_all, d, d), np.inf)
    for (_, index, *_), (projected, inverse, known) in zip(rows.groups, rows.predictors, strict=True):
        b, m = index.shape
        flat = residual[index].reshape(b, m * d, 1)
        score = (projected.transpose(0, 2, 1) @ (projected @ flat)).reshape(b, m, d)
        predicted = np.einsum("bmij,bmj->bmi", inverse, score)
        squared[index] = np.where(known, np.einsum("bmi,bmi->bm", score, predicted), 0.0)
        error[index] = np.where(known[..., None], predicted, 0.0)
        covariance[index] = np.where(known[..., None, None], inverse, np.inf)
    return squared, error, covariance


def _predictor(noise: Float4D, white: Float3D, basis: Float3D) -> tuple[Float3D, Float4D, Bool2D]:
    """Return what `Rows.predictors` holds of some configurations, from their rows' noise, (b, m, d, d)."""
    b, m, d, _ = noise.shape
    projected = white - basis @ (basis.transpose(0, 2, 1) @ white)
    per_row = np.ascontiguousarray(projected.reshape(b, m * d, m, d).transpose(0, 2, 3, 1))
    own = per_row @ per_row.transpose(0, 1, 3, 2)
    scale = np.einsum("bmdd->bm", noise) / d**2
    known = np.linalg.eigvalsh(own).min(-1) * scale > 1e-9
    return projected, np.linalg.inv(np.where(known[..., None, None], own, np.eye(d))), known


def deletion_limit(squared: Float1D, readings: int) -> float:
    """Return the limit on squared deletion residuals that a clean recording exceeds anywhere with 1 % probability.

    The scale is the recording's own (median), never below the claimed noise, so that missing physics or understated
    noise does not turn readings into outliers.

    Args:
        squared: As `deleted` returns them; zero where no other row could predict one.
        readings: Number of readings of the recording.
    """
    testable = squared[squared > 0]
    scale = float(np.median(testable) / chi2_limit(0.5, 3)) if len(testable) else 1.0
    return chi2_limit(FALSE_EXCLUSION / readings, 3) * max(1.0, scale)


def _groups(rows: Rows) -> Iterator[tuple[Int1D, Int1D]]:
    """Yield configurations with equally many rows and offsets together: their indices (b,) and their rows (b, m)."""
    order = np.argsort(rows.configuration, kind="stable")
    present, starts, counts = np.unique(rows.configuration[order], return_index=True, return_counts=True)
    sizes: dict[tuple[int, int], list[int]] = {}
    for i, (start, count) in enumerate(zip(starts, counts, strict=True)):
        offsets = set(rows.offset[order[start : start + count]].tolist())
        sizes.setdefault((int(count), len(offsets)), []).append(i)
    for (count, _), members in sizes.items():
        index = order[starts[members][:, None] + np.arange(count)[None, :]]
        yield present[members], index


def _contrast(white: Float3D, basis: Float3D) -> Float3D:
    """Return (b, r, md): products with it are free of offsets, independent and of unit variance.

    Both arguments are as `_whiten` returns them.
    """
    rest = np.linalg.qr(basis, mode="complete")[0][:, :, basis.shape[2] :]
    return np.asarray(rest.transpose(0, 2, 1) @ white)


def _whiten(rows: Rows, index: Int1D) -> tuple[Float3D, Float3D]:
    """Return the inverse Cholesky factor (b, md, md) and an orthonormal basis of the whitened offsets (b, md, o).

    Only rows that share a wrench reading are correlated: the factor is found block by block.
    """
    b, m = index.shape
    d = rows.noise.shape[1]
    factor = np.zeros((b, m, d, m, d))
    for group, place in _sharing(rows.load[index]):
        factor[group[:, None, None], place[:, :, None], :, place[:, None, :]] = _inverse_root(
            rows.noise[index[group[:, None], place]], rows.shared[index[group[:, None], place]]
        )
    white = factor.reshape(b, m * d, m * d)
    basis, _ = np.linalg.qr(white @ _incidence(rows, index))
    return white, basis


def _incidence(rows: Rows, index: Int2D) -> Float3D:
    """Return which free offset, (b, md, o), every row of some configurations, (b, m), has."""
    b, m = index.shape
    d = rows.noise.shape[1]
    place = _ranks(rows.offset[index])
    incidence = np.zeros((b, m, d, int(place.max()) + 1, d))
    incidence[np.arange(b)[:, None], np.arange(m), :, place, :] = np.eye(d)
    return incidence.reshape(b, m * d, -1)


def _ranks(values: Int2D) -> Int2D:
    """Return for (b, m) values which of the different ones in its line each is, counted from 0 in rising order."""
    order = np.argsort(values, axis=1, kind="stable")
    ordered = np.take_along_axis(values, order, axis=1)
    ranks = np.zeros_like(values)
    rising = np.cumsum(ordered[:, 1:] != ordered[:, :-1], axis=1)
    np.put_along_axis(ranks, order[:, 1:], rising, axis=1)
    return ranks


def _sharing(load: Int2D) -> Iterator[tuple[Int1D, Int2D]]:
    """Yield the blocks of rows that share a wrench reading, those of equal size together.

    Args:
        load: (b, m).

    Yields:
        group: (n,) first index of each block; place: (n, c) second indices of its rows.
    """
    b, m = load.shape
    order = np.argsort(load, axis=1, kind="stable")
    ordered = np.take_along_axis(load, order, axis=1)
    first = np.ones((b, m), dtype=bool)
    first[:, 1:] = ordered[:, 1:] != ordered[:, :-1]
    starts = np.flatnonzero(first)
    counts = np.diff(np.append(starts, b * m))
    for count in np.unique(counts):
        begin = starts[counts == count]
        yield begin // m, order.reshape(-1)[begin[:, None] + np.arange(count)]


def _inverse_root(noise: Float4D, shared: Float4D) -> FloatND:
    """Return the inverse Cholesky factors of blocks of rows, (n, c, c, d, d).

    Args:
        noise: (n, c, d, d).
        shared: (n, c, d, w).
    """
    n, c, d, w = shared.shape
    flat = shared.reshape(n, c * d, w)
    full = (flat @ flat.transpose(0, 2, 1)).reshape(n, c, d, c, d)
    diagonal = np.arange(c)
    full[:, diagonal, :, diagonal, :] += noise.transpose(1, 0, 2, 3)
    lower = np.asarray(np.linalg.cholesky(full.reshape(n, c * d, c * d)), dtype=np.float64)
    inverse = _lower_inverse(lower)
    return inverse.reshape(n, c, d, c, d).transpose(0, 1, 3, 2, 4)


def _lower_inverse(lower: Float3D) -> Float3D:
    """Return the inverses of lower triangular matrices, (n, k, k), line by line for all of them at once."""
    inverse = np.zeros_like(lower)
    scale = 1 / np.einsum("nii->ni", lower)
    inverse[:, 0, 0] = scale[:, 0]
    for i in range(1, lower.shape[1]):
        inverse[:, i, :i] = -scale[:, i, None] * (lower[:, i : i + 1, :i] @ inverse[:, :i, :i])[:, 0]
        inverse[:, i, i] = scale[:, i]
    return inverse
