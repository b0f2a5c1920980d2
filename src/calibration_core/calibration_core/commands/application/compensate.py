"""`calibration compensate`: corrected targets for a calibrated, loaded robot."""

from __future__ import annotations

import argparse
from collections import Counter
from typing import Any

import numpy as np

from calibration_core.cell import Cell
from calibration_core.commands.application.inputs import calibrated, numbers, outside_lines, task_of
from calibration_core.commands.shared.common import report_line, report_progress
from calibration_core.compensation.compensate import OK
from calibration_core.compensation.tables import compensated_csv, poses_csv, trajectory_yaml
from calibration_core.compensation.task import Task
from calibration_core.engine.command_line import refuse_without_effect
from calibration_core.outcomes.compensation import Applied, apply
from calibration_core.outcomes.inputs import Inputs, digest_of
from calibration_core.report.results.command import command_result, input_record
from calibration_core.report.results.result import result_json
from calibration_core.report.writing.output import RESULT, Content, write_files

COMPENSATED, POSES, TRAJECTORY = "compensated.csv", "poses.csv", "trajectory.yaml"


def run(arguments: argparse.Namespace) -> str:
    """Compensate a task, write the corrected targets, and return a summary.

    Raises:
        InputError: The input cannot be used, or the output cannot be written.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    report_progress(arguments, 0.0, "correcting the targets")
    cell, model, robot = calibrated(arguments)
    task = task_of(arguments.task, arguments, cell)
    _refuse_idle(arguments, task)
    n = robot.chain.n
    seed = None
    if arguments.seed_q is not None:
        seed = numbers("--seed-q", arguments.seed_q, n, f"{n} joint angles, rad (m where a joint slides)")
    applied = apply(robot, model, task, axes=arguments.axes, seed_q=seed)
    if arguments.report:
        report_progress(arguments, 0.5, "drawing the report")
    inputs = {"model": digest_of(arguments.model), "task": digest_of(arguments.task)}
    write_files(arguments.out, files_of(applied, cell, inputs, report=arguments.report))
    return f"{summary(applied)}\ntargets: {arguments.out / COMPENSATED}\n{report_line(arguments)}"


def _refuse_idle(arguments: argparse.Namespace, task: Task) -> None:
    """Refuse stated options that have no effect on this task."""
    if task.q is not None:
        where = "on a task with q1 ... qn, which choose the branch"
        refuse_without_effect(arguments.stated, "compensate", ("--seed-q",), where, "a task of places alone")
    if not np.any(task.wrench):
        where = "without a wrench other than zero"
        refuse_without_effect(arguments.stated, "compensate", ("--axes",), where, "--wrench, or fx ... tz in the task")


def files_of(applied: Applied, cell: Cell, inputs: Inputs, *, report: bool) -> dict[str, Content]:
    """Return everything that the command writes: file name -> content.

    Args:
        applied: The compensated task.
        cell: Its cell.
        inputs: Role -> file -> SHA-256 of input files besides the cell's.
        report: Whether the report is among them.
    """
    task, found, robot = applied.task, applied.found, applied.robot
    result = result_json(compensation_result(applied, cell, inputs))
    files: dict[str, Content] = {
        RESULT: result,
        COMPENSATED: compensated_csv(task, found),
        POSES: poses_csv(found),
        TRAJECTORY: trajectory_yaml(robot.chain.joints, found, applied.time),
    }
    if report:
        from calibration_core.report.documents.application import compensation_document, space_of
        from calibration_core.report.view3d.space import space_view
        from calibration_core.report.writing.rendering import rendered

        view = space_view(space_of(cell, robot, found.nominal, task.wrench), cell)
        files |= rendered(compensation_document(applied, cell, inputs, result), view)
    return files


def compensation_result(applied: Applied, cell: Cell, inputs: Inputs) -> dict[str, Any]:
    """Return the content of result.json."""
    found, task = applied.found, applied.task
    before, after = (np.linalg.norm(error[found.ok], axis=1) for error in (found.error_before, found.error_after))
    bound = found.u95[found.ok]
    refused = [{"row": k + 1, "reason": status} for k, status in enumerate(found.status) if status != OK]
    return command_result(
        "compensate",
        cell,
        {
            "file": "",
            "configurations": len(task),
            "steps": len(task),
            "points": [],
            "loaded": bool(np.any(task.wrench)),
        },
        rows=len(task),
        compensated=int(found.ok.sum()),
        refused=refused,
        error_before=_figures(before),
        error_after=_figures(after),
        u95=_figures(bound[np.isfinite(bound)]),
        without_interval=int(np.sum(~np.isfinite(bound))),
        outside_valid_range=applied.outside,
        remarks=applied.remarks,
        files=[COMPENSATED, POSES, TRAJECTORY],
        input=input_record(cell, None, inputs),
        summary=summary(applied).splitlines(),
    )


def _figures(sizes: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, Any]:
    if not len(sizes):
        return {"mean": None, "max": None, "unit": "m"}
    return {"mean": float(sizes.mean()), "max": float(sizes.max()), "unit": "m"}


def summary(applied: Applied) -> str:
    """Return what came out, in a few lines."""
    found = applied.found
    ok = found.ok
    lines = [f"{int(ok.sum())} of {len(ok)} rows compensated"]
    if ok.any():
        before = np.linalg.norm(found.error_before[ok], axis=1)
        lines[0] += (
            f"; error at the tool without: mean {1e3 * before.mean():.3f} mm, largest {1e3 * before.max():.3f} mm"
        )
        known = found.u95[ok][np.isfinite(found.u95[ok])]
        if len(known):
            lines.append(
                f"expected with (95 %): {1e3 * known.mean():.3f} mm on average, {1e3 * known.max():.3f} mm at worst"
            )
    counts = Counter(status for status in found.status if status != OK)
    lines += [f"refused: {number} ({why})" for why, number in counts.most_common()]
    return "\n".join([*lines, *outside_lines(applied.outside), *applied.remarks])
