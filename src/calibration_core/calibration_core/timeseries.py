"""The vocabulary everyone shares: frozen values with read-only arrays, units stated, no opinion.

Two levels.  `Streams` are what sensors sent, sampled, one stream per topic.  `Readings` are what was measured:
one row per configuration, step and measurement point, as in the measurement table; a bag becomes readings by finding
its plateaus, a table is readings already.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float1D = NDArray[np.float64]  # (n,)
Float2D = NDArray[np.float64]  # (m, n)
Float3D = NDArray[np.float64]  # (k, m, n)
Float4D = NDArray[np.float64]  # (l, k, m, n)
FloatND = NDArray[np.float64]  # of several shapes, which the function states
Int1D = NDArray[np.int64]  # (n,)
Int2D = NDArray[np.int64]  # (m, n)
Bool1D = NDArray[np.bool_]  # (n,)
Bool2D = NDArray[np.bool_]  # (m, n)

NANOSECONDS = 1_000_000_000


def read_only(values: ArrayLike, dtype: type = np.float64) -> NDArray[np.float64]:
    """Copy `values` into a contiguous array that cannot be written to."""
    array: NDArray[np.float64] = np.array(values, dtype=dtype, order="C")
    array.setflags(write=False)
    return array


def in_time(configuration: Int1D) -> Int1D:
    """Return the position of every reading's configuration in the order in which they were read, (m,), from 0.

    Their numbers are names: they need not grow.
    """
    _, first, index = np.unique(configuration, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[index.reshape(-1)].astype(np.int64)


def numbers_in_time(configuration: Int1D) -> Int1D:
    """Return the different numbers of configurations, in the order in which they were read."""
    return configuration[np.sort(np.unique(configuration, return_index=True)[1])]


class Phase(enum.IntEnum):
    """What the cell is doing, as in `calibration_interfaces/msg/MeasurementStep`."""

    MOVING = 0
    LOADING = 1
    SETTLING = 2
    MEASURING = 3
    UNLOADING = 4
    DONE = 5


@dataclasses.dataclass(frozen=True, eq=False)
class TimeSeries:
    """Samples of one sensor, in the order of time.

    Attributes:
        time: (n,) int64, ns since the epoch of the recording's clock; never decreasing.
        values: (n, k) float64 in SI units (degrees Celsius for temperature).
        received: (n,) int64, receive time in ns, in the same order.
        frame: `frame_id` of the samples, empty where the message has none.
    """

    time: Int1D
    values: Float2D
    received: Int1D
    frame: str = ""

    def __post_init__(self) -> None:
        """Copy to read-only arrays; raise ValueError on unequal lengths or decreasing time."""
        time = read_only(self.time, np.int64)
        values = read_only(self.values)
        received = read_only(self.received, np.int64)
        if time.ndim != 1 or values.ndim != 2 or time.shape != received.shape or len(time) != len(values):
            msg = f"expected (n,), (n, k), (n,); got {time.shape}, {values.shape}, {received.shape}"
            raise ValueError(msg)
        if len(time) > 1 and np.any(np.diff(time) < 0):
            msg = "time decreases"
            raise ValueError(msg)
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "received", received)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.time)


@dataclasses.dataclass(frozen=True, eq=False)
class StepMarkers:
    """The changes announced on `/calibration/step`.

    Attributes:
        time: (n,) int64, ns; never decreasing.
        configuration: (n,) int64.
        step: (n,) int64.
        phase: (n,) int64, values of `Phase`.
    """

    time: Int1D
    configuration: Int1D
    step: Int1D
    phase: Int1D

    def __post_init__(self) -> None:
        """Copy to read-only arrays; raise ValueError on unequal lengths."""
        arrays = {f.name: read_only(getattr(self, f.name), np.int64) for f in dataclasses.fields(self)}
        if len({a.shape for a in arrays.values()}) != 1 or self.time.ndim != 1:
            msg = f"unequal lengths {[a.shape for a in arrays.values()]}"
            raise ValueError(msg)
        for name, array in arrays.items():
            object.__setattr__(self, name, array)


NO_INTERVALS = "no_intervals"  # kind of the note that a model file states no covariance


@dataclasses.dataclass(frozen=True)
class Note:
    """Something a person must be told about the data: lost, repaired, set aside or suspicious.

    Attributes:
        kind: A short stable word, e.g. `truncated`, `gap`, `out_of_order`, `repeated_stamp`, `non_finite`, `unsettled`.
        place: File, topic, row or configuration concerned.
        text: One sentence with the figures.
        count: How many messages, rows or samples are concerned.
    """

    kind: str
    place: str
    text: str
    count: int = 1

    @property
    def line(self) -> str:
        """The note as a terminal shows it."""
        return f"note: {self.place}: {self.text}"


@dataclasses.dataclass(frozen=True)
class Override:
    """Who let a measurement go on although a condition of the standard was violated, and why.

    Attributes:
        operator: Who answers for it.
    """

    condition: str
    operator: str
    reason: str


@dataclasses.dataclass(frozen=True)
class Condition:
    """One condition that CWA 17384 puts on the measurement, as it was seen while measuring.

    Attributes:
        name: A stable word, e.g. `temperature`.
        clause: Of the standard.
        requirement: In few words.
        limit: With its unit.
        value: What was seen, with its unit.
        met: True, False, or None where it cannot be seen.
        shall: Whether the standard demands it; otherwise it recommends it.
        override: Who let the measurement go on all the same; None if nobody did.
    """

    name: str
    clause: str
    requirement: str
    limit: str
    value: str
    met: bool | None
    shall: bool
    override: Override | None = None

    @property
    def stops(self) -> bool:
        """Whether a run must not go on."""
        return self.shall and self.met is False and self.override is None


@dataclasses.dataclass(frozen=True)
class Provenance:
    """Where data came from.

    Attributes:
        path: As the user named it.
        kind: `mcap`, `db3`, `csv` or `session`.
        sha256: File name -> SHA-256 hex digest of every file read.
        messages: Topic -> number of messages (rows for a table) that were read.
        start: UTC date of the first sample, ISO 8601, empty if the recording carries no date.
        plan_sha256: SHA-256 of the plan that was measured, empty where the recording does not know it.
    """

    path: str
    kind: str
    sha256: Mapping[str, str]
    messages: Mapping[str, int]
    start: str = ""
    plan_sha256: str = ""


@dataclasses.dataclass(frozen=True, eq=False)
class Streams:
    """Everything a bag holds that this software knows, as arrays.

    Attributes:
        joints: (n, joints) rad, columns in the order of the cell's joint names.
        joint_efforts: (n, joints) N*m where the messages carry efforts, else None.
        points: Measurement point -> (n, 3) m, tracker frame.
        wrench: (n, 6) N and N*m (force, torque), sensor axes at the sensor origin; None if not recorded.
        temperature: (n, 1) degrees Celsius; None if not recorded.
        steps: Step markers; None if not recorded.
        robot_description: URDF text, empty if not recorded.
        provenance: Files, hashes and counts.
        notes: What was lost or repaired.
        conditions: The standard's conditions as they were seen while measuring: every change, in the order of time.
    """

    joints: TimeSeries
    points: Mapping[str, TimeSeries]
    wrench: TimeSeries | None
    temperature: TimeSeries | None
    steps: StepMarkers | None
    robot_description: str
    provenance: Provenance
    notes: tuple[Note, ...] = ()
    joint_efforts: TimeSeries | None = None
    conditions: tuple[tuple[Condition, ...], ...] = ()

    def __post_init__(self) -> None:
        """Freeze the mapping of points."""
        object.__setattr__(self, "points", MappingProxyType(dict(self.points)))


@dataclasses.dataclass(frozen=True, eq=False)
class Readings:
    """One row per configuration, step and measurement point, in the order of time.

    Attributes:
        points: Names of the measurement points.
        configuration: (m,) int64.
        step: (m,) int64, 0 first within a configuration.
        point: (m,) int64, index into `points`.
        q: (m, n) rad, encoder angles at this reading.
        position: (m, 3) m, tracker frame (or differences to step 0: cell file, `measurements.points`).
        wrench: (m, 6) N and N*m as recorded (cell file, `measurements.wrench_*`); None: no external load known.
        time: (m,) s, NaN where unknown.
        temperature: (m,) degrees Celsius, NaN where unknown.
        position_covariance: (m, 3, 3) m^2, of the mean over the plateau, from its own scatter; None for a table.
        wrench_covariance: (m, 6, 6), of the mean over the plateau; None for a table.
        samples: (m,) int64, tracker samples averaged; None for a table.
        provenance: Files, hashes and counts.
        notes: What was lost, repaired or set aside on the way.
        conditions: The standard's conditions as they were seen while measuring, the worst of each; empty for a table.
        recording: (m,) int64, which of several recordings that are evaluated together a row is from; None: one alone.
        position_claim: (m, 3, 3) m^2, what the instrument of its recording claims; None: what the cell file states.
        wrench_claim: (m, 6, 6), likewise.
        viewpoint: (m, 3) m, where the tracker stood, base frame, which is that of `position`; None: at its origin.
        wrench_change: (m, 6, 6) what takes a wrench from axes and origin of its own sensor to those of `wrench`.
    """

    points: tuple[str, ...]
    configuration: Int1D
    step: Int1D
    point: Int1D
    q: Float2D
    position: Float2D
    wrench: Float2D | None
    time: Float1D
    temperature: Float1D
    provenance: Provenance
    notes: tuple[Note, ...] = ()
    position_covariance: Float3D | None = None
    wrench_covariance: Float3D | None = None
    samples: Int1D | None = None
    conditions: tuple[Condition, ...] = ()
    recording: Int1D | None = None
    position_claim: Float3D | None = None
    wrench_claim: Float3D | None = None
    viewpoint: Float2D | None = None
    wrench_change: Float3D | None = None

    def __post_init__(self) -> None:
        """Copy to read-only arrays; raise ValueError on unequal lengths."""
        rows = len(self.configuration)
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                if len(value) != rows:
                    msg = f"{field.name} has {len(value)} rows, configuration has {rows}"
                    raise ValueError(msg)
                integer = np.issubdtype(value.dtype, np.integer)
                object.__setattr__(self, field.name, read_only(value, np.int64 if integer else np.float64))

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.configuration)

    def select(self, rows: NDArray[np.bool_] | Int1D) -> Readings:
        """Return the readings of the given rows (mask or indices), everything else kept."""
        changes = {
            field.name: getattr(self, field.name)[rows]
            for field in dataclasses.fields(self)
            if isinstance(getattr(self, field.name), np.ndarray)
        }
        return dataclasses.replace(self, **changes)

    def each(self) -> list[Int1D]:
        """Return the rows of every recording, as indices: all rows where there is one alone."""
        if self.recording is None:
            return [np.arange(len(self))]
        return [np.flatnonzero(self.recording == number) for number in np.unique(self.recording)]

    def with_notes(self, *notes: Note) -> Readings:
        """Return the same readings with further notes."""
        return dataclasses.replace(self, notes=(*self.notes, *notes))
