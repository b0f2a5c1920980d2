"""The tool as a rigid body: where each point stands against the others, by configuration and step.

Loads and the robot move the tool, not its shape.  Everything here is seen in the flange axes, in residuals of any model
of the robot that is right up to a rigid motion of the tool.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Int1D, Readings, numbers_in_time

OTHERS = 2  # points at the same step, to which a reading must stand wrong to be the one at fault
CLEARLY = 6.0  # times the usual change of a distance
MEDIAN = 1.4826  # standard deviation over median size, normal distribution


@dataclasses.dataclass(frozen=True, eq=False)
class Shape:
    """Residuals as a table.

    Attributes:
        numbers: (k,) numbers of the configurations, in the order of time.
        table: (k, s, p, 3) m, flange axes; NaN where nothing was read.
        which: (p,) index of every point among the names of the readings.
    """

    numbers: Int1D
    table: Float3D
    which: Int1D

    @property
    def points(self) -> int:
        """Number of points."""
        return self.table.shape[2]

    def against_others(self) -> Float3D:
        """Return (k, s, p, 3) every point's residual minus the mean of the other points' at the same step."""
        total = self.table.sum(axis=2, keepdims=True)
        return np.asarray(self.table - (total - self.table) / max(self.points - 1, 1))


def shape_of(residual: Float2D, readings: Readings, axes: Float3D) -> Shape:
    """Arrange residuals by configuration, step and point.

    Args:
        residual: (m, 3) m, base axes.
        readings: The same readings.
        axes: (m, 3, 3) rows are the flange axes in the base frame.
    """
    local = np.einsum("mia,ma->mi", axes, residual)
    numbers = numbers_in_time(readings.configuration)
    steps = np.unique(readings.step)
    table = np.full((len(numbers), len(steps), len(readings.points), 3), np.nan)
    place = {int(number): k for k, number in enumerate(numbers)}
    rows = np.array([place[int(number)] for number in readings.configuration])
    table[rows, np.searchsorted(steps, readings.step), readings.point] = local
    present = np.isfinite(table).any(axis=(0, 1, 3))
    return Shape(numbers, table[:, :, present], np.flatnonzero(present))


def own_variances(squares: Float1D) -> Float1D:
    """Return the (p,) variance per coordinate that each point has of its own.

    The contrast of point i to the mean of the others has the variance a_i + sum of the others' over (p - 1)^2
    (three-cornered hat).

    Args:
        squares: (p,) mean square per coordinate of every point's contrast.
    """
    p = len(squares)
    system = np.full((p, p), 1 / (p - 1) ** 2)
    np.fill_diagonal(system, 1.0)
    return np.asarray(np.linalg.solve(system, squares))


def out_of_shape(readings: Readings, noise: float) -> Bool1D:
    """Return the (m,) readings whose distances to all other points of their step, two or more, are not the usual ones.

    No model of the robot is needed: whatever moves the tool keeps its shape.

    Args:
        readings: m readings, absolute positions.
        noise: Claimed standard deviation of one coordinate, m.
    """
    keys = np.column_stack([readings.configuration, readings.step])
    steps, row = np.unique(keys, axis=0, return_inverse=True)
    table = np.full((len(steps), len(readings.points), 3), np.nan)
    table[row.reshape(-1), readings.point] = readings.position
    distance = np.linalg.norm(table[:, :, None] - table[:, None], axis=-1)
    change = np.full_like(distance, np.nan)
    for i, j in itertools.permutations(np.unique(readings.point), 2):
        seen = np.isfinite(distance[:, i, j])
        if seen.any():
            change[:, i, j] = np.abs(distance[:, i, j] - np.median(distance[seen, i, j]))
    known = np.isfinite(change)
    usual = max(np.sqrt(2) * noise, MEDIAN * float(np.median(change[known]))) if known.any() else np.inf
    off = (change > CLEARLY * usual).sum(axis=2)
    gross = (off == known.sum(axis=2)) & (off >= OTHERS)
    return np.asarray(gross[row.reshape(-1), readings.point])
