"""Several recordings of one robot in a report: what each contributed, and whether they show the same robot."""

from __future__ import annotations

import math
from collections.abc import Sequence

from calibration_core.identification.result.estimate import Contribution, JointStiffness, Together
from calibration_core.report.document import Block, Column, Items, Paragraph, Table
from calibration_core.report.rounding import COVERAGE, DASH, STIFFNESS, counted, decimals, fixed, shortened, spread

COMMON = "the common values there hold for none of them"
COLUMNS = (
    Column("No"),
    Column("Recording", "left", wide=True),
    Column("Configurations"),
    Column("numbered", "left"),
    Column("Readings"),
    Column("not used"),
    Column("Claimed noise [µm]"),
    Column("times"),
    Column("Residual [µm]"),
)


def together_lines(together: Together) -> list[str]:
    """Return in words, a line each, what every recording contributed and whether they agree."""
    lines = [
        f"recording {one.number}: {one.file}: {counted(one.configurations, 'configuration')} (numbered from "
        f"{one.numbers[0]}), {counted(one.readings, 'reading')}, claimed noise {spread(1e6 * one.noise)} µm times "
        f"{one.scale:.2f}, residual {spread(1e6 * one.rms)} µm"
        for one in together.contributions
    ]
    return [*lines, agreement_line(together)]


def agreement_line(together: Together) -> str:
    """Return in one line whether the recordings show the same robot."""
    if not together.compared:
        return "agreement: cannot tell, no parameter of the robot is known from two of the recordings"
    if not together.disagreements:
        return f"agreement: the recordings agree in {counted(len(together.compared), 'parameter')} of the robot"
    places = "; ".join(dict.fromkeys(f"{one.location} in {one.file}" for one in together.disagreements))
    off = bool(together.taken_off)
    common = "this is taken off, and the common values are those of the others" if off else COMMON
    return f"agreement: the recordings differ ({places}); {common}"


def together_blocks(together: Together, stiffness: Sequence[JointStiffness]) -> tuple[Block, ...]:
    """Return the section of a report; `stiffness` is what all recordings show together."""
    text = (
        "All recordings are of one robot: its stiffness, geometry and effects are shared. Tracker pose, measurement "
        "points, sensor, noise and reference temperature are each recording's own. Points are called POINT@NUMBER."
    )
    rows = tuple(_row(one) for one in together.contributions)
    blocks: list[Block] = [Paragraph(text), Table("Recordings", COLUMNS, rows)]
    if any(one.stiffness for one in together.contributions):
        blocks.append(_by_recording(together, stiffness))
    return (*blocks, Items((agreement_line(together),)))


def _by_recording(together: Together, stiffness: Sequence[JointStiffness]) -> Table:
    """Return the stiffness of every joint as each recording shows it by itself, beside that of all of them."""
    columns = (
        Column("Joint", "left", wide=True),
        *(Column(f"Recording {one.number}") for one in together.contributions),
        Column("All together"),
    )
    rows = []
    for joint in stiffness:
        named = shortened(joint.joint) if joint.unit == "N*m/rad" else f"{shortened(joint.joint)} [10⁵ N/m]"
        alone = [one.stiffness.get(joint.joint, (math.nan, math.nan)) for one in together.contributions]
        rows.append((named, *(_with_std(*pair) for pair in (*alone, (joint.value, joint.std)))))
    note = f"In {STIFFNESS.name}, each ± half of its 95 % interval; {DASH}: the recording does not determine it."
    return Table("Joint stiffness by recording", columns, tuple(rows), note)


def _with_std(value: float, std: float) -> str:
    if not (math.isfinite(value) and math.isfinite(std)):
        return DASH
    places = decimals(STIFFNESS.factor * std)
    return f"{fixed(STIFFNESS.factor * value, places)} ± {fixed(COVERAGE * STIFFNESS.factor * std, places)}"


def _row(one: Contribution) -> tuple[str, ...]:
    return (
        str(one.number),
        shortened(one.file),
        str(one.configurations),
        f"{one.numbers[0]} to {one.numbers[1]}",
        f"{one.readings:,}",
        f"{one.excluded:,}",
        spread(1e6 * one.noise),
        f"{one.scale:.2f}",
        spread(1e6 * one.rms),
    )
