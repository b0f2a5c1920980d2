"""`calibration_core.diagnose`: which physics the model of a recording leaves out."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

from calibration_core.commands.evaluation.diagnose import Diagnosed, evaluate_all
from calibration_core.commands.shared.inputs import Refusal
from calibration_core.diagnosis.comparison.result import Comparison
from calibration_core.diagnosis.result.finding import Diagnosis, Finding
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.library.arguments import checked
from calibration_core.library.identification import ANOMALY
from calibration_core.library.models import HoldsModel, given_model, in_memory
from calibration_core.library.recordings import Recording, recordings_of
from calibration_core.library.result import Columns, Judged, Picture, columns_of
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.timeseries import Readings

WATERFALL = ("name", "what", "rms", "held_out_rms", "test_rms", "share")
FINDING = ("effect", "family", "location", "magnitude", "held_out_gain", "log_bayes_factor", "explanation")


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class DiagnosisResult(Judged):
    """The effects that the model leaves out, and how much better it is with them.

    Attributes:
        cell: The cell that it holds for.
        answer: The diagnosis, or the refusal of input that is not what it claims to be (`usable` is `no`).
        fitted: The recordings that the model was identified from, and those of the model that it started from.
    """

    answer: Diagnosed | Refusal
    fitted: tuple[Readings, ...] = ()

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The effects found, largest movement of the measured points (m, root mean square) first."""
        return () if isinstance(self.answer, Refusal) else self.answer.diagnosis.findings

    @property
    def tables(self) -> Mapping[str, Columns]:
        """`findings` (magnitude in m), their `parameters`, `stiffness`, `anomalies`, `waterfall`; SI units."""
        parameters = [{**vars(one), "effect": f.effect} for f in self.findings for one in f.parameters]
        stiffness = {} if isinstance(self.answer, Refusal) else self.answer.diagnosis.stiffness
        steps = () if self._compared is None else self._compared.waterfall
        return {
            "findings": columns_of([vars(finding) for finding in self.findings], FINDING),
            "parameters": columns_of(parameters, ("effect", "name", "value", "std", "unit")),
            "stiffness": {
                "joint": list(stiffness),
                "value": [value for value, _ in stiffness.values()],
                "std": [std for _, std in stiffness.values()],
            },
            "anomalies": columns_of(self._contents["anomalies"], ANOMALY),
            "waterfall": columns_of([vars(step) for step in steps], WATERFALL),
        }

    @property
    def _compared(self) -> Comparison | None:
        compared = () if isinstance(self.answer, Refusal) else self.answer.diagnosis.comparisons
        return compared[0] if len(compared) == 1 and compared[0].waterfall else None

    def plot(self) -> Picture:
        """Draw what the steps from a simulation to the noise leave; without one the residuals of the configurations.

        In µm or mm; of the configurations without and with the findings.
        """
        from calibration_core.report.figures.diagnosis import before_after_figure, waterfall_figure
        from calibration_core.report.figures.identification import prediction_figure

        if self._compared is not None:
            return Picture(waterfall_figure(self._compared), "From the simulation to the noise")
        found = self.diagnosis
        null, before = found.identification, found.residual_before
        if before is None or not before.shape == found.residual.shape == null.readings.position.shape:
            svg = prediction_figure(null.residuals, null.kind == "loaded")
            return Picture(svg, "Predicted and measured positions, without the findings")
        svg = before_after_figure(null.readings, before, found.residual, found.noise)
        return Picture(svg, "Residuals without and with the findings")

    @property
    def diagnosis(self) -> Diagnosis:
        """Everything that was found: SI units, and frames as its fields state.

        Raises:
            IdentificationError: Nothing was: the input is not what it claims to be.
        """
        if isinstance(self.answer, Refusal):
            raise self.answer.error
        return self.answer.diagnosis

    def _given(self) -> GivenModel:
        if isinstance(self.answer, Refusal):
            raise self.answer.error
        return in_memory(
            self.answer.model, self.answer.model_text, self.answer.estimate, self.answer.covered, self.fitted
        )


@checked
def diagnose(
    recording: Recording | Sequence[Recording],
    *,
    test: Recording | None = None,
    simulation: Recording | Sequence[Recording] | None = None,
    model: str | Path | HoldsModel | None = None,
    robust: bool = True,
) -> DiagnosisResult:
    """Say where recording and model differ, which physics the model leaves out, and how much better it is with it.

    Args:
        recording: What was measured: angles in rad, points in m (tracker frame), wrenches in N and N*m; or several
            recordings of one robot, each with the cell of its own set-up.
        test: A further recording, in the set-up of the first, in its units and frames, predicted and not fitted.
        simulation: What a simulation says of the same measurement, compared before any physics; of several recordings
            one for each, in their order, or fewer for the first ones.
        model: A model file or result to start from; its effects are known and are taken off the readings.
        robust: Set gross errors aside, by name.

    Returns:
        The findings with their size in m at the measured points, what else would explain them, and the extended model.

    Raises:
        InputError: The recording cannot be evaluated; the message names the place, what was found, what was expected.

    Source: marginal likelihood with priors of physical size (Kass and Raftery, 1995), and configurations left out.
    """
    recordings, cells = recordings_of(recording)
    cell = cells[0]
    tested = None if test is None else test.readings
    simulated = () if simulation is None else recordings_of(simulation)[0]
    given = None if model is None else given_model(model, cell)
    fitted = (*recordings, *(() if given is None else given.recordings))
    options = Options(robust=robust)
    return DiagnosisResult(cell, evaluate_all(recordings, cells, options, tested, simulated, given), fitted)
