"""Mean of a plateau and the covariance of that mean, with autocorrelation taken into account.

Samples of one sensor at hundreds of hertz are not independent: vibration, turbulence and filters tie neighbours
together.  The variance of the mean of n samples is tau / n times their variance, with the integrated autocorrelation
time tau = 1 + 2 (rho_1 + rho_2 + ...).  The sum is cut off after Geyer (1992, "Practical Markov chain Monte Carlo",
initial monotone sequence): sums of neighbouring pairs are taken while they are positive, and made to decrease.

Covariances of the readings: what the instruments claim, and what the plateaus themselves show.

The cell file states the standard deviation of one averaged reading.  That claim contains what does not average out
within a window (refraction, bearing errors, sensor drift), so it is a floor: a quiet window does not make a reading
better than its instrument.  Where a window scatters more than the claim allows - vibration, a bad line of sight - the
reading is worse, and its covariance is inflated to what was seen, in the directions in which it was seen.  The scatter
of few samples is uncertain itself: windows that scatter as much as the others, within chance, are pooled before they
are compared with the claim.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell, Tracker
from calibration_core.errors import CellError
from calibration_core.policy import MAD
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Int1D, Readings

OUTLIER = 8.0  # robust standard deviations; beam breaks and glitches lie far beyond, noise never
SMALL_SAMPLE = 8.0  # the limit is wider by the factor 1 + this / n, as the scale of few samples is uncertain itself
MIN_FOR_OUTLIERS = 12


@dataclasses.dataclass(frozen=True, eq=False)
class Average:
    """Mean of samples.

    Attributes:
        mean: (k,).
        covariance: (k, k), of the mean; zero for a single sample, of which the scatter is unknown.
        samples: Number of samples averaged.
        effective: Number of independent samples that would give the same variance (worst component).
        outliers: Samples left out.
    """

    mean: Float1D
    covariance: Float2D
    samples: int
    effective: float
    outliers: int


def mean_of(values: Float2D) -> Float1D:
    """Return the mean (k,) of samples (n, k), n >= 1, wild ones left out; the same as that of `average`."""
    return np.asarray(values[inliers(values)].mean(axis=0))


def average(values: Float2D) -> Average:
    """Average samples (n, k), n >= 1, evenly spaced in time."""
    keep = inliers(values)
    used = values[keep]
    n, k = used.shape
    mean = np.asarray(used.mean(axis=0))
    dropped = len(values) - n
    if n < 2:
        return Average(mean, np.zeros((k, k)), n, float(n), dropped)
    deviations = used - mean
    tau = autocorrelation_times(deviations)
    scale = np.sqrt(tau / n)
    covariance = (deviations.T @ deviations / (n - 1)) * np.outer(scale, scale)
    return Average(mean, covariance, n, float(n / tau.max()), dropped)


def inliers(values: Float2D) -> Bool1D:
    """(n,) False for samples more than eight robust standard deviations off the median in any component.

    The scale is the median absolute deviation; a component in which it is zero (resolution coarser than the noise)
    is not judged.
    """
    keep = np.ones(len(values), np.bool_)
    if len(values) < MIN_FOR_OUTLIERS:
        return keep
    distance = np.abs(values - _median(values))
    scale = MAD * _median(distance)
    judged = scale > 0
    limit = OUTLIER * (1.0 + SMALL_SAMPLE / len(values)) * scale
    keep &= (distance[:, judged] <= limit[judged]).all(axis=1)
    return keep


def _median(values: Float2D) -> Float1D:
    """Return the median (k,) of samples (n, k), as `np.median`, which spends most of its time on other cases."""
    if np.isnan(values).any():
        return np.asarray(np.median(values, axis=0))
    half = len(values) // 2
    if len(values) % 2:
        return np.asarray(np.partition(values, half, axis=0)[half])
    low, high = np.partition(values, [half - 1, half], axis=0)[half - 1 : half + 1]
    return np.asarray((low + high) / 2.0)


def autocorrelation_times(deviations: Float2D) -> Float1D:
    """Return the integrated autocorrelation time of every column of samples (n, k) without mean, (k,) in samples.

    At least 1, at most n / 2.  Negative correlation (an oscillation) is not credited: a mean is never held better than
    independent samples give.
    """
    n, k = deviations.shape
    times = np.ones(k)
    columns = np.ascontiguousarray(deviations.T)
    power = np.einsum("kn,kn->k", columns, columns)
    moving = np.flatnonzero(power > 0.0)
    if n < 4 or not len(moving):
        return times
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(columns[moving], size)
    rho = np.fft.irfft(spectrum * spectrum.conj(), size)[:, :n] / power[moving, None]
    for index, pairs in zip(moving, rho[:, : n // 2 * 2].reshape(len(moving), -1, 2).sum(axis=2), strict=True):
        negative = np.flatnonzero(pairs <= 0.0)
        falling = np.minimum.accumulate(pairs[: negative[0]] if len(negative) else pairs)
        times[index] = min(max(2.0 * float(falling.sum()) - 1.0, 1.0), n / 2)
    return times


# --- covariances of the readings --------------------------------------------------------------------------------------


STEEPEST = 0.1  # cosine of elevation; closer to the vertical the azimuth is not trusted to be better


def position_covariance(readings: Readings, cell: Cell) -> Float3D:
    """Covariance of each position, (m, 3, 3) m², tracker frame.

    A Cartesian claim is the same for every coordinate.  A spherical claim is about the tracker's origin and its z axis:
    range (`sigma_range` + `sigma_range_per_m` times the range), azimuth and elevation (`sigma_angle` each).  The
    plateau's own covariance inflates it where it is larger (see the module).  Of several recordings, a reading
    brings the claim of its own instrument.

    Raises:
        CellError: Positions are displacements, but the claim is spherical (the range is not known).
    """
    tracker = cell.instruments.tracker
    if readings.position_claim is not None:
        claim = readings.position_claim
    elif tracker.sigma is not None:
        claim = np.broadcast_to(tracker.sigma**2 * np.eye(3), (len(readings), 3, 3))
    elif cell.measurements.points == "displacement":
        expected = "sigma: recorded displacements have no range from the tracker"
        raise CellError(cell.path, "instruments.tracker", "sigma_range and sigma_angle", expected)
    else:
        claim = spherical_covariance(readings.position, tracker)
    return _larger(claim, readings.position_covariance, readings.samples)


def coordinate_std(covariance: Float3D) -> float:
    """Return the standard deviation of one coordinate, m, root mean square over covariances (m, 3, 3) m²."""
    return float(np.sqrt(np.einsum("mii->m", covariance).mean() / 3))


def spherical_covariance(position: Float2D, tracker: Tracker) -> Float3D:
    """Covariance (m, 3, 3) m² of positions (m, 3) in the tracker frame under a claim in range, azimuth, elevation.

    dp = e_r dr + e_az r cos(el) d_az + e_el r d_el.
    """
    axes = sight_axes(position)
    reach = np.maximum(np.linalg.norm(position, axis=1), 1e-9)
    level = np.hypot(axes[:, 0, 0], axes[:, 0, 1])
    radial = float(tracker.sigma_range or 0.0) + tracker.sigma_range_per_m * reach
    angle = float(tracker.sigma_angle or 0.0)
    sigma = np.column_stack([radial, angle * reach * np.maximum(level, STEEPEST), angle * reach])
    return np.asarray(np.einsum("mki,mk,mkj->mij", axes, sigma**2, axes))


def sight_axes(position: Float2D) -> Float3D:
    """Return (m, 3, 3) rows: the line of sight from the tracker to positions (m, 3), and azimuth and elevation."""
    reach = np.maximum(np.linalg.norm(position, axis=1), 1e-9)
    sight = np.where(np.linalg.norm(position, axis=1)[:, None] > 1e-9, position / reach[:, None], [1.0, 0.0, 0.0])
    level = np.hypot(sight[:, 0], sight[:, 1])
    flat = level > 1e-9
    safe = np.where(flat, level, 1.0)
    east = np.column_stack([
        np.where(flat, -sight[:, 1] / safe, 0.0), np.where(flat, sight[:, 0] / safe, 1.0), np.zeros(len(level))
    ])  # fmt: skip
    return np.stack([sight, east, np.cross(sight, east)], axis=1)


def wrench_covariance(readings: Readings, cell: Cell) -> Float3D:
    """Covariance of each wrench, (m, 6, 6) in N and N·m, axes and point of the recorded wrench.

    The sensor's claim, inflated by the plateau's own covariance where that is larger; zero without a wrench.

    Raises:
        CellError: There is a wrench, but the cell file does not say how uncertain the sensor is.
    """
    if readings.wrench is None:
        return np.zeros((len(readings), 6, 6))
    if readings.wrench_claim is not None:
        return _larger(readings.wrench_claim, readings.wrench_covariance, readings.samples)
    sensor = cell.instruments.force_torque
    if sensor is None:
        raise cell.missing("instruments.force_torque", "the recorded wrench")
    claim = np.diag(np.repeat([sensor.sigma_force**2, sensor.sigma_torque**2], 3))
    return _larger(np.broadcast_to(claim, (len(readings), 6, 6)), readings.wrench_covariance, readings.samples)


def _larger(claim: Float3D, seen: Float3D | None, samples: Int1D | None) -> Float3D:
    """Smallest inflation of the claim along the principal axes of what was seen, relative to the claim.

    In coordinates in which the claim is the unit matrix, the eigenvalues of what was seen are raised to at least one.
    A component of the claim that is zero takes what was seen.
    """
    if seen is None:
        return np.array(claim)
    k = claim.shape[-1]
    trace = np.trace(claim, axis1=1, axis2=2)[:, None, None]
    floor = 1e-12 * np.maximum(trace, np.trace(seen, axis1=1, axis2=2)[:, None, None]) + 1e-30
    root = np.linalg.cholesky(claim + floor * np.eye(k))
    whitened = np.linalg.solve(root, np.swapaxes(np.linalg.solve(root, seen), 1, 2))
    whitened = (whitened + np.swapaxes(whitened, 1, 2)) / 2
    if samples is not None:
        whitened = _pooled(whitened, np.maximum(samples - 1, 0).astype(float))
    values, vectors = np.linalg.eigh(whitened)
    excess = np.maximum(values - 1.0, 0.0)
    extra = root @ (vectors * excess[:, None, :]) @ np.swapaxes(vectors, 1, 2) @ np.swapaxes(root, 1, 2)
    return np.asarray(claim + (extra + np.swapaxes(extra, 1, 2)) / 2)


def _pooled(seen: Float3D, freedom: Float1D) -> Float3D:
    """Return what windows scatter, (m, k, k) in units of the claim, as the mean of all that chance alone tells apart.

    Source: largest eigenvalue of a sample covariance, (1 + sqrt(k / f))^2 of the true one (Marchenko and Pastur 1967).

    Args:
        seen: Of each window.
        freedom: (m,) f, degrees of freedom of each; 0: nothing was seen.
    """
    k, several = seen.shape[-1], freedom > 0
    if not several.any():
        return seen
    level = max(1.0, float(np.median(np.trace(seen[several], axis1=1, axis2=2))) / k)
    limit = level * (1 + np.sqrt(k / np.maximum(freedom, 1.0))) ** 2
    alike = several & (np.linalg.eigvalsh(seen)[:, -1] <= limit)
    if not alike.any():
        return seen
    mean = np.einsum("m,mij->ij", freedom[alike], seen[alike]) / freedom[alike].sum()
    return np.where((alike | ~several)[:, None, None], mean, seen)
