"""The investigated operating space on paper: four views of arms, points, forces and deflections (CWA 17384, 8 g)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from calibration_core.identification.result.estimate import OperatingSpace
from calibration_core.report.figures.style import ACCENT, GREY, INK, MARGINS, PALE, WIDTH, panels, place, thinned
from calibration_core.timeseries import Float1D, Float2D, Int1D

MOST_ARMS = 60
"""Arms drawn at most; more configurations are shown by their points alone."""

MOST_POINTS = 2000

FLAT = 1e-9
"""Area of an outline, of the square of its length, below which it is a line."""

HIGHEST = 4.8
"""Height of the figure at most, inches: it must leave room for other things on a page."""

_TURN = math.radians(-55.0)
_TILT = math.radians(28.0)
_FRONT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).T
_SIDE = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]).T
_TOP = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]).T
_OBLIQUE = np.array(
    [
        [math.cos(_TURN), -math.sin(_TURN), 0.0],
        [math.sin(_TURN) * math.sin(_TILT), math.cos(_TURN) * math.sin(_TILT), math.cos(_TILT)],
    ]
).T


def space_figure(space: OperatingSpace) -> bytes:
    """Draw front, side, top and oblique view of the operating space, base frame; the first three at one scale."""
    arms = evenly(len(space.q), MOST_ARMS)
    low, high = _extent(space, arms)
    x, y, z = high - low
    across, up = MARGINS.sum(axis=0)
    scale = min((WIDTH - 2 * across) / (x + y), (HIGHEST - 2 * up) / (z + y))  # inches per m
    wide, narrow = scale * x + across, scale * y + across
    beside = min((wide + narrow - WIDTH) / 2, 0.0)  # left empty, as it is negative
    upper, lower = scale * z + up, scale * y + up
    rows = ((upper, (beside, wide, narrow, beside)), (lower, (beside, wide, narrow, beside)))
    with panels(*rows) as ((front, side, top, oblique), buffer):
        for axes, basis in ((front, _FRONT), (side, _SIDE), (top, _TOP), (oblique, _OBLIQUE)):
            place(axes)
            _view(axes, space, arms, basis)
        for axes, name, columns in (
            (front, "front, along y", (0, 2)),
            (side, "side, along x", (1, 2)),
            (top, "top, along z", (0, 1)),
        ):
            right, above = columns
            axes.set(xlim=(low[right], high[right]), ylim=(low[above], high[above]))
            axes.set(xlabel=f"{'xyz'[right]} [m]", ylabel=f"{'xyz'[above]} [m]")
            axes.set_title(name)
        oblique.set_aspect("equal", adjustable="datalim")
        oblique.set_title("oblique")
        oblique.set_axis_off()
    return buffer.getvalue()


def measured_points(space: OperatingSpace) -> Float2D:
    """Return every measured point, (k * points, 3) m, base frame."""
    return np.concatenate([np.asarray(points) for points in space.points.values()] or [np.asarray(space.flange)])


def evenly(count: int, most: int) -> Int1D:
    """Return at most `most` indices, evenly spaced over `count`."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


def reach(space: OperatingSpace) -> float:
    """Return the largest distance of any drawn point from the base, m; 1 if everything lies in the base."""
    distance = float(np.max(np.linalg.norm(np.asarray(space.joint_origins).reshape(-1, 3), axis=1), initial=0.0))
    return distance or 1.0


def force_scale(space: OperatingSpace) -> float:
    """Return the length of a force arrow per newton, m/N, so that the largest is a fifth of the reach; 0 without."""
    return _scale(space.force, 0.2 * reach(space))


def deflection_scale(space: OperatingSpace) -> float:
    """Return a round factor that makes the largest deflection about a sixth of the reach; 0 without deflections."""
    return round_scale(space.deflection, space)


def round_scale(vectors: Float2D | None, space: OperatingSpace) -> float:
    """Return a round factor that makes the largest of (k, 3) m about a sixth of the reach; 0 without any."""
    scale = _scale(vectors, reach(space) / 6)
    if scale <= 0:
        return 0.0
    decade = 10.0 ** math.floor(math.log10(scale))
    return max(step * decade for step in (1, 2, 5) if step * decade <= scale)


def hull_outline(flat: Float2D) -> Float2D:
    """Return the closed convex outline of (k, 2) points; (0, 2) where they span no area.

    Andrew 1979 (monotone chain): to import the same from scipy takes as long as to draw two diagrams.
    """
    points = [(float(x), float(y)) for x, y in np.unique(flat, axis=0)]
    outline = np.array([*_turning_left(points)[:-1], *_turning_left(points[::-1])]).reshape(-1, 2)
    x, y = (outline - outline[:1]).T
    area = float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])) / 2
    length = float(np.ptp(flat, axis=0).max(initial=0.0)) if len(flat) else 0.0
    return outline if area > FLAT * length**2 else np.zeros((0, 2))


def _turning_left(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the points, sorted along x, that a string around them touches on its way to the last one."""
    chain: list[tuple[float, float]] = []
    for x, y in points:
        while len(chain) > 1:
            (x0, y0), (x1, y1) = chain[-2:]
            if (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0) > 0:
                break
            chain.pop()
        chain.append((x, y))
    return chain


def _scale(vectors: Float2D | None, length: float) -> float:
    if vectors is None:
        return 0.0
    sizes = np.linalg.norm(vectors, axis=1)
    largest = float(np.max(sizes[np.isfinite(sizes)], initial=0.0))
    return length / largest if largest > 0 else 0.0


def _extent(space: OperatingSpace, arms: Int1D) -> tuple[Float1D, Float1D]:
    """Return lower and upper corner of everything drawn, with a margin, (3,) m each."""
    drawn = [
        measured_points(space),
        np.asarray(space.joint_origins)[arms].reshape(-1, 3),
        np.eye(3) * 0.15 * reach(space),
    ]
    drawn += [start[arms] + vector[arms] for start, vector, _, _ in _vectors(space)]
    points = np.concatenate(drawn)
    points = points[np.all(np.isfinite(points), axis=1)]
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    margin = 0.04 * float(np.max(high - low))
    # A flat arrangement still gets a panel of some width.
    thin = np.maximum(0.3 * float(np.max(high - low)) - (high - low), 0.0) / 2
    return low - margin - thin, high + margin + thin


def _view(axes: Axes, space: OperatingSpace, arms: Int1D, basis: Float2D) -> None:
    points = measured_points(space)
    lines = np.asarray(space.joint_origins)[arms] @ basis
    axes.add_collection(LineCollection(list(lines), colors=PALE if len(arms) > 6 else GREY, linewidths=0.6, zorder=1))
    shown = points[thinned(np.linalg.norm(points, axis=1), MOST_POINTS)] @ basis
    axes.plot(shown[:, 0], shown[:, 1], ".", color=INK, markersize=2.6 if len(shown) < 400 else 1.2, zorder=4)
    outline = hull_outline(points @ basis)
    axes.plot(outline[:, 0], outline[:, 1], color=GREY, linestyle=(0, (4, 3)), linewidth=0.7, zorder=2)
    for start, vector, colour, width in _vectors(space):
        flat, arrow = start[arms] @ basis, vector[arms] @ basis
        axes.quiver(
            flat[:, 0],
            flat[:, 1],
            arrow[:, 0],
            arrow[:, 1],
            color=colour,
            angles="xy",
            scale_units="xy",
            scale=1.0,
            units="dots",
            width=width,
            headwidth=5,
            headlength=6,
            headaxislength=5,
            zorder=5,
        )
    axes.autoscale_view()
    length = 0.15 * reach(space)
    for name, tip in zip("xyz", basis * length, strict=True):
        if float(np.linalg.norm(tip)) > 0.1 * length:
            axes.plot([0, tip[0]], [0, tip[1]], color=INK, linewidth=1.4, zorder=6)
            axes.annotate(name, (tip[0] * 1.25, tip[1] * 1.25), ha="center", va="center", fontsize=8)


def _vectors(space: OperatingSpace) -> list[tuple[Float2D, Float2D, str, float]]:
    """Return start, drawn vector, colour and width of forces and deflections."""
    vectors: list[tuple[Float2D, Float2D, str, float]] = []
    if space.force is not None:
        start = space.flange if space.wrench_point is None else space.wrench_point
        vectors.append((np.asarray(start), np.asarray(space.force) * force_scale(space), GREY, 0.8))
    if space.deflection is not None:
        first = next(iter(space.points.values()), space.flange)
        vectors.append((np.asarray(first), np.asarray(space.deflection) * deflection_scale(space), ACCENT, 1.2))
    return vectors
