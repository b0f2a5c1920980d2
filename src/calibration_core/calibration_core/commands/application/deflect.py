"""`calibration deflect`: where points and tool of a calibrated robot go under a load, with 95 % intervals."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from calibration_core.cell import Cell
from calibration_core.commands.application.inputs import calibrated, finite_or_none, outside_lines, task_of
from calibration_core.commands.shared.common import report_line, report_progress
from calibration_core.compensation.deflection import TOOL, Deflection
from calibration_core.engine.command_line import refuse_without_effect
from calibration_core.errors import InputError
from calibration_core.files.written import csv_bytes
from calibration_core.outcomes.compensation import Deflected, deflected
from calibration_core.outcomes.inputs import Inputs, digest_of
from calibration_core.report.results.command import command_result, input_record
from calibration_core.report.results.result import result_json
from calibration_core.report.writing.output import RESULT, Content, write_files

DEFLECTIONS = "deflections.csv"
MOVED = ("dx", "dy", "dz", "rx", "ry", "rz")


def run(arguments: argparse.Namespace) -> str:
    """Predict deflections, write them, and return a summary.

    Raises:
        InputError: The input cannot be used, or the output cannot be written.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    report_progress(arguments, 0.0, "predicting the deflections")
    if (arguments.q is None) == (arguments.poses is None):
        raise InputError("--q", "", "both or none", "either --q with joint angles or --poses with a file")
    if not arguments.report:
        refuse_without_effect(arguments.stated, "deflect", ("--plane",), "with --no-report", "the report, with its map")
    cell, model, robot = calibrated(arguments)
    task = task_of(arguments.poses, arguments, cell)
    inputs = {"model": digest_of(arguments.model)}
    if arguments.poses is not None:
        inputs["poses"] = digest_of(arguments.poses)
    plane = arguments.plane if arguments.report else None
    done = deflected(robot, model, task, axes=arguments.axes, plane=plane)
    if arguments.report:
        report_progress(arguments, 0.5, "drawing the report")
    write_files(arguments.out, files_of(done, cell, inputs, report=arguments.report))
    return f"{summary(done)}\ndeflections: {arguments.out / DEFLECTIONS}\n{report_line(arguments)}"


def files_of(done: Deflected, cell: Cell, inputs: Inputs, *, report: bool) -> dict[str, Content]:
    """Return everything that the command writes: file name -> content.

    Args:
        done: The deflections.
        cell: Their cell.
        inputs: Role -> file -> SHA-256 of input files besides the cell's.
        report: Whether the report is among them.
    """
    result = result_json(deflection_result(done, cell, inputs))
    files: dict[str, Content] = {RESULT: result, DEFLECTIONS: deflections_csv(done.found)}
    if report:
        from calibration_core.report.documents.application import deflection_document, space_of
        from calibration_core.report.view3d.space import space_view
        from calibration_core.report.writing.rendering import rendered

        view = space_view(space_of(cell, done.robot, done.q, done.task.wrench), cell)
        files |= rendered(deflection_document(done, cell, inputs, result), view)
    return files


def deflections_csv(found: Deflection) -> bytes:
    """Return one line per row and point: m and rad, base axes; intervals empty without a covariance."""
    head = ["row", "point", *MOVED, *(f"u95_{name}" for name in MOVED)]
    places = ((k, p, name) for k in range(len(found.moved)) for p, name in enumerate(found.names))
    return csv_bytes(head, ([k + 1, name, *found.moved[k, p], *found.u95[k, p]] for k, p, name in places))


def deflection_result(done: Deflected, cell: Cell, inputs: Inputs) -> dict[str, Any]:
    """Return the content of result.json."""
    found, task = done.found, done.task
    stiff, axes = found.stiffness()
    tool = found.names.index(TOOL)
    return command_result(
        "deflect",
        cell,
        {"file": "", "configurations": len(task), "steps": len(task), "points": list(found.names), "loaded": True},
        deflections=[
            {
                "row": k + 1,
                "point": name,
                "moved": found.moved[k, p].tolist(),
                "u95": [finite_or_none(float(x)) for x in found.u95[k, p]],
            }
            for k in range(len(task))
            for p, name in enumerate(found.names)
        ],
        largest={"value": float(np.linalg.norm(found.moved[:, tool, :3], axis=1).max()), "unit": "m"},
        stiffness_ellipsoid=[
            {
                "row": k + 1,
                "stiffness": [finite_or_none(float(x)) for x in stiff[k]],
                "directions": axes[k].tolist(),
                "unit": "N/m",
            }
            for k in range(len(task))
        ],
        outside_valid_range=done.outside,
        remarks=done.remarks,
        files=[DEFLECTIONS],
        input=input_record(cell, None, inputs),
        summary=summary(done).splitlines(),
    )


def summary(done: Deflected) -> str:
    """Return what came out, in a few lines; lengths in mm, angles in mrad."""
    found, lines = done.found, []
    tool = found.names.index(TOOL)
    stiff, axes = found.stiffness()
    for k in range(min(len(done.task), 5)):
        moved, bound = 1e3 * found.moved[k, tool], 1e3 * found.u95[k, tool]
        shift = ", ".join(_with_bound(x, u) for x, u in zip(moved[:3], bound[:3], strict=True))
        turn = ", ".join(_with_bound(x, u) for x, u in zip(moved[3:], bound[3:], strict=True))
        softest = ", ".join(f"{x:z.2f}" for x in axes[k, 0])
        lines.append(f"row {k + 1}: tool moves ({shift}) mm and turns ({turn}) mrad (95 %)")
        lines.append(
            f"  softest {1e-6 * stiff[k, 0]:.3f} N/µm along ({softest}), stiffest {1e-6 * stiff[k, 2]:.3f} N/µm"
        )
    if len(done.task) > 5:
        lines.append(f"{len(done.task) - 5} further rows in {DEFLECTIONS}")
    return "\n".join([*lines, *outside_lines(done.outside), *done.remarks])


def _with_bound(value: float, bound: float) -> str:
    return f"{value:z.4f}" if np.isnan(bound) else f"{value:z.4f} ± {bound:.4f}"
