"""What a maker of effects works with: the robot's typical magnitudes, an amplitude, and randomness."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.timeseries import Float1D
from calibration_sim.generators.robots import Magnitudes

NAMES = tuple(f"joint_{i}" for i in range(1, 7))


@dataclasses.dataclass(frozen=True, eq=False)
class Draw:
    """What a maker of effects works with.

    Attributes:
        size: Typical magnitudes of the robot.
        stiffness: (n,) N*m/rad, as stated.
        amplitude: In units of the typical magnitude.
        rng: Source of randomness.
        place: Joint or link (index) where the effect shall be; None: anywhere.
        configurations: How many loaded configurations the protocol has; numbered from 1.
        plain: True: the very law that a diagnosis could know, isotropic and without a twist of its own.
    """

    size: Magnitudes
    stiffness: Float1D
    amplitude: float
    rng: np.random.Generator
    place: int | None = None
    configurations: int = 18
    plain: bool = False

    def among(self, *places: int) -> int:
        """Return the place asked for, or one of these."""
        return int(self.rng.choice(places)) if self.place is None else self.place

    def sign(self) -> float:
        """Return one or minus one."""
        return float(self.rng.choice([-1.0, 1.0]))

    def direction(self) -> Float1D:
        """Return a unit vector (3,)."""
        vector = self.rng.standard_normal(3)
        return np.asarray(vector / np.linalg.norm(vector))

    def seed(self) -> int:
        """Return a seed."""
        return int(self.rng.integers(2**31))

    def uneven(self) -> float:
        """Return a ratio between two principal compliances."""
        return 1.0 if self.plain else float(np.exp(self.rng.uniform(-np.log(2.0), np.log(2.0))))

    def twist(self) -> float:
        """Return how far (rad) principal axes are turned; none in half of the cases."""
        return 0.0 if self.plain or self.rng.random() < 0.5 else float(np.radians(self.rng.uniform(-20.0, 20.0)))


def at_joint(index: int) -> dict[str, str]:
    """Return the location of a joint (index)."""
    return {"joint": NAMES[index]}


def components(names: str, values: Float1D) -> dict[str, float]:
    """Return named components of a vector (3,)."""
    return {names.format(axis): float(value) for axis, value in zip("xyz", values, strict=True)}
