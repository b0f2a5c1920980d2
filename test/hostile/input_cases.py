"""Recordings that are read as something else: other axes, other columns, differences."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np

from calibration_core.cell import Cell
from calibration_core.timeseries import Readings

ROOT = Path(__file__).resolve().parents[2]
REAL = next((one / "shared" / "data" / "real" for one in ROOT.parents if (one / "shared").is_dir()), ROOT / "none")
CELL = ROOT / "config" / "cells" / "small.cell.yaml"
Change = Callable[[Readings, Cell], tuple[Readings, Cell]]


def wrench(force: float = 1.0, torque: float = 1.0, turn: np.ndarray | None = None) -> Change:
    def change(readings: Readings, cell: Cell) -> tuple[Readings, Cell]:
        assert readings.wrench is not None
        axes = np.eye(3) if turn is None else turn
        parts = [force * readings.wrench[:, :3] @ axes.T, torque * readings.wrench[:, 3:] @ axes.T]
        return dataclasses.replace(readings, wrench=np.hstack(parts)), cell

    return change


def columns(order: tuple[int, ...], signs: tuple[float, ...] = (1.0,) * 6) -> Change:
    def change(readings: Readings, cell: Cell) -> tuple[Readings, Cell]:
        assert readings.wrench is not None
        return dataclasses.replace(readings, wrench=np.array(signs) * readings.wrench[:, list(order)]), cell

    return change


def left_handed(axis: int, *, stated: bool = True) -> Change:
    def change(readings: Readings, cell: Cell) -> tuple[Readings, Cell]:
        if not stated:
            cell = cell.model_copy(update={"frames": cell.frames.model_copy(update={"tracker": None})})
        sign = np.where(np.arange(3) == axis, -1.0, 1.0)
        return dataclasses.replace(readings, position=sign * readings.position), cell

    return change


def since_step_zero(readings: Readings) -> Readings:
    """Return positions as displacements since the first step of every configuration and point."""
    keys = np.column_stack([readings.configuration, readings.point])
    _, first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return dataclasses.replace(readings, position=readings.position - readings.position[first][group.reshape(-1)])


def deflections(readings: Readings, cell: Cell) -> tuple[Readings, Cell]:
    """Return the same recording as displacements, and a cell file that says so."""
    how = cell.measurements.model_copy(update={"points": "displacement"})
    return since_step_zero(readings), cell.model_copy(update={"measurements": how})


def in_other_axes(readings: Readings, cell: Cell, turn: np.ndarray, *, stated: bool) -> tuple[Readings, Cell]:
    if not stated:
        cell = cell.model_copy(update={"frames": cell.frames.model_copy(update={"tracker": None})})
    return dataclasses.replace(readings, position=readings.position @ turn.T), cell
