"""The identified model as a file: what `identify` writes and `predict`, `simulate`, `identify` and `diagnose` read.

YAML, SI units.  `geometry` holds corrections to the cell file's nominal geometry, so the file goes with its robot: its
name, those of its joints, and the digest of the robot section with its URDF (`robot_sha256`) are checked; the cell
file's own hash is kept for the record.

Everything that was identified stands in `parameters` (name, unit, value, std; the name is the path of the number in
this file, see `named_values`), with their joint `covariance` as the rows of its lower triangle (`.inf` on the diagonal:
nothing is known), and the `valid_range` of the recording.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from calibration_core.cell import Cell
from calibration_core.cell.identity import robot_sha256
from calibration_core.errors import ModelFileError, quoted
from calibration_core.files.names import NAME, is_name
from calibration_core.files.yaml_file import YamlFile, read_yaml, yaml_text
from calibration_core.model.chain import pose_matrix, rpy_of
from calibration_core.model.effects import catalogue
from calibration_core.model.effects.words import effect_sentence
from calibration_core.model.identified.calibrated import WITHOUT_INTERVALS, CalibratedModel, ValidRange
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.named_values import GEOMETRY, value_of
from calibration_core.model.parameters import AppliedEffect, ModelParameters
from calibration_core.recording.source import sha256_of
from calibration_core.timeseries import NO_INTERVALS, Float1D, Float2D, Note, Readings

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


# --- the identified model as a file -----------------------------------------------------------------------------------


SCHEMA = 2
MAX_BYTES = 4 << 20  # many times what a model with all its covariances takes
KEYS = (
    "schema", "robot", "cell", "joints", "compliance", "stiffness", "geometry", "tracker", "measurement_points",
    "wrench_point", "force_torque", "effects", "robot_sha256", "parameters", "covariance", "valid_range",
)  # fmt: skip
EFFECT_KEYS = ("effect", "location", "variant", "parameters")


def model_dict(
    parameters: ModelParameters,
    cell: Cell,
    estimate: GaussianEstimate | None = None,
    valid_range: ValidRange | None = None,
) -> dict[str, Any]:
    """Return the content of the file as plain values, in the order in which it is written.

    Args:
        parameters: The model.
        cell: Its robot.
        estimate: What is known of its numbers; None: nothing was identified, the file has no intervals.
        valid_range: What the recording covered; None: unknown.

    Raises:
        CellError: The URDF cannot be read.
    """
    compliance = [float(c) for c in parameters.compliance]
    return {
        "schema": SCHEMA,
        "robot": cell.robot.name,
        "robot_sha256": robot_sha256(cell),
        "cell": {"file": cell.path.name, "sha256": cell.sha256},
        "joints": list(parameters.joints),
        "compliance": compliance,
        "stiffness": [1 / c if c > 0 else None for c in compliance],
        "geometry": [dict(zip(GEOMETRY, map(float, row), strict=True)) for row in parameters.geometry],
        "tracker": _pose_dict(parameters.tracker),
        "measurement_points": {name: [float(x) for x in point] for name, point in parameters.points.items()},
        "wrench_point": None if parameters.wrench_point is None else [float(x) for x in parameters.wrench_point],
        "force_torque": None if parameters.force_torque is None else _pose_dict(parameters.force_torque),
        "effects": [_effect_dict(effect) for effect in parameters.effects],
        "valid_range": None if valid_range is None else range_dict(valid_range, parameters.joints),
        **estimate_dict(estimate or GaussianEstimate.nothing(), parameters),
    }


def model_text(
    parameters: ModelParameters,
    cell: Cell,
    estimate: GaussianEstimate | None = None,
    valid_range: ValidRange | None = None,
) -> str:
    """Return the file's text; every float keeps all its digits.  Arguments and errors as `model_dict`."""
    head = "# Identified model: SI units; geometry is the correction to the nominal geometry of the cell file.\n"
    return head + yaml_text(model_dict(parameters, cell, estimate, valid_range), flow=None)


def read_model(path: str | Path, cell: Cell) -> ModelParameters:
    """Read the parameters of an identified model; errors as `read_calibrated`."""
    return read_calibrated(path, cell).parameters


def read_calibrated(path: str | Path, cell: Cell) -> CalibratedModel:
    """Read an identified model with everything that its file says: covariance and valid range, where it has them.

    Raises:
        ModelFileError: It is missing, malformed, or belongs to another robot: another name, other joints, or another
            robot section or URDF of the cell file.
        CellError: The cell's URDF cannot be read.
    """
    file = read_yaml(path, MAX_BYTES, "model file (YAML)", ModelFileError)
    with file.locating():
        data = _content(file)
        parameters = _parameters(file.path, data, cell)
        estimate = read_estimate(file.path, data, parameters)
        covered = read_range(file.path, data, parameters.joints)
        return CalibratedModel(parameters, estimate if estimate.names else None, covered)


def _parameters(path: Path, data: dict[str, Any], cell: Cell) -> ModelParameters:
    joints = cell.robot.joints
    if data.get("joints") != list(joints):
        raise ModelFileError(path, "joints", quoted(data.get("joints")), f"the cell's joints {list(joints)}")
    if data.get("robot") != cell.robot.name:
        raise ModelFileError(path, "robot", quoted(data.get("robot")), f"the cell's robot {quoted(cell.robot.name)}")
    if data.get("robot_sha256") != robot_sha256(cell):
        expected = f"{robot_sha256(cell)}, the digest of the cell's robot section and URDF (another robot, or changed)"
        raise ModelFileError(path, "robot_sha256", quoted(data.get("robot_sha256")), expected)
    n = len(joints)
    points = data.get("measurement_points")
    if not isinstance(points, dict) or not points:
        raise ModelFileError(path, "measurement_points", quoted(points), "a mapping of points")
    for name in points:
        if not is_name(str(name)):
            raise ModelFileError(path, "measurement_points", quoted(name), NAME)
    compliance = vector(path, "compliance", data.get("compliance"), n)
    if np.any(compliance < 0):
        raise ModelFileError(path, "compliance", quoted(float(compliance.min())), "compliances that are not negative")
    optional = {key: data.get(key) for key in ("wrench_point", "force_torque")}
    return ModelParameters(
        joints=joints,
        compliance=compliance,
        geometry=_geometry(path, data.get("geometry"), n),
        tracker=_pose(path, "tracker", data.get("tracker")),
        points={str(name): vector(path, f"measurement_points.{name}", xyz, 3) for name, xyz in points.items()},
        wrench_point=None
        if optional["wrench_point"] is None
        else vector(path, "wrench_point", optional["wrench_point"], 3),
        force_torque=None
        if optional["force_torque"] is None
        else _pose(path, "force_torque", optional["force_torque"]),
        effects=_effects(path, data.get("effects") or []),
    )


def _content(file: YamlFile) -> dict[str, Any]:
    """Return the mapping that a model file holds; only its keys and its schema are checked."""
    path, data = file.path, file.data
    if not isinstance(data, dict):
        raise ModelFileError(path, "", quoted(data), f"a mapping with the keys {', '.join(KEYS)}")
    schema = data.get("schema")
    if isinstance(schema, bool) or schema != SCHEMA:
        raise ModelFileError(path, "schema", quoted(schema), f"{SCHEMA}, as identify and diagnose write it now")
    unknown = [key for key in data if key not in KEYS]
    if unknown:
        raise ModelFileError(path, unknown[0], "an unknown key", f"one of {', '.join(KEYS)}")
    return data


def _geometry(path: Path, value: object, n: int) -> Float2D:
    if not isinstance(value, list) or len(value) != n:
        raise ModelFileError(path, "geometry", quoted(value), f"{n} entries, one per joint")
    rows = []
    for i, row in enumerate(value):
        if not isinstance(row, dict) or set(row) != set(GEOMETRY):
            raise ModelFileError(path, f"geometry.{i}", quoted(row), f"the keys {', '.join(GEOMETRY)}")
        rows.append(vector(path, f"geometry.{i}", [row[key] for key in GEOMETRY], 6))
    return np.stack(rows)


def _effects(path: Path, value: object) -> tuple[AppliedEffect, ...]:
    """Read the list of effects; names must be of the catalogue, values finite."""
    if not isinstance(value, list):
        raise ModelFileError(path, "effects", quoted(value), "a list of effects")
    known = [effect.name for effect in catalogue()]
    effects = []
    for i, entry in enumerate(value):
        place = f"effects.{i}"
        if not isinstance(entry, dict) or set(entry) != set(EFFECT_KEYS):
            raise ModelFileError(path, place, quoted(entry), f"the keys {', '.join(EFFECT_KEYS)}")
        if entry["effect"] not in known:
            raise ModelFileError(path, f"{place}.effect", quoted(entry["effect"]), f"one of {', '.join(known)}")
        location, parameters = entry["location"], entry["parameters"]
        if not isinstance(location, dict) or not all(_named(x) for x in location.values()):
            raise ModelFileError(path, f"{place}.location", quoted(location), "names of joints, links or sensors")
        if not isinstance(parameters, dict) or not all(finite(x) for x in parameters.values()):
            raise ModelFileError(path, f"{place}.parameters", quoted(parameters), "names with finite numbers")
        where = {str(key): tuple(x) if isinstance(x, list) else str(x) for key, x in location.items()}
        numbers = {str(key): float(x) for key, x in parameters.items()}
        effects.append(AppliedEffect(str(entry["effect"]), where, str(entry["variant"]), numbers))
    return tuple(effects)


def _named(value: object) -> bool:
    return isinstance(value, str) or (isinstance(value, list) and all(isinstance(x, str) for x in value))


def _effect_dict(effect: AppliedEffect) -> dict[str, Any]:
    return {
        "effect": effect.effect,
        "location": {key: list(x) if isinstance(x, tuple) else x for key, x in effect.location.items()},
        "variant": effect.variant,
        "parameters": {key: float(x) for key, x in effect.parameters.items()},
    }


def _pose(path: Path, place: str, value: object) -> Float2D:
    if not isinstance(value, dict) or set(value) != {"xyz", "rpy"}:
        raise ModelFileError(path, place, quoted(value), "a pose with the keys xyz, rpy")
    return pose_matrix(vector(path, f"{place}.xyz", value["xyz"], 3), vector(path, f"{place}.rpy", value["rpy"], 3))


def _pose_dict(pose: Float2D) -> dict[str, list[float]]:
    return {"xyz": [float(x) for x in pose[:3, 3]], "rpy": [float(x) for x in rpy_of(pose[:3, :3])]}


# --- A model that is handed in as a file ------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class GivenModel:
    """An identified or extended model and the file it came from.

    Attributes:
        estimate: What it says of its numbers' uncertainty; None: nothing.
        valid_range: What its recording covered; None where it does not say.
        recordings: What it was identified from; empty where a file holds the model.
    """

    parameters: ModelParameters
    file: str
    sha256: str
    estimate: GaussianEstimate | None = None
    valid_range: ValidRange | None = None
    recordings: tuple[Readings, ...] = ()

    @property
    def calibrated(self) -> CalibratedModel:
        """The model with its covariance and its range."""
        return CalibratedModel(self.parameters, self.estimate, self.valid_range)

    @property
    def start(self) -> ModelParameters:
        """The model without its effects: what a fit of readings freed of them starts from."""
        return self.parameters.replace(effects=())

    @property
    def digest(self) -> dict[str, dict[str, str]]:
        """The file as input of a result: role -> file name -> SHA-256."""
        return {"model": {Path(self.file).name: self.sha256}}

    @property
    def notes(self) -> tuple[Note, ...]:
        """What its reader must know: a file without a covariance gives no intervals."""
        text = WITHOUT_INTERVALS[0].lower() + WITHOUT_INTERVALS[1:].removesuffix(".")
        return () if self.estimate is not None else (Note(NO_INTERVALS, self.file, text),)

    def known_effects(self) -> str:
        """The effects and their places in words."""
        texts = [effect_sentence(effect.effect, effect.location) for effect in self.parameters.effects]
        return "; ".join(dict.fromkeys(texts)) or "no effects"


def read_given(path: Path, cell: Cell) -> GivenModel:
    """Read a model file.

    Raises:
        ModelFileError: It is missing, malformed, or belongs to another robot.
        CellError: The cell's URDF cannot be read.
    """
    model = read_calibrated(path, cell)
    return GivenModel(model.parameters, str(path), sha256_of(path), model.estimate, model.valid_range)
