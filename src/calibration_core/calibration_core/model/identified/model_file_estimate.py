"""What a model file says of its numbers: names, units, joint covariance, and the range of the recording."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from calibration_core.errors import ModelFileError, quoted
from calibration_core.model.identified.calibrated import ValidRange
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.named_values import value_of
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float1D, Float2D

PARAMETER_KEYS = {"name", "unit", "value", "std"}
RANGE_KEYS = {"joints", "force", "torque", "temperature"}
SAME = 1e-9  # relative: a parameter's value is that of the model
MOST_CORRELATION = 1 + 1e-6
POSITIVE = -1e-6  # eigenvalue of the correlation matrix, below which it is no covariance


def estimate_dict(estimate: GaussianEstimate, parameters: ModelParameters) -> dict[str, Any]:
    """Return the keys `parameters` and `covariance` as plain values; values are those of the model, as it is written.

    Raises:
        KeyError: The model has no number of a name.
    """
    rows = zip(estimate.names, estimate.units, estimate.std, strict=True)
    return {
        "parameters": [
            {"name": name, "unit": unit, "value": value_of(parameters, name), "std": float(std)}
            for name, unit, std in rows
        ],
        "covariance": [[float(x) for x in row[: k + 1]] for k, row in enumerate(estimate.covariance)],
    }


def read_estimate(path: Path, data: dict[str, Any], parameters: ModelParameters) -> GaussianEstimate:
    """Return what the keys `parameters` and `covariance` say.

    Raises:
        ModelFileError: They are malformed, name no number of the model, state another value than the model, or the
            covariance is none.
    """
    entries = data.get("parameters")
    if not isinstance(entries, list):
        raise ModelFileError(path, "parameters", quoted(entries), "a list of parameters")
    names: list[str] = []
    units: list[str] = []
    for k, entry in enumerate(entries):
        name, unit = _parameter(path, f"parameters.{k}", entry, parameters)
        if name in names:
            raise ModelFileError(path, f"parameters.{k}.name", quoted(name), "every parameter once")
        names.append(name)
        units.append(unit)
    covariance = _covariance(path, data.get("covariance"), len(names))
    value = np.array([value_of(parameters, name) for name in names])
    return GaussianEstimate(tuple(names), tuple(units), value, covariance)


def _parameter(path: Path, place: str, entry: object, parameters: ModelParameters) -> tuple[str, str]:
    if not isinstance(entry, dict) or set(entry) != PARAMETER_KEYS:
        raise ModelFileError(path, place, quoted(entry), f"the keys {', '.join(sorted(PARAMETER_KEYS))}")
    name, unit = entry["name"], entry["unit"]
    if not isinstance(unit, str) or not unit:
        raise ModelFileError(path, f"{place}.unit", quoted(unit), "a unit")
    try:
        value = value_of(parameters, str(name))
    except KeyError:
        expected = "the path of a number of this model, such as compliance.JOINT or effects.0.PARAMETER"
        raise ModelFileError(path, f"{place}.name", quoted(name), expected) from None
    if not finite(entry["value"]) or not math.isclose(entry["value"], value, rel_tol=SAME, abs_tol=1e-15):
        raise ModelFileError(path, f"{place}.value", quoted(entry["value"]), f"{value!r}, as the model has it")
    return str(name), unit


def _covariance(path: Path, rows: object, p: int) -> Float2D:
    if not isinstance(rows, list) or len(rows) != p:
        found = quoted(rows) if not isinstance(rows, list) else f"{len(rows)} rows"
        raise ModelFileError(path, "covariance", found, f"{p} rows, one per parameter: a lower triangle")
    matrix = np.zeros((p, p))
    for k, row in enumerate(rows):
        place = f"covariance.{k}"
        if not isinstance(row, list) or len(row) != k + 1:
            found = quoted(row) if not isinstance(row, list) else f"{len(row)} numbers"
            raise ModelFileError(path, place, found, f"{k + 1} numbers: a lower triangle")
        unknown = row[k] == math.inf
        if not all(finite(x) for x in (row[:k] if unknown else row)) or (not unknown and row[k] < 0):
            raise ModelFileError(path, place, quoted(row), "finite numbers, and a variance (or .inf) at the end")
        matrix[k, : k + 1] = row
    matrix = matrix + np.tril(matrix, -1).T
    _require_positive(path, matrix)
    return matrix


def _require_positive(path: Path, matrix: Float2D) -> None:
    """Refuse a matrix that is no covariance: not positive, or with something that varies with the unknown."""
    variance = np.diag(matrix)
    unknown = np.isinf(variance)
    beside = np.where(np.eye(len(matrix), dtype=bool), 0.0, matrix)
    wrong = np.flatnonzero(np.any(beside != 0, axis=1) & (unknown | (variance == 0)))
    if len(wrong):
        raise ModelFileError(
            path, f"covariance.{wrong[0]}", "a covariance with what is unknown, or exact", "zeros beside .inf or 0"
        )
    std = np.sqrt(np.where(unknown | (variance == 0), 1.0, variance))
    scaled = np.where(np.isinf(matrix), 0.0, matrix) / np.outer(std, std)
    largest = float(np.abs(scaled).max(initial=0.0))
    if not largest <= MOST_CORRELATION:  # also where it overflows
        raise ModelFileError(path, "covariance", f"a correlation of {largest:.3g}", "correlations from -1 to 1")
    least = float(np.linalg.eigvalsh(scaled)[0]) if len(matrix) else 0.0
    if least < POSITIVE * len(matrix):
        found = f"a smallest eigenvalue of the correlations of {least:.3g}"
        raise ModelFileError(path, "covariance", found, "a covariance, which has none below zero")


def range_dict(valid_range: ValidRange, joints: tuple[str, ...]) -> dict[str, Any]:
    """Return the key `valid_range` as plain values."""
    covered = {name: [float(low), float(high)] for name, (low, high) in zip(joints, valid_range.joints, strict=True)}
    temperature = valid_range.temperature
    return {
        "joints": covered,
        "force": [float(x) for x in valid_range.force],
        "torque": [float(x) for x in valid_range.torque],
        "temperature": None if temperature is None else [float(x) for x in temperature],
    }


def read_range(path: Path, data: dict[str, Any], joints: tuple[str, ...]) -> ValidRange | None:
    """Return what the key `valid_range` says; None where it is null.

    Raises:
        ModelFileError: It is malformed.
    """
    value = data.get("valid_range")
    if value is None:
        return None
    if not isinstance(value, dict) or set(value) != RANGE_KEYS:
        raise ModelFileError(path, "valid_range", quoted(value), f"the keys {', '.join(sorted(RANGE_KEYS))}")
    covered = value["joints"]
    if not isinstance(covered, dict) or set(covered) != set(joints):
        raise ModelFileError(path, "valid_range.joints", quoted(covered), f"the joints {', '.join(joints)}")
    rows = [_interval(path, f"valid_range.joints.{name}", covered[name]) for name in joints]
    force, torque = (_interval(path, f"valid_range.{key}", value[key]) for key in ("force", "torque"))
    warm = value["temperature"]
    temperature = None if warm is None else _interval(path, "valid_range.temperature", warm)
    return ValidRange(np.array(rows), force, torque, temperature)


def _interval(path: Path, place: str, value: object) -> tuple[float, float]:
    low, high = (float(x) for x in vector(path, place, value, 2))
    if low > high:
        raise ModelFileError(path, place, quoted(value), "the smaller number first")
    return low, high


def vector(path: Path, place: str, value: object, length: int) -> Float1D:
    """Return a list of finite numbers as (length,); anything else is refused by its place."""
    if not isinstance(value, list) or len(value) != length or not all(finite(x) for x in value):
        raise ModelFileError(path, place, quoted(value), f"{length} finite numbers")
    return np.array(value, dtype=float)


def finite(value: object) -> bool:
    """Say whether a value of a file is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
