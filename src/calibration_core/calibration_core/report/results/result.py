"""result.json: the answer for programs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from calibration_core.cell import Cell
from calibration_core.files.written import json_bytes
from calibration_core.identification.result.estimate import Anomaly, Identification, JointStiffness
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.observations.kinds import held_out_freedom, postures_at_rest
from calibration_core.report.results.phases import decoupled_dict, phases_dict
from calibration_core.report.results.provenance import digests, software
from calibration_core.report.results.scene import space_dict
from calibration_core.report.results.standard import standard_dict
from calibration_core.report.results.together import cell_digests, together_dict
from calibration_core.report.results.traffic_light import with_light
from calibration_core.report.results.verdict import rest
from calibration_core.timeseries import Readings

SCHEMA = 1


def result_dict(
    identification: Identification,
    cell: Cell,
    command: str = "identify",
    files: Mapping[str, Mapping[str, str]] | None = None,
) -> dict[str, Any]:
    """Return the content of result.json: the fixed keys in their order, further keys after them.

    Numbers that are not finite are None.  The verdict is `consistent` where the residuals agree with the noise, else
    `unexplained`; a search for causes (`diagnosis_result.identified_dict`) says more.

    Args:
        identification: What was found.
        cell: The cell file.
        command: Which command found it.
        files: Role -> file -> SHA-256 of input files beside the recording and the cell; None: those of `tested`.
    """
    result, left = identification, rest(identification)
    where: dict[str, Any] = {}
    if left.significant:
        where = {"configurations": list(left.configurations), "axis": left.axis}
    content = {
        "schema": SCHEMA,
        "command": command,
        "robot": cell.robot.name,
        "recording": recording_record(result.readings, loaded=result.kind == "loaded"),
        "stiffness": [stiffness_row(joint) for joint in result.stiffness],
        "fit": _fit(result),
        "verdict": "unexplained" if left.significant else "consistent",
        "findings": [],
        "anomalies": [anomaly_record(anomaly) for anomaly in result.anomalies],
        "unexplained": {"rms": left.rms if left.significant else 0.0, "significant": left.significant, "where": where},
        "next_measurements": [],
        **_further(result, cell, tested(result) if files is None else files),
    }
    if result.together is not None:
        content |= together_dict(result.together)
    return with_light({key: plain(value) for key, value in content.items()})


def result_json(content: dict[str, Any]) -> bytes:
    """Return result.json: UTF-8, indented, same bytes for the same content."""
    return json_bytes(content)


def recording_record(readings: Readings, *, loaded: bool) -> dict[str, Any]:
    """Return a recording as result.json has it: its file and what it holds; `loaded`: whether it holds load steps."""
    steps = np.unique(np.column_stack([readings.configuration, readings.step]), axis=0)
    return {
        "file": readings.provenance.path,
        "configurations": len(np.unique(readings.configuration)),
        "steps": len(steps),
        "points": list(readings.points),
        "loaded": loaded,
        "readings": len(readings),
        **({"postures_at_rest": rest} if (rest := postures_at_rest(readings)) else {}),
    }


def anomaly_record(anomaly: Anomaly) -> dict[str, Any]:
    """Return an anomaly as result.json has it."""
    return {
        "kind": anomaly.kind,
        "location": dict(anomaly.location),
        "configurations": None if anomaly.configurations is None else list(anomaly.configurations),
        "magnitude": anomaly.magnitude,
        "unit": anomaly.unit,
        "text": anomaly.text,
        **({"remedy": anomaly.remedy} if anomaly.remedy else {}),
        **anomaly.further,
    }


def stiffness_row(joint: JointStiffness) -> dict[str, Any]:
    """Return one joint's stiffness; `extended` stands beside it where the standard's model leaves something out."""
    row: dict[str, Any] = {
        "joint": joint.joint,
        "value": joint.value,
        "std": joint.std,
        "unit": joint.unit,
        "identifiable": joint.identifiable,
        "interval_95": list(joint.interval),
        "reason": joint.reason,
        "compliance": joint.compliance,
        "compliance_std": joint.compliance_std,
    }
    if joint.extended is not None:
        beside = joint.extended
        row["extended"] = {"value": beside.value, "std": beside.std, "interval_95": list(beside.interval)}
    return row


def _fit(result: Identification) -> dict[str, Any]:
    fit = result.fit
    return {
        "rms_before": fit.rms_before,
        "rms_after": fit.rms_after,
        "held_out_rms_before": fit.held_out_rms_before,
        "held_out_rms_after": fit.held_out_rms_after,
        "noise": fit.noise,
        "unit": "m",
        "held_out_mean_after": fit.held_out_mean_after,
        "held_out_max_after": fit.held_out_max_after,
        "held_out_freedom": held_out_freedom(result.readings),
        **({} if math.isnan(fit.positions) else {"positions_rms": fit.positions}),
    }


def _further(result: Identification, cell: Cell, files: Mapping[str, Mapping[str, str]]) -> dict[str, Any]:
    """Return the keys beyond the fixed ones."""
    provenance = result.readings.provenance
    return {
        "kind": result.kind,
        "method": result.method,
        "condition_number": result.condition_number,
        "unidentified": [
            {"combination": dict(item.combination), "reason": item.reason} for item in result.unidentified
        ],
        "noise": _record(result.noise),
        "stages": [_record(stage) for stage in result.stages],
        "parameters": [_record(parameter) for parameter in result.parameters],
        "correlation": {"names": list(result.names), "matrix": correlation(result)},
        "preconditions": [_record(precondition) for precondition in result.preconditions],
        "exclusions": [_record(exclusion) for exclusion in result.exclusions],
        "test": None if result.test is None else _record(result.test),
        "notes": [_record(note) for note in result.notes],
        "given_model": None if result.given is None else _given(result.given),
        "input": {
            "recording": {
                "path": provenance.path,
                "kind": provenance.kind,
                "start": provenance.start,
                "messages": dict(provenance.messages),
            },
            "cell": str(cell.path),
            "sha256": [
                {"role": role, "file": name, "sha256": digest}
                for role, name, digest in digests(cell, provenance, files)
            ],
            "software": software(),
        },
        "safety_rated_speed": safety_rated_speed(cell),
        "operating_space": space_dict(result.space),
        "standard_geometry": standard_dict(result.standard, cell),
        "phases": phases_dict(result),
        "decoupled": decoupled_dict(result),
    }


def _given(given: GivenModel) -> dict[str, Any]:
    """Return the model that was handed in: file, digest, and the effects that were taken off the readings."""
    effects = [
        {"effect": effect.effect, "location": dict(effect.location), "variant": effect.variant}
        for effect in given.parameters.effects
    ]
    return {"file": given.file, "sha256": given.sha256, "effects": effects}


def safety_rated_speed(cell: Cell) -> dict[str, Any] | None:
    """Return the controller's speed limit that the cell file declares, m/s, and who does; None if there is none."""
    if cell.safety is None:
        return None
    return {"value": cell.safety.speed_limit, "unit": "m/s", "source": cell.safety.source}


def tested(result: Identification) -> dict[str, Mapping[str, str]]:
    """Return the digests of further cells, second recording and given model under their roles; empty without them."""
    files: dict[str, Mapping[str, str]] = {} if result.together is None else cell_digests(result.together)
    files |= {} if result.test is None else {"test": result.test.sha256}
    return files if result.given is None else {**files, "model": {result.given.file: result.given.sha256}}


def correlation(identification: Identification) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the (p, p) correlation matrix; NaN in the rows of parameters without a finite, positive variance."""
    covariance = np.asarray(identification.covariance, dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        std = np.sqrt(np.diag(covariance))
        std = np.where((std > 0) & np.isfinite(std), std, np.nan)
        matrix = covariance / np.outer(std, std)
    return np.asarray(np.clip(matrix, -1.0, 1.0))


def _record(value: object) -> dict[str, Any]:
    return dict(vars(value))


def plain(value: Any) -> Any:
    """Return a value with JSON types only: arrays and tuples as lists, non-finite numbers as None."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if hasattr(value, "__dataclass_fields__"):
        return plain(_record(value))
    return value
