"""Identified models as arguments: a model file, or the result that holds the model."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Protocol, runtime_checkable

from calibration_core.cell import Cell
from calibration_core.model.identified.calibrated import ValidRange
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.model_file import GivenModel, read_given
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Readings


@runtime_checkable
class HoldsModel(Protocol):
    """A result with an identified model."""

    def _given(self) -> GivenModel: ...


def given_model(model: str | Path | HoldsModel, cell: Cell) -> GivenModel:
    """Return the model of a file or of a result.

    Raises:
        ModelFileError: The file is missing, malformed, or belongs to another robot; or the result holds no model.
    """
    if isinstance(model, str | Path):
        return read_given(Path(model), cell)
    return model._given()


def in_memory(
    parameters: ModelParameters,
    text: str,
    estimate: GaussianEstimate | None,
    covered: ValidRange,
    recordings: tuple[Readings, ...],
) -> GivenModel:
    """Return a model that no file holds.

    Args:
        parameters: The model.
        text: What its file would be.
        estimate: What is known of the uncertainty of its numbers; None: nothing.
        covered: What its recordings covered.
        recordings: What it was identified from, and what the model that it started from was.
    """
    digest = hashlib.sha256(text.encode()).hexdigest()
    return GivenModel(parameters, "identified model", digest, estimate, covered, recordings)
