"""From a URDF to a chain: the joints between base and flange, with every mass on the nearest of them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from calibration_core.cell import Cell
from calibration_core.cell.urdf import MOST_RADIANS, RADIANS, endless
from calibration_core.errors import CellError, quoted
from calibration_core.model.chain import Chain, Mimic, rotation_x
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
        stated = (0.0, 0.0) if joint.type == "continuous" else (joint.limit.lower, joint.limit.upper)
        limits[i] = (-ENDLESS, ENDLESS) if endless(joint.type, *stated) else stated
    return limits


@dataclasses.dataclass(frozen=True)
class Gear:
    """How a mimic joint goes with one of the robot's own: it stands at multiplier times that one plus offset.

    Attributes:
        driver: Index of the robot's own joint.
        multiplier: rad or m per rad or m.
        offset: rad, m where the mimic joint slides.
    """

    driver: int
    multiplier: float
    offset: float


def gears_of(cell: Cell, tree: Tree, path: list[str]) -> dict[str, Gear]:
    """Return the gears of the mimic joints among the joints from base to flange, by name.

    One whose multiplier is 0, or that mimics a driven joint beside the chain, stands still, as `Tree.standing` says,
    and is none of them.

    Raises:
        CellError: A joint of the cell mimics another, or one on the chain mimics what is none of the cell's.
    """
    own, joints = cell.robot.joints, tree.joints
    found = {}
    for name in path:
        mimic = joints[name].mimic
        if mimic is None or joints[name].type not in MOVING:
            continue
        driver, multiplier, offset = str(mimic.joint), float(mimic.multiplier), float(mimic.offset)
        if name in own:
            expected = f"joints with a drive of their own: leave it out, it goes with {quoted(driver)}"
            raise CellError(cell.path, f"robot.joints.{own.index(name)}", f"{quoted(name)}, a mimic joint", expected)
        beside = joints.get(driver)
        if driver not in path and beside is not None and beside.type in MOVING and beside.mimic is None:
            continue
        if driver not in own:
            raise CellError(
                cell.urdf_path or cell.path,
                f"joint {quoted(name)}, mimic",
                "nothing" if mimic.joint is None else f"{quoted(driver)}, {_what(tree, driver, name)}",
                f"one of the cell's joints, which drive: {', '.join(own)}",
            )
        if multiplier != 0.0:
            found[name] = Gear(own.index(driver), multiplier, offset)
    return found


def _what(tree: Tree, driver: str, name: str) -> str:
    """Say why a joint cannot drive a mimic joint."""
    joint = tree.joints.get(driver)
    if joint is None:
        return "no joint of the URDF"
    if joint.type not in MOVING:
        return f"a {joint.type} joint"
    if joint.mimic is not None:
        chain = [name, driver]
        while (following := tree.joints.get(chain[-1])) is not None and following.mimic is not None:
            chain.append(str(following.mimic.joint))
            if chain[-1] in chain[:-1]:
                return f"in a circle of mimic joints, {' -> '.join(chain)}"
        return f"a mimic joint itself, of {quoted(chain[-1])}"
    return "a joint that the cell file does not name"


def narrowed(cell: Cell, tree: Tree, limits: Float2D, gears: dict[str, Gear]) -> Float2D:
    """Return the limits of the robot's own joints, (n, 2), within which the mimic joints keep their own, too.

    Raises:
        CellError: No position of a driver is within the limits of a joint that mimics it.
    """
    kept = np.array(limits)
    for name, gear in gears.items():
        limit = tree.joints[name].limit
        if tree.joints[name].type == "continuous" or limit is None or limit.lower is None or limit.upper is None:
            continue
        ends = sorted((end - gear.offset) / gear.multiplier for end in (limit.lower, limit.upper))
        low, high = max(kept[gear.driver, 0], ends[0]), min(kept[gear.driver, 1], ends[1])
        if not low < high:
            driver, (first, last) = cell.robot.joints[gear.driver], kept[gear.driver]
            reached = sorted(gear.multiplier * end + gear.offset for end in (first, last))
            raise CellError(
                cell.urdf_path or cell.path,
                f"joint {quoted(name)}, limit",
                f"[{limit.lower:g}, {limit.upper:g}]",
                f"some of what {quoted(driver)} makes it reach, [{reached[0]:g}, {reached[1]:g}]",
            )
        kept[gear.driver] = low, high
    return kept
