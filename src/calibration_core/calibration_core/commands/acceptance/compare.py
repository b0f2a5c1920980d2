"""`calibration compare`: one robot at different times, or twins: what has changed, and what stays open."""

from __future__ import annotations

import argparse
import dataclasses
import datetime as dt
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from calibration_core.acceptance.comparison import OF_JOINTS
from calibration_core.commands.shared.common import report_line, report_progress
from calibration_core.errors import InputError, quoted
from calibration_core.identification.several.merge import cells_of
from calibration_core.outcomes.comparison import (
    Compared,
    compared_sources,
    date_of,
    described,
    described_trend,
    refuse_other_robots,
    reservations,
    source_of,
)
from calibration_core.report.results.command import command_result, input_record
from calibration_core.report.results.result import result_json
from calibration_core.report.results.traffic_light import light_of, with_light
from calibration_core.report.writing.output import RESULT, Content, write_files

UNCHANGED = "no stiffness, no law of a joint and no effect has changed"


def run(arguments: argparse.Namespace) -> str:
    """Compare, write result and report, and return a summary.

    Raises:
        InputError: The input cannot be used, or the output cannot be written.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    found = compared(arguments)
    if arguments.report:
        report_progress(arguments, 0.9, "drawing the report")
    write_files(arguments.out, files_of(found, report=arguments.report))
    return f"{comparison_summary(found)}\n{report_line(arguments)}"


def files_of(found: Compared, *, report: bool) -> dict[str, Content]:
    """Return everything that the command writes: file name -> content."""
    content = comparison_result(found)
    result = result_json(content)
    files: dict[str, Content] = {RESULT: result}
    if report:
        from calibration_core.report.documents.comparison import comparison_files

        files |= comparison_files(found, result, light_of(content))
    return files


def compared(arguments: argparse.Namespace) -> Compared:
    """Read, identify what is a recording, and compare.

    Raises:
        InputError: The input cannot be used.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    paths: list[Path] = arguments.measurements
    if len(paths) < 2:
        raise InputError("compare", "", f"{len(paths)} measurement", "two or more")
    cells = cells_of(arguments.cells, len(paths), "compare")
    refuse_other_robots(cells)
    dates = _dates(arguments.dates, len(paths))
    sources = []
    for k, (path, cell) in enumerate(zip(paths, cells, strict=True)):
        report_progress(arguments, 0.8 * k / len(paths), f"reading {path}")
        sources.append(source_of(path, cell))
    return compared_sources(sources, cells, dates)


def _dates(texts: Sequence[str] | None, count: int) -> list[dt.datetime | None]:
    if texts is None:
        return [None] * count
    if len(texts) != count:
        raise InputError("compare", "--dates", f"{len(texts)} dates", f"{count}, one for each measurement")
    dates = []
    for text in texts:
        date = date_of(text)
        if date is None:
            raise InputError("compare", "--dates", quoted(text), "ISO 8601, for example 2026-05-31")
        dates.append(date)
    return [*dates]


def comparison_result(found: Compared) -> dict[str, Any]:
    """Return the content of result.json."""
    first = found.measurements[0]
    recording = {
        "file": first.label,
        "configurations": first.configurations,
        "steps": found.steps,
        "points": list(found.cells[0].points),
        "loaded": found.loaded,
    }
    content = command_result(
        "compare",
        found.cells[0],
        recording,
        measurements=[
            {
                "file": one.label,
                "date": None if one.date is None else one.date.isoformat(),
                "configurations": one.configurations,
                "cell": str(cell.path),
            }
            for one, cell in zip(found.measurements, found.cells, strict=True)
        ],
        comparisons=[
            {"first": first.label, "second": other.label, "differences": [dataclasses.asdict(one) for one in rows]}
            for other, rows in zip(found.measurements[1:], found.differences, strict=True)
        ],
        trends=[dataclasses.asdict(one) for one in found.trends],
        remarks=list(found.remarks),
        input=input_record(found.cells[0], None, found.inputs),
    )
    content["summary"] = comparison_summary(found).splitlines()
    return with_light(content, UNCHANGED, further=reservations(found))


def comparison_summary(found: Compared) -> str:
    """Return what came out, a line each."""
    lines = []
    for other, rows in zip(found.measurements[1:], found.differences, strict=True):
        lines.append(f"{found.measurements[0].label} -> {other.label}")
        lines += [f"  {described(one)}" for one in rows if one.quantity in OF_JOINTS or one.verdict == "changed"]
        others = [one for one in rows if one.quantity not in OF_JOINTS and one.verdict != "changed"]
        if others:
            fine = sum(one.verdict == "not_changed" for one in others)
            lines.append(f"  backlash, hysteresis and effects: {fine} not changed, {len(others) - fine} cannot tell")
    lines += [described_trend(one) for one in found.trends if one.verdict == "changed"]
    steps = [step for _, step in reservations(found)[:1]]
    return "\n".join([*lines, *found.remarks, *(f"next: {step}" for step in steps)])
