"""Recordings as the library hands them on."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import InputError
from calibration_core.library.arguments import checked
from calibration_core.library.result import Columns, Picture, Tables
from calibration_core.observations.observe import observe
from calibration_core.recording.tables.arrays import readings_of_columns
from calibration_core.recording.tables.columns import POSITION, WRENCH, joint_columns
from calibration_core.timeseries import Float1D, Float2D, Int1D, Readings


@runtime_checkable
class ColumnsByName(Protocol):
    """A data frame, of pandas or another package: names of columns, and each column by its name."""

    columns: Any

    def __getitem__(self, key: Any) -> Any:
        """Return a column."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Recording(Tables):
    """What was measured: one row per configuration, load step and measurement point, in the order of time.

    Attributes:
        readings: The rows, with their covariances where the recording shows them.
        cell: The cell that it was measured in.
    """

    readings: Readings
    cell: Cell

    @property
    def q(self) -> Float2D:
        """(m, n) joint angles as the encoders show them, rad (m where a joint slides)."""
        return self.readings.q

    @property
    def position(self) -> Float2D:
        """(m, 3) m, tracker frame; differences to step 0 where the cell file says `points: displacement`."""
        return self.readings.position

    @property
    def wrench(self) -> Float2D | None:
        """(m, 6) force (N) and torque (N*m) of the environment on the robot, as the cell file says; None unloaded."""
        return self.readings.wrench

    @property
    def configuration(self) -> Int1D:
        """(m,) number of the configuration, no unit."""
        return self.readings.configuration

    @property
    def step(self) -> Int1D:
        """(m,) load step within the configuration, from 0, no unit."""
        return self.readings.step

    @property
    def temperature(self) -> Float1D:
        """(m,) degrees Celsius; NaN where unknown."""
        return self.readings.temperature

    @property
    def notes(self) -> tuple[str, ...]:
        """What was lost, repaired or set aside while reading, one sentence each."""
        return tuple(f"{note.place}: {note.text}" for note in self.readings.notes)

    @property
    def tables(self) -> Mapping[str, Columns]:
        """`measurements`: the columns of the measurement table, SI units."""
        r = self.readings
        columns: dict[str, Any] = {"configuration": r.configuration, "step": r.step}
        columns |= {name: getattr(r, name) for name in ("time", "temperature")}
        columns |= dict(zip(joint_columns(self.cell), r.q.T, strict=True))
        if r.wrench is not None:
            columns |= dict(zip(WRENCH, r.wrench.T, strict=True))
        columns["point"] = [r.points[index] for index in r.point]
        columns |= dict(zip(POSITION, r.position.T, strict=True))
        return {"measurements": columns}

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.readings)

    def __repr__(self) -> str:
        count = len(np.unique(self.readings.configuration))
        loads = "without loads" if self.readings.wrench is None else "with loads"
        return f"recording {self.readings.provenance.path}: {count} configurations, {len(self)} readings, {loads}"

    def _repr_html_(self) -> str:
        return f"<p>{self!r}</p>{self._html_table()}"

    def plot(self) -> Picture:
        """Draw the measured points and the robot, in m, base frame, seen from three sides."""
        from calibration_core.identification.checks.space import operating_space
        from calibration_core.model.nominal import nominal_parameters
        from calibration_core.model.robot import chain_of
        from calibration_core.report.figures.operating_space import space_figure

        space = operating_space(chain_of(self.cell), nominal_parameters(self.cell), self.readings, None)
        return Picture(space_figure(space), "Operating space of the recording, base frame, m")


def recordings_of(recording: Recording | Sequence[Recording]) -> tuple[list[Readings], list[Cell]]:
    """Return the readings of one recording or of several, and the cell of each.

    Raises:
        InputError: There is none.
    """
    recordings = [recording] if isinstance(recording, Recording) else list(recording)
    if not recordings:
        raise InputError("recording", "", "none", "at least one")
    return [one.readings for one in recordings], [one.cell for one in recordings]


@checked
def load_recording(
    source: str | Path | Mapping[str, Any] | ColumnsByName, cell: Cell, name: str = "arrays"
) -> Recording:
    """Read a recording from a file, or take it from arrays that are in memory.

    Args:
        source: A path: rosbag2 directory, `.mcap` or `.db3` file, measurement table (`.csv`), or session directory.
            Otherwise columns of m rows each, as a mapping of arrays or a data frame, with the names and SI units of the
            measurement table: `configuration`, `step`, `q1` ... `qn` (rad), `point`, `x y z` (m, tracker frame), and
            optionally `time` (s), `temperature` (degrees Celsius), `fx fy fz tx ty tz` (N, N*m: wrench of the
            environment on the robot, in sensor axes at the sensor's origin unless the cell file says otherwise).
        cell: The cell that it was measured in.
        name: What arrays are called in messages and results.

    Raises:
        InputError: The recording cannot be used; the message names the place, what was found and what was expected.

    Source: the measurement of CWA 17384, 7.6.
    """
    if isinstance(source, str | Path):
        return Recording(observe(Path(source), cell), cell)
    keys: Iterable[Any] = source if isinstance(source, Mapping) else source.columns
    readings = readings_of_columns({str(key): source[key] for key in keys}, cell, name)
    return Recording(dataclasses.replace(readings, q=readings.q @ cell.robot.coupling.T), cell)
