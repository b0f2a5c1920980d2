"""The investigated operating space to turn: a self-contained 3-D scene (CWA 17384, 8 g)."""

from __future__ import annotations

import functools
import html
import json
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from calibration_core.identification.estimate import OperatingSpace
from calibration_core.report.document import printable
from calibration_core.report.space_figure import (
    MOST_ARMS,
    deflection_scale,
    evenly,
    force_scale,
    measured_points,
    reach,
)
from calibration_core.report.style import ACCENT, GREY, INK
from calibration_core.timeseries import Float2D, Int1D

MOST_POINTS = 2000
_SYMBOLS = ("circle", "diamond", "square", "cross", "x", "circle-open", "diamond-open", "square-open")


def space_scene(space: OperatingSpace) -> str:
    """Return the scene as JSON (`data`, `layout`) that is safe inside a script element.

    Every configuration is a polyline from base to flange (of many, evenly spaced ones), with the measurement points,
    the largest force at the wrench point, the deflection under it (enlarged), base axes and the convex outline, and
    where they are known the tracker with its beams and the boxes that stand in the cell.
    """
    size = reach(space)
    arms = evenly(len(space.q), MOST_ARMS)
    data = [_lines("robot", [space.joint_origins[i] for i in arms], "#b8b8b8", 2.0)]
    for i, (name, points) in enumerate(space.points.items()):
        rows = evenly(len(points), MOST_POINTS // max(len(space.points), 1))
        data.append(_points(f"point {printable(name, 30)}", points[rows], space.configuration[rows], _SYMBOLS[i % 8]))
    if space.force is not None:
        start = space.flange if space.wrench_point is None else space.wrench_point
        vectors = np.asarray(space.force) * force_scale(space)
        data.append(_lines("force", _shafts(start, vectors, arms), "#555555", 3.0))
    if space.deflection is not None:
        factor = deflection_scale(space)
        first = next(iter(space.points.values()), space.flange)
        shafts = _shafts(first, np.asarray(space.deflection) * factor, arms)
        data.append(_lines(f"deflection × {factor:g}", shafts, ACCENT, 5.0))
    data += _sight(space, arms)
    data += _boxes(space)
    data += _outline(measured_points(space))
    data += _base(0.15 * size)
    axis = {"backgroundcolor": "white", "gridcolor": "#dddddd", "zerolinecolor": "#aaaaaa", "showspikes": False}
    layout = {
        "scene": {
            **{f"{a}axis": {**axis, "title": {"text": f"{a} [m]"}} for a in "xyz"},
            "aspectmode": "data",
            "camera": {"eye": {"x": 1.05, "y": -1.2, "z": 0.65}, "projection": {"type": "orthographic"}},
        },
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "legend": {"x": 0, "y": 1, "bgcolor": "rgba(255,255,255,0.8)"},
        "font": {"family": "serif", "color": INK},
        "paper_bgcolor": "white",
        "hovermode": "closest",
    }
    text = json.dumps({"data": data, "layout": layout}, allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


@functools.cache
def plotly_script() -> str:
    """Return the source of plotly.js, as it is installed with the Python package."""
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs())


def _lines(name: str, lines: list[Float2D], colour: str, width: float) -> dict[str, Any]:
    """Return one trace of many polylines, separated by gaps."""
    gap = np.full((1, 3), np.nan)
    joined = np.concatenate([np.concatenate([line, gap]) for line in lines] or [gap])
    return {
        **_scatter(name, joined),
        "mode": "lines",
        "hoverinfo": "name",
        "line": {"color": colour, "width": width},
    }


def _points(name: str, points: Float2D, numbers: Int1D, symbol: str) -> dict[str, Any]:
    labels = [f"configuration {int(number)}" for number in numbers]
    return {
        **_scatter(name, points),
        "mode": "markers",
        "text": labels,
        "hovertemplate": "%{text}<br>%{x}, %{y}, %{z} m",
        "marker": {"size": 2.8 if len(points) < 500 else 1.2, "color": INK, "symbol": symbol},
    }


def _shafts(start: Float2D, vectors: Float2D, rows: Int1D) -> list[Float2D]:
    return [_shaft(np.asarray(start[i]), np.asarray(vectors[i])) for i in rows if np.all(np.isfinite(vectors[i]))]


def _shaft(start: Float2D, vector: Float2D) -> Float2D:
    """Return an arrow as one polyline: shaft, then the two sides of its head."""
    side = np.cross(vector, [0.0, 0.0, 1.0])
    if np.linalg.norm(side) < 1e-9 * max(float(np.linalg.norm(vector)), 1e-12):
        side = np.cross(vector, [1.0, 0.0, 0.0])
    norm = float(np.linalg.norm(side))
    side = side * (0.1 * float(np.linalg.norm(vector)) / norm) if norm > 0 else side
    tip, neck = start + vector, start + 0.78 * vector
    return np.array([start, tip, neck + side, tip, neck - side])


def _sight(space: OperatingSpace, arms: Int1D) -> list[dict[str, Any]]:
    """Return the tracker and its beams to every point of the configurations drawn; nothing where it is not shown."""
    if space.tracker is None:
        return []
    here = np.asarray(space.tracker)
    beams = [np.stack([here, np.asarray(points)[i]]) for points in space.points.values() for i in arms]
    marker = {"size": 7, "color": INK, "symbol": "diamond"}
    return [
        {**_scatter("tracker", here[None]), "mode": "markers", "marker": marker, "hoverinfo": "name"},
        _lines("beams", beams, "#d9b38c", 1.0),
    ]


def _boxes(space: OperatingSpace) -> list[dict[str, Any]]:
    """Return what stands in the cell, box by box; the first one stands in the legend for all."""
    if space.boxes is None:
        return []
    drawn = []
    for k, corners in enumerate(np.asarray(space.boxes)):
        faces = ConvexHull(corners).simplices
        body = {**_scatter("boxes", corners), "type": "mesh3d", "opacity": 0.35, "color": GREY, "hoverinfo": "skip"}
        drawn.append({**body, "legendgroup": "boxes", "showlegend": k == 0,
                      **{key: faces[:, i].tolist() for i, key in enumerate("ijk")}})  # fmt: skip
    return drawn


def _outline(points: Float2D) -> list[dict[str, Any]]:
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return []
    corners = {int(old): new for new, old in enumerate(hull.vertices)}
    faces = np.array([[corners[int(c)] for c in face] for face in hull.simplices])
    mesh = _scatter("outline", points[hull.vertices])
    return [
        {
            **mesh,
            "type": "mesh3d",
            "opacity": 0.07,
            "color": GREY,
            "hoverinfo": "skip",
            "showlegend": True,
            **{key: faces[:, i].tolist() for i, key in enumerate("ijk")},
        }
    ]


def _base(length: float) -> list[dict[str, Any]]:
    axes = [np.array([np.zeros(3), length * row]) for row in np.eye(3)]
    tips = np.eye(3) * length * 1.15
    return [
        {**_lines("base axes", axes, INK, 6.0), "showlegend": False},
        {**_scatter("base", tips), "mode": "text", "text": ["x", "y", "z"], "showlegend": False, "hoverinfo": "skip"},
    ]


def _scatter(name: str, points: Float2D) -> dict[str, Any]:
    """Return the common part of a trace; coordinates to 0.1 mm (as text in a picture), gaps as null."""
    columns = np.round(np.asarray(points, dtype=np.float64), 4).T
    x, y, z = ([value if value == value else None for value in column.tolist()] for column in columns)
    return {"type": "scatter3d", "name": html.escape(name), "x": x, "y": y, "z": z}
