"""What the measurement points might be instead of what the cell file says: exchanged, or mirrored."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from calibration_core.input_checks.anomaly import InputAnomaly
from calibration_core.timeseries import Float2D

MOST_POINTS = 5  # all of whose orders are tried


def other_points(names: tuple[str, ...], points: Float2D) -> Iterator[tuple[InputAnomaly, Float2D]]:
    """Yield every other order and mirror image of (k, 3) points, with what it means; none of a single point's order."""
    count = len(names)
    orders = itertools.permutations(range(count)) if count <= MOST_POINTS else _exchanges(count)
    for order in orders:
        changed = [i for i in range(count) if order[i] != i]
        if not changed:
            continue
        words = ", ".join(f"{names[i]} is {names[order[i]]}" for i in changed)
        text = f"measurement points are exchanged ({words})"
        remedy = f"name the points as the cell file has them: {words}"
        anomaly = InputAnomaly("point_order", text, remedy, 0.0, points=tuple(names[i] for i in changed))
        yield anomaly, points[list(order)]
    for axis in range(3):
        mirrored = points * np.where(np.arange(3) == axis, -1.0, 1.0)
        if np.array_equal(mirrored, points):
            continue
        text = f"the measurement points are mirrored: {'xyz'[axis]} has the wrong sign in the cell file"
        remedy = f"turn the sign of {'xyz'[axis]} of frames.measurement_points"
        yield InputAnomaly("point_order", text, remedy, 0.0, points=names, axes=f"-{'xyz'[axis]}"), mirrored


def _exchanges(count: int) -> Iterator[tuple[int, ...]]:
    for i, j in itertools.combinations(range(count), 2):
        order = list(range(count))
        order[i], order[j] = j, i
        yield tuple(order)
