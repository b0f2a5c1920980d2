"""From the cell file to a chain: DH rows directly, URDF through yourdfpy.

`pinocchio_model` gives the same chain as a pinocchio model, for whoever wants its algorithms; the two are tested
against each other.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.chain import Chain, rotation_x, rotation_z


def chain_of(cell: Cell) -> Chain:
    """Return the robot's kinematic chain, with masses where the cell file or the URDF states them.

    Raises:
        CellError: The URDF is missing, malformed, or does not hold the joints and links that the cell file names.
    """
    if cell.robot.dh is not None:
        return _from_dh(cell)
    from calibration_core.model.urdf import chain_of_urdf  # yourdfpy is slow to load, and DH rows do not need it

    return chain_of_urdf(cell)


def pinocchio_model(chain: Chain) -> Any:
    """Return a `pinocchio.Model` of the chain, with the operational frame `flange`.

    Joints that mimic others are joints of their own in it: its configurations are those of `Chain.expanded`.
    """
    import pinocchio as pin

    model, chain = pin.Model(), chain.whole
    parent = 0
    for i, name in enumerate(chain.joints):
        rotation = chain.rotation[i] @ rotation_z(float(chain.offset[i]))
        kind = pin.JointModelPZ() if chain.prismatic[i] else pin.JointModelRZ()
        parent = model.addJoint(parent, kind, pin.SE3(rotation, chain.translation[i].copy()), name)
        if chain.mass is not None and chain.com is not None:
            inertia = pin.Inertia(float(chain.mass[i]), chain.com[i].copy(), np.zeros((3, 3)))
            model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    flange = pin.SE3(chain.flange_rotation.copy(), chain.flange_translation.copy())
    model.addFrame(pin.Frame("flange", parent, 0, flange, pin.FrameType.OP_FRAME))
    model.gravity.linear = chain.gravity.copy()
    return model


def _from_dh(cell: Cell) -> Chain:
    robot = cell.robot
    rows = robot.dh or ()
    n = len(rows)
    rotation, translation = np.empty((n, 3, 3)), np.empty((n, 3))
    pending = np.eye(3), np.zeros(3)  # what of the previous row stands between its rotation and this joint
    tails = []
    for i, row in enumerate(rows):
        turn, along_x, along_z = rotation_x(row.alpha), np.array([row.a, 0.0, 0.0]), np.array([0.0, 0.0, row.d])
        if robot.modified_dh:
            rotation[i] = pending[0] @ turn
            translation[i] = pending[1] + pending[0] @ along_x
            pending = np.eye(3), along_z
        else:
            rotation[i], translation[i] = pending
            pending = turn, along_z + along_x
        tails.append(pending)
    mass = com = None
    if robot.inertials is not None:
        mass = np.array([inertial.mass for inertial in robot.inertials])
        com = np.array([t[0] @ np.array(i.com) + t[1] for t, i in zip(tails, robot.inertials, strict=True)])
    return Chain(
        joints=robot.joints,
        rotation=rotation,
        translation=translation,
        offset=np.array([row.theta for row in rows]),
        flange_rotation=pending[0],
        flange_translation=pending[1],
        limits=np.array(robot.joint_limits, dtype=float),
        gravity=cell.gravity,
        mass=mass,
        com=com,
        inertials_known=robot.inertials_known,
        rigid=tuple(stiffness == math.inf for stiffness in robot.stiffness or ()),
        prismatic=tuple(kind == "prismatic" for kind in robot.joint_types or ()),
        along=np.array([row.d if robot.modified_dh else 0.0 for row in rows]),
    )
