"""Recordings to readings: one row per configuration, step and point, whatever the recording was."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import ObservationError
from calibration_core.observations.average import average, mean_of
from calibration_core.observations.clock import clock_offset, corrected, on_one_base, refuse_frozen, without_faults
from calibration_core.observations.plateaus import USUAL_SIGMA, Window, found_windows, marked_windows
from calibration_core.observations.window import settled_from
from calibration_core.recording.bags.bag import read_bag
from calibration_core.recording.session import read_session
from calibration_core.recording.source import recording_kind
from calibration_core.recording.tables.table import read_table
from calibration_core.timeseries import NANOSECONDS, Condition, Float1D, Float2D, Note, Readings, Streams, TimeSeries

POSITION_DRIFT = 3.0  # claimed standard deviations over a window do not matter
WRENCH_DRIFT = 5.0
WRENCH_DRIFT_SHARE = 0.01  # of the load
JOINT_DRIFT = 5e-4  # rad
NEAREST_JOINTS = 1.0  # s; a window between two joint states takes what lies between them
NEAREST_TEMPERATURE = 600.0  # s
CLAIMS_BASE_AXES = "wrench_axes"  # note: the messages say that the wrench is in base axes


def observe(path: Path, cell: Cell, *, simulated: bool = False) -> Readings:
    """Read a recording of any kind.

    Args:
        path: A bag, a measurement table, or a session (directory or database).
        cell: The cell it was recorded in.
        simulated: Whether a simulation wrote it, see `read_table`.

    Returns:
        The readings, their angles those of the chain; `notes` tell what was lost, repaired or set aside.

    Raises:
        RecordingError: The recording cannot be used.
        ObservationError: It holds nothing that can be evaluated.
    """
    path = Path(path)
    kind = recording_kind(path)
    if kind == "table":
        readings = read_table(path, cell, simulated=simulated)
    elif kind == "session":
        readings, conditions = read_session(path, cell)
        readings = dataclasses.replace(readings, conditions=worst(conditions))
    else:
        readings = observe_recording(read_bag(path, cell), cell)
    refuse_frozen(readings, cell)
    return (
        dataclasses.replace(readings, q=readings.q @ cell.robot.coupling.T) if cell.robot.joint_coupling else readings
    )


def observe_recording(recording: Streams, cell: Cell) -> Readings:
    """Turn streams into readings: find the windows, let them settle, average.

    Joint angles, wrench and temperature of a row are averaged over the stretch in which its point was seen.  The
    result depends on the arrays of the recording alone.

    Raises:
        ObservationError: No window, or none with a settled point.
        RecordingError: A topic carries messages of two publishers, or nothing but zeros.
    """
    recording = on_one_base(without_faults(recording, cell))
    windows, notes = _windows(recording, cell)
    recording, clock = corrected(recording, clock_offset(recording, windows, cell))
    rows: list[_Row] = []
    aside: list[Note] = []
    outliers = 0
    for window in windows:
        for point, name in enumerate(cell.points):
            series = recording.points.get(name)
            if series is None:
                continue
            found = _row(recording, cell, window, point, series)
            if isinstance(found, Note):
                aside.append(found)
            elif found is not None:
                rows.append(found)
                outliers += found.outliers
    if not rows:
        found_text = f"{len(windows)} plateaus, none with a settled point" if windows else "no plateau"
        raise ObservationError(
            recording.provenance.path,
            "",
            found_text,
            "standstills of the joints with constant wrench and tracker readings",
        )
    if outliers:
        aside.append(Note("outlier_samples", "tracker", f"{outliers} wild samples within plateaus left out", outliers))
    rows.sort(key=lambda row: row.time)
    return _readings(recording, cell, rows, (*recording.notes, *notes, *clock, *aside, *_frame_notes(recording, cell)))


def _frame_notes(recording: Streams, cell: Cell) -> list[Note]:
    """Say that the messages claim other axes of the wrench than the cell file does."""
    frame = "" if recording.wrench is None else recording.wrench.frame
    base = cell.robot.base_link or "base_link"
    if frame != base or cell.measurements.wrench_axes != "sensor":
        return []
    text = f"the messages carry the frame {frame!r}, the cell file says that the wrench is in sensor axes"
    return [Note(CLAIMS_BASE_AXES, "wrench", text)]


def _windows(recording: Streams, cell: Cell) -> tuple[list[Window], list[Note]]:
    if recording.steps is not None:
        streams = [recording.joints, *recording.points.values()]
        windows, notes = marked_windows(recording.steps, max(int(series.time[-1]) for series in streams))
        if windows:
            return windows, notes
    windows = found_windows(recording, cell)
    steps = len(windows)
    count = len({window.configuration for window in windows})
    text = f"no step markers: {steps} plateaus in {count} configurations found from joint standstill and wrench"
    return windows, [Note("no_markers", "/calibration/step", text)]


@dataclasses.dataclass(frozen=True, eq=False)
class _Row:
    window: Window
    point: int
    time: float
    q: Float1D
    position: Float1D
    position_covariance: Float2D
    wrench: Float1D
    wrench_covariance: Float2D
    temperature: float
    samples: int
    outliers: int


def _row(recording: Streams, cell: Cell, window: Window, point: int, series: TimeSeries) -> _Row | Note | None:
    """Average one point over one window; a note if it cannot be used, None if the point was not seen."""
    place = f"configuration {window.configuration}, step {window.step}, {cell.points[point]}"
    seen = _cut(series, window.begin, window.end)
    if not len(seen):
        return None
    settled = settled_from(seen.time, seen.values, np.full(3, POSITION_DRIFT * _claim(cell, seen.values)))
    if settled is None:
        return _unsettled(place, "the point", seen, 1e6, "µm")
    seen = _from(seen, settled)
    begin, end = int(seen.time[0]), int(seen.time[-1]) + 1
    if len(seen) == 1:  # one averaged reading of the instrument itself: it stands for the window
        begin, end = window.begin, window.end
    joints = _cut(recording.joints, begin, end)
    if settled_from(joints.time, joints.values, np.full(joints.values.shape[1], JOINT_DRIFT)) is None:
        return _unsettled(place, "the joints", joints, 1e3, "mrad")
    q = mean_of(joints.values) if len(joints) else _between(recording.joints, begin, end, NEAREST_JOINTS)
    if q is None:
        return Note("missing", place, "no joint states near this reading")
    force, force_covariance = np.zeros(6), np.zeros((6, 6))
    if recording.wrench is not None:
        pulled = _cut(recording.wrench, begin, end)
        if not len(pulled):
            pulled = _cut(recording.wrench, window.begin, window.end)
        if not len(pulled):
            return Note("missing", place, "no wrench was recorded during this reading")
        if settled_from(pulled.time, pulled.values, _wrench_tolerance(cell, pulled.values)) is None:
            return _unsettled(place, "the wrench", pulled, 1.0, "N or N*m")
        mean = average(pulled.values)
        force, force_covariance = mean.mean, mean.covariance
    position = average(seen.values)
    return _Row(
        window, point, float(np.mean(seen.time - _origin(recording))) / NANOSECONDS, q, position.mean,
        position.covariance, force, force_covariance, _temperature(recording, begin, end), position.samples,
        position.outliers,
    )  # fmt: skip


def _readings(recording: Streams, cell: Cell, rows: list[_Row], notes: tuple[Note, ...]) -> Readings:
    has_wrench = recording.wrench is not None
    return Readings(
        points=cell.points,
        configuration=np.array([row.window.configuration for row in rows], np.int64),
        step=np.array([row.window.step for row in rows], np.int64),
        point=np.array([row.point for row in rows], np.int64),
        q=np.array([row.q for row in rows]),
        position=np.array([row.position for row in rows]),
        wrench=np.array([row.wrench for row in rows]) if has_wrench else None,
        time=np.array([row.time for row in rows]),
        temperature=np.array([row.temperature for row in rows]),
        provenance=recording.provenance,
        notes=notes,
        position_covariance=np.array([row.position_covariance for row in rows]),
        wrench_covariance=np.array([row.wrench_covariance for row in rows]) if has_wrench else None,
        samples=np.array([row.samples for row in rows], np.int64),
        conditions=worst(recording.conditions),
    )


def _origin(recording: Streams) -> int:
    """First sample of the recording, ns: times of readings count from here."""
    return min(int(series.time[0]) for series in [recording.joints, *recording.points.values()])


def _cut(series: TimeSeries, begin: int, end: int) -> TimeSeries:
    first, last = np.searchsorted(series.time, [begin, end])
    return _from(series, int(first), int(last))


def _from(series: TimeSeries, first: int, last: int | None = None) -> TimeSeries:
    rows = slice(first, last)
    return TimeSeries(series.time[rows], series.values[rows], series.received[rows], series.frame)


def _claim(cell: Cell, position: Float2D) -> float:
    """One claimed standard deviation of a coordinate, m; for a spherical claim the larger of range and angle."""
    tracker = cell.instruments.tracker
    if tracker.sigma is not None:
        return tracker.sigma
    reach = float(np.median(np.linalg.norm(position, axis=1)))
    along = float(tracker.sigma_range or 0.0) + tracker.sigma_range_per_m * reach
    return max(along, float(tracker.sigma_angle or 0.0) * reach)


def _wrench_tolerance(cell: Cell, values: Float2D) -> Float1D:
    sensor = cell.instruments.force_torque
    force, torque = USUAL_SIGMA if sensor is None else (sensor.sigma_force, sensor.sigma_torque)
    load = np.linalg.norm(values.mean(axis=0).reshape(2, 3), axis=1)
    return np.repeat(np.maximum(WRENCH_DRIFT * np.array([force, torque]), WRENCH_DRIFT_SHARE * load), 3)


def _unsettled(place: str, what: str, series: TimeSeries, scale: float, unit: str) -> Note:
    half = len(series) // 2
    change = np.abs(series.values[half:].mean(axis=0) - series.values[:half].mean(axis=0)).max()
    text = f"{what} still moves (halves of the window differ by {change * scale:.3g} {unit}): set aside"
    return Note("unsettled", place, text)


def _between(series: TimeSeries, begin: int, end: int, nearest: float) -> Float1D | None:
    """Interpolate at the middle of a stretch without samples; None if the neighbours are too far away."""
    middle = (begin + end) // 2
    after = int(np.searchsorted(series.time, middle))
    near = [i for i in (after - 1, after) if 0 <= i < len(series)]
    near = [i for i in near if abs(int(series.time[i]) - middle) <= nearest * NANOSECONDS + (end - begin) / 2]
    if not near:
        return None
    time = (series.time[near] - middle).astype(np.float64)
    return np.array([np.interp(0.0, time, column) for column in series.values[near].T])


def _temperature(recording: Streams, begin: int, end: int) -> float:
    if recording.temperature is None:
        return float("nan")
    inside = _cut(recording.temperature, begin, end)
    if len(inside):
        return float(inside.values.mean())
    near = _between(recording.temperature, begin, end, NEAREST_TEMPERATURE)
    return float("nan") if near is None else float(near[0])


def worst(history: Sequence[Sequence[Condition]]) -> tuple[Condition, ...]:
    """Sum up what was seen of every condition over a measurement.

    A violation stays, with the value of the first one, whatever came before or after; otherwise the last known value
    counts.  An override that was given at any time stays.
    """
    summed: dict[str, Condition] = {}
    for conditions in history:
        for one in conditions:
            before = summed.get(one.name)
            if before is None:
                summed[one.name] = one
                continue
            kept = before if before.met is False or (one.met is None and before.met is not None) else one
            summed[one.name] = dataclasses.replace(kept, override=one.override or before.override)
    return tuple(summed.values())
