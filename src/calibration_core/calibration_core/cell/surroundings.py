"""What stands in a cell besides the robot."""

from __future__ import annotations

from calibration_core.cell.values import Name, Positive, Strict, Vector


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
    rpy: Vector = (0.0, 0.0, 0.0)
    size: tuple[Positive, Positive, Positive]
