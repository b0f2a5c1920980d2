"""A model that is handed in as a file: to start from, with effects that are known already."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from calibration_core.cell import Cell
from calibration_core.model.model_file import read_model
from calibration_core.model.parameters import ModelParameters
from calibration_core.recording.source import sha256_of


@dataclasses.dataclass(frozen=True, eq=False)
class GivenModel:
    """An identified or extended model and the file it came from.

    Attributes:
        parameters: The model, its effects included.
        file: Its path as given.
        sha256: Digest of the file.
    """

    parameters: ModelParameters
    file: str
    sha256: str

    @property
    def start(self) -> ModelParameters:
        """The model without its effects: what a fit of readings freed of them starts from."""
        return self.parameters.replace(effects=())

    def told(self) -> str:
        """Name the effects and their places."""
        texts = []
        for effect in self.parameters.effects:
            place = ", ".join(x if isinstance(x, str) else " and ".join(x) for x in effect.location.values())
            texts.append(f"{effect.effect.replace('_', ' ')} at {place}")
        return "; ".join(dict.fromkeys(texts)) or "no effects"


def read_given(path: Path, cell: Cell) -> GivenModel:
    """Read a model file.

    Raises:
        ModelFileError: It is missing, malformed, or belongs to another robot.
    """
    parameters = read_model(path, cell)
    return GivenModel(parameters, str(path), sha256_of(path))
