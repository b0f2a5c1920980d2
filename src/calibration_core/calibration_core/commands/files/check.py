"""`calibration check`: everything that is wrong with a cell file at once, what it means in words, and a drawing."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from calibration_core.commands.shared.common import report_line, report_progress, typed
from calibration_core.errors import InputError
from calibration_core.input_checks.cell_file import Remark
from calibration_core.outcomes.cell_check import CheckedCell, examine
from calibration_core.report.results.provenance import digests, software
from calibration_core.report.results.result import SCHEMA, result_json
from calibration_core.report.rounding import counted
from calibration_core.report.writing.output import RESULT, Content, write_files

PICTURE, DRAWING = "cell.png", "cell.html"


def run(arguments: argparse.Namespace) -> str:
    """Check, draw and write; every error is a line on stdout.

    Raises:
        InputError: There are errors: how many.
    """
    report_progress(arguments, 0.0, "reading the cell file")
    checked, faults = examine(arguments.cell, arguments.recording)
    if faults or checked is None:
        _print_all(faults)
        count = counted(len(faults), "error")
        raise InputError(arguments.cell, "", count, "none; each is a line above")
    recording = "RECORDING" if arguments.recording is None else arguments.recording
    following = typed("identify", recording, "--cell", arguments.cell)
    if arguments.recording is None and checked.cell.frames.tracker is not None:
        following = f"{typed('plan', '--cell', arguments.cell)}; once it is measured: {following}"
    lines = [f"{label}: {text}" for label, text in checked.words]
    lines += [f"Unusual: {_unusual(one)}" for one in checked.unusual]
    lines += [f"{one.role} ({one.topic}): {one.text}" for one in checked.topics]
    lines += [*checked.readings, f"next: {following}"]
    result = result_json({**_result(checked, arguments.recording), "summary": lines})
    files: dict[str, Content] = {RESULT: result}
    report_progress(arguments, 0.5, "drawing the cell")
    from calibration_core.report.view3d import cell_view, page
    from calibration_core.report.view3d.picture import png

    view = cell_view(checked.cell)
    files |= {PICTURE: png(view), DRAWING: page(view)}
    if arguments.report:
        report_progress(arguments, 0.7, "writing the report")
        from calibration_core.report.documents.cell_check import check_document
        from calibration_core.report.writing.rendering import rendered

        files |= rendered(check_document(checked, view, result), view)
    write_files(arguments.out, files)
    drawing = f"drawing: {arguments.out / DRAWING} and {arguments.out / PICTURE}"
    return "\n".join([*lines[:-1], drawing, report_line(arguments), lines[-1]])


def _unusual(one: Remark) -> str:
    return f"{one.place}: found {one.found}, expected {one.expected}"


def _print_all(faults: Sequence[InputError]) -> None:
    if sys.stdout is not None:
        for fault in faults:
            print(fault)


def _result(checked: CheckedCell, recording: Path | None) -> dict[str, Any]:
    cell = checked.cell
    return {
        "schema": SCHEMA,
        "command": "check",
        "robot": cell.robot.name,
        "cell": str(cell.path),
        "meaning": [{"what": label, "text": text} for label, text in checked.words],
        "unusual": [dataclasses.asdict(one) for one in checked.unusual],
        "recording": None if recording is None else str(recording),
        "topics": [dataclasses.asdict(one) for one in checked.topics],
        "readings": list(checked.readings),
        "sha256": [{"role": role, "file": file, "sha256": digest} for role, file, digest in digests(cell)],
        "software": software(),
    }
