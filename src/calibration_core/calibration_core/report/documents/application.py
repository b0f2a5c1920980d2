"""The reports of `compensate` and `deflect`."""

from __future__ import annotations

import datetime as dt
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.compensation.compensate import OK
from calibration_core.compensation.deflection import TOOL
from calibration_core.compensation.robot import CalibratedRobot
from calibration_core.identification.result.estimate import OperatingSpace
from calibration_core.model.simulation.simulate import Schedule
from calibration_core.outcomes.compensation import Applied, Deflected
from calibration_core.outcomes.inputs import Inputs
from calibration_core.outcomes.spaces import scheduled_space
from calibration_core.report.document import (
    Block,
    Column,
    Document,
    Facts,
    Figure,
    Items,
    Section,
    Table,
    Verdict,
    cleaned,
    numbered,
)
from calibration_core.report.figures.application import errors_figure
from calibration_core.report.figures.deflection_map import map_figure
from calibration_core.report.rounding import counted, fixed, padded
from calibration_core.report.sections.records import traceability_section
from calibration_core.report.writing.rendering import document_number
from calibration_core.timeseries import Float2D

MOST_ROWS = 40
MOST_DRAWN = 60
STATEMENT = (
    "Predicted by the identified model; nothing was measured. Intervals hold the covariance of what was identified, "
    "not the robot's repeatability, nor what the model leaves out."
)


def compensation_document(applied: Applied, cell: Cell, inputs: Inputs, result: bytes) -> Document:
    """Build the report of a compensated task."""
    found = applied.found
    ok = found.ok
    before, after = (1e3 * np.linalg.norm(error, axis=1) for error in (found.error_before, found.error_after))
    bound = 1e3 * found.u95
    lines = []
    if ok.any():
        lines.append(
            ("Without", f"Error at the tool {before[ok].mean():.3f} mm on average, {before[ok].max():.3f} mm at worst")
        )
        known = bound[ok][np.isfinite(bound[ok])]
        if len(known):
            text = f"at most {known.mean():.3f} mm on average, {known.max():.3f} mm at worst (95 %)"
            lines.append(("With", f"Error to be expected {text}"))
    counts = Counter(status for status in found.status if status != OK)
    lines += [("Refused", f"{counted(number, 'row')}: {why}") for why, number in counts.most_common()]
    rows = [
        (str(k + 1), *(fixed(float(x), 3) for x in (before[k], after[k], bound[k])), found.status[k])
        for k in range(min(len(ok), MOST_ROWS))
    ]
    columns = (
        Column("Row"),
        Column("Error before [mm]"),
        Column("Predicted after [mm]"),
        Column("95 % [mm]"),
        Column("Status", "left", wide=True),
    )
    note = "" if len(ok) <= MOST_ROWS else f"The first {MOST_ROWS} of {len(ok):,} rows; all stand in compensated.csv."
    verdict = Verdict(f"{int(ok.sum()):,} of {len(ok):,} targets corrected", tuple(lines))
    front: tuple[Block, ...] = (Table("Targets", columns, padded(rows), note),)
    if ok.any():
        caption = (
            "Errors at the tool, row by row: without the correction, and what is to be expected with it; below 0.1 µm "
            "drawn at 0.1 µm."
        )
        drawn = errors_figure(before, after, bound, ("row", "predicted with"))
        front = (*front, Figure("errors", caption, caption, drawn))
    texts = (*_beyond(applied.outside), *applied.remarks) or ("Every row lies within the model's valid range.",)
    sections = (Section("Range and remarks", "", (Items(texts),)),)
    facts = _facts(cell, inputs, len(ok))
    return _document("Compensated targets", result, facts, verdict, front, (*sections, _records(cell, inputs)))


def deflection_document(done: Deflected, cell: Cell, inputs: Inputs, result: bytes) -> Document:
    """Build the report of deflections."""
    found = done.found
    tool = found.names.index(TOOL)
    size = 1e3 * np.linalg.norm(found.moved[:, tool, :3], axis=1)
    stiff, axes = found.stiffness()
    shown = range(min(len(size), MOST_ROWS))
    rows = [
        (str(k + 1), name, *map(_bounded, found.moved[k, p], found.u95[k, p]))
        for k in shown
        for p, name in enumerate(found.names)
    ]
    springs = [
        (str(k + 1), f"{1e-6 * stiff[k, axis]:.3f}", *(f"{x:z.3f}" for x in axes[k, axis]))
        for k in shown
        for axis in range(3)
    ]
    moved = tuple(
        Column(name) for name in ("x [mm]", "y [mm]", "z [mm]", "about x [mrad]", "about y [mrad]", "about z [mrad]")
    )
    note = f"Base axes, against {done.reference}; intervals of 95 %."
    if len(size) > MOST_ROWS:
        note += f" The first {MOST_ROWS} of {len(size):,} rows; all stand in deflections.csv."
    front: tuple[Block, ...] = (
        Table("Deflections", (Column("Row"), Column("Point", "left"), *moved), padded(rows), note),
        Table(
            "Stiffness of the tool's point",
            (Column("Row"), Column("Stiffness [N/µm]"), Column("x"), Column("y"), Column("z")),
            padded(springs),
            "Main directions of the ellipsoid, base axes, the softest first.",
        ),
    )
    if done.chart is not None and np.isfinite(done.chart.size).any():
        caption = f"Deflection of the tool over the {done.chart.plane} plane of row 1, orientation and load kept."
        front = (
            *front,
            Figure(
                "map",
                caption,
                caption,
                map_figure(done.chart.across, done.chart.up, 1e3 * done.chart.size, done.chart.plane),
            ),
        )
    verdict = Verdict(
        f"The tool yields by at most {size.max():.3f} mm", (("Softest", f"{1e-6 * stiff[:, 0].min():.3f} N/µm"),)
    )
    remarks = (*_beyond(done.outside), *done.remarks) or ("Everything that moves the tool has its interval.",)
    sections = (Section("Remarks", "", (Items(remarks),)), _records(cell, inputs))
    return _document("Deflection under load", result, _facts(cell, inputs, len(size)), verdict, front, sections)


def _beyond(outside: Mapping[str, Sequence[int]]) -> list[str]:
    return [
        f"{key}: {counted(len(numbers), 'row')} beyond what the recording covered" for key, numbers in outside.items()
    ]


def _bounded(value: float, bound: float) -> str:
    """Return a length in mm, or an angle in mrad, with its interval where there is one."""
    return f"{1e3 * value:z.4f}" + ("" if np.isnan(bound) else f" ± {1e3 * bound:.4f}")


def space_of(cell: Cell, robot: CalibratedRobot, q: Float2D, wrench: Float2D) -> OperatingSpace:
    """Return the places, for the drawing that can be turned; a part of many."""
    rows = np.unique(np.linspace(0, len(q) - 1, min(len(q), MOST_DRAWN)).round().astype(np.int64))
    schedule = Schedule(rows + 1, np.zeros(len(rows), dtype=np.int64), q[rows], np.zeros_like(wrench[rows]))
    return scheduled_space(schedule, cell, robot.parameters)


def _document(
    title: str, result: bytes, facts: Facts, verdict: Verdict, front: tuple[Block, ...], sections: tuple[Section, ...]
) -> Document:
    return numbered(
        cleaned(
            Document(
                number=document_number(result),
                title=title,
                subtitle="By a model that was identified according to CWA 17384",
                facts=facts,
                verdict=verdict,
                front=front,
                sections=sections,
                signatures=("Evaluated by", "Approved by"),
                statement=STATEMENT,
            )
        )
    )


def _facts(cell: Cell, inputs: Inputs, rows: int) -> Facts:
    files = [
        (role.capitalize(), ", ".join(f"{name} (SHA-256 {digest[:12]}…)" for name, digest in of.items()))
        for role, of in inputs.items()
    ]
    return Facts((
        ("Industrial robot", cell.robot.name), ("Cell", cell.name), ("Date", f"{dt.datetime.now(dt.UTC):%Y-%m-%d}"),
        ("Rows", f"{rows:,}"), *files,
    ))  # fmt: skip


def _records(cell: Cell, inputs: Inputs) -> Section:
    return Section("Input and software", "", traceability_section(cell, None, inputs))
