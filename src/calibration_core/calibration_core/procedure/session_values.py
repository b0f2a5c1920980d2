"""The values that a session stores, and how a reading is written down."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence

import numpy as np

from calibration_core.timeseries import NANOSECONDS, Float1D, Float2D, Provenance, Readings, read_only


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


def as_readings(confirmed: Sequence[ConfirmedReading], points: tuple[str, ...], path: str) -> Readings:
    """Return confirmed readings as the identification takes them.

    Args:
        confirmed: At least one, in the order of time.
        points: Names of the measurement points, in the cell's order.
        path: Of the session, for the provenance.
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
        provenance=Provenance(path, "session", {}, {"reading": len(confirmed)}),
        position_covariance=np.array([r.position_covariance for r in confirmed]),
        wrench_covariance=np.array([r.wrench_covariance for r in confirmed]) if with_wrench else None,
        samples=np.array([r.samples for r in confirmed], np.int64),
    )
