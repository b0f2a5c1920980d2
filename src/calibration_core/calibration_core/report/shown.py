"""The residuals as the report shows them: without reference rows, against the deviation to be expected after a fit."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.result.estimate import Identification, Residuals
from calibration_core.identification.stiffness.predict import references


def shown(identification: Identification, cell: Cell) -> Identification:
    """Return the same answer with the rows and expected deviations that figures and tables of residuals show.

    Where a recording holds displacements, the first step of every configuration and point is the reference: its
    residual is zero by definition and says nothing.  The expected deviation of a residual is smaller than that of a
    reading, because offsets and parameters were fitted: by sqrt(degrees of freedom / coordinates used).
    """
    result = identification
    keep = np.ones(len(result.readings), dtype=bool)
    if result.kind == "loaded" and cell.measurements.points == "displacement":
        keep = ~references(result.readings)
    residuals = result.residuals
    used = keep & ~np.asarray(residuals.excluded, dtype=bool)
    coordinates, freedom = 3 * int(np.count_nonzero(used)), result.fit.degrees_of_freedom
    factor = float(np.sqrt(freedom / coordinates)) if 0 < freedom <= coordinates else 1.0
    changes = {field.name: getattr(residuals, field.name)[keep] for field in dataclasses.fields(Residuals)}
    changes["sigma"] = changes["sigma"] * factor
    return dataclasses.replace(result, readings=result.readings.select(keep), residuals=Residuals(**changes))
