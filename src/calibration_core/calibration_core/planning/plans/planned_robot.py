"""For which robot a plan was made: its joint limits, and where its flange is in two postures.

Joint names alone do not tell robots apart: most of a maker's robots share them.  A plan for another robot asks for
postures that nobody has held against collisions, and its speeds are bounded for other arms.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import quoted
from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import posture
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Float2D, read_only

SAME_LIMIT = 1e-4  # rad, m where a joint slides
SAME_FLANGE = 0.01  # m: a calibrated robot is some millimetres off its nominal description, another one decimetres
POSTURES = (0.2, -0.3)  # rad (m) of joint i, times i: no joint is at zero, and no two are alike


@dataclasses.dataclass(frozen=True, eq=False)
class PlannedRobot:
    """What tells a robot from another.

    Attributes:
        limits: (n, 2) rad, m where a joint slides.
        flange: (2, 3) m, the flange's places in the base frame at the two postures.
    """

    limits: Float2D
    flange: Float2D

    def __post_init__(self) -> None:
        """Copy to read-only arrays."""
        for name in ("limits", "flange"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @staticmethod
    def of(chain: Chain) -> PlannedRobot:
        """Return what tells this robot from others."""
        q = np.outer(POSTURES, np.arange(1.0, chain.n + 1.0))
        return PlannedRobot(chain.limits, posture(chain, q).flange_origin.T)

    def differences(self, other: PlannedRobot, joints: tuple[str, ...]) -> tuple[str, ...]:
        """Return in words what is different in the other robot; empty if it may be the same one."""
        found = [
            f"limits of {name} {mine[0]:g} to {mine[1]:g}, not {its[0]:g} to {its[1]:g}"
            for name, mine, its in zip(joints, self.limits, other.limits, strict=True)
            if np.abs(mine - its).max() > SAME_LIMIT
        ]
        off = float(np.linalg.norm(self.flange - other.flange, axis=1).max())
        if off > SAME_FLANGE:
            found.append(f"the flange {1e3 * off:.0f} mm elsewhere in the same posture")
        return tuple(found)


def planned_robot(cell: Cell) -> PlannedRobot:
    """Return what tells the cell's robot from others."""
    return PlannedRobot.of(chain_of(cell))


def read_planned_robot(
    content: object, joints: int, fault: Callable[[str, str, str], Exception]
) -> PlannedRobot | None:
    """Return the robot that a plan file names in `made_for`; None where it names none."""
    if content is None:
        return None
    keys = {"limits": (joints, 2), "flange": (len(POSTURES), 3)}
    if not isinstance(content, dict) or set(content) != set(keys):
        raise fault("made_for", quoted(content), f"a mapping with {' and '.join(keys)}")
    arrays = {}
    for key, shape in keys.items():
        try:
            array = np.array(content[key], dtype=float)
        except (ValueError, TypeError):
            array = np.empty(0)
        if array.shape != shape or not np.isfinite(array).all():
            raise fault(f"made_for.{key}", quoted(content[key]), f"{shape[0]} rows of {shape[1]} finite numbers")
        arrays[key] = array
    return PlannedRobot(**arrays)
