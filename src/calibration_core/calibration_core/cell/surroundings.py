"""What is in a cell besides the robot: what stands about, and what the robot carries."""

from __future__ import annotations

from calibration_core.cell.values import Angles, Name, NonNegative, Positive, Statement, Strict, Vector


class Box(Strict):
    """A box that the robot must not touch and the tracker cannot see through.

    Attributes:
        name: As messages call it.
        xyz: m, its centre in the base frame.
        rpy: rad, its orientation there, fixed axes.
        size: m, its edge lengths along its own axes.
    """

    name: Name
    xyz: Vector
    rpy: Angles = (0.0, 0.0, 0.0)
    size: tuple[Positive, Positive, Positive]


class EndEffector(Strict):
    """How the end effector gives way at the flange, where it is not much stiffer than the robot (CWA 17384, 5.1).

    Attributes:
        rotation: rad/(N*m) about the flange's axes.
        translation: m/N along them.
        source: Who states it, e.g. a finite element analysis.
    """

    rotation: tuple[NonNegative, NonNegative, NonNegative] = (0.0, 0.0, 0.0)
    translation: tuple[NonNegative, NonNegative, NonNegative] = (0.0, 0.0, 0.0)
    source: Statement
