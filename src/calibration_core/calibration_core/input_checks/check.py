"""The input of a recording, looked at before any physics; the same look for every command that fits."""

from __future__ import annotations

import numpy as np

from calibration_core.cell import Cell
from calibration_core.input_checks.anomaly import CellSizes, InputAnomaly, check_lengths, unit_words
from calibration_core.input_checks.explained import Motion, Reading, centred
from calibration_core.input_checks.loaded import check_loaded
from calibration_core.input_checks.placed import PositionRecording, check_positions
from calibration_core.model.chain import Chain, nearest_rotation, pose_matrix
from calibration_core.model.kinematics import posture
from calibration_core.model.robot import chain_of
from calibration_core.observations.observe import CLAIMS_BASE_AXES
from calibration_core.timeseries import Float2D, Note, Readings, numbers_in_time

MOST = 1500  # readings that are looked at
GROSS = 6.0  # times the motion that nearly all readings have
TINY = 1e-9  # N and N*m


def check_inputs(readings: Readings, cell: Cell) -> tuple[InputAnomaly, ...]:
    """Return what is wrong with a recording as it was handed in; empty where nothing is.

    Raises:
        CellError: The robot cannot be read.
    """
    chain = chain_of(cell)
    some = some_of(readings)
    points = np.array([cell.frames.measurement_points[name] for name in readings.points])
    found = check_lengths(cell, chain)
    if not found and cell.measurements.points == "absolute":
        first = _first_of_groups(some)
        loaded = some.wrench is not None and len(first) < len(some)
        names = tuple(readings.points)
        turn = _stated_axes(cell)
        seen = PositionRecording(chain, first.q, first.position, first.point, points, names, loaded, turn)
        found += check_positions(seen)
    if not found and some.wrench is not None:
        motion = _motion(some, cell, chain, points)
        ways = _ways(cell)
        given = ways.pop((cell.measurements.wrench_axes, cell.measurements.wrench_at), None)
        if motion is not None and given is not None:
            named = {_words(*key): way for key, way in ways.items()}
            found += check_loaded(motion, given, named, _facts(readings, cell))
    return tuple(found)


def unit_note(readings: Readings, cell: Cell) -> Note | None:
    """Say where the unit of forces and positions cannot be checked, or hardly; None where it can, or loads are absent.

    Raises:
        CellError: The robot cannot be read.
    """
    if readings.wrench is None:
        return None
    chain = chain_of(cell)
    points = np.array([cell.frames.measurement_points[name] for name in readings.points])
    motion = _motion(some_of(readings), cell, chain, points)
    given = _ways(cell).get((cell.measurements.wrench_axes, cell.measurements.wrench_at))
    if motion is None or given is None:
        return None
    text = unit_words(motion, _facts(readings, cell))
    return None if not text else Note("units", "forces and positions", text)


def _words(axes: str, at: str) -> str:
    return f"in {axes} axes, at the {at.replace('_', ' ')}"


def _facts(readings: Readings, cell: Cell) -> CellSizes:
    robot, claimed = cell.robot, any(note.kind == CLAIMS_BASE_AXES for note in readings.notes)
    positions = cell.measurements.points == "absolute"
    return CellSizes(robot.rated_load, robot.stiffness, robot.joints, positions, claimed, _stated_axes(cell))


def _stated_axes(cell: Cell) -> Float2D | None:
    """Return the (3, 3) axes of the tracker in the base frame; None where the cell file states none."""
    stated = cell.frames.tracker
    return None if stated is None else pose_matrix(np.array(stated.xyz), np.array(stated.rpy))[:3, :3]


def some_of(readings: Readings) -> Readings:
    """Return whole configurations, evenly taken, of about as many readings as are looked at."""
    if len(readings) <= MOST:
        return readings
    numbers = numbers_in_time(readings.configuration)
    count = max(6, int(len(numbers) * MOST / len(readings)))
    taken = numbers[np.unique(np.linspace(0, len(numbers) - 1, count).astype(int))]
    return readings.select(np.isin(readings.configuration, taken))


def _first_of_groups(readings: Readings) -> Readings:
    keys = np.column_stack([readings.configuration, readings.point])
    _, first = np.unique(keys, axis=0, return_index=True)
    keep = np.zeros(len(readings), dtype=bool)
    keep[first] = True
    return readings.select(keep)


def _ways(cell: Cell) -> dict[tuple[str, str], Reading]:
    """Return every way of reading a wrench for which the cell file has the frames, by axes and point."""
    frames = cell.frames
    sensor = None if frames.force_torque is None else pose_matrix(
        np.array(frames.force_torque.xyz), np.array(frames.force_torque.rpy)
    )  # fmt: skip
    at = {} if frames.wrench_point is None else {"wrench_point": np.array(frames.wrench_point)}
    axes: dict[str, Float2D | None] = {"base": None}
    if sensor is not None:
        at["sensor"], axes["sensor"] = sensor[:3, 3], sensor[:3, :3]
    return {(name, where): Reading(point, turn) for name, turn in axes.items() for where, point in at.items()}


def _motion(readings: Readings, cell: Cell, chain: Chain, points: Float2D) -> Motion | None:
    """Return the motion under load; None where no group has two readings under different wrenches."""
    keys = np.column_stack([readings.configuration, readings.point])
    _, group = np.unique(keys, axis=0, return_inverse=True)
    group = group.reshape(-1)
    assert readings.wrench is not None  # noqa: S101 - asked for loaded recordings only
    change = np.abs(centred(readings.wrench, group)).max(axis=1)
    loaded = np.bincount(group, change > TINY) > 0
    keep = (loaded & (np.bincount(group) > 1))[group]
    if not keep.any():
        return None
    readings = readings.select(keep)
    _, group = np.unique(keys[keep], axis=0, return_inverse=True)
    group = group.reshape(-1)
    rigid = posture(chain, readings.q).point(points[readings.point].T).T
    moved = centred(readings.position @ _tracker(readings, cell, rigid).T - rigid, group)
    size = np.linalg.norm(moved, axis=1)
    wild = size > GROSS * max(float(np.quantile(size, 0.95)), 1e-12)
    if wild.any():  # groups with a gross error say nothing about axes and signs
        sound = ~np.isin(group, group[wild])
        _, again = np.unique(group[sound], return_inverse=True)
        readings, moved, group = readings.select(sound), moved[sound], again.reshape(-1)
        if not len(group):
            return None
    assert readings.wrench is not None  # noqa: S101 - as above
    sigma = _sigma(cell, readings)
    wrench, names = readings.wrench, tuple(readings.points)
    return Motion(chain, readings.q, wrench[:, :3], wrench[:, 3:], readings.point, points, names, moved, group, sigma)


def _tracker(readings: Readings, cell: Cell, rigid: Float2D) -> Float2D:
    """Return the (3, 3) orientation of the tracker in the base frame: from the points where they tell, else stated."""
    if cell.measurements.points == "absolute":
        a, b = rigid - rigid.mean(axis=0), readings.position - readings.position.mean(axis=0)
        values = np.linalg.svd(a.T @ b, compute_uv=False)
        if values[1] > 1e-3 * values[0]:
            return nearest_rotation(a.T @ b)
    stated = _stated_axes(cell)
    return np.eye(3) if stated is None else stated


def _sigma(cell: Cell, readings: Readings) -> float:
    tracker = cell.instruments.tracker
    if tracker.sigma is not None:
        return tracker.sigma
    reach = float(np.median(np.linalg.norm(readings.position, axis=1)))
    along = float(tracker.sigma_range or 0.0) + tracker.sigma_range_per_m * reach
    return float(np.sqrt((along**2 + 2 * (float(tracker.sigma_angle or 0.0) * reach) ** 2) / 3))
