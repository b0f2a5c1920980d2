"""The simulator's own truth: angles at every millisecond of motion, speeds of the watched points, and where they are.

While the robot moves, only times and angles are written; speeds are found when the log is read, for what is written
many thousand times a second must cost the living cell next to nothing.
"""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from calibration_core.timeseries import Float1D, Float2D, Float3D
from calibration_sim.living_cell.live import LiveCell, watched

BLOCK = 20_000  # rows whose points are held in memory at a time


class MotionLog:
    """Writes instants (s) and angles (rad) as rows of 1 + n doubles; a row of NaN ends each motion."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self._moving = False

    def add(self, instants: Float1D, q: Float2D) -> None:
        """Take the instants (k,) s and angles (k, n) rad of a motion, as `LiveCell.advance` returns them."""
        if len(instants):
            self._file.write(np.column_stack([instants, q]).tobytes())
        elif self._moving:
            self._file.write(np.full(1 + q.shape[1], np.nan).tobytes())
        self._moving = len(instants) > 0

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


class TruthLog:
    """Writes where the measurement points really are: rows of time (s), angles (rad), load (N, N*m), points (m)."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb", buffering=0)  # whoever reads it meanwhile sees what was

    def add(self, cell: LiveCell) -> None:
        """Take the cell as it is now: encoder angles, load in base axes, points in the true tracker frame."""
        self._file.write(np.concatenate([[cell.time], cell.q, cell.load, cell.points().ravel()]).tobytes())

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def true_places(path: Path, joints: int, points: int) -> tuple[Float1D, Float2D, Float2D, Float3D]:
    """Return what a `TruthLog` holds: times (m,) s, angles (m, n) rad, loads (m, 6), points (m, p, 3) m."""
    width = 1 + joints + 6 + 3 * points
    values = np.fromfile(path)
    rows = values[: len(values) // width * width].reshape(-1, width)
    time, q, load, places = np.split(rows, [1, 1 + joints, 7 + joints], axis=1)
    return time[:, 0], q, load, places.reshape(-1, points, 3)


def true_speeds(path: Path, cell: LiveCell) -> Float2D:
    """Return times and speeds of the fastest watched point, (m, 2) s and m/s, between successive instants of a log."""
    rows = np.fromfile(path)
    rows = rows[: len(rows) // (1 + len(cell.q)) * (1 + len(cell.q))].reshape(-1, 1 + len(cell.q))
    found = [np.empty((0, 2))]
    for begin in range(0, len(rows), BLOCK):
        block = rows[begin : begin + BLOCK + 1]  # one row more: the step into the next block
        places = watched(cell, block[:, 1:])
        steps = np.linalg.norm(np.diff(places, axis=0), axis=2).max(axis=1)
        speeds = np.column_stack([block[1:, 0], steps / np.diff(block[:, 0])])
        found.append(speeds[np.isfinite(speeds).all(axis=1)])
    return np.concatenate(found)
