"""Recording and simulation row by row: deflections where the load changes, positions where there is one step alone."""

from __future__ import annotations

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison.points import Placed, rigid
from calibration_core.diagnosis.comparison.result import PartDifference, StepByStep
from calibration_core.observations.average import coordinate_std, position_covariance
from calibration_core.timeseries import Bool1D, Float2D, Readings

UNLOADED = 0.02  # share of the largest force below which nothing is seen of it


def step_by_step(
    ours: Readings, theirs: Readings, placed: Placed | None, cell: Cell, noise: float | None = None
) -> tuple[StepByStep, StepByStep | None]:
    """Compare what corresponds.

    Args:
        ours: Rows of the recording.
        theirs: The corresponding rows of the simulation.
        placed: Positions of these in the recording's frame; None: displacements, which have none.
        cell: The cell file.
        noise: m per coordinate, seen in the simulation; None: as the instruments claim.

    Returns:
        Deflections of configurations with several steps, or positions where every configuration has one; and, beside
        deflections, the positions of configurations with one step, None where there are none or no positions at all.
    """
    position = theirs.position if placed is None else placed.position
    several = _several(ours)
    if not several.any():
        return _compared(ours, ours.position, position, cell, noise), None
    deflections = _compared(*_of(several, ours, position), cell, noise, bends=True)
    if several.all() or placed is None:
        return deflections, None
    return deflections, _compared(*_of(~several, ours, _at_rest(ours, position, several)), cell, noise)


def _of(rows: Bool1D, ours: Readings, position: Float2D) -> tuple[Readings, Float2D, Float2D]:
    kept = ours.select(rows)
    return kept, kept.position, position[rows]


def _several(readings: Readings) -> Bool1D:
    """Return the rows of configurations with several steps."""
    pairs = np.unique(np.column_stack([readings.configuration, readings.step]), axis=0)
    numbers, counts = np.unique(pairs[:, 0], return_counts=True)
    return np.isin(readings.configuration, numbers[counts > 1])


def _at_rest(ours: Readings, position: Float2D, several: Bool1D) -> Float2D:
    """Return simulated positions in the frame that fits best where little pulls; deflections must not turn it."""
    still = ~several
    if ours.wrench is not None:
        force = np.linalg.norm(ours.wrench[:, :3], axis=1)
        still |= force <= UNLOADED * force.max()
    rotation, shift, _ = rigid(ours.position[still], position[still])
    return np.asarray(position @ rotation.T + shift)


def _compared(
    ours: Readings, mine: Float2D, other: Float2D, cell: Cell, seen: float | None, *, bends: bool = False
) -> StepByStep:
    if bends:
        mine, other = deflection(ours, mine), deflection(ours, other)
    rest = mine - other
    noise = coordinate_std(position_covariance(ours, cell))
    power = float(np.sum(other**2))
    shown = mine if bends else np.zeros_like(mine)
    groups = [
        _parts(rest, shown, np.asarray(names), order)
        for names, order in (
            ([str(c) for c in ours.configuration], False),
            ([str(s) for s in ours.step], True),
            ([ours.points[p] for p in ours.point], True),
        )
    ]
    return StepByStep(
        rms=float(np.sqrt(np.mean(rest**2))),
        noise=float(np.sqrt(2)) * noise if seen is None else float(np.hypot(noise, seen)),
        slope=float(np.sum(mine * other)) / power if bends and power > 0 else float("nan"),
        by_configuration=groups[0],
        by_step=groups[1],
        by_point=groups[2],
        grid=_grid(ours, rest),
    )


def _grid(readings: Readings, rest: Float2D) -> Float2D:
    """Return (configurations, steps) m per coordinate, in the order of their numbers; NaN where nothing was read."""
    keys = [np.unique(k, return_inverse=True)[1].reshape(-1) for k in (readings.configuration, readings.step)]
    total, count = (np.zeros((int(keys[0].max()) + 1, int(keys[1].max()) + 1)) for _ in range(2))
    np.add.at(total, tuple(keys), np.mean(rest**2, axis=1))
    np.add.at(count, tuple(keys), 1.0)
    return np.sqrt(np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0))


def deflection(readings: Readings, position: Float2D) -> Float2D:
    """Return positions less the mean of their configuration and point."""
    _, group = np.unique(np.column_stack([readings.configuration, readings.point]), axis=0, return_inverse=True)
    group = group.reshape(-1)
    mean = np.zeros((group.max() + 1, 3))
    np.add.at(mean, group, position)
    return position - (mean / np.bincount(group)[:, None])[group]


def _parts(rest: Float2D, measured: Float2D, names: np.ndarray, in_order: bool) -> tuple[PartDifference, ...]:
    parts = []
    for name in dict.fromkeys(map(str, names)):
        rows = names == name
        parts.append(
            PartDifference(
                name,
                float(np.sqrt(np.mean(rest[rows] ** 2))),
                float(np.linalg.norm(rest[rows], axis=1).max()),
                float(np.sqrt(np.mean(measured[rows] ** 2))),
            )
        )
    return tuple(parts) if in_order else tuple(sorted(parts, key=lambda part: -part.rms))
