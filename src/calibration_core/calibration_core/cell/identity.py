"""Which robot a cell file describes, as a digest: a model of one robot is not sent to another."""

from __future__ import annotations

import hashlib
import json
import math

from calibration_core.cell import Cell
from calibration_core.cell.urdf import urdf_bytes

BELIEFS = ("urdf", "stiffness")  # the URDF's content counts, not its name; a calibration replaces the stiffness


def robot_sha256(cell: Cell) -> str:
    """Return the SHA-256 digest, as hexadecimal digits, of the parsed robot section and of the URDF's content.

    Comments, order and spelling of the cell file do not matter, nor do frames, instruments and topics: another set-up
    of the same robot has the same digest.  Of the stiffnesses only those that are declared rigid (`.inf`) count.

    Raises:
        CellError: The URDF cannot be read.
    """
    robot = cell.robot
    content = robot.model_dump(mode="python", exclude={*BELIEFS, "joint_coupling"})
    if robot.joint_coupling:  # a robot without one keeps the digest that it had before there were any
        content["joint_coupling"] = {name: dict(others) for name, others in robot.joint_coupling.items()}
    content["rigid"] = [stiffness == math.inf for stiffness in robot.stiffness or ()]
    digest = hashlib.sha256(json.dumps(content, sort_keys=True, allow_nan=False).encode())
    if cell.urdf_path is not None:
        digest.update(urdf_bytes(cell.urdf_path))
    return digest.hexdigest()
