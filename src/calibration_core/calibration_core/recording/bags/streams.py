"""Samples as they arrived -> a time series: which clock, in which order, what is missing.

Recorded and live samples go through the same function, so that both give the same series.
"""

from __future__ import annotations

import numpy as np

from calibration_core.recording.messages.kinds import Samples
from calibration_core.timeseries import NANOSECONDS, Bool1D, Float2D, Int1D, Note, TimeSeries

LARGEST = 1e9  # m, rad, N, °C: numbers beyond come from damaged bytes
GAP_FACTOR = 5.0  # a pause of more than so many sampling intervals ...
GAP_SECONDS = 0.05  # ... and of more than this is a gap


def to_series(samples: Samples, topic: str) -> tuple[TimeSeries, TimeSeries | None, list[Note]]:
    """Bring samples into the order of time.

    The time of a message is its stamp; where that is zero, its receive time.  If most messages repeat an earlier
    stamp, the sender's clock stands still and the receive times are used throughout.  Messages with a stamp and values
    that were there before are dropped, and so are messages with values that are not finite.

    Returns:
        The series, the series of efforts (None if there are none), and what was lost or repaired.
    """
    notes = _content_notes(samples, topic)
    time = np.where(samples.stamp == 0, samples.received, samples.stamp)
    missing = int(np.count_nonzero(samples.stamp == 0))
    if missing:
        text = f"{missing} of {len(time)} messages have no stamp: their receive time is used"
        notes.append(Note("missing_stamp", topic, text, missing))
    finite: Bool1D = np.logical_and.reduce(np.abs(samples.values) < LARGEST, axis=1)  # False for NaN
    lost = int(len(finite) - np.count_nonzero(finite))
    if lost:
        text = f"{lost} messages with numbers that are not finite, or beyond {LARGEST:g}, are left out"
        notes.append(Note("non_finite", topic, text, lost))
    rows = np.flatnonzero(finite) if lost else np.arange(len(time))
    time = time[rows]
    repeats = _repeats(time)
    if len(time) > 1 and repeats > len(time) / 2:
        text = f"{repeats} of {len(time)} messages repeat an earlier stamp: receive times are used for all"
        notes.append(Note("clock_stands", topic, text, repeats))
        time = samples.received[rows]
        repeats = _repeats(time)
    late = int(np.count_nonzero(np.diff(time) < 0))
    if late:
        order = np.argsort(time, kind="stable")
        rows, time = rows[order], time[order]
        notes.append(Note("out_of_order", topic, f"{late} messages came later than one with a later stamp", late))
    if repeats:
        keep = _first_of_equals(time, samples.values[rows])
        dropped = int(len(keep) - np.count_nonzero(keep))
        rows, time = rows[keep], time[keep]
        text = f"{repeats} messages repeat a stamp; {dropped} of them repeat the values too and are left out"
        notes.append(Note("repeated_stamp", topic, text, repeats))
    notes += _gaps(time, topic)
    frame = max(samples.frames, key=lambda name: samples.frames[name]) if samples.frames else ""
    received = samples.received[rows]
    series = TimeSeries(time, samples.values[rows] if len(rows) < len(samples.values) or late else samples.values,
                        received, frame)  # fmt: skip
    efforts = None
    if samples.efforts is not None:
        torque = samples.efforts[rows]
        has = np.isfinite(torque).all(axis=1)
        if has.any():
            efforts = TimeSeries(time[has], torque[has], received[has], frame)
    return series, efforts, notes


def _content_notes(samples: Samples, topic: str) -> list[Note]:
    notes = []
    if samples.malformed:
        text = f"{samples.malformed} messages cannot be read"
        notes.append(Note("malformed", topic, text, samples.malformed))
    if samples.unusable and len(samples.stamp):
        text = f"{samples.unusable} messages do not have a position for every joint of the cell and are left out"
        notes.append(Note("other_joints", topic, text, samples.unusable))
    if len(samples.frames) > 1:
        names = ", ".join(repr(name) for name in sorted(samples.frames)[:5])
        text = f"messages of {len(samples.frames)} frames on one topic: {names}"
        notes.append(Note("frames", topic, text, len(samples.frames)))
    return notes


def _repeats(time: Int1D) -> int:
    if np.all(time[1:] > time[:-1]):
        return 0
    return len(time) - len(np.unique(time))


def _first_of_equals(time: Int1D, values: Float2D) -> Bool1D:
    """(n,) False for messages with stamp and values of one before, among those of equal stamp."""
    same = np.diff(time) == 0
    involved = np.flatnonzero(np.append(same, False) | np.insert(same, 0, False))
    keys = np.column_stack([time[involved].view(np.float64), values[involved]]).view(np.int64)
    _, first = np.unique(keys, axis=0, return_index=True)
    keep = np.ones(len(time), np.bool_)
    keep[involved] = False
    keep[involved[first]] = True
    return keep


def _gaps(time: Int1D, topic: str) -> list[Note]:
    steps = np.diff(time)
    steps = steps[steps > 0]
    if len(steps) < 10:
        return []
    limit = max(GAP_FACTOR * float(np.median(steps)), GAP_SECONDS * NANOSECONDS)
    gaps = steps[steps > limit]
    if not len(gaps):
        return []
    text = (
        f"{len(gaps)} gaps of more than {limit / NANOSECONDS:.3g} s, the longest of {gaps.max() / NANOSECONDS:.3g} s; "
        f"the usual interval is {np.median(steps) / NANOSECONDS:.3g} s"
    )
    return [Note("gap", topic, text, len(gaps))]
