"""The report of a simulated recording: by which model, with which noise, and what comes out."""

from __future__ import annotations

import datetime as dt

import numpy as np

from calibration_core.cell import Cell
from calibration_core.outcomes.simulation import BAG, TABLE, Simulated
from calibration_core.report.document import (
    Block,
    Column,
    Document,
    Facts,
    Paragraph,
    Section,
    Table,
    Verdict,
    cleaned,
    numbered,
)
from calibration_core.report.rounding import counted, fixed, padded, shortened, spread
from calibration_core.report.sections.model import model_table
from calibration_core.report.sections.procedure import (
    MOST_ROWS,
    SHOWN_ROWS,
    configurations,
    equipment,
    operating_space,
    rated_force,
)
from calibration_core.report.sections.records import traceability_section
from calibration_core.report.writing.rendering import document_number
from calibration_core.timeseries import NANOSECONDS

STATEMENT = (
    "These are no measurements. The recording is the model's own prediction: evaluating it shows what the procedure "
    "can determine, not whether the model is true. Dates and times in it are arbitrary."
)
EQUILIBRIUM = "Equilibrium on the deformed geometry; gravity and the complementary stiffness K_CSM are included."


def simulation_document(simulated: Simulated, cell: Cell, result: bytes, day: dt.date | None = None) -> Document:
    """Build the report of a simulated recording.

    Args:
        simulated: What was simulated.
        cell: The cell.
        result: The bytes of result.json, for the report's number.
        day: Date of the simulation; today (UTC) if not given.
    """
    day = day or dt.datetime.now(dt.UTC).date()
    table1 = [one.number for one in simulated.plan.primary], np.array([one.q for one in simulated.plan.primary])
    sections = (
        Section("Operating space", "8 g)", operating_space(simulated.space)),
        Section("Manipulator configurations", "8 d)", configurations(*table1, cell.prismatic)),
        Section("Predicted deflections", "", _deflections(simulated)),
        Section("Noise", "5.3", (Paragraph(_noise(simulated)), *equipment(cell))),
        Section("Recording", "", _recording(simulated)),
        Section("Input and software", "", traceability_section(cell, None, simulated.inputs, simulated.notes)),
    )
    document = Document(
        number=document_number(result),
        title="Simulated recording",
        subtitle="Simulation for a calibration according to CWA 17384, no measurement",
        facts=_facts(simulated, cell, day),
        verdict=_verdict(simulated),
        front=(model_table(simulated.parameters, cell, "The simulated model", EQUILIBRIUM),),
        sections=sections,
        signatures=("Simulated by",),
        statement=STATEMENT,
    )
    return numbered(cleaned(document))


def _steps(simulated: Simulated) -> int:
    return sum(len(one.steps) for one in simulated.plan.primary)


def _largest_force(simulated: Simulated) -> float:
    return float(max(np.linalg.norm(one.steps[:, :3], axis=1).max() for one in simulated.plan.primary))


def _facts(simulated: Simulated, cell: Cell, day: dt.date) -> Facts:
    readings, force = simulated.readings, _largest_force(simulated)
    load = f"forces up to {force:,.0f} N, {100 * force / rated_force(cell):.0f} % of the rated load"
    rows = (
        ("Industrial robot", cell.robot.name),
        ("Cell", cell.name),
        ("Simulated on", f"{day:%Y-%m-%d}"),
        (
            "Extent",
            (
                f"{counted(len(simulated.plan.primary), 'configuration')}, {counted(_steps(simulated), 'step')}, "
                f"{counted(len(readings.points), 'measurement point')}, {counted(len(readings), 'reading')}"
            ),
        ),
        ("Applied load", load if force > 0 else "none besides the robot's own weight"),
        ("Plan", "made for this simulation, see plan.yaml" if simulated.made else _source(simulated, "plan")),
        ("Model", _source(simulated, "model") if "model" in simulated.inputs else "the cell file's"),
    )
    return Facts(rows)


def _source(simulated: Simulated, role: str) -> str:
    return ", ".join(shortened(name, 80) for name in simulated.inputs[role])


def _verdict(simulated: Simulated) -> Verdict:
    lines = [("Noise", _noise(simulated))]
    if np.any(simulated.deflections > 0):
        size = 1e3 * simulated.deflections
        lines.append(
            (
                "Deflection",
                (
                    f"of {shortened(simulated.readings.points[0])} under the largest load: {spread(float(size.min()))} "
                    f"to {spread(float(size.max()))} mm"
                ),
            )
        )
    lines.append(("Files", f"the same readings stand in {BAG} (rosbag2, mcap) and {TABLE} (measurement table)"))
    if simulated.plan.spares:
        lines.append(("Spares", f"{counted(len(simulated.plan.spares), 'spare')} of the plan left out"))
    headline = f"Recording simulated: {counted(len(simulated.readings), 'reading')}"
    return Verdict(headline, tuple((label, text[0].upper() + text[1:]) for label, text in lines))


def _noise(simulated: Simulated) -> str:
    if simulated.seed is None:
        return "No noise: every reading is exactly what the model predicts."
    return (
        f"Normal noise of the instruments as stated in the cell file, seed {simulated.seed}; all points of a step "
        "share one wrench reading."
    )


def _deflections(simulated: Simulated) -> tuple[Block, ...]:
    space = simulated.space
    if space.force is None or space.deflection is None:
        return (Paragraph("Nothing is loaded: the recording holds positions under the robot's own weight."),)
    shown = len(space.q) if len(space.q) <= MOST_ROWS else SHOWN_ROWS
    rows = [
        (
            f"{int(space.configuration[i])}",
            f"{float(np.linalg.norm(space.force[i])):,.0f}",
            *(fixed(1e3 * float(part), 3) for part in space.deflection[i]),
            fixed(1e3 * float(simulated.deflections[i]), 3),
        )
        for i in range(shown)
    ]
    columns = (
        Column("Configuration"),
        Column("Largest force [N]"),
        *(Column(f"{axis} [mm]") for axis in "xyz"),
        Column("Length [mm]"),
    )
    note = "Base axes, relative to the equilibrium under the robot's own weight."
    if shown < len(space.q):
        note += f" First {shown} of {len(space.q):,}; every reading stands in {TABLE}."
    caption = f"Predicted deflection of {shortened(simulated.readings.points[0])} under the largest force"
    return (Table(caption, columns, padded(rows), note),)


def _recording(simulated: Simulated) -> tuple[Block, ...]:
    recording = simulated.recording
    counts = recording.provenance.messages
    seconds = (int(recording.joints.time[-1]) - int(recording.joints.time[0])) / NANOSECONDS
    rows = tuple((topic, f"{count:,}", f"{count / seconds:.1f}") for topic, count in counts.items())
    columns = (Column("Topic", "left", wide=True), Column("Messages"), Column("Mean rate [1/s]"))
    text = (
        f"{seconds / 60:,.1f} minutes: the robot moves to a configuration, the load rises and falls in steps, and in "
        "each measuring window the samples scatter about the reading of the table."
    )
    return (Paragraph(text), Table("Messages in the bag", columns, rows))
