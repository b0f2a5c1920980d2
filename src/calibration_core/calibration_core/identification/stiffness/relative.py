"""Residuals of loaded readings as figures have them: without the free offsets, or since step 0 of displacements."""

from __future__ import annotations

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.statistics.offsets import without_offsets
from calibration_core.identification.stiffness.predict import from_step_zero, references
from calibration_core.identification.stiffness.problem import Linearised, LoadedProblem
from calibration_core.timeseries import Bool1D, Float2D, Int1D, Readings


def relative(problem: LoadedProblem, linear: Linearised, cell: Cell, used: Int1D | Bool1D | None = None) -> Float2D:
    """Return the (m, 3) m residuals after the best offsets; for displacement recordings, relative to step 0.

    Args:
        problem: All readings.
        linear: The problem at some compliances, with the residuals.
        cell: The cell file.
        used: Readings that the offsets rest on, as indices or mask; None: all.
    """
    if cell.measurements.points == "displacement":
        return from_step_zero(problem.readings, linear.residual)
    return without_offsets(linear.rows if used is None else linear.rows.counting(used), linear.residual)


def counted(readings: Readings, cell: Cell) -> Bool1D:
    """Say which readings count in the figures, (m,): all but step 0 of a displacement recording, zero by definition."""
    if cell.measurements.points == "absolute":
        return np.ones(len(readings), dtype=bool)
    return ~references(readings)
