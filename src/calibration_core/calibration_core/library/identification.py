"""`calibration_core.identify`: joint stiffnesses, frames and geometry from a recording."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calibration_core.commands.evaluation import identify as identifying
from calibration_core.commands.evaluation.identify import Identified, evaluate_all
from calibration_core.commands.shared.inputs import Refusal
from calibration_core.identification.result.estimate import Identification, JointStiffness
from calibration_core.identification.stiffness.fit import Deflections
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.identification.stiffness.problem import Method, Weights
from calibration_core.library.arguments import checked, differing
from calibration_core.library.models import HoldsModel, given_model, in_memory
from calibration_core.library.recordings import Recording, recordings_of
from calibration_core.library.result import Columns, Judged, Picture, columns_of
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.timeseries import Float1D, Float2D, Readings

STIFFNESS = ("joint", "value", "std", "low", "high", "compliance", "compliance_std", "identifiable", "reason", "unit")
OPTIONS = {name: f"--{name}" for name in ("method", "weights", "deflections", "readmit")}
ANOMALY = ("kind", "location", "magnitude", "unit", "text", "remedy")


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class IdentificationResult(Judged):
    """Joint stiffnesses with their uncertainty, and what else the recording tells.

    Attributes:
        cell: The cell that it holds for.
        answer: What was identified, or the refusal of input that is not what it claims to be (`usable` is `no`).
        fitted: The recordings that the model was identified from, and those of the model that it started from.
    """

    answer: Identified | Refusal
    fitted: tuple[Readings, ...] = ()

    @property
    def _joints(self) -> tuple[JointStiffness, ...]:
        return () if isinstance(self.answer, Refusal) else self.answer.identification.stiffness

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the n joints with a stiffness, no unit; none where nothing was identified."""
        return tuple(joint.joint for joint in self._joints)

    @property
    def stiffness(self) -> Float1D:
        """(n,) joint stiffness, N*m/rad (N/m where a joint slides); infinite for a rigid joint. CWA 17384, Table 2."""
        return np.array([joint.value for joint in self._joints], dtype=np.float64)

    @property
    def interval(self) -> Float2D:
        """(n, 2) 95 % interval of `stiffness`, in its unit; infinite where the recording allows a rigid joint."""
        return np.array([joint.interval for joint in self._joints], dtype=np.float64).reshape(-1, 2)

    @property
    def compliance(self) -> Float1D:
        """(n,) joint compliance, rad/(N*m) (m/N where a joint slides), the reciprocal of `stiffness`."""
        return np.array([joint.compliance for joint in self._joints], dtype=np.float64)

    @property
    def tables(self) -> Mapping[str, Columns]:
        """`stiffness`, `parameters` (frames, points, geometry), `residuals` and `anomalies`; SI units, base axes."""
        found = None if isinstance(self.answer, Refusal) else self.answer.identification
        rows = [{**vars(joint), "low": joint.interval[0], "high": joint.interval[1]} for joint in self._joints]
        parameters = () if found is None else found.parameters
        fields = ("name", "group", "value", "std", "unit", "nominal", "fitted")
        return {
            "stiffness": columns_of(rows, STIFFNESS),
            "parameters": columns_of([vars(one) for one in parameters], fields),
            "residuals": {} if found is None else residual_columns(found),
            "anomalies": columns_of(self._contents["anomalies"], ANOMALY),
        }

    def plot(self) -> Picture:
        """Draw the stiffnesses (10^5 N*m/rad) with their 95 % intervals; the residuals (µm) where there are none."""
        from calibration_core.report.figures.identification import prediction_figure, stiffness_figure

        found = self.identification
        if found.stiffness:
            nominal = self.cell.robot.stiffness
            return Picture(stiffness_figure(found.stiffness, nominal), "Joint stiffness with 95 % intervals")
        return Picture(prediction_figure(found.residuals, found.kind == "loaded"), "Predicted and measured positions")

    @property
    def identification(self) -> Identification:
        """Everything that was identified: SI units, and frames as its fields state.

        Raises:
            IdentificationError: Nothing was: the input is not what it claims to be.
        """
        if isinstance(self.answer, Refusal):
            raise self.answer.error
        return self.answer.identification

    def _given(self) -> GivenModel:
        if isinstance(self.answer, Refusal):
            raise self.answer.error
        found = self.answer.identification
        return in_memory(found.model, self.answer.model_text, found.estimate, self.answer.covered, self.fitted)


@checked
def identify(
    recording: Recording | Sequence[Recording],
    *,
    test: Recording | None = None,
    model: str | Path | HoldsModel | None = None,
    method: Method = "equilibrium",
    weights: Weights = "instrument",
    deflections: Deflections = "points",
    robust: bool = True,
    readmit: Iterable[tuple[int, int, str]] = (),
) -> IdentificationResult:
    """Identify joint stiffnesses from a loaded recording; frames, geometry and elasticity from an unloaded one.

    Args:
        recording: What was measured: angles in rad, points in m (tracker frame), wrenches in N and N*m; or several
            recordings of one robot, each with the cell of its own set-up.
        test: A further recording, in the set-up of the first, in its units and frames, predicted and not fitted.
        model: A model file or result to start from; its effects are known and are taken off the readings.
        method: `equilibrium`: on the deformed geometry, with K_CSM and gravity; `linear`: the standard's equations (6)
            and (7), which neglect it, with these weights and one free offset per configuration and point.
        weights: `instrument`: by the instruments' uncertainties; `plain`: every coordinate alike.
        deflections: `points`: positions; `pose`: the full pose from three or more points.
        robust: Set gross errors aside, by name.
        readmit: Readings to use all the same: (configuration, step, point); of several recordings the point is named
            `point@number`, as the report names it.

    Returns:
        Stiffness in N*m/rad with 95 % intervals, and what limits it. Where the input is not what it claims to be,
        `usable` is `no` and no stiffness is stated.

    Raises:
        InputError: The recording cannot be evaluated; the message names the place, what was found, what was expected.

    Source: CWA 17384, 6.2 and 7.6, equations (3) to (7).
    """
    recordings, cells = recordings_of(recording)
    cell = cells[0]
    asked = {"method": method, "weights": weights, "deflections": deflections, "readmit": readmit}
    identifying.refuse_idle(differing(asked, identify, OPTIONS), recordings, robust=robust)
    options = Options(
        method=method, weights=weights, deflections=deflections, robust=robust, readmit=frozenset(readmit)
    )
    given = None if model is None else given_model(model, cell)
    fitted = (*recordings, *(() if given is None else given.recordings))
    tested = None if test is None else test.readings
    answer = evaluate_all(recordings, cells, options, tested, given)
    if isinstance(answer, Identified):
        identifying.refuse_unknown(options.readmit, answer.readings)
    return IdentificationResult(cell, answer, fitted)


def residual_columns(found: Identification) -> Columns:
    """Return the residuals row by row: m, base axes; the load in N."""
    rows, readings = found.residuals, found.readings
    columns: dict[str, Any] = {
        "configuration": readings.configuration,
        "step": readings.step,
        "point": [readings.points[index] for index in readings.point],
        "load": rows.load,
    }
    for kind in ("measured", "predicted", "residual", "held_out", "sigma"):
        columns |= {f"{kind}_{axis}": values for axis, values in zip("xyz", getattr(rows, kind).T, strict=True)}
    return {**columns, "excluded": rows.excluded}
