"""Where a recording or a plan stands in space: the robot in every configuration, its points, forces and deflections."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison.result import WaterfallStep
from calibration_core.identification.result.estimate import OperatingSpace
from calibration_core.report.figures.operating_space import deflection_scale, evenly, force_scale, round_scale
from calibration_core.report.view3d.view import DEFLECTION, FORCE, Arrow, ArrowKind, View, cell_view
from calibration_core.timeseries import Float1D, Float2D, Int1D

MOST_POSTURES = 200
MOST_PLACES = 2000
MOST_ARROWS = 400
BEFORE, AFTER = (0.76, 0.15, 0.10), (0.10, 0.52, 0.25)  # colours of a difference, from its first step to its last


def space_view(space: OperatingSpace, cell: Cell, waterfall: Sequence[WaterfallStep] = ()) -> View:
    """Return an operating space (CWA 17384, 8 g) with the robot of its cell.

    Of more than `MOST_POSTURES` configurations evenly spaced ones can be chosen; all have their points shown, up to
    `MOST_PLACES`.

    Args:
        space: The operating space.
        cell: Its cell.
        waterfall: From a simulation to the noise: what each step leaves can be shown, alike enlarged.

    Raises:
        CellError: The robot cannot be read.
    """
    rows = evenly(len(space.q), MOST_POSTURES)
    postures = [(str(int(space.configuration[i])), space.q[i]) for i in rows]
    view = cell_view(cell, postures)
    arrows: list[Arrow] = []
    kinds: list[ArrowKind] = []
    bent: tuple[Float1D, ...] = ()
    if space.force is not None:
        start = space.flange if space.wrench_point is None else space.wrench_point
        arrows += _arrows("force", start, np.asarray(space.force) * force_scale(space), rows)
        largest = float(np.nanmax(np.linalg.norm(space.force, axis=1), initial=0.0))
        kinds.append(dataclasses.replace(FORCE, note=f"largest {largest:,.0f} N", shown=not waterfall))
    if space.deflection is not None:
        factor = deflection_scale(space)
        first = next(iter(space.points.values()), space.flange)
        arrows += _arrows("deflection", first, np.asarray(space.deflection) * factor, rows)
        kinds.append(dataclasses.replace(DEFLECTION, note=f"× {factor:g}", shown=not waterfall))
        if space.joint_deflection is not None and np.all(np.isfinite(space.joint_deflection)):
            bent = tuple((space.q + factor * np.asarray(space.joint_deflection))[rows])
    left, ways = _differences(space, rows, waterfall)
    most = MOST_PLACES // max(len(space.points), 1)
    places = {name: np.asarray(points)[evenly(len(points), most)] for name, points in space.points.items()}
    tracker = view.tracker if space.tracker is None else np.asarray(space.tracker)
    name = f"{cell.robot.name} in {len(space.q)} configurations"
    return dataclasses.replace(
        view, name=name, places=places, arrows=(*arrows, *ways), kinds=(*kinds, *left), tracker=tracker, bent=bent
    )


def _arrows(kind: str, start: Float2D, vectors: Float2D, rows: Int1D) -> list[Arrow]:
    return [
        Arrow(kind, k, np.asarray(start[i]), vectors[i])
        for k, i in enumerate(rows[:MOST_ARROWS])
        if np.all(np.isfinite(vectors[i])) and np.any(vectors[i])
    ]


def _differences(
    space: OperatingSpace, rows: Int1D, waterfall: Sequence[WaterfallStep]
) -> tuple[list[ArrowKind], list[Arrow]]:
    """Return what each step leaves, as arrows at the points: at the largest load, or at rest."""
    steps = [step for step in waterfall if step.arrows]
    factor = round_scale(np.array([way for step in steps for way in step.arrows.values()]).reshape(-1, 3), space)
    kinds, arrows = [], []
    for k, step in enumerate(steps):
        share = k / max(len(steps) - 1, 1)
        colour = tuple(a + share * (b - a) for a, b in zip(BEFORE, AFTER, strict=True))
        name = f"after {k}, {step.name}" if k else "difference"
        note = f"{1e6 * step.rms:.1f} µm" if k else f"{1e6 * step.rms:.1f} µm, × {factor:g}"
        kinds.append(ArrowKind(name, (colour[0], colour[1], colour[2]), note, shown=k in {0, len(steps) - 1}))
        for point, places in space.points.items():
            ways = [step.arrows.get((int(number), point), np.zeros(3)) for number in space.configuration]
            arrows += _arrows(
                name, np.asarray(places), factor * np.array(ways), rows[: MOST_ARROWS // len(space.points)]
            )
    return kinds, arrows
