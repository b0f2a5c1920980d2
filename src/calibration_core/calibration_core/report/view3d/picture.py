"""A view as a picture: the same bodies, frames, targets and boxes without a browser."""

from __future__ import annotations

import io
import math

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from calibration_core.model.kinematics import Posture, posture
from calibration_core.report.figures.style import GREY, INK, PALE, STYLE, drawable, drawing
from calibration_core.report.view3d.solids import Solid, mesh_of
from calibration_core.report.view3d.view import View
from calibration_core.timeseries import Float1D, Float2D

ROBOT, AMBER = "#b3bac4", "#9e5c00"
FAR = 3.5  # times the robot's size: what is farther away is named, and not drawn to scale
AXES = ("#c71f1f", "#1a8526", "#1f40c7")
_TURN, _TILT = -0.95, 0.42  # rad, as the program draws it first
_LIGHT = np.array([0.27, -0.36, 0.89])


def png(view: View, width: float = 6.7, height: float = 4.6, dpi: int = 150) -> bytes:
    """Return a picture of a view at its first posture, PNG; the same bytes for the same view.

    Args:
        view: What is drawn.
        width: Inches.
        height: Inches.
        dpi: Pixels per inch.
    """
    buffer = io.BytesIO()
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        axes = figure.add_subplot()
        draw(axes, view)
        figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return buffer.getvalue()


def svg(view: View, height: float = 4.2) -> bytes:
    """Return the same picture for a document, SVG, `height` inches high; its shaded faces are pixels inside."""
    with drawing(height) as (figure, buffer):
        draw(figure.add_subplot(), view)
    return buffer.getvalue()


def draw(axes: Axes, view: View, index: int = 0) -> None:
    """Draw a view at one of its postures, seen from the side and above, without perspective."""
    at = posture(view.chain.whole, view.chain.expanded(view.postures[index][1][None]))
    polygons = [_faces(solid, at) for solid in view.solids]
    names: list[tuple[Float1D, str]] = []
    size, middle = _extent(view, at, polygons)
    _floor(axes, size)
    _solid(axes, np.concatenate(polygons) if polygons else np.zeros((0, 3, 3)), ROBOT, 1.0, 3)
    for name, edges, pose in view.boxes:
        box = Solid(0, "box", edges, pose)
        _solid(axes, _faces(box, at), GREY, 0.4, 4)
        names.append((pose[:3, 3], name))
    flange = at.flange_origin[:, 0]
    for name, place in view.targets.items():
        there = at.point(place)[:, 0]
        _line(axes, [flange, there], INK, 0.8, 5)
        axes.plot(*_flat(there[None]).T, "o", color=INK, markersize=3.5, zorder=6)
        names.append((there, name))
    for kind in view.kinds:
        for arrow in view.arrows if kind.shown else ():
            if arrow.kind == kind.name and arrow.posture == index:
                start, vector = _flat(arrow.start[None])[0], _flat(arrow.vector[None])[0]
                style = {"arrowstyle": "-|>", "color": kind.colour}
                axes.annotate("", start + vector, start, arrowprops=style, zorder=8)
    for frame in view.frames:
        pose = frame.pose if frame.on == "base" else _pose_of(at) @ frame.pose
        if float(np.linalg.norm(pose[:3, 3] - middle)) < FAR * size:
            long = size * (0.1 if frame.on == "base" else 0.05)
            for k in range(3):
                _line(axes, [pose[:3, 3], pose[:3, 3] + long * pose[:3, k]], AXES[k], 1.3, 7)
            names.append((pose[:3, 3], frame.name))
    names += _sight(axes, view, at, middle, size)
    _texts(axes, names, size)
    axes.set_aspect("equal")
    axes.set_axis_off()


def _sight(axes: Axes, view: View, at: Posture, middle: Float1D, size: float) -> list[tuple[Float1D, str]]:
    """Draw the tracker and its beams; return what is written beside it."""
    if view.tracker is None:
        return []
    way = view.tracker - middle
    distance = float(np.linalg.norm(way))
    if distance >= FAR * size:
        tip = middle + way * (0.5 * size / distance)
        _line(axes, [middle, tip], AMBER, 1.5, 7)
        return [(tip, f"tracker, {distance:.3g} m away")]
    for place in view.targets.values():
        _line(axes, [view.tracker, at.point(place)[:, 0]], AMBER, 0.5, 2)
    axes.plot(*_flat(view.tracker[None]).T, "D", color=AMBER, markersize=6, zorder=7)
    return []


def _extent(view: View, at: Posture, polygons: list[np.ndarray]) -> tuple[float, Float1D]:
    """Return size and middle of the robot with its targets, m."""
    points = [np.zeros((1, 3)), at.flange_origin.T, *(origin.T for origin in at.origin)]
    points += [at.point(place).T for place in view.targets.values()]
    points += [faces.reshape(-1, 3) for faces in polygons]
    every = np.concatenate(points)
    low, high = every.min(axis=0), every.max(axis=0)
    return float(np.linalg.norm(high - low)) or 1.0, (low + high) / 2


def _faces(solid: Solid, at: Posture) -> np.ndarray:
    """Return the corners of a body's faces in the base frame, (f, 3, 3) m."""
    vertices, faces = mesh_of(solid)
    local = vertices @ solid.pose[:3, :3].T + solid.pose[:3, 3]
    if solid.link:
        columns, origin = at.body[solid.link - 1][:, :, 0], at.body_origin[solid.link - 1][:, 0]
        local = local @ columns + origin
    return np.asarray(local[faces])


def _pose_of(at: Posture) -> Float2D:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = at.flange[:, :, 0].T, at.flange_origin[:, 0]
    return pose


def _solid(axes: Axes, corners: np.ndarray, colour: str, alpha: float, order: float) -> None:
    """Paint faces from the farthest to the nearest, shaded by how they face the light and the eye."""
    if not len(corners):
        return
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    eye = _eye()
    light = np.clip(0.45 + 0.4 * np.abs(normal @ eye) + 0.2 * np.maximum(normal @ _LIGHT, 0.0), 0.0, 1.0)
    depth = np.argsort(corners.mean(axis=1) @ eye)
    shades = np.column_stack([light[:, None] * np.array(to_rgb(colour)), np.full(len(light), alpha)])[depth]
    flat = _flat(corners.reshape(-1, 3)).reshape(-1, 3, 2)[depth]
    axes.add_collection(
        PolyCollection(list(flat), facecolors=shades, edgecolors=shades, linewidths=0.2, zorder=order, rasterized=True)
    )
    axes.update_datalim(flat.reshape(-1, 2))
    axes.autoscale_view()


def _floor(axes: Axes, size: float) -> None:
    step = 10.0 ** math.floor(math.log10(size / 2))
    half = math.ceil(0.6 * size / step) * step
    ticks = np.arange(-half, half + step / 2, step)
    ends = [[[x, -half, 0], [x, half, 0]] for x in ticks] + [[[-half, x, 0], [half, x, 0]] for x in ticks]
    axes.add_collection(LineCollection([_flat(np.array(end)) for end in ends], colors=PALE, linewidths=0.4, zorder=1))


def _line(axes: Axes, ends: list[Float1D], colour: str, width: float, order: float) -> None:
    flat = _flat(np.array(ends))
    axes.plot(flat[:, 0], flat[:, 1], color=colour, linewidth=width, zorder=order)


def _texts(axes: Axes, names: list[tuple[Float1D, str]], size: float) -> None:
    """Write names beside their places, each below those that it would cover."""
    taken: list[Float1D] = []
    row, width = 0.035 * size, 0.35 * size
    for place, text in names:
        there = _flat(place[None])[0] + 0.6 * row
        while any(abs(there[0] - other[0]) < width and abs(there[1] - other[1]) < row for other in taken):
            there = there - np.array([0.0, row])
        taken.append(there)
        axes.annotate(drawable(text), there, fontsize=7, zorder=9)


def _eye() -> Float1D:
    """Return the (3,) unit vector towards the eye."""
    tilt = math.cos(_TILT)
    return np.array([tilt * math.cos(_TURN), tilt * math.sin(_TURN), math.sin(_TILT)])


def _flat(points: Float2D) -> Float2D:
    """Return (k, 3) m as (k, 2) on paper: to the right and up."""
    eye = _eye()
    right = np.array([-math.sin(_TURN), math.cos(_TURN), 0.0])
    return np.asarray(points @ np.stack([right, np.cross(eye, right)], axis=1))
