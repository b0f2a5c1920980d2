"""From a URDF to a chain: the joints between base and flange, with every mass on the nearest of them."""

from __future__ import annotations

import math

import numpy as np

from calibration_core.cell import Cell
from calibration_core.cell.urdf import MOST_RADIANS, RADIANS
from calibration_core.errors import CellError, quoted
from calibration_core.model.chain import Chain, rotation_x
from calibration_core.model.mimic import Mimic
from calibration_core.model.urdf.mimics import gears_of, narrowed
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
    gears = gears_of(cell, tree, path)
    moving = [name for name in path if name in cell.robot.joints or name in gears]
    rotation, translation = np.empty((len(moving), 3, 3)), np.empty((len(moving), 3))
    here = np.eye(4)  # from the body frame of the link before
    i = 0
    for name in path:
        here = here @ (tree.origin(name) if name in gears else tree.standing(name))
        if name not in moving:
            continue
        turn = _align_z(_axis(cell, tree, name))
        rotation[i], translation[i] = here[:3, :3] @ turn, here[:3, 3]
        here = np.eye(4)
        here[:3, :3] = turn.T
        i += 1
    mass, com = _masses(cell, tree, moving)
    slides = [tree.joints[name].type == "prismatic" for name in moving]
    own = [moving.index(name) for name in cell.robot.joints]
    mimics = tuple(
        Mimic(
            name=name,
            behind=sum(k < i for k in own),
            driver=gears[name].driver,
            multiplier=gears[name].multiplier,
            offset=gears[name].offset,
            rotation=rotation[i],
            translation=translation[i],
            prismatic=slides[i],
            mass=None if mass is None else float(mass[i]),
            com=None if com is None else com[i],
        )
        for i, name in enumerate(moving)
        if name in gears
    )
    return Chain(
        joints=cell.robot.joints,
        rotation=rotation[own],
        translation=translation[own],
        offset=np.zeros(len(own)),
        flange_rotation=here[:3, :3],
        flange_translation=here[:3, 3],
        limits=narrowed(cell, tree, _limits(cell, tree), gears),
        gravity=cell.gravity,
        mass=None if mass is None else mass[own],
        com=None if com is None else com[own],
        inertials_known=cell.robot.inertials_known,
        rigid=tuple(stiffness == math.inf for stiffness in cell.robot.stiffness or ()),
        prismatic=tuple(slides[i] for i in own),
        mimics=tuple(mimics),
    )


def joint_alignments(cell: Cell) -> Float3D:
    """Return per joint the (3, 3) turn from its frame in the chain, z along the axis, to the axes of its URDF joint.

    Raises:
        CellError: As `chain_of_urdf`.
    """
    tree = tree_of(cell)
    return np.stack([_align_z(_axis(cell, tree, name)) for name in cell.robot.joints])


def link_poses(cell: Cell, tree: Tree) -> dict[str, tuple[int, Float2D]]:
    """Return link -> (index of the joint that carries it, -1 for the base; (4, 4) pose in that link's body frame).

    Of every link that hangs on the base.  All moving joints from base to flange are counted, those that mimic others
    too (`Chain.whole`); all other joints that are none of the cell's stand at zero.
    """
    path = _path(cell, tree)
    gears = gears_of(cell, tree, path)
    return _link_poses(cell, tree, [name for name in path if name in cell.robot.joints or name in gears])


def _link_poses(cell: Cell, tree: Tree, moving: list[str]) -> dict[str, tuple[int, Float2D]]:
    order = {name: i for i, name in enumerate(moving)}
    below: dict[str, list[str]] = {}
    for name, joint in tree.joints.items():
        below.setdefault(joint.parent, []).append(name)
    poses = {str(cell.robot.base_link): (-1, np.eye(4))}
    open_ends = [str(cell.robot.base_link)]
    while open_ends:
        link = open_ends.pop()
        carrier, pose = poses[link]
        for name in below.get(link, []):
            child = tree.joints[name].child
            if name in order:
                body = np.eye(4)
                body[:3, :3] = _align_z(_axis(cell, tree, name)).T
                poses[child] = (order[name], body)
            else:
                poses[child] = (carrier, pose @ tree.standing(name))
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
    chain = [name for name in path if name in robot.joints]
    if chain != list(robot.joints):
        order = ", ".join(chain) or "none of them"
        raise CellError(cell.path, "robot.joints", ", ".join(robot.joints), f"the joints from base to flange: {order}")
    return path


def _axis(cell: Cell, tree: Tree, name: str) -> Float1D:
    """Return the (3,) unit axis of a joint, in the axes of the link that it carries."""
    axis = unit_axis(tree.joints[name].axis)
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


def _masses(cell: Cell, tree: Tree, moving: list[str]) -> tuple[Float1D | None, Float2D | None]:
    """Gather every body's mass on the nearest moving joint below it; None where no link beyond one has any."""
    mass, moment = np.zeros(len(moving)), np.zeros((len(moving), 3))
    for name, (carrier, pose) in _link_poses(cell, tree, moving).items():
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
