"""What physics allows: a compliance is not negative, and that of an elastic hinge is a positive matrix.

Estimates scatter, so that a small compliance may come out below zero.  How far the nearest allowed values are from an
estimate, in nats, tells scatter from a cause that only has the shape of a compliance; and the nearest allowed values
are the estimate that is reported.

With the covariance C = L L' of the estimate m, the nearest x with A x >= 0 is m + C A' y, where y >= 0 minimises
|L' A' y + L^-1 m| (the dual, non-negative least squares; Lawson and Hanson 1974).  A matrix is positive where w' M w is
for every w: such rows are added, w being the eigenvector of the eigenvalue that is still negative, until none is.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.model.effects.candidate import Parameter
from calibration_core.timeseries import Bool1D, Float1D, Float2D

HINGE = (True, True, False)  # two compliances across an axis and the one between them (`springs.tilting`)
THREE_AXES = (*HINGE, True, False, False)  # the same, the compliance about the third axis and those between it and both
PLACES = ((0, 0), (1, 1), (0, 1), (2, 2), (0, 2), (1, 2))  # of their values in the matrix of a hinge
JITTER = 1e-12  # of the variances
WITHIN = 2.0  # standard deviations
SCATTER = 2.7  # nats: one in a hundred estimates of a compliance that is zero lies further below
MOST_SHARE = 0.2  # of what a hypothesis gains, that the way to the nearest possible values may cost
ROUNDS = 60  # of further directions in which matrices must be positive
NEGATIVE = 1e-9  # of a matrix's largest eigenvalue, in standard deviations: less is a rounding error


@dataclasses.dataclass(frozen=True, eq=False)
class Nearest:
    """The nearest values that physics allows.

    Attributes:
        value: (p,) the values.
        nats: By how many they are less probable than the estimate.
        held: (k, p) combinations of the parameters that are zero there because physics allows none beyond.
    """

    value: Float1D
    nats: float
    held: Float2D


def nearest(several: Sequence[Sequence[Parameter]], mean: Float1D, covariance: Float2D) -> Nearest:
    """Return the values nearest to an estimate that physics allows.

    Args:
        several: The parameters of one candidate after another, p in all.
        mean: (p,) their estimate.
        covariance: (p, p) of it.
    """
    positive, hinges = _demanded(several)
    if np.all(mean[positive] >= 0) and not any(_indefinite(mean[hinge]) for hinge in hinges):
        return Nearest(mean, 0.0, np.zeros((0, len(mean))))
    std = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    unit = covariance / np.outer(std, std) + JITTER * np.eye(len(mean))
    lower = np.linalg.cholesky(unit)
    target = np.linalg.solve(lower, mean / std)
    rows = np.eye(len(mean))[positive]
    from scipy.optimize import nnls  # slow to load, and few recordings meet the bound

    value, way, dual = mean / std, np.zeros(len(mean)), np.zeros(len(rows))
    for _ in range(ROUNDS):
        dual, _ = nnls(lower.T @ rows.T, -target)
        way = lower.T @ (rows.T @ dual)
        value = mean / std + lower @ way
        more = [row for hinge in hinges if (row := _negative(value, hinge, std)) is not None]
        if not more:
            break
        rows = np.concatenate([rows, more])
    at_bound = positive & (value < JITTER * np.abs(mean / std))
    at_bound[np.flatnonzero(positive)[dual[: positive.sum()] > 0]] = True
    value = np.where(at_bound, 0.0, value) * std
    held = [np.eye(len(mean))[[k]] for k in np.flatnonzero(at_bound)]
    for hinge in hinges:
        value[hinge], directions = _positive(value[hinge], std[hinge])
        held.append(_equations(directions, hinge, len(mean)))
    return Nearest(value, 0.5 * float(way @ way), np.concatenate([np.zeros((0, len(mean))), *held]))


def forbidden(nats: float, gain: float) -> bool:
    """Say whether the way to the nearest values that physics allows costs too much for a hypothesis of some gain."""
    return nats > max(MOST_SHARE * gain, SCATTER)


def out_of_bounds(parameters: Sequence[Parameter], mean: Float1D, covariance: Float2D) -> str:
    """Return why an estimate cannot be, whatever its scatter; empty if it can.

    Args:
        parameters: k of them, one candidate's.
        mean: (k,) their estimate.
        covariance: (k, k) of it.
    """
    margin = WITHIN * np.sqrt(np.diag(covariance))
    least = np.abs(mean) - margin
    first = abs(float(mean[0])) + float(margin[0])
    if any(size > one.reach * first for one, size in zip(parameters, least, strict=True)):
        return "its law would lie where another form of it is offered"
    if any(size > one.most for one, size in zip(parameters, least, strict=True)):
        return "it would be larger than physics allows"
    return ""


def _demanded(several: Sequence[Sequence[Parameter]]) -> tuple[Bool1D, list[slice]]:
    """Return (p,) which parameters must be positive, and the places of hinges."""
    hinges, first = [], 0
    for parameters in several:
        for demanded in (THREE_AXES, HINGE):
            if tuple(parameter.positive for parameter in parameters[: len(demanded)]) == demanded:
                hinges.append(slice(first, first + len(demanded)))
                break
        first += len(parameters)
    return np.array([parameter.positive for parameters in several for parameter in parameters], dtype=bool), hinges


def _indefinite(values: Float1D) -> bool:
    if len(values) == len(HINGE):
        return bool(values[2] ** 2 > values[0] * values[1])
    return bool(np.linalg.eigvalsh(_matrix(values))[0] < 0)


def _matrix(values: Float1D) -> Float2D:
    """Return the matrix of a hinge, (2, 2) or (3, 3)."""
    matrix = np.zeros((_axes(values), _axes(values)))
    for (i, j), value in zip(PLACES, values, strict=False):
        matrix[i, j] = matrix[j, i] = value
    return matrix


def _axes(values: Float1D) -> int:
    """Return the number of axes of a hinge with these values."""
    return 2 if len(values) == len(HINGE) else 3


def _negative(value: Float1D, hinge: slice, std: Float1D) -> Float1D | None:
    """Return the row in which a hinge's matrix is still negative, (p,); None where it is not.

    Args:
        value: (p,) standard deviations.
        hinge: Its place.
        std: (p,) standard deviations.
    """
    across = _units(std[hinge])
    own, turn = _eigen(value[hinge] * std[hinge], across)
    if own[0] >= -NEGATIVE * max(abs(own[-1]), 1.0):
        return None
    w = turn[0] / across
    row = np.zeros(len(value))
    places = PLACES[: len(std[hinge])]
    row[hinge] = np.array([w[i] ** 2 if i == j else 2 * w[i] * w[j] for i, j in places]) * std[hinge]
    return row / np.linalg.norm(row)


def _units(std: Float1D) -> Float1D:
    """Return the units, one for each axis of a hinge, in which all its compliances count alike."""
    return np.sqrt([one for one, (i, j) in zip(std, PLACES, strict=False) if i == j])


def _positive(values: Float1D, std: Float1D) -> tuple[Float1D, Float2D]:
    """Return the values of a hinge with its matrix positive to the last digit, and where it is zero, (k, 2 or 3)."""
    across = _units(std)
    own, turn = _eigen(values, across)
    zero = own <= 2 * NEGATIVE * max(abs(float(own[-1])), 1.0)
    if not zero.any():
        return values, np.zeros((0, len(across)))
    kept = (turn.T * np.where(zero, 0.0, own)) @ turn * np.outer(across, across)
    return np.array([kept[place] for place in PLACES[: len(values)]]), (turn / across)[zero]


def _eigen(values: Float1D, across: Float1D) -> tuple[Float1D, Float2D]:
    """Return the eigenvalues of a hinge's matrix, the smallest one first, and their vectors, a row each.

    Args:
        values: Its compliances, in the order of `PLACES`.
        across: (2,) or (3,) units of the axes.
    """
    if len(across) > 2:
        several, vectors = np.linalg.eigh(_matrix(values) / np.outer(across, across))
        return several, vectors.T
    a, b, c = values[0] / across[0] ** 2, values[1] / across[1] ** 2, values[2] / (across[0] * across[1])
    middle, apart = (a + b) / 2, np.hypot((a - b) / 2, c)
    angle = 0.5 * np.arctan2(2 * c, a - b)  # of the larger one
    x, y = np.cos(angle), np.sin(angle)
    return np.array([middle - apart, middle + apart]), np.array([[-y, x], [x, y]])


def _equations(directions: Float2D, hinge: slice, count: int) -> Float2D:
    """Return the (d k, p) equations M w = 0 of a hinge's matrix, of k directions of d axes each."""
    rows = np.zeros((directions.size, count))
    for k, w in enumerate(directions):
        own = rows[k * len(w) : (k + 1) * len(w), hinge]  # a view
        for place, (i, j) in enumerate(PLACES[: own.shape[1]]):
            own[i, place], own[j, place] = w[j], w[i]
    return rows
