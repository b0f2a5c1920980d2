"""What is measured, as markers for RViz: points on the flange; operating space and deflections in the base frame.

Everything has the stamp zero: it is shown at the newest transform.  The deflections are as long as the scene says.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from geometry_msgs.msg import Point, Pose, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from calibration.conversions import to_point
from calibration_core.cell import Cell
from calibration_core.report.results.scene import Scene

MEASUREMENT = ColorRGBA(r=0.1, g=0.5, b=0.9, a=1.0)
WRENCH = ColorRGBA(r=0.9, g=0.5, b=0.1, a=1.0)
SIZE = 0.02  # m, diameter of a point
DEFLECTION = ColorRGBA(r=0.85, g=0.1, b=0.1, a=1.0)
SPACE = ColorRGBA(r=0.2, g=0.7, b=0.3, a=0.15)


def to_markers(cell: Cell, scene: Scene | None) -> MarkerArray:
    """Return all markers; they replace the ones before.

    Args:
        cell: For the points on the flange, as the cell file has them.
        scene: Operating space and deflections; None if nothing has been planned or evaluated yet.
    """
    markers = [Marker(action=Marker.DELETEALL), *_on_flange(cell)]
    if scene is not None:
        markers += _in_space(scene, cell.robot.base_link or "base_link")
    return MarkerArray(markers=markers)


def _on_flange(cell: Cell) -> Iterator[Marker]:
    flange = cell.robot.flange or "flange"
    points: Mapping[str, Any] = cell.frames.measurement_points
    named = [(name, place, MEASUREMENT, "measurement_points") for name, place in points.items()]
    if cell.frames.wrench_point is not None:
        named.append(("wrench point", cell.frames.wrench_point, WRENCH, "wrench_point"))
    for number, (name, place, colour, space) in enumerate(named):
        pose = Pose(position=to_point(place))
        size = Vector3(x=SIZE, y=SIZE, z=SIZE)
        yield _marker(flange, space, number, Marker.SPHERE, colour, pose=pose, scale=size)
        text = Vector3(z=2 * SIZE)
        yield _marker(
            flange, f"{space}_names", number, Marker.TEXT_VIEW_FACING, colour, pose=pose, scale=text, text=name
        )


def _in_space(scene: Scene, base: str) -> Iterator[Marker]:
    size = Vector3(x=SIZE, y=SIZE, z=SIZE)
    lists = [(f"space_{name}", places, MEASUREMENT) for name, places in scene.points.items()]
    for space, places, colour in (*lists, ("space_wrench_point", scene.wrench_point, WRENCH)):
        if len(places):
            points = [to_point(place) for place in places]
            yield _marker(base, space, 0, Marker.SPHERE_LIST, colour, points=points, scale=size)
    thin = Vector3(x=SIZE / 4, y=SIZE / 2, z=0.0)
    for number, (start, end) in enumerate(scene.arrows):
        ends: list[Point] = [to_point(start), to_point(end)]
        yield _marker(base, "deflection", number, Marker.ARROW, DEFLECTION, points=ends, scale=thin)
    centre, edges = scene.box
    x, y, z = (float(edge) for edge in edges)
    yield _marker(
        base,
        "operating_space",
        0,
        Marker.CUBE,
        SPACE,
        pose=Pose(position=to_point(centre)),
        scale=Vector3(x=x, y=y, z=z),
    )


def _marker(frame: str, namespace: str, number: int, kind: int, colour: ColorRGBA, **fields: Any) -> Marker:
    header = Header(frame_id=frame)
    return Marker(header=header, ns=namespace, id=number, type=kind, action=Marker.ADD, color=colour, **fields)
