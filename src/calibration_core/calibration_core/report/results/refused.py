"""The answer where the input is not what it claims to be: what is seen, and how to put it right; no stiffness table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calibration_core.cell import Cell
from calibration_core.input_checks.anomaly import InputAnomaly
from calibration_core.report.results.command import command_result, input_record
from calibration_core.report.results.traffic_light import with_light
from calibration_core.report.summary import on_a_terminal
from calibration_core.timeseries import Readings


def refused_result(
    command: str,
    cell: Cell,
    readings: Readings,
    found: Sequence[InputAnomaly],
    inputs: Mapping[str, Mapping[str, str]],
) -> dict[str, Any]:
    """Return the content of result.json.

    Args:
        command: Name of the command.
        cell: The cell.
        readings: The recording.
        found: What is wrong with its input.
        inputs: Role -> file -> SHA-256 of input files besides recording and cell.
    """
    steps = np.unique(np.column_stack([readings.configuration, readings.step]), axis=0)
    configurations = len(np.unique(readings.configuration))
    recording = {
        "file": readings.provenance.path,
        "configurations": configurations,
        "steps": len(steps),
        "points": list(readings.points),
        "loaded": readings.wrench is not None and len(steps) > configurations,
        "readings": len(readings),
    }
    content = command_result(
        command,
        cell,
        recording,
        anomalies=[anomaly.record() for anomaly in found],
        unexplained={"rms": 0.0, "significant": True, "where": {}},
        notes=[vars(note) for note in readings.notes],
        input=input_record(cell, readings.provenance, inputs),
    )
    return {**with_light(content), "summary": refused_summary(found)}


def refused_summary(found: Sequence[InputAnomaly]) -> list[str]:
    """Return what is wrong and what to put right, as a terminal shows it."""
    lines = [f"not usable: {found[0].remedy}", "no stiffness is stated from such input"]
    return on_a_terminal([*lines, *(f"anomaly: {anomaly.kind}: {anomaly.text}" for anomaly in found)])
