"""`calibration_core.verify` and `compare`: whether a model still holds, and what has changed since."""

from __future__ import annotations

import dataclasses
import datetime as dt
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calibration_core.acceptance.comparison import QuantityChange
from calibration_core.acceptance.decision import COVERAGE
from calibration_core.acceptance.verification import Verification
from calibration_core.acceptance.verification import verify as judged_by
from calibration_core.cell import Cell
from calibration_core.commands.acceptance import compare as comparing
from calibration_core.commands.acceptance import verify as verifying
from calibration_core.errors import InputError, RecordingError
from calibration_core.library.arguments import checked
from calibration_core.library.models import HoldsModel, given_model
from calibration_core.library.recordings import Recording
from calibration_core.library.result import Columns, Picture, ResultWithLight, columns_of
from calibration_core.model.parameters import ModelParameters
from calibration_core.outcomes.comparison import (
    Compared,
    compared_sources,
    recorded_source,
    refuse_other_robots,
    source_of,
)
from calibration_core.outcomes.inputs import Inputs, look, naming_model, refuse_own
from calibration_core.outcomes.verification import places
from calibration_core.report.writing.output import Content
from calibration_core.timeseries import Float1D


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class VerificationResult(ResultWithLight):
    """A model judged by places that it was not identified from.

    Attributes:
        cell: The cell that it holds for.
        recording: What was measured.
        parameters: The model.
        found: Errors, their uncertainty, and decisions.
        inputs: Role -> name -> SHA-256 of what it rests on.
    """

    recording: Recording
    parameters: ModelParameters
    found: Verification
    inputs: Inputs

    @property
    def decision(self) -> str:
        """`conforming`, `not_conforming` or `undecided` (ISO 14253-1), no unit."""
        return self.found.decision

    @property
    def error(self) -> Float1D:
        """(m,) m: distance of every measured point from the predicted one."""
        return self.found.size

    @property
    def uncertainty(self) -> Float1D:
        """(m,) m: standard uncertainty of `error`."""
        return self.found.uncertainty

    @property
    def tables(self) -> Mapping[str, Columns]:
        """`places`: per configuration the reading nearest to, or furthest beyond, the tolerance; m."""
        rows = places(self.found)
        return {"places": columns_of(rows, tuple(rows[0]))}

    @property
    def summary(self) -> str:
        """What was decided, in a few lines, as the command prints it; mm."""
        return verifying.verification_summary(self.found)

    def plot(self) -> Picture:
        """Draw the errors reading by reading with the ends of their 95 % intervals and the tolerance, mm."""
        from calibration_core.report.figures.application import errors_figure

        before = None if self.found.before is None else 1e3 * np.linalg.norm(self.found.before, axis=1)
        bound = 1e3 * (self.found.size + COVERAGE * self.found.uncertainty)
        figure = errors_figure(
            before, 1e3 * self.found.size, bound, ("reading", "with the model"), 1e3 * self.found.tolerance
        )
        return Picture(figure, "Errors of the verification")

    def files(self, *, report: bool = True) -> dict[str, Content]:
        """Return result, report and certificate: file name -> bytes; arguments as for `save`."""
        return verifying.files_of(
            self.found, self.cell, self.recording.readings, self.parameters, self.inputs, report=report
        )

    def _content(self) -> dict[str, Any]:
        return verifying.verification_result(self.found, self.cell, self.recording.readings, self.inputs)


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class ComparisonResult(ResultWithLight):
    """What has changed between measurements of one robot, or between twins.

    Attributes:
        cell: The first measurement's cell.
        found: Measurements, differences and trends.
    """

    found: Compared

    @property
    def differences(self) -> tuple[tuple[QuantityChange, ...], ...]:
        """Per measurement after the first: each quantity's change with its 95 % interval and verdict, SI units."""
        return self.found.differences

    @property
    def tables(self) -> Mapping[str, Columns]:
        """`differences`: one row per quantity of every measurement after the first; SI units."""
        rows = [
            {"measurement": other.label, **vars(one)}
            for other, of in zip(self.found.measurements[1:], self.found.differences, strict=True)
            for one in of
        ]
        return {"differences": columns_of(rows, ("measurement", *(f.name for f in dataclasses.fields(QuantityChange))))}

    @property
    def summary(self) -> str:
        """What has changed, in a few lines, as the command prints it; %."""
        return comparing.comparison_summary(self.found)

    def plot(self) -> Picture:
        """Draw the changes of all stiffnesses with their 95 % intervals, %."""
        from calibration_core.report.figures.application import changes_figure

        rows = [
            (f"{one.location}, {k}" if len(self.found.differences) > 1 else one.location, one)
            for k, of in enumerate(self.found.differences, start=2)
            for one in of
            if one.quantity == "stiffness"
        ]
        change, low, high = (
            100 * np.array([getattr(one, key) for _, one in rows]) for key in ("change", "low", "high")
        )
        figure = changes_figure(
            [name for name, _ in rows], change, low, high, [one.verdict == "changed" for _, one in rows]
        )
        return Picture(figure, "Changes of stiffness with 95 % intervals")

    def files(self, *, report: bool = True) -> dict[str, Content]:
        """Return result and report: file name -> bytes; arguments as for `save`."""
        return comparing.files_of(self.found, report=report)

    def _content(self) -> dict[str, Any]:
        return comparing.comparison_result(self.found)


@checked
def verify(
    recording: Recording, model: str | Path | HoldsModel, tolerance: float, *, fit_tracker: bool = False
) -> VerificationResult:
    """Judge a model by places that it was not identified from, with the decision rule of ISO 14253-1.

    Args:
        recording: Angles in rad, points in m (tracker frame), wrenches in N and N*m.
        model: A model file, or the result of `identify` or `diagnose`.
        tolerance: What the length of an error may not exceed, m.
        fit_tracker: Fit the tracker's pose to this recording first, because it was set up anew.

    Returns:
        Errors and their uncertainties (m), and the decision: conforming, not conforming, or undecided.

    Raises:
        InputError: Model, tolerance or recording cannot be used: one that the model was identified from, or one that
            is not what it claims to be.
        EquilibriumError: A load is beyond what the joints can carry.

    Source: ISO 14253-1, decision rule; static equilibrium of CWA 17384, 6.2.
    """
    verifying.refuse_tolerance(tolerance)
    cell, readings = recording.cell, recording.readings
    given = given_model(model, cell)
    readings = refuse_own(readings, given, cell)
    blocking = [one for one in look(readings, None, cell) if one.blocks]
    if blocking:
        raise RecordingError(readings.provenance.path, blocking[0].kind, blocking[0].text, "a recording as it claims")
    with naming_model(Path(given.file)):
        found = judged_by(readings, cell, given.calibrated, tolerance, fit_tracker=fit_tracker)
    return VerificationResult(
        cell, dataclasses.replace(recording, readings=readings), given.parameters, found, given.digest
    )


@checked
def compare(
    first: Recording | str | Path,
    second: Recording | str | Path,
    *further: Recording | str | Path,
    cells: Cell | Sequence[Cell] | None = None,
    dates: Sequence[dt.datetime] | None = None,
) -> ComparisonResult:
    """Say what has changed between measurements of one robot, or between twins.

    Args:
        first: A loaded recording (rad, m, N, N*m), or the output folder of `identify` or `diagnose`.
        second: What it is compared with, likewise.
        further: More of them, likewise.
        cells: For output folders: one cell for all, or one for each measurement.
        dates: One for each measurement; None: as the measurements say.

    Returns:
        Per quantity the change with its 95 % interval (relative for stiffnesses, else SI units) and a verdict.

    Raises:
        InputError: A measurement cannot be used, or the robots are not of one kind.
        EquilibriumError: A load is beyond what the joints can carry.

    Source: generalised least squares; forward selection (Miller, Subset selection in regression, 2002).
    """
    measured = (first, second, *further)
    given = [cells] * len(measured) if cells is None or isinstance(cells, Cell) else list(cells)
    if len(given) != len(measured):
        raise InputError("compare", "cells", f"{len(given)} cells", f"one for all, or {len(measured)}, one for each")
    if dates is not None and len(dates) != len(measured):
        raise InputError("compare", "dates", f"{len(dates)} dates", f"{len(measured)}, one for each measurement")
    sources, used = [], []
    for one, cell in zip(measured, given, strict=True):
        if isinstance(one, Recording):
            used.append(one.cell)
            sources.append(recorded_source(one.readings, one.cell, one.readings.provenance.path))
        elif cell is None:
            raise InputError("compare", "cells", "none", f"the cell of {one}")
        else:
            used.append(cell)
            sources.append(source_of(Path(one), cell))
    refuse_other_robots(used)
    found = compared_sources(sources, tuple(used), [None] * len(measured) if dates is None else list(dates))
    return ComparisonResult(used[0], found)
