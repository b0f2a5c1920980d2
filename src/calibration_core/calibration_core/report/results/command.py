"""result.json of the commands that identify nothing: the fixed keys, empty where they do not apply."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from calibration_core.cell import Cell
from calibration_core.report.results.provenance import digests, software
from calibration_core.report.results.result import SCHEMA, plain
from calibration_core.timeseries import Provenance

FIT = ("rms_before", "rms_after", "held_out_rms_before", "held_out_rms_after", "noise")


def command_result(
    command: str,
    cell: Cell,
    recording: Mapping[str, Any],
    fit: Mapping[str, float] | None = None,
    anomalies: Sequence[Mapping[str, Any]] = (),
    **further: Any,
) -> dict[str, Any]:
    """Return the content of result.json: the fixed keys in their order, further keys after them.

    Args:
        command: Name of the command.
        cell: The cell.
        recording: `file`, `configurations`, `steps`, `points` and `loaded` of what was read, planned or written.
        fit: Root mean squares that are known, m; the others are None.
        anomalies: Something wrong with the data.
        further: Keys beyond the fixed ones.
    """
    known = {key: (fit or {}).get(key) for key in FIT}
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "command": command,
        "robot": cell.robot.name,
        "recording": dict(recording),
        "stiffness": [],
        "fit": {**known, "unit": "m", **{key: value for key, value in (fit or {}).items() if key not in known}},
        "verdict": "consistent",
        "findings": [],
        "anomalies": [dict(anomaly) for anomaly in anomalies],
        "unexplained": {"rms": 0.0, "significant": False, "where": {}},
        "next_measurements": [],
        **further,
    }
    return {key: plain(value) for key, value in content.items()}


def input_record(
    cell: Cell, provenance: Provenance | None = None, further: Mapping[str, Mapping[str, str]] | None = None
) -> dict[str, Any]:
    """Return what a result rests on: files with their digests, and software.

    Args:
        cell: The cell.
        provenance: The recording, if one was read.
        further: Role -> file -> SHA-256 of further input files.
    """
    return {
        "cell": str(cell.path),
        **({} if provenance is None else {"recording": {"start": provenance.start}}),
        "sha256": [
            {"role": role, "file": name, "sha256": digest} for role, name, digest in digests(cell, provenance, further)
        ],
        "software": software(),
    }
