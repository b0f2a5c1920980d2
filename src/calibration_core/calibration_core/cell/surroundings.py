"""What is in a cell besides the robot: what stands about, and what the robot carries."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import model_validator

from calibration_core.cell.values import Angles, Label, Name, NonNegative, Number, Positive, Strict, Vector, field_error


class Surroundings(Strict):
    """What the robot stands on.

    Attributes:
        floor: m, z of the floor in the base frame (on a wall: its height over the base frame's origin); none: no floor.
    """

    floor: Literal["none"] | Number = 0.0


class Box(Strict):
    """A box that the robot must not touch and the tracker cannot see through.

    Attributes:
        xyz: m, its centre in the base frame.
        rpy: rad, its orientation there, fixed axes.
        size: m, its edge lengths along its own axes.
    """

    name: Name
    xyz: Vector
    rpy: Angles = (0.0, 0.0, 0.0)
    size: tuple[Positive, Positive, Positive]


class EndEffector(Strict):
    """What the flange carries: its mass, and how it gives way where it is not much stiffer than the robot (5.1).

    Attributes:
        mass: kg, of tool and sensor; it counts towards the rated load.
        com: m, its centre of gravity in the flange frame.
        rotation: rad/(N*m) about the flange's axes.
        translation: m/N along them.
        source: Who states how it gives way, e.g. a finite element analysis; needed unless the mass alone is stated.
    """

    mass: NonNegative = 0.0
    com: Vector = (0.0, 0.0, 0.0)

    rotation: tuple[NonNegative, NonNegative, NonNegative] = (0.0, 0.0, 0.0)
    translation: tuple[NonNegative, NonNegative, NonNegative] = (0.0, 0.0, 0.0)
    source: Label = ""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.source and (self.states_stiffness or "mass" not in self.model_fields_set):
            raise field_error("source", "nothing", "who states how the end effector gives way")
        return self

    @property
    def states_stiffness(self) -> bool:
        """Whether it says how the end effector gives way, be it not at all."""
        return bool(self.source) or not {"rotation", "translation"}.isdisjoint(self.model_fields_set)
