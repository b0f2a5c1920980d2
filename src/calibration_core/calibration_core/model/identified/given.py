"""A model that is handed in as a file: to start from, with effects that are known already."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from calibration_core.cell import Cell
from calibration_core.model.effects.words import effect_sentence
from calibration_core.model.identified.calibrated import WITHOUT_INTERVALS, CalibratedModel, ValidRange
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.model_file import read_calibrated
from calibration_core.model.parameters import ModelParameters
from calibration_core.recording.source import sha256_of
from calibration_core.timeseries import NO_INTERVALS, Note, Readings


@dataclasses.dataclass(frozen=True, eq=False)
class GivenModel:
    """An identified or extended model and the file it came from.

    Attributes:
        parameters: The model, its effects included.
        file: Its path as given.
        sha256: Digest of the file.
        estimate: What it says of its numbers' uncertainty; None: nothing.
        valid_range: What its recording covered; None where it does not say.
        recordings: What it was identified from; empty where a file holds the model.
    """

    parameters: ModelParameters
    file: str
    sha256: str
    estimate: GaussianEstimate | None = None
    valid_range: ValidRange | None = None
    recordings: tuple[Readings, ...] = ()

    @property
    def calibrated(self) -> CalibratedModel:
        """The model with its covariance and its range."""
        return CalibratedModel(self.parameters, self.estimate, self.valid_range)

    @property
    def start(self) -> ModelParameters:
        """The model without its effects: what a fit of readings freed of them starts from."""
        return self.parameters.replace(effects=())

    @property
    def digest(self) -> dict[str, dict[str, str]]:
        """The file as input of a result: role -> file name -> SHA-256."""
        return {"model": {Path(self.file).name: self.sha256}}

    @property
    def notes(self) -> tuple[Note, ...]:
        """What its reader must know: a file without a covariance gives no intervals."""
        text = WITHOUT_INTERVALS[0].lower() + WITHOUT_INTERVALS[1:].removesuffix(".")
        return () if self.estimate is not None else (Note(NO_INTERVALS, self.file, text),)

    def known_effects(self) -> str:
        """The effects and their places in words."""
        texts = [effect_sentence(effect.effect, effect.location) for effect in self.parameters.effects]
        return "; ".join(dict.fromkeys(texts)) or "no effects"


def read_given(path: Path, cell: Cell) -> GivenModel:
    """Read a model file.

    Raises:
        ModelFileError: It is missing, malformed, or belongs to another robot.
        CellError: The cell's URDF cannot be read.
    """
    model = read_calibrated(path, cell)
    return GivenModel(model.parameters, str(path), sha256_of(path), model.estimate, model.valid_range)
