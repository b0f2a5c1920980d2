"""What makes one choice of measurements better than another: the criteria of CWA 17384, 5.4, and of optimal design.

Every criterion is a function of the information matrix M = J^T N^-1 J (J: the stacked Jacobian of all readings by the
parameters, N: their noise), in units of the parameters' scale.  All but the condition number are logarithms of
functions that are concave and homogeneous of degree one.  For such a function phi with slope G at M, tr(G M) = 1, and
any other mean information M* of candidates X_i, log phi(M*) <= log phi(M) + log max_i tr(G X_i): what any choice could
reach at most (Pukelsheim, Optimal Design of Experiments, 1993, ch. 7).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from calibration_core.timeseries import Float1D, Float2D, Float3D

SHARPNESS = 8  # exponent p by which the largest of several values is approached smoothly, in order to be differentiable
RIDGE = 1e-13  # of the mean diagonal: what cannot be determined becomes very uncertain instead of infinite


@dataclasses.dataclass(frozen=True)
class Criterion:
    """One criterion; larger scores are better.

    Attributes:
        name: As it is selected.
        text: What it means, for the report.
        score: (k, n, n) -> (k,) logarithm of the criterion, -inf where the parameters are not determined.
        smooth: (k, n, n) -> (k,) the same, or a differentiable bound above it.
        slope: (n, n) -> (n, n) gradient of `smooth`.
        power: Exponent of the multiplicative algorithm that raises `smooth`.
        concave: Whether exp(smooth) is concave and homogeneous, so that what a choice could reach can be certified.
    """

    name: str
    text: str
    score: Callable[[Float3D], Float1D]
    smooth: Callable[[Float3D], Float1D]
    slope: Callable[[Float2D], Float2D]
    power: float
    concave: bool = True


def _log(values: Float1D) -> Float1D:
    return np.where(values > 0, np.log(np.where(values > 0, values, 1.0)), -np.inf)


def _ridged(matrices: Float3D) -> Float3D:
    n = matrices.shape[-1]
    size = np.trace(matrices, axis1=-2, axis2=-1) / n
    ridged: Float3D = matrices + (RIDGE * size + 1e-300)[..., None, None] * np.eye(n)
    return ridged


def _inverse(matrices: Float3D) -> Float3D:
    return np.asarray(np.linalg.inv(_ridged(matrices)), dtype=np.float64)


def _variances(matrices: Float3D) -> Float2D:
    """Return the (k, n) variances of the parameters; infinite where rounding left none."""
    found = np.diagonal(_inverse(matrices), axis1=-2, axis2=-1)
    return np.where(found > 0, found, np.inf)


def _values(matrices: Float3D) -> Float2D:
    return np.maximum(np.linalg.eigvalsh(matrices), 0.0)


def _determinant(matrices: Float3D) -> Float1D:
    return _log(np.linalg.det(matrices)) / matrices.shape[-1]


def _determinant_slope(matrix: Float2D) -> Float2D:
    return _inverse(matrix) / len(matrix)


def _mean_variance(matrices: Float3D) -> Float1D:
    return -np.log(_variances(matrices).mean(axis=-1))


def _mean_variance_slope(matrix: Float2D) -> Float2D:
    inverse = _inverse(matrix)
    return inverse @ inverse / np.trace(inverse)


def _worst(matrices: Float3D) -> Float1D:
    return -np.log(_variances(matrices).max(axis=-1))


def _worst_smooth(matrices: Float3D) -> Float1D:
    """-log of the p-mean of the variances, which no choice has above their largest."""
    variances = _variances(matrices)
    largest = variances.max(axis=-1)
    ratio = variances / np.where(np.isfinite(largest), largest, 1.0)[..., None]
    return -np.log(largest) - np.log((ratio**SHARPNESS).mean(axis=-1)) / SHARPNESS


def _worst_slope(matrix: Float2D) -> Float2D:
    inverse = _inverse(matrix)
    weight = np.maximum(np.diag(inverse) / np.diag(inverse).max(), 0.0) ** (SHARPNESS - 1)
    return (inverse * weight) @ inverse / float(weight @ np.diag(inverse))


def _smallest(matrices: Float3D) -> Float1D:
    return _log(_values(matrices)[..., 0])


def _smallest_smooth(matrices: Float3D) -> Float1D:
    values = _values(matrices)
    least = values[..., :1]
    ratio = np.where(values > 0, least / np.where(values > 0, values, 1.0), 1.0)
    return _log(least[..., 0]) - np.log((ratio**SHARPNESS).mean(axis=-1)) / SHARPNESS


def _smallest_slope(matrix: Float2D) -> Float2D:
    values, vectors = np.linalg.eigh(_ridged(matrix))
    weight = (values[0] / values) ** SHARPNESS
    return (vectors * (weight / values)) @ vectors.T / weight.sum()


def _condition(matrices: Float3D) -> Float1D:
    values = _values(matrices)
    return 0.5 * (_log(values[..., 0]) - np.log(np.maximum(values[..., -1], 1e-300)))


def _condition_slope(matrix: Float2D) -> Float2D:
    values, vectors = np.linalg.eigh(_ridged(matrix))
    least, most = vectors[:, :1], vectors[:, -1:]
    return 0.5 * (least @ least.T / values[0] - most @ most.T / values[-1])


def _trace(matrices: Float3D) -> Float1D:
    return _log(np.trace(matrices, axis1=-2, axis2=-1) / matrices.shape[-1])


def _trace_slope(matrix: Float2D) -> Float2D:
    return np.eye(len(matrix)) / np.trace(matrix)


D_OPTIMAL = Criterion(
    "D",
    "determinant of the information on all parameters (D-optimality; the observability index of Borm and Menq)",
    _determinant,
    _determinant,
    _determinant_slope,
    1.0,
)
CRITERIA: Mapping[str, Criterion] = MappingProxyType(
    {
        one.name: one
        for one in (
            D_OPTIMAL,
            Criterion(
                "A",
                "mean variance of the parameters (A-optimality)",
                _mean_variance,
                _mean_variance,
                _mean_variance_slope,
                0.5,
            ),
            Criterion(
                "worst",
                "variance of the worst parameter",
                _worst,
                _worst_smooth,
                _worst_slope,
                1.0 / (SHARPNESS + 1),
            ),
            Criterion(
                "condition",
                "condition number of the stacked Jacobian (CWA 17384, 5.4, 1)",
                _condition,
                _condition,
                _condition_slope,
                0.0,
                concave=False,
            ),
            Criterion(
                "observability",
                "smallest singular value of the stacked Jacobian, the observability of the worst combination "
                "(CWA 17384, 5.4, 2; Nahvi and Hollerbach)",
                _smallest,
                _smallest_smooth,
                _smallest_slope,
                1.0 / (SHARPNESS + 1),
            ),
            Criterion(
                "trace",
                "trace of the sensitivity matrix S^T S, S the derivatives of the readings by the parameters "
                "(CWA 17384, 5.4, 3)",
                _trace,
                _trace,
                _trace_slope,
                1.0,
            ),
        )
    }
)


@dataclasses.dataclass(frozen=True)
class Observability:
    """The standard's figures of a choice (CWA 17384, 5.4), for the mean information in units of the parameters' scale.

    Attributes:
        condition: Condition number of the stacked Jacobian.
        index: Borm and Menq's observability index, the geometric mean of its singular values over sqrt(configurations).
        smallest: Its smallest singular value, likewise.
        noise: Nahvi and Hollerbach's noise amplification index, smallest squared over largest singular value, likewise.
        trace: Trace of the sensitivity matrix S^T S, per configuration.
    """

    condition: float
    index: float
    smallest: float
    noise: float
    trace: float

    @staticmethod
    def of(matrix: Float2D) -> Observability:
        """Return the figures of one mean information matrix, (n, n), dimensionless."""
        singular = np.sqrt(_values(matrix))
        least, most = float(singular[0]), float(singular[-1])
        return Observability(
            condition=most / least if least > 0 else float("inf"),
            index=float(np.exp(_log(singular).mean())),
            smallest=least,
            noise=least**2 / most,
            trace=float(np.trace(matrix)),
        )
