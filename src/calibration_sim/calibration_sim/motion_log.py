"""The simulator's own truth of motions: the angles at every millisecond, and how fast the watched points went then.

While the robot moves, only times and angles are written; speeds are found when the log is read, for what is written
many thousand times a second must cost the living cell next to nothing.
"""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from calibration_core.timeseries import Float1D, Float2D
from calibration_sim.live import LiveCell, watched

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


def true_speeds(path: Path, cell: LiveCell) -> Float2D:
    """Return times and speeds of the fastest watched point, (m, 2) s and m/s, between successive instants of a log.

    Args:
        path: The log.
        cell: The cell that wrote it, or one with the same truth.
    """
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
