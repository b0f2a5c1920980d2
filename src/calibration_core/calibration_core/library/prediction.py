"""`calibration_core.predict`: where an identified model puts the points of a recording."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calibration_core.commands.evaluation.predict import PredictedRecording, evaluate
from calibration_core.commands.shared.inputs import Refusal
from calibration_core.library.arguments import checked
from calibration_core.library.models import HoldsModel, given_model
from calibration_core.library.recordings import Recording
from calibration_core.library.result import Columns, Judged, Picture
from calibration_core.outcomes.inputs import refuse_lengths
from calibration_core.outcomes.prediction import Prediction
from calibration_core.timeseries import Float1D, Float2D


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class PredictionResult(Judged):
    """A recording beside what a model predicts of it; nothing was fitted.

    Attributes:
        cell: The cell that it holds for.
        answer: The prediction, or the refusal of input that is not what it claims to be (`usable` is `no`).
    """

    answer: PredictedRecording | Refusal

    @property
    def found(self) -> Prediction:
        """Readings, predicted points and errors; m.

        Raises:
            IdentificationError: Nothing was predicted: the input is not what it claims to be.
        """
        if isinstance(self.answer, Refusal):
            raise self.answer.error
        return self.answer.found

    @property
    def predicted(self) -> Float2D:
        """(m, 3) m, tracker frame: where the model puts every reading's point."""
        return self.found.predicted

    @property
    def error(self) -> Float1D:
        """(m,) m: distance of every measured point from the predicted one."""
        return np.linalg.norm(self.found.readings.position - self.found.predicted, axis=1)

    @property
    def tables(self) -> Mapping[str, Columns]:
        """`predictions`: `configuration step point x y z px py pz`, m, tracker frame; p: predicted."""
        if isinstance(self.answer, Refusal):
            return {"predictions": {}}
        readings, predicted = self.found.readings, self.found.predicted
        columns: dict[str, Any] = {
            "configuration": readings.configuration,
            "step": readings.step,
            "point": [readings.points[index] for index in readings.point],
        }
        columns |= dict(zip("xyz", readings.position.T, strict=True))
        columns |= dict(zip(("px", "py", "pz"), predicted.T, strict=True))
        return {"predictions": columns}

    def plot(self) -> Picture:
        """Draw predicted against measured positions or deflections, per base axis, in mm or µm."""
        from calibration_core.report.figures.identification import prediction_figure

        svg = prediction_figure(self.found.shown().residuals, self.found.kind == "loaded")
        return Picture(svg, "Predicted and measured positions")


@checked
def predict(recording: Recording, model: str | Path | HoldsModel) -> PredictionResult:
    """Predict every reading of a recording from its joint angles and wrenches alone; nothing is fitted.

    Args:
        recording: Angles in rad, points in m (tracker frame), wrenches in N and N*m.
        model: A model file, or the result of `identify` or `diagnose`.

    Returns:
        Predicted points in m (tracker frame) with their errors, and whether they can be used. Where the input is not
        what it claims to be, `usable` is `no` and nothing is predicted.

    Raises:
        InputError: The model cannot be used, or does not know a point of the recording.
        EquilibriumError: A load is beyond what the joints can carry.

    Source: static equilibrium on the deformed geometry, CWA 17384, 6.2.
    """
    given = given_model(model, recording.cell)
    refuse_lengths(recording.cell)
    return PredictionResult(recording.cell, evaluate(recording.cell, given, recording.readings))
