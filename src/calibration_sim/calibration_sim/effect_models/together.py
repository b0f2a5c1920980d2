"""One cause at many places: several effects that are one."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np

from calibration_core.timeseries import Float1D
from calibration_sim.cell.truth import Truth
from calibration_sim.effect_models.effect import At, Effect
from calibration_sim.mechanics.chain import Chain
from calibration_sim.mechanics.mjcf import Spring


@dataclasses.dataclass(frozen=True, eq=False)
class Together(Effect):
    """Effects of structure and joints that act together under one label.

    Attributes:
        parts: The effects; their own labels say nothing.
    """

    parts: tuple[Effect, ...]

    def springs(self, chain: Chain) -> tuple[Spring, ...]:
        """Return what gives way besides the joints."""
        return tuple(spring for part in self.parts for spring in part.springs(chain))

    def change_truth(self, truth: Truth) -> Truth:
        """Return what all parts make of the truth."""
        return functools.reduce(lambda changed, part: part.change_truth(changed), self.parts, truth)

    def change_file(self, cell: dict[str, Any]) -> dict[str, Any]:
        """Return what all parts make of the cell file."""
        return functools.reduce(lambda changed, part: part.change_file(changed), self.parts, cell)

    def begin(self, joints: int) -> Any:
        """Return what each part remembers."""
        return tuple(part.begin(joints) for part in self.parts)

    def arrive(self, memory: Any, at: At) -> Any:
        """Let each part arrive."""
        return tuple(part.arrive(own, at) for part, own in zip(self.parts, memory, strict=True))

    def deflect(self, memory: Any, torque: Float1D, at: At) -> Float1D | None:
        """Add up."""
        shifts = [part.deflect(own, torque, at) for part, own in zip(self.parts, memory, strict=True)]
        present = [shift for shift in shifts if shift is not None]
        return None if not present else np.asarray(np.sum(present, axis=0))

    def settle(self, memory: Any, torque: Float1D, at: At) -> Any:
        """Let each part remember."""
        return tuple(part.settle(own, torque, at) for part, own in zip(self.parts, memory, strict=True))
