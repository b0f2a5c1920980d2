"""Input that is no measurement: zeros of a lost target, messages of two publishers, readings that stand still."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import RecordingError
from calibration_core.timeseries import NANOSECONDS, Bool1D, Float2D, Note, Readings, Streams, TimeSeries

TO_AND_FRO = 0.1  # share of messages that jump away from both neighbours; noise does so in fewer than 0.02
NEARER = 5.0  # times nearer to each other than to the message between them, the neighbours of such a message
SOON = 1.0  # s between such neighbours: a robot does not go there and back meanwhile
JUMP_JOINTS = 5e-4  # rad, m: more than an encoder's step
JUMP_POINTS = 1e-4  # m: more than the noise of a laser tracker
JUMP_WRENCH = 0.05  # of the largest load
LAST_DIGITS = 8 * np.finfo(np.float64).eps  # relative: averages of equal numbers differ by no more
MOVED_JOINT = 1e-3  # rad, m
MOVED_POINT = 0.01  # m: more than any load bends a robot
FEWEST_STEPS = 3  # of a configuration, in which a wrench that is measured is never the same
COPIED = 0.01  # of the configurations: so few are copied rows, gross errors (2 of 1,000 in a public UR10 table)


def without_faults(recording: Streams, cell: Cell) -> Streams:
    """Return a recording without readings of lost targets.

    Trackers report 0, 0, 0 where they see no target; no measured position is that to the bit.

    Raises:
        RecordingError: A topic carries messages of two publishers, or nothing but zeros.
    """
    path, topics = recording.provenance.path, cell.topics
    streams = [(topics.joint_states, recording.joints, JUMP_JOINTS)]
    points, notes = dict(recording.points), []
    for name, series in recording.points.items():
        topic = topics.point(name)
        lost = ~series.values.any(axis=1)
        if cell.measurements.points == "absolute" and lost.any():
            if lost.all():
                expected = "positions; trackers report zeros where they see no target"
                raise RecordingError(path, topic, "zeros in all messages", expected)
            kept = ~lost
            points[name] = TimeSeries(series.time[kept], series.values[kept], series.received[kept], series.frame)
            count = int(lost.sum())
            text = f"{count} messages of exactly 0, 0, 0 are left out: trackers report them where they see no target"
            notes.append(Note("zeros", topic, text, count))
        streams.append((topic, points[name], JUMP_POINTS))
    if recording.wrench is not None:
        wrench = recording.wrench
        force = TimeSeries(wrench.time, wrench.values[:, :3], wrench.received, wrench.frame)
        streams.append((topics.wrench, force, JUMP_WRENCH * float(np.abs(force.values).max(initial=0.0))))
    for topic, series, jump in streams:
        if _jumps_to_and_fro(series, jump):
            found = "messages that jump to and fro between two values: two publishers write on it"
            expected = f"one: ros2 topic info -v {topic} names them; record again with one of them"
            raise RecordingError(path, topic, found, expected)
    return dataclasses.replace(recording, points=points, notes=(*recording.notes, *notes))


def _jumps_to_and_fro(series: TimeSeries, least: float) -> bool:
    """Tell whether many messages lie far from both neighbours, and these near each other."""
    values = series.values
    if len(values) < 3:
        return False
    soon = series.time[2:] - series.time[:-2] < SOON * NANOSECONDS
    step = np.abs(np.diff(values, axis=0)).max(axis=1)
    apart = np.abs(values[2:] - values[:-2]).max(axis=1)
    away = np.minimum(step[1:], step[:-1])
    return bool(np.mean(soon & (away > least) & (away > NEARER * apart)) > TO_AND_FRO)


def refuse_frozen(readings: Readings, cell: Cell) -> None:
    """Refuse readings that stay the same, to the last digit, while what they measure changes.

    Raises:
        RecordingError: A target, the joint angles or the wrench stand still; it says where.
    """
    path = readings.provenance.path
    if cell.measurements.points == "absolute":
        for index, name in enumerate(readings.points):
            rows = np.flatnonzero(readings.point == index)
            rows = rows[np.unique(readings.configuration[rows], return_index=True)[1]]
            q, position, numbers = readings.q[rows], readings.position[rows], readings.configuration[rows]
            turned = np.abs(np.diff(q[:, :-1], axis=0)).max(axis=1) > MOVED_JOINT
            moved = np.linalg.norm(np.diff(position, axis=0), axis=1) > MOVED_POINT
            for what, same in ((name, _same(position) & turned), ("joint angles", _same(q) & moved)):
                if same.any() and same.mean() > COPIED:
                    where = ", ".join(map(str, numbers[1:][same][:10]))
                    found = f"the numbers of the configuration before, to the last digit, in configuration {where}"
                    expected = "readings that move with the robot: its source stood still there; leave these out"
                    raise RecordingError(path, what, found, expected)
    if readings.wrench is None:
        return
    still = []
    for number in np.unique(readings.configuration):
        rows = np.flatnonzero(readings.configuration == number)
        wrench = readings.wrench[rows]
        if len(np.unique(readings.step[rows])) >= FEWEST_STEPS and _same(wrench).all() and wrench.any():
            still.append((int(number), wrench[:1]))
    if len(still) > 1 and _same(np.vstack([wrench for _, wrench in still])).all():
        where = ", ".join(str(number) for number, _ in still)
        found = f"the same numbers, to the last digit, in all steps of configurations {where}"
        raise RecordingError(path, "wrench", found, "readings of a load: the sensor stood still there; leave these out")


def _same(values: Float2D) -> Bool1D:
    """Tell of each row but the first, (n, k), whether it repeats the one before."""
    return np.asarray((np.abs(np.diff(values, axis=0)) <= LAST_DIGITS * np.abs(values[1:])).all(axis=1))
