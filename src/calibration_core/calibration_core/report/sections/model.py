"""The joints of a given model: what they yield, and where their frames stand against the cell file's geometry."""

from __future__ import annotations

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.parameters import ModelParameters
from calibration_core.report.document import Column, Table
from calibration_core.report.rounding import DASH, STIFFNESS, padded, shortened, significant, spread
from calibration_core.report.sections.stiffness import symbol


def model_table(parameters: ModelParameters, cell: Cell, caption: str, note: str = "") -> Table:
    """Return stiffness and correction of the geometry, joint by joint, beside the cell file's stiffness.

    Args:
        parameters: The model.
        cell: The cell.
        caption: Of the table.
        note: Small print, after what a frame is.
    """
    stated = cell.robot.stiffness
    rows = []
    for i, (joint, compliance) in enumerate(zip(parameters.joints, parameters.compliance, strict=True)):
        value = significant(STIFFNESS.factor / float(compliance), 4) if compliance > 0 else "rigid"
        cell_file = DASH if stated is None else significant(stated[i] * STIFFNESS.factor, 4)
        moved = spread(1e3 * float(np.linalg.norm(parameters.geometry[i, :3])))
        turned = spread(1e3 * float(np.linalg.norm(parameters.geometry[i, 3:])))
        rows.append((symbol(i + 1), shortened(joint), value, cell_file, moved, turned))
    columns = (
        Column("Joint", "left"),
        Column("Name", "left", wide=True),
        Column(f"Stiffness [{STIFFNESS.name}]"),
        Column("Cell file"),
        Column("Frame moved [mm]"),
        Column("Frame turned [mrad]"),
    )
    frame = "“Frame”: correction of the frame before the joint against the cell file's geometry."
    return Table(caption, columns, padded(rows), f"{frame} {note}".strip())
