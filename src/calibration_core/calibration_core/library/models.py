"""Identified models as arguments: a model file, or the result that holds the model."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Protocol

from calibration_core.cell import Cell
from calibration_core.model.identified.calibrated import ValidRange
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.given import GivenModel, read_given
from calibration_core.model.parameters import ModelParameters


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
    parameters: ModelParameters, text: str, estimate: GaussianEstimate | None, covered: ValidRange
) -> GivenModel:
    """Return a model that no file holds; `text` is what its file would be, `covered` what its recording covered."""
    return GivenModel(parameters, "identified model", hashlib.sha256(text.encode()).hexdigest(), estimate, covered)
