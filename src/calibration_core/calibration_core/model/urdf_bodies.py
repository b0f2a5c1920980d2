"""The collision bodies of a URDF, link by link, as shapes that coal knows."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pinocchio as pin

from calibration_core.cell import Cell
from calibration_core.errors import CellError
from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import posture
from calibration_core.model.urdf import captured_stderr, frame_of, joint_ids, load_urdf
from calibration_core.timeseries import Float2D


@dataclasses.dataclass(frozen=True, eq=False)
class LinkBody:
    """One rigid body of the robot.

    Attributes:
        link: 0 for the base, i for what joint i carries.
        name: As the URDF or the geometry calls it.
        shape: A `coal.CollisionGeometry`.
        pose: (4, 4) in the link's body frame (after the joint's rotation; the base frame for the base).
    """

    link: int
    name: str
    shape: Any
    pose: Float2D


def urdf_bodies(cell: Cell, chain: Chain) -> tuple[LinkBody, ...]:
    """Return the collision bodies of the URDF's links, none where it states none; joints off the chain stand at zero.

    `package://` and relative names of meshes are looked for beside the URDF and in the three folders above it.

    Raises:
        CellError: The URDF cannot be read, or a mesh that it names cannot.
    """
    path = cell.urdf_path
    if path is None:
        return ()
    model = load_urdf(cell)
    said: list[str] = []
    folders = [str(folder) for folder in (path.parent, *path.parents[1:4])]
    try:
        with captured_stderr(said):
            geometry = pin.buildGeomFromUrdfString(
                model, path.read_text(encoding="utf-8"), pin.GeometryType.COLLISION, None, folders
            )
    except (RuntimeError, ValueError) as error:
        raise CellError(path, "collision", " ".join(said) or str(error), "meshes that can be read") from None
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    pin.updateFramePlacements(model, data)
    to_base = frame_of(cell, model, data, "base_link").inverse()
    ids = joint_ids(cell, model)
    at = posture(chain, np.zeros((1, chain.n)))
    frames = [np.eye(4)]
    for columns, origin in zip(at.body, (*at.origin,), strict=True):
        frame = np.eye(4)
        frame[:3, :3], frame[:3, 3] = columns[:, :, 0].T, origin[:, 0]
        frames.append(frame)
    bodies = []
    for found in geometry.geometryObjects:
        carriers = [ids.index(j) + 1 for j in model.supports[found.parentJoint] if j in ids]
        link = carriers[-1] if carriers else 0
        pose = (to_base * data.oMi[found.parentJoint] * found.placement).homogeneous
        bodies.append(LinkBody(link, found.name, found.geometry, np.linalg.solve(frames[link], pose)))
    return tuple(bodies)
