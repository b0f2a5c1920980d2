"""The values that a session stores, and how a reading is written down."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence

import numpy as np

from calibration_core.errors import quoted
from calibration_core.recording.dates import iso_date
from calibration_core.timeseries import NANOSECONDS, Float1D, Float2D, Note, Provenance, Readings, read_only


@dataclasses.dataclass(frozen=True, eq=False)
class ConfirmedReading:
    """One measurement point at one step, averaged.

    Attributes:
        configuration: Number; 0 is the reference configuration.
        step: Step, for the reference configuration the visit.
        point: Name of the measurement point.
        time: ns since the epoch of the cell's clock, mean stamp of what was averaged.
        q: (n,) rad, encoder angles.
        position: (3,) m, tracker frame.
        position_covariance: (3, 3) m^2, of the mean.
        samples: Tracker samples averaged.
        wrench: (6,) N and N*m, as on the wrench topic; None without sensor.
        wrench_covariance: (6, 6), of the mean; None without sensor.
        temperature: degrees Celsius, NaN where unknown.
    """

    configuration: int
    step: int
    point: str
    time: int
    q: Float1D
    position: Float1D
    position_covariance: Float2D
    samples: int
    wrench: Float1D | None = None
    wrench_covariance: Float2D | None = None
    temperature: float = math.nan

    def __post_init__(self) -> None:
        """Copy to read-only arrays."""
        for name in ("q", "position", "position_covariance", "wrench", "wrench_covariance"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, read_only(getattr(self, name)))


@dataclasses.dataclass(frozen=True)
class Decision:
    """A change of the guard's mind.

    Attributes:
        time: ns.
        permitted: Whether motion was permitted from then on.
        latched: Whether a fault stayed until an operator's reset.
        reasons: Why not; empty if permitted.
    """

    time: int
    permitted: bool
    latched: bool
    reasons: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Event:
    """Something that happened and belongs in the record (a tare, an operator's word, a blocked motion)."""

    time: int
    kind: str
    text: str


def packed(reading: ConfirmedReading) -> str:
    """Return the content of a reading, without its place, as JSON; every float keeps all its digits."""
    arrays = ("q", "position", "position_covariance", "wrench", "wrench_covariance")
    content = {name: None if getattr(reading, name) is None else getattr(reading, name).tolist() for name in arrays}
    temperature = None if math.isnan(reading.temperature) else reading.temperature
    return json.dumps({**content, "samples": reading.samples, "temperature": temperature}, allow_nan=False)


def unpacked(configuration: int, step: int, point: str, time: int, text: str) -> ConfirmedReading:
    """Return the reading that `packed` wrote."""
    content = json.loads(text)
    if content["temperature"] is None:
        content["temperature"] = math.nan
    return ConfirmedReading(configuration, step, point, time, **content)


def checked_reading(
    configuration: int, step: int, point: str, time: int, content: object, joints: int
) -> ConfirmedReading:
    """Return the reading in content that anybody may have written, parsed from JSON.

    Args:
        configuration: Its number; likewise `step`, `point` and `time`, checked already.
        step: See there.
        point: See there.
        time: See there.
        content: What `packed` wrote.
        joints: Of the robot.

    Raises:
        ValueError: Something is wrong with it; the text is what was found, a bar, and what was expected.
    """
    if not isinstance(content, dict):
        raise ValueError(f"{quoted(content)}|a mapping")
    shapes = {"q": (joints,), "position": (3,), "position_covariance": (3, 3)}
    if content.get("wrench") is not None:
        shapes |= {"wrench": (6,), "wrench_covariance": (6, 6)}
    arrays = {name: _array(name, content.get(name), shape) for name, shape in shapes.items()}
    for name in ("position_covariance", "wrench_covariance"):
        if name in arrays and not _is_covariance(arrays[name]):
            raise ValueError(f"{name} {quoted(content[name])}|a covariance: symmetric, no variance below zero")
    samples, temperature = content.get("samples"), content.get("temperature")
    if isinstance(samples, bool) or not isinstance(samples, int) or not 0 < samples < 1 << 32:
        raise ValueError(f"samples {quoted(samples)}|an integer of at least one")
    if not (temperature is None or _is_number(temperature)):
        raise ValueError(f"temperature {quoted(temperature)}|degrees Celsius or null")
    celsius = math.nan if temperature is None else float(temperature)
    return ConfirmedReading(configuration, step, point, time, samples=samples, temperature=celsius, **arrays)


def _array(name: str, value: object, shape: tuple[int, ...]) -> Float2D:
    try:
        found = np.array(value, dtype=np.float64) if _is_nested(value, shape) else None
    except OverflowError:  # an integer beyond all floats
        found = None
    if found is None or not np.isfinite(found).all():
        raise ValueError(f"{name} {quoted(value)}|{' x '.join(map(str, shape))} finite numbers")
    return found


def _is_nested(value: object, shape: tuple[int, ...]) -> bool:
    if not shape:
        return _is_number(value)
    return isinstance(value, list) and len(value) == shape[0] and all(_is_nested(one, shape[1:]) for one in value)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300


def _is_covariance(values: Float2D) -> bool:
    largest = np.abs(values).max()
    return bool(np.all(np.diag(values) >= 0.0) and np.abs(values - values.T).max() <= 1e-9 * largest)


def point_excluded(configuration: object, text: object) -> Note:
    """Return what is said of a configuration that an operator has left a point out of; anybody may have written it."""
    return Note("point_excluded", f"configuration {str(configuration)[:20]}", str(text)[:300])


def tracker_clock(text: object) -> Note:
    """Return what is said of a tracker's clock; anybody may have written it."""
    return Note("tracker_clock", "tracker", f"{str(text)[:300]}; its stamps are corrected")


def as_readings(
    confirmed: Sequence[ConfirmedReading],
    points: tuple[str, ...],
    path: str,
    *,
    sha256: Mapping[str, str] | None = None,
    plan_sha256: str = "",
    notes: tuple[Note, ...] = (),
) -> Readings:
    """Return confirmed readings as the identification takes them.

    Args:
        confirmed: At least one, in the order of time.
        points: Names of the measurement points, in the cell's order.
        path: Of the session, for the provenance.
        sha256: File name -> SHA-256 of what was read.
        plan_sha256: Of the plan that was measured.
        notes: What has to be said of them.
    """
    origin = confirmed[0].time
    with_wrench = all(r.wrench is not None for r in confirmed)
    return Readings(
        points=points,
        configuration=np.array([r.configuration for r in confirmed], np.int64),
        step=np.array([r.step for r in confirmed], np.int64),
        point=np.array([points.index(r.point) for r in confirmed], np.int64),
        q=np.array([r.q for r in confirmed]),
        position=np.array([r.position for r in confirmed]),
        wrench=np.array([r.wrench for r in confirmed]) if with_wrench else None,
        time=np.array([(r.time - origin) / NANOSECONDS for r in confirmed]),
        temperature=np.array([r.temperature for r in confirmed]),
        provenance=Provenance(
            path, "session", sha256 or {}, {"reading": len(confirmed)}, iso_date(origin), plan_sha256
        ),
        notes=notes,
        position_covariance=np.array([r.position_covariance for r in confirmed]),
        wrench_covariance=np.array([r.wrench_covariance for r in confirmed]) if with_wrench else None,
        samples=np.array([r.samples for r in confirmed], np.int64),
    )
