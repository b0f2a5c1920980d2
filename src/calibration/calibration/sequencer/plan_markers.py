"""A plan, as markers for RViz: where its points will be measured."""

from __future__ import annotations

from visualization_msgs.msg import MarkerArray

from calibration.evaluation.markers import Look, to_markers
from calibration_core.cell import Cell
from calibration_core.outcomes.spaces import planned_space
from calibration_core.planning.plans.plan import Plan
from calibration_core.report.results.scene import scene_of, space_dict


def plan_markers(plan: Plan, cell: Cell, base: str, flange: str, size: float) -> MarkerArray:
    """Return the operating space of a plan, and the points on the flange.

    Args:
        plan: All configurations, spares included.
        cell: Its cell.
        base: Name of the base frame; empty: the cell file's, or base_link.
        flange: Name of the flange frame; empty: the cell file's, or flange.
        size: m, diameter of a point.
    """
    scene = scene_of(space_dict(planned_space(plan, cell)), scale=1.0)
    return to_markers(cell, scene, Look.of(cell, base, flange, size))
