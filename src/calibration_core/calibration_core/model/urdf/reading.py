"""From a URDF to a chain: the joints between base and flange, with every mass on the nearest of them.

What the links of a URDF look like and touch with: primitives and meshes, link by link.

A URDF is often handed on without its meshes.  They are looked for beside it, in the folders above it, and where ROS
looks: in `ROS_PACKAGE_PATH` and `AMENT_PREFIX_PATH`.  One that is not found, or that holds nothing, is no error: it is
named, and others take the link's place.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal
from urllib.parse import unquote

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


# --- what the links of a URDF look like and touch with ----------------------------------------------------------------


MESHES = "meshes"  # folder beside a URDF into which `init` copies its meshes
MAX_MESH_BYTES = 256 << 20
SHOWN = 3  # meshes that a message names
Kind = Literal["collision", "visual"]
Form = Literal["box", "cylinder", "sphere", "mesh"]


@dataclasses.dataclass(frozen=True, eq=False)
class Body:
    """One rigid body of the robot.

    Attributes:
        link: 0 for the base, i for what moving joint i carries, those that mimic others counted (`Chain.whole`).
        name: Of the URDF's link, with a number where it has several bodies.
        size: m: edges of a box, (3,); radius and length of a cylinder, (2,); radius of a sphere, (1,); the factors by
            which a mesh is scaled, (3,).
        mesh: The mesh as the URDF names it; empty for a primitive.
        pose: (4, 4) in the link's body frame (after the joint's rotation; the base frame for the base).
    """

    link: int
    name: str
    form: Form
    size: Float1D
    mesh: str
    pose: Float2D


def urdf_bodies(cell: Cell, kind: Kind = "collision") -> tuple[Body, ...]:
    """Return the bodies of the URDF's links, none where it states none; joints off the chain stand at zero.

    Raises:
        CellError: The URDF cannot be read.
    """
    if cell.urdf_path is None:
        return ()
    tree = tree_of(cell)
    bodies = []
    for name, (carrier, pose) in link_poses(cell, tree).items():
        link = tree.links[name]
        for number, one in enumerate(link.collisions if kind == "collision" else link.visuals):
            placed = pose if one.origin is None else pose @ np.asarray(one.origin, dtype=float)
            title = name if number == 0 else f"{name} {number + 1}"
            form, size, mesh = _form(cell.urdf_path, f"link {quoted(name)}, {kind}", one.geometry)
            bodies.append(Body(carrier + 1, title, form, size, mesh, placed))
    return tuple(bodies)


def _form(urdf: Path, place: str, geometry: Any) -> tuple[Form, Float1D, str]:
    if geometry is None:
        raise CellError(urdf, place, "no geometry", "a box, cylinder, sphere or mesh")
    if geometry.box is not None:
        return "box", np.asarray(geometry.box.size, dtype=float), ""
    if geometry.cylinder is not None:
        return "cylinder", np.array([geometry.cylinder.radius, geometry.cylinder.length]), ""
    if geometry.sphere is not None:
        return "sphere", np.array([geometry.sphere.radius]), ""
    scale = np.ones(3) if geometry.mesh.scale is None else np.broadcast_to(geometry.mesh.scale, 3).astype(float)
    return "mesh", scale, str(geometry.mesh.filename)


def urdf_shapes(cell: Cell, kind: Kind = "collision") -> tuple[list[tuple[Body, Any]], dict[Body, str]]:
    """Return the bodies with their `coal.CollisionGeometry`, and those whose mesh cannot be had, with the reason.

    Raises:
        CellError: The URDF cannot be read.
    """
    shapes: list[tuple[Body, Any]] = []
    lost: dict[Body, str] = {}
    for body in urdf_bodies(cell, kind):
        found = _shape(cell, body)
        if isinstance(found, str):
            lost[body] = found
        else:
            shapes.append((body, found))
    return shapes, lost


def lost_meshes(lost: dict[Body, str]) -> str:
    """Return a sentence on meshes that cannot be had, with what is done instead and the cure; empty for none."""
    if not lost:
        return ""
    names = list(dict.fromkeys(f"{body.mesh} ({reason})" for body, reason in lost.items()))
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return (
        f"meshes of the URDF cannot be used: {', '.join(names[:SHOWN])}{more}; capsules along the links take their "
        f"place; to have them, set ROS_PACKAGE_PATH or AMENT_PREFIX_PATH, or give calibration init --meshes FOLDER"
    )


def mesh_file(urdf: Path, name: str, folders: Sequence[Path] = ()) -> Path | None:
    """Return where a mesh of a URDF lies; None where it is not found.

    Args:
        urdf: The URDF.
        name: As the URDF names it: `package://PACKAGE/...`, `file:///...`, a path.
        folders: Where to look besides, first.
    """
    scheme, _, rest = name.rpartition("://")
    inside = mesh_place(name)
    places = [urdf.parent / MESHES / inside]
    places += [] if scheme == "package" else [urdf.parent / unquote(rest)]
    places += [
        place for folder in folders for place in (folder / inside, *_within(folder, inside), folder / inside.name)
    ]
    for folder in urdf.parents:
        places += [folder / inside, *_within(folder, inside)]
    if scheme == "package":
        roots = [Path(one) for one in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if one]
        places += [place for root in roots for place in (root / inside, *_within(root, inside))]
        places += [found for root in roots for found in sorted(root.glob(f"*/{inside}"))]  # a repository of packages
        prefixes = [Path(one) for one in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if one]
        places += [prefix / "share" / inside for prefix in prefixes]
    return next((place for place in places if place.is_file()), None)


def mesh_place(name: str) -> Path:
    """Return where a mesh that a URDF names lies in a folder of meshes: without scheme and ways upwards."""
    return Path(*(part for part in Path(unquote(name.rpartition("://")[2])).parts if part not in ("..", "/")))


def _within(folder: Path, inside: Path) -> Iterator[Path]:
    """Yield a file of a package in a folder that is the package's, of whatever name."""
    if len(inside.parts) > 1:
        yield folder / Path(*inside.parts[1:])


def _shape(cell: Cell, body: Body) -> Any:
    """Return a body as a `coal.CollisionGeometry`, or why its mesh cannot be used."""
    import coal

    if body.form == "box":
        return coal.Box(*body.size)
    if body.form == "cylinder":
        return coal.Cylinder(*body.size)
    if body.form == "sphere":
        return coal.Sphere(*body.size)
    path = None if cell.urdf_path is None else mesh_file(cell.urdf_path, body.mesh)
    if path is None:
        return "not found"
    if path.stat().st_size > MAX_MESH_BYTES:
        return f"more than {MAX_MESH_BYTES >> 20} MB"
    try:
        shape = coal.MeshLoader().load(str(path), body.size)
    except (RuntimeError, ValueError):  # what the loader says names a place in its own sources
        return "empty or not readable"
    return shape if shape.num_tris > 0 and np.isfinite(np.asarray(shape.vertices())).all() else "empty or not readable"
