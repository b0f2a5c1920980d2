"""Base frame, joint axes and wrist centre by circle points and spheres (CWA 17384, 7.1 to 7.3)."""

from __future__ import annotations

from calibration_core.cell import Cell
from calibration_core.identification.result.estimate import StandardGeometry
from calibration_core.report.document import Block, Column, Items, Table
from calibration_core.report.results.standard import standard_rows
from calibration_core.report.rounding import decimals, fixed, padded

GROUPS = {"base_frame": "base coordinate system", "joint_axes": "joint axis", "wrist_centre": "wrist centre point"}


def standard_section(found: StandardGeometry, cell: Cell) -> tuple[Block, ...]:
    """Return the values with their uncertainties, and what limits them or is missing."""
    rows = []
    for row in standard_rows(found, cell):
        factor, unit = 1e3, "mm" if row.unit == "m" else "mrad"
        places = decimals(row.std * factor)
        rows.append(
            (row.name, GROUPS[row.group], fixed(row.value * factor, places), fixed(row.std * factor, places), unit)
        )
    columns = (
        Column("Parameter", "left", wide=True),
        Column("Belongs to", "left"),
        Column("Value"),
        Column("Standard uncertainty"),
        Column("Unit", "left"),
    )
    wrist = ""
    if found.wrist is not None:
        place = ", ".join(fixed(1e3 * x, 3) for x in found.wrist.trilaterated)
        wrist = f" by a fit of all readings; by spheres and trilateration alone it is ({place}) mm"
    note = (
        "Tracker: pose in the base frame. Joint axes: corrections to the nominal geometry. Wrist centre: flange frame, "
        f"from {'identified' if found.points_fitted else 'nominal'} measurement points{wrist}. "
        "Bending by weight and loads was taken off the positions as the model has it."
    )
    warned = [*(found.base.warnings if found.base else ()), *(found.wrist.warnings if found.wrist else ())]
    missing = [f"no {GROUPS[name]}: {reason}" for name, reason in found.reasons.items()]
    table = Table("Results by circle points and spheres", columns, padded(rows), note)
    return (table, *([Items((*warned, *missing))] if warned or missing else []))
