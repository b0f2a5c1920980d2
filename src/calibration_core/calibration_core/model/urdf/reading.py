"""From a URDF to a chain: the joints between base and flange, with every mass on the nearest of them."""

from __future__ import annotations

import math

import numpy as np

from calibration_core.cell import Cell
from calibration_core.cell.urdf import MOST_RADIANS, RADIANS
from calibration_core.errors import CellError, quoted
from calibration_core.model.chain import Chain, rotation_x
from calibration_core.model.urdf.tree import MOVING, Tree, tree_of, unit_axis
from calibration_core.timeseries import Float1D, Float2D, Float3D

ENDLESS = 2 * np.pi  # rad either way, for a continuous joint, which has no limits of its own


def chain_of_urdf(cell: Cell) -> Chain:
    """Return the kinematic chain between the links that the cell file names, with the URDF's masses.

    Raises:
        CellError: The URDF is missing, malformed, or does not hold the joints and links that the cell file names.
    """
    if cell.robot.inertials is not None:
        raise CellError(cell.path, "robot.inertials", "inertials beside a urdf", "the URDF's own inertials only")
    tree = tree_of(cell)
    path = _path(cell, tree)
    n = len(cell.robot.joints)
    rotation, translation = np.empty((n, 3, 3)), np.empty((n, 3))
    here = np.eye(4)  # from the body frame of the link before
    i = 0
    for name in path:
        here = here @ tree.standing(name)
        if name not in cell.robot.joints:
            continue
        turn = _align_z(_axis(cell, tree, i))
        rotation[i], translation[i] = here[:3, :3] @ turn, here[:3, 3]
        here = np.eye(4)
        here[:3, :3] = turn.T
        i += 1
    mass, com = _masses(cell, tree)
    return Chain(
        joints=cell.robot.joints,
        rotation=rotation,
        translation=translation,
        offset=np.zeros(n),
        flange_rotation=here[:3, :3],
        flange_translation=here[:3, 3],
        limits=_limits(cell, tree),
        gravity=cell.gravity,
        mass=mass,
        com=com,
        inertials_known=cell.robot.inertials_known,
        rigid=tuple(stiffness == math.inf for stiffness in cell.robot.stiffness or ()),
        prismatic=tuple(tree.joints[name].type == "prismatic" for name in cell.robot.joints),
    )


def joint_alignments(cell: Cell) -> Float3D:
    """Return per joint the (3, 3) turn from its frame in the chain, z along the axis, to the axes of its URDF joint.

    Raises:
        CellError: As `chain_of_urdf`.
    """
    tree = tree_of(cell)
    return np.stack([_align_z(_axis(cell, tree, i)) for i in range(len(cell.robot.joints))])


def link_poses(cell: Cell, tree: Tree) -> dict[str, tuple[int, Float2D]]:
    """Return link -> (index of the joint that carries it, -1 for the base; (4, 4) pose in that link's body frame).

    Of every link that hangs on the base; joints that are none of the cell's stand at zero.
    """
    order = {name: i for i, name in enumerate(cell.robot.joints)}
    below: dict[str, list[str]] = {}
    for name, joint in tree.joints.items():
        below.setdefault(joint.parent, []).append(name)
    poses = {str(cell.robot.base_link): (-1, np.eye(4))}
    open_ends = [str(cell.robot.base_link)]
    while open_ends:
        link = open_ends.pop()
        carrier, pose = poses[link]
        for name in below.get(link, []):
            child, placed = tree.joints[name].child, pose @ tree.standing(name)
            if name in order:
                body = np.eye(4)
                body[:3, :3] = _align_z(_axis(cell, tree, order[name])).T
                poses[child] = (order[name], body)
            else:
                poses[child] = (carrier, placed)
            open_ends.append(child)
    return poses


def _path(cell: Cell, tree: Tree) -> list[str]:
    """Return the joints from base to flange; raise CellError where the cell's joints are not among them in order."""
    robot = cell.robot
    path = tree.path(str(robot.base_link), str(robot.flange))
    if path is None:
        raise CellError(cell.path, "robot.flange", quoted(robot.flange), f"a link that hangs on {robot.base_link!r}")
    moving = [name for name, joint in tree.joints.items() if joint.type in MOVING]
    for i, name in enumerate(robot.joints):
        if name not in moving:
            raise CellError(
                cell.path, f"robot.joints.{i}", quoted(name), "a moving joint of the URDF: " + ", ".join(moving)
            )
    for name in path:
        if tree.joints[name].mimic is not None and tree.joints[name].type in MOVING:
            found = f"a mimic joint between {robot.base_link!r} and {robot.flange!r}"
            raise CellError(
                cell.urdf_path or cell.path, f"joint {quoted(name)}", found, "joints of its own drive there"
            )
    chain = [name for name in path if name in robot.joints]
    if chain != list(robot.joints):
        order = ", ".join(chain) or "none of them"
        raise CellError(cell.path, "robot.joints", ", ".join(robot.joints), f"the joints from base to flange: {order}")
    return path


def _axis(cell: Cell, tree: Tree, i: int) -> Float1D:
    """Return the (3,) unit axis of one of the cell's joints, in the axes of the link that it carries."""
    name = cell.robot.joints[i]
    joint = tree.joints[name]
    axis = unit_axis(joint.axis)
    if axis is None:
        raise CellError(cell.urdf_path or cell.path, f"joint {quoted(name)}", "an axis of length zero", "an axis")
    return axis


def _align_z(axis: Float1D) -> Float2D:
    """Return the smallest rotation that takes z to `axis`."""
    z = np.array([0.0, 0.0, 1.0])
    c = float(axis @ z)
    if c > 1 - 1e-12:
        return np.eye(3)
    if c < -1 + 1e-12:
        return rotation_x(np.pi)
    v = np.cross(z, axis)
    skew = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + skew + skew @ skew / (1 + c)


def _masses(cell: Cell, tree: Tree) -> tuple[Float1D | None, Float2D | None]:
    """Gather every body's mass on the nearest joint of the chain below it; None where no link beyond one has any."""
    n = len(cell.robot.joints)
    mass, moment = np.zeros(n), np.zeros((n, 3))
    for name, (carrier, pose) in link_poses(cell, tree).items():
        inertial = tree.links[name].inertial
        if inertial is None or carrier < 0:
            continue
        place = np.eye(4) if inertial.origin is None else np.asarray(inertial.origin, dtype=float)
        mass[carrier] += inertial.mass
        moment[carrier] += inertial.mass * (pose @ place)[:3, 3]
    if not mass.any():
        return None, None
    return mass, moment / np.where(mass > 0, mass, 1.0)[:, None]


def _limits(cell: Cell, tree: Tree) -> Float2D:
    if cell.robot.joint_limits is not None:
        for i, (name, (low, high)) in enumerate(zip(cell.robot.joints, cell.robot.joint_limits, strict=True)):
            if tree.joints[name].type != "prismatic" and max(abs(low), abs(high)) > MOST_RADIANS:
                raise CellError(cell.path, f"robot.joint_limits.{i}", f"[{low:g}, {high:g}]", RADIANS)
        return np.array(cell.robot.joint_limits, dtype=float)
    limits = np.empty((len(cell.robot.joints), 2))
    for i, name in enumerate(cell.robot.joints):
        joint = tree.joints[name]
        endless = joint.type == "continuous"
        limits[i] = (-ENDLESS, ENDLESS) if endless else (joint.limit.lower, joint.limit.upper)
    return limits
