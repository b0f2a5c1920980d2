"""How far the sliding joints of a cell's robot travel, without the robot's kinematics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration_core.cell import Cell
from calibration_core.cell.urdf import urdf_travels


def farthest(cell: Cell) -> NDArray[np.float64]:
    """Return (n,) m, how far from its zero each sliding joint stands at most by its limits; NaN where a joint turns.

    Where a file states no limits, which planning would ask for, it is infinite.

    Raises:
        CellError: The URDF cannot be used.
    """
    robot, path = cell.robot, cell.urdf_path
    slides = cell.prismatic
    if robot.joint_limits is not None:
        limits = dict(zip(robot.joints, robot.joint_limits, strict=True))
    else:
        limits = urdf_travels(path) if path is not None and any(slides) else {}
    return np.array([
        max(map(abs, limits.get(name, (np.inf,)))) if sliding else np.nan
        for name, sliding in zip(robot.joints, slides, strict=True)
    ])  # fmt: skip
