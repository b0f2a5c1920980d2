"""What a maker of effects works with: the robot's typical magnitudes, an amplitude, and randomness."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np

from calibration_core.cell import Cell, load_cell
from calibration_core.files.yaml_file import read_yaml
from calibration_core.timeseries import Float1D
from calibration_sim.effects.effect import Label

CELLS = Path(__file__).with_name("cells")
ROBOTS = ("heavy", "light")
MORE_ROBOTS = ("tiny", "middle", "giant")  # 3, 60 and 500 kg
FIRST_AXIS = {"column": 1}  # index of the arm's first axis, where the arm stands on further ones
HOUR = 3600.0  # s


def _magnitudes() -> Mapping[str, SimpleNamespace]:
    """Read what is typical of every robot's class, SI units; an effect of amplitude one has it."""
    data: dict[str, Any] = read_yaml(CELLS / "magnitudes.yaml", 1 << 16, "magnitudes of effects (YAML)").data
    usual, result = data.pop("usual"), {}
    for robot, own in data.items():
        inverse = {name: 1 / value for name, value in own.pop("inverse").items()}
        values = {name: tuple(v) if isinstance(v, list) else v for name, v in (usual | own | inverse).items()}
        hourly = ("drift", "tracker_drift", "tracker_rate")
        per_second = {k: np.divide(values[k], HOUR).tolist() for k in hourly}
        result[robot] = SimpleNamespace(**values | per_second)
    return MappingProxyType(result | {"column": result["light"]})  # the same arm, on a lifting column


MAGNITUDES = _magnitudes()


@functools.cache
def robot_cell(name: str) -> Cell:
    """Return the cell of a robot, one of `ROBOTS` or `MORE_ROBOTS` or `FIRST_AXIS`, as its file states it."""
    return load_cell(CELLS / f"{name}.cell.yaml")


@dataclasses.dataclass(frozen=True, eq=False)
class Draw:
    """What a maker of effects works with.

    Attributes:
        size: Typical magnitudes of the robot, see `cells/magnitudes.yaml`.
        stiffness: (n,) N*m/rad, as stated, of the arm's joints.
        amplitude: In units of the typical magnitude.
        rng: Source of randomness.
        place: Joint or link (index) where the effect shall be; None: anywhere.
        configurations: How many loaded configurations the protocol has; numbered from 1.
        plain: True: the very law that a diagnosis could know, isotropic and without a twist of its own.
        first: Index of the arm's first joint, where it stands on further axes; places are counted in the arm.
    """

    size: SimpleNamespace
    stiffness: Float1D
    amplitude: float
    rng: np.random.Generator
    place: int | None = None
    configurations: int = 18
    plain: bool = False
    first: int = 0

    def among(self, *places: int) -> int:
        """Return the place asked for, or one of these."""
        return int(self.rng.choice(places)) if self.place is None else self.place

    def sign(self) -> float:
        """Return one or minus one."""
        return float(self.rng.choice([-1.0, 1.0]))

    def direction(self) -> Float1D:
        """Return a unit vector (3,)."""
        return unit(self.rng.standard_normal(3))

    def phase(self) -> float:
        """Return an angle (rad) of a full turn."""
        return float(self.rng.uniform(0.0, 2.0 * np.pi))

    def seed(self) -> int:
        """Return a seed."""
        return int(self.rng.integers(2**31))

    def some(self, count: int) -> list[int]:
        """Return indices of configurations, in order."""
        return sorted(int(k) for k in self.rng.choice(self.configurations, count, replace=False))

    def pair(self, size: float) -> tuple[float, float]:
        """Return two principal compliances about a size; equal where the law is plain."""
        ratio = 1.0 if self.plain else float(np.exp(self.rng.uniform(-np.log(2.0), np.log(2.0))))
        return size * np.sqrt(ratio), size / np.sqrt(ratio)

    def twist(self) -> float:
        """Return how far (rad) principal axes are turned; none in half of the cases."""
        return 0.0 if self.plain or self.rng.random() < 0.5 else float(np.radians(self.rng.uniform(-20.0, 20.0)))

    def at(self, joint: int) -> dict[str, str]:
        """Return the location of a joint (index)."""
        return {"joint": f"joint_{self.first + joint + 1}"}

    def link(self, index: int) -> dict[str, str]:
        """Return the location of a link (index)."""
        return {"link": f"link_{self.first + index + 1}"}

    def label(
        self,
        family: str,
        effect: str,
        location: Mapping[str, Any],
        parameters: Mapping[str, float] = MappingProxyType({}),
        alike: tuple[tuple[str, Mapping[str, Any]], ...] = (),
        **more: Any,
    ) -> Label:
        """Return the label of what is drawn; exact aliases, (effect, location), are those of an arm on the ground."""
        equivalent = tuple({"effect": name, "location": place} for name, place in alike) if self.first == 0 else ()
        return Label(family, effect, location, self.amplitude, parameters, equivalent, **more)


def unit(vector: Float1D) -> Float1D:
    """Return a vector of length one."""
    return np.asarray(vector / np.linalg.norm(vector))


def components(names: str, values: Float1D) -> dict[str, float]:
    """Return named components of a vector (3,)."""
    return {names.format(axis): float(value) for axis, value in zip("xyz", values, strict=True)}
