"""What was left out, what was noticed, and on which files and programs the result rests."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from calibration_core.cell import Cell
from calibration_core.identification.result.estimate import Identification
from calibration_core.report.document import Block, Column, Facts, Items, Paragraph, Table
from calibration_core.report.results.provenance import digests, software
from calibration_core.report.rounding import counted, length_unit, padded, shortened, spread
from calibration_core.report.sections.procedure import MOST_ROWS, SHOWN_ROWS
from calibration_core.timeseries import Note, Provenance


def exclusion_section(result: Identification, by: str = "", *, readmits: bool = True) -> tuple[Block, ...]:
    """Return every reading that was not used, why, and how to use it after all.

    Args:
        result: What was identified.
        by: Which fit did not use it, for a report of more than one: ` by the fit of ...`.
        readmits: Whether the command can be asked to use a single one after all.
    """
    exclusions = result.exclusions
    if not exclusions:
        return (Paragraph(f"Every reading was used{by}."),)
    largest = max((item.size for item in exclusions if math.isfinite(item.size)), default=0.0)
    unit = length_unit(largest)
    shown = exclusions if len(exclusions) <= MOST_ROWS else exclusions[:SHOWN_ROWS]
    rows = [
        (
            str(item.configuration),
            str(item.step),
            shortened(item.point),
            spread(item.size * unit.factor),
            spread(item.times_sigma),
            item.reason,
        )
        for item in shown
    ]
    columns = (
        Column("Configuration"),
        Column("Step"),
        Column("Point", "left"),
        Column(f"Residual [{unit.name}]"),
        Column("In σ"),
        Column("Reason", "left", wide=True),
    )
    note = (
        ""
        if len(shown) == len(exclusions)
        else f"First {len(shown)} of {len(exclusions):,}; all stand in result.json and residuals.csv."
    )
    return (
        Paragraph(
            f"{counted(len(exclusions), 'reading was', 'readings were')} not used{by}. Nothing was deleted: each "
            "stays in the recording and, "
            "marked, in residuals.csv. " + (READMIT if readmits and result.kind == "loaded" else "") + USE_ALL
        ),
        Table("Readings not used", columns, padded(rows), note),
    )


READMIT = "A single one is used after all with --readmit CONFIGURATION:STEP:POINT. "
USE_ALL = "All of them are used with --no-robust."


def remark_section(result: Identification) -> tuple[Block, ...]:
    """Return anomalies of the data and remarks on reading them."""
    texts = [f"{item.kind.replace('_', ' ')}: {item.text}" for item in result.anomalies]
    texts += [f"{note.kind.replace('_', ' ')}, {note.place}: {note.text}" for note in result.notes[:MOST_ROWS]]
    if len(result.notes) > MOST_ROWS:
        texts.append(f"{len(result.notes) - MOST_ROWS:,} further remarks stand in result.json.")
    return (Items(tuple(texts)),) if texts else (Paragraph("Nothing was noticed."),)


def given_model(result: Identification) -> tuple[tuple[str, str], ...]:
    """Return the fact that a model was handed in, and what it already contained; nothing without one."""
    given = result.given
    if given is None:
        return ()
    text = f"{given.file} (SHA-256 {given.sha256[:12]}…), taken off the readings as known: {given.known_effects()}"
    return (("Given model", text),)


def traceability_section(
    cell: Cell,
    provenance: Provenance | None = None,
    further: Mapping[str, Mapping[str, str]] | None = None,
    notes: Sequence[Note] = (),
) -> tuple[Block, ...]:
    """Return the input files with their digests, and the versions of the software.

    Args:
        cell: The cell.
        provenance: The recording; None if none was read.
        further: Role -> file -> SHA-256 of further input files.
        notes: What must be stated of them.
    """
    files = digests(cell, provenance, further)
    counts = {} if provenance is None else provenance.messages
    messages = tuple((topic, f"{count:,}") for topic, count in counts.items())
    read = Table("Messages or rows read", (Column("Topic or table", "left", wide=True), Column("Number")), messages)
    versions = ", ".join(f"{package} {version}" for package, version in software().items())
    origin = tuple((label, text) for label, text in (("Origin of the data", cell.source), ("Note", cell.note)) if text)
    return (
        *(Paragraph(f"{note.place}: {note.text}.") for note in notes),
        *((Facts(origin),) if origin else ()),
        Table(
            "Input files", (Column("Role", "left"), Column("File", "left", wide=True), Column("SHA-256", "left")), files
        ),
        *((read,) if messages else ()),
        Facts((("Software", versions),)),
    )
