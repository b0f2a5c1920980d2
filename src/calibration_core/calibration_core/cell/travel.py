"""How far the sliding joints of a cell's robot travel, without the robot's kinematics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration_core.cell import Cell
from calibration_core.cell.urdf import urdf_limits


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
        sliding = [name for name, one in zip(robot.joints, slides, strict=True) if one]
        limits = urdf_limits(path, sliding) if path is not None and sliding else {}
    return np.array([
        max(map(abs, limits.get(name, (np.inf,)))) if one else np.nan
        for name, one in zip(robot.joints, slides, strict=True)
    ])  # fmt: skip
