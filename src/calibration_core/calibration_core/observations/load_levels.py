"""How large the loads of a recording are: the levels of its steps as shares of the full load, and the largest force."""

from __future__ import annotations

import numpy as np

from calibration_core.observations.kinds import is_loaded, single_steps
from calibration_core.timeseries import Readings

LEAST = 0.02  # of the largest load: levels closer than this are the same


def levels_of(readings: Readings) -> tuple[float, ...]:
    """Return the load levels of a recording's steps, as shares of the full load, the first being none.

    Of the configurations with as many readings as most have, the one of the largest load stands for all (a reference
    that is measured again and again is not loaded, nor are postures at rest beside loaded configurations); a load
    against the first full one is negative.
    """
    if is_loaded(readings):
        readings = readings.select(~single_steps(readings))
    assert readings.wrench is not None  # noqa: S101 - a loaded recording has a wrench
    numbers, counts = np.unique(readings.configuration, return_counts=True)
    usual, often = np.unique(counts, return_counts=True)
    size = np.linalg.norm(readings.wrench[:, :3], axis=1)
    among = np.isin(readings.configuration, numbers[counts == usual[np.argmax(often)]])
    inside = readings.configuration == readings.configuration[np.argmax(np.where(among, size, -1.0))]
    steps, first = np.unique(readings.step[inside], return_index=True)
    wrench = readings.wrench[inside][first][np.argsort(steps)]
    size = np.linalg.norm(wrench[:, :3], axis=1)
    full = wrench[int(np.argmax(size >= (1 - LEAST) * size.max())), :3]
    power = float(full @ full)
    if power == 0.0:
        return (0.0,)
    levels = np.round(wrench[:, :3] @ full / power, 2)
    levels[np.abs(levels) < LEAST] = 0.0
    return tuple(float(level) for level in np.clip(levels, -1.0, 1.0))


def largest_force(readings: Readings) -> float:
    """Return the largest force of a recording, N."""
    assert readings.wrench is not None  # noqa: S101 - a loaded recording has a wrench
    return float(np.linalg.norm(readings.wrench[:, :3], axis=1).max())
