"""Where a recording or a plan stands in space: the robot in every configuration, its points, forces and deflections."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.result.estimate import OperatingSpace
from calibration_core.report.figures.operating_space import deflection_scale, evenly, force_scale
from calibration_core.report.view3d.view import Arrow, View, cell_view
from calibration_core.timeseries import Float1D, Float2D, Int1D

MOST_POSTURES = 200
MOST_PLACES = 2000
MOST_ARROWS = 400


def space_view(space: OperatingSpace, cell: Cell) -> View:
    """Return an operating space (CWA 17384, 8 g) with the robot of its cell.

    Of more than `MOST_POSTURES` configurations evenly spaced ones can be chosen; all have their points shown, up to
    `MOST_PLACES`.

    Raises:
        CellError: The robot cannot be read.
    """
    rows = evenly(len(space.q), MOST_POSTURES)
    postures = [(str(int(space.configuration[i])), space.q[i]) for i in rows]
    view = cell_view(cell, postures)
    arrows: list[Arrow] = []
    notes: dict[str, str] = {}
    bent: tuple[Float1D, ...] = ()
    if space.force is not None:
        start = space.flange if space.wrench_point is None else space.wrench_point
        arrows += _arrows("force", start, np.asarray(space.force) * force_scale(space), rows)
        notes["force"] = f"largest {float(np.nanmax(np.linalg.norm(space.force, axis=1), initial=0.0)):,.0f} N"
    if space.deflection is not None:
        factor = deflection_scale(space)
        first = next(iter(space.points.values()), space.flange)
        arrows += _arrows("deflection", first, np.asarray(space.deflection) * factor, rows)
        notes["deflection"] = f"× {factor:g}"
        if space.joint_deflection is not None and np.all(np.isfinite(space.joint_deflection)):
            bent = tuple((space.q + factor * np.asarray(space.joint_deflection))[rows])
    most = MOST_PLACES // max(len(space.points), 1)
    places = {name: np.asarray(points)[evenly(len(points), most)] for name, points in space.points.items()}
    tracker = view.tracker if space.tracker is None else np.asarray(space.tracker)
    name = f"{cell.robot.name} in {len(space.q)} configurations"
    return dataclasses.replace(
        view, name=name, places=places, arrows=tuple(arrows), notes=notes, tracker=tracker, bent=bent
    )


def _arrows(kind: Literal["force", "deflection"], start: Float2D, vectors: Float2D, rows: Int1D) -> list[Arrow]:
    return [
        Arrow(kind, k, np.asarray(start[i]), vectors[i])
        for k, i in enumerate(rows[:MOST_ARROWS])
        if np.all(np.isfinite(vectors[i])) and np.any(vectors[i])
    ]
