"""The simulator's own truth of Cartesian speeds: the fastest watched point at every millisecond of every motion."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from calibration_core.timeseries import Float1D, Float2D
from calibration_sim.live import LiveCell, watched

HEADER = "time,speed\n"


class SpeedLog:
    """Writes `time` (s) and `speed` (m/s, of the fastest point) while the robot moves."""

    def __init__(self, path: Path, cell: LiveCell) -> None:
        self._file = path.open("w", encoding="ascii")
        self._file.write(HEADER)
        self._cell = cell
        self._last: tuple[float, Float2D] | None = None

    def add(self, instants: Float1D, q: Float2D) -> None:
        """Take the instants (k,) s and angles (k, n) rad of a motion, as `LiveCell.advance` returns them."""
        if not len(instants):
            self._last = None
            return
        places = watched(self._cell, q)
        if self._last is not None:
            instants, places = np.append(self._last[0], instants), np.concatenate([self._last[1][None], places])
        self._last = (float(instants[-1]), places[-1])
        if len(instants) > 1:
            steps = np.linalg.norm(np.diff(places, axis=0), axis=2).max(axis=1) / np.diff(instants)
            self._file.writelines(f"{t:.4f},{v:.6f}\n" for t, v in zip(instants[1:], steps, strict=True))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def read_speed_log(path: Path) -> Float2D:
    """Return times and speeds, (m, 2) s and m/s."""
    return np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
