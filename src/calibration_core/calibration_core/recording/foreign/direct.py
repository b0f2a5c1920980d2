"""A foreign table read as a recording of a cell, where it can be read in one way only."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from calibration_core.cell import Cell
from calibration_core.cell.travel import farthest
from calibration_core.errors import RecordingError
from calibration_core.recording.foreign.join import import_files
from calibration_core.recording.foreign.source import Seen
from calibration_core.timeseries import Float2D, Float3D, Note, Readings


def read_foreign(path: Path, cell: Cell, *, simulated: bool = False) -> Readings:
    """Read a table of another program.

    Args:
        path: The table.
        cell: The cell.
        simulated: Whether a simulation wrote it: poses of the tool in the base frame are then read as its points.

    Returns:
        Readings with the cell's points; a note says how the table was understood.

    Raises:
        RecordingError: Something is missing or can be read in more than one way; says which command to type.
    """
    command = f"or convert it: calibration import {path.name} --map map.yaml"
    try:
        travels = {f"q{i + 1}": float(most) for i, most in enumerate(farthest(cell)) if not np.isnan(most)}
        imported = import_files([path], travels=travels, seen=_tool_points(cell) if simulated else None)
    except RecordingError as error:
        raise RecordingError(error.file, error.place, error.found, f"{error.expected}; {command}") from None
    readings = imported.readings
    if readings.q.shape[1] != len(cell.robot.joints):
        found = f"{readings.q.shape[1]} columns of joint angles"
        raise RecordingError(
            path, "columns", found, f"{len(cell.robot.joints)}, as the cell's robot has joints; {command}"
        )
    places = {name.lower(): i for i, name in enumerate(cell.points)}
    unknown = [name for name in readings.points if name.lower() not in places]
    if unknown:
        expected = f"points of the cell file ({', '.join(cell.points)}); {command}"
        raise RecordingError(path, "points", ", ".join(unknown[:8]), expected)
    point = np.array([places[name.lower()] for name in readings.points])[readings.point]
    source = imported.sources[0]
    units = {one.unit: one.meaning for one in reversed(source.taken) if one.unit}
    text = f"a foreign table: {source.form}; units " + ", ".join(
        f"{unit} ({meaning})" for unit, meaning in units.items()
    )
    read = dataclasses.replace(readings, points=cell.points, point=point)
    return read.with_notes(Note("foreign_table", path.name, text, len(readings)))


def _tool_points(cell: Cell) -> Seen:
    """Return what says where the points stand, tracker frame, from poses of the tool in the base frame.

    Without a stated tool it is the wrench point with the flange's axes, as in tasks.
    """
    from scipy.spatial.transform import Rotation  # slow to load, and read for tables of simulations alone

    frames = cell.frames
    tool = np.array(frames.tool.xyz if frames.tool is not None else frames.wrench_point or np.zeros(3))
    turn = Rotation.from_euler("xyz", frames.tool.rpy if frames.tool is not None else np.zeros(3))
    tracker = frames.tracker
    place, base = (np.zeros(3), Rotation.identity()) if tracker is None else (
        np.array(tracker.xyz), Rotation.from_euler("xyz", tracker.rpy)
    )  # fmt: skip

    def seen(places: Float2D, axes: Float3D) -> dict[str, Float2D]:
        stand = {name: turn.inv().apply(np.array(point) - tool) for name, point in frames.measurement_points.items()}
        return {name: base.inv().apply(places + axes @ point - place) for name, point in stand.items()}

    return seen
