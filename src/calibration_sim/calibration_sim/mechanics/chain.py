"""The robot as its file states it: a tree of links, read from a URDF or from DH rows.

A link's frame turns with its joint.  Standing joints (fixed, or movable but not among the cell's joints) have no axis;
joints between base and flange that mimic one of the cell's have one.
Only what statics needs is read: joint origins and axes, masses and centres of gravity.
"""

from __future__ import annotations

import dataclasses
import math
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from calibration_core.cell import Cell, DhRow, Robot
from calibration_core.cell.urdf import endless, urdf_bytes
from calibration_core.errors import CellError, quoted
from calibration_core.timeseries import Float1D, Float2D
from calibration_sim.mechanics.transforms import Placement, axis_rotation, fixed_axes, translation, turn

DRIVEN = ("revolute", "continuous", "prismatic")


@dataclasses.dataclass(frozen=True)
class Follows:
    """How a mimic joint stands: at multiplier times where the link of another joint stands, plus an offset.

    Attributes:
        name: Of the mimic joint.
        joint: Name of the other, one of the cell's.
        multiplier: Of the other's rad, or m where it slides.
        offset: rad, m where the mimic joint slides.
    """

    name: str
    joint: str
    multiplier: float
    offset: float


@dataclasses.dataclass(frozen=True, eq=False)
class Link:
    """One body of the tree.

    Attributes:
        name: Unique name.
        parent: Index of the link it hangs on, -1 for the base frame.
        origin: Its frame in the parent's frame, joint angle zero.
        joint: Name of the joint that turns it, empty if it stands still in its parent.
        axis: (3,) unit axis of that joint through the frame's origin, in the link's frame.
        slides: Whether the joint moves along its axis instead of turning about it.
        mass: kg.
        com: (3,) m, centre of gravity in the link's frame.
        follows: Where a mimic joint moves it about or along the axis, how; None otherwise.
    """

    name: str
    parent: int
    origin: Placement
    joint: str
    axis: Float1D
    mass: float
    com: Float1D
    slides: bool = False
    follows: Follows | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Chain:
    """A robot: links, parents before children, and which of them carries what.

    Attributes:
        links: The tree.
        joints: Names of the moving joints, in the order of q.
        flange: Index of the flange link.
        limits: (n, 2) rad, m where a joint slides; lower and upper.
    """

    links: tuple[Link, ...]
    joints: tuple[str, ...]
    flange: int
    limits: Float2D

    def child_of(self, joint: int) -> Link:
        """Return the first link that hangs on what a joint carries."""
        carrier = next(i for i, link in enumerate(self.links) if link.joint == self.joints[joint])
        return next(link for link in self.links if link.parent == carrier)


def read_chain(cell: Cell) -> Chain:
    """Read the robot of a cell.

    Raises:
        CellError: The URDF is missing, malformed, or lacks a joint, link or limit that the cell names.
    """
    return _from_dh(cell.robot) if cell.robot.dh is not None else _from_urdf(cell)


def _from_dh(robot: Robot) -> Chain:
    rows = robot.dh or ()
    links: list[Link] = []
    before = translation()  # what stands between the previous link's frame and this joint's axis
    for i, (row, name) in enumerate(zip(rows, robot.joints, strict=True)):
        first, last = _dh_halves(row, modified=robot.modified_dh)
        mass, com = 0.0, np.zeros(3)
        if robot.inertials is not None:
            mass, com = robot.inertials[i].mass, last.apply(robot.inertials[i].com)
        slides = robot.joint_types is not None and robot.joint_types[i] == "prismatic"
        links.append(Link(f"link_{i + 1}", i - 1, before @ first, name, np.array([0.0, 0.0, 1.0]), mass, com, slides))
        before = last
    links.append(Link("flange", len(rows) - 1, before, "", np.zeros(3), 0.0, np.zeros(3)))
    limits = np.array(robot.joint_limits, dtype=np.float64)
    return Chain(tuple(links), robot.joints, len(rows), limits)


def _dh_halves(row: DhRow, *, modified: bool) -> tuple[Placement, Placement]:
    """Split one row's transform into what comes before the joint turns about z, and what comes after."""
    if modified:  # Rx(alpha) Tx(a) Rz(theta + q) Tz(d); Rz and Tz about one axis commute
        first = turn(axis_rotation(0, row.alpha)) @ translation(x=row.a, z=row.d) @ turn(axis_rotation(2, row.theta))
        return first, translation()
    last = turn(axis_rotation(2, row.theta)) @ translation(x=row.a, z=row.d) @ turn(axis_rotation(0, row.alpha))
    return translation(), last


def _from_urdf(cell: Cell) -> Chain:
    path = cell.urdf_path
    if path is None:
        raise cell.missing("robot.urdf", "simulating the robot")
    robot = cell.robot
    root = ET.fromstring(urdf_bytes(path, robot.joints if robot.joint_limits is None else ()))
    names = [element.get("name", "") for element in root.findall("link")]
    for key, name in (("base_link", robot.base_link), ("flange", robot.flange)):
        if name not in names:
            raise CellError(cell.path, f"robot.{key}", quoted(name), f"a link of {path.name}: {', '.join(names)}")
    children: dict[str, list[ET.Element]] = {}
    above: dict[str, ET.Element] = {}
    for joint in root.findall("joint"):
        children.setdefault(_attribute(path, joint, "parent", "link"), []).append(joint)
        above[_attribute(path, joint, "child", "link")] = joint
    followers = _followers(cell, path, above)
    inertials = {element.get("name", ""): element.find("inertial") for element in root.findall("link")}
    links: list[Link] = []
    limits: dict[str, tuple[float, float]] = {}
    narrower: list[tuple[Follows, tuple[float, float]]] = []
    open_ends = [(child, -1) for child in children.get(str(robot.base_link), [])]
    while open_ends:
        joint, parent = open_ends.pop(0)
        link = _link(path, joint, parent, robot.joints, inertials, followers.get(joint.get("name", "")))
        if link.joint:
            limits[link.joint] = _limits(path, joint)
        limit = joint.find("limit")
        bounded = limit is not None and {"lower", "upper"} <= set(limit.keys()) and joint.get("type") != "continuous"
        if link.follows is not None and bounded and link.follows.multiplier != 0.0:
            narrower.append((link.follows, _limits(path, joint)))
        if link.name in {known.name for known in links}:
            raise CellError(path, f"link {link.name!r}", "two parents", "a tree")
        links.append(link)
        open_ends += [(child, len(links) - 1) for child in children.get(link.name, [])]
    flange = next((i for i, link in enumerate(links) if link.name == robot.flange), None)
    if flange is None:
        raise CellError(cell.path, "robot.flange", quoted(robot.flange), f"a link that hangs on {robot.base_link!r}")
    _check_joints(cell, links, flange)
    if robot.joint_limits is not None:
        limits = dict(zip(robot.joints, robot.joint_limits, strict=True))
    for follows, ends in narrower:
        low, high = sorted((end - follows.offset) / follows.multiplier for end in ends)
        limits[follows.joint] = max(low, limits[follows.joint][0]), min(high, limits[follows.joint][1])
    return Chain(tuple(links), robot.joints, flange, np.array([limits[name] for name in robot.joints]))


def _followers(cell: Cell, path: Path, above: dict[str, ET.Element]) -> dict[str, Follows]:
    """Return the mimic joints between base and flange, by name."""
    found, way, here = {}, list[ET.Element](), str(cell.robot.flange)
    while here != cell.robot.base_link and here in above:
        way.append(above[here])
        here = _attribute(path, above[here], "parent", "link")
    beside = {
        joint.get("name", "")
        for joint in above.values()
        if joint not in way and joint.get("type") in DRIVEN and joint.find("mimic") is None
    }
    for joint in way:
        mimic, name = joint.find("mimic"), joint.get("name", "")
        if mimic is not None and joint.get("type") in DRIVEN:
            driver, place = mimic.get("joint", ""), f"joint {name!r}, mimic"
            multiplier, offset = (
                _number(path, place, mimic.get(key, default)) for key, default in (("multiplier", "1"), ("offset", "0"))
            )
            if driver in beside and name not in cell.robot.joints:  # nobody drives it: it stands
                driver, multiplier = cell.robot.joints[0], 0.0
            if name in cell.robot.joints or driver not in cell.robot.joints:
                raise CellError(path, place, quoted(driver), "one joint of the cell, itself none of them")
            found[name] = Follows(name, driver, multiplier, offset)
    return found


def _link(
    path: Path,
    joint: ET.Element,
    parent: int,
    joints: tuple[str, ...],
    inertials: dict[str, ET.Element | None],
    follows: Follows | None,
) -> Link:
    name, kind = joint.get("name", ""), joint.get("type", "")
    child = _attribute(path, joint, "child", "link")
    if child not in inertials:
        raise CellError(path, f"joint {name!r}", f"child {quoted(child)}", "a link of this file")
    axis = np.zeros(3)
    if name in joints or follows is not None:
        if kind not in DRIVEN:
            raise CellError(path, f"joint {name!r}", f"type {quoted(kind)}", "revolute, continuous or prismatic")
        axis = _vector(path, joint, "axis", "xyz", (1.0, 0.0, 0.0))
        length = float(np.linalg.norm(axis))
        if length < 1e-6:
            raise CellError(path, f"joint {name!r}", "an axis of length zero", "an axis")
        axis = axis / length
    mass, com = 0.0, np.zeros(3)
    inertial = inertials[child]
    if inertial is not None:
        mass = _number(path, f"link {child!r}", _attribute(path, inertial, "mass", "value"))
        com = _vector(path, inertial, "origin", "xyz", (0.0, 0.0, 0.0))
        if mass < 0.0:
            raise CellError(path, f"link {child!r}", f"mass {mass:g}", "a mass of at least zero")
    origin = Placement(
        fixed_axes(*_vector(path, joint, "origin", "rpy", (0.0, 0.0, 0.0))),
        _vector(path, joint, "origin", "xyz", (0.0, 0.0, 0.0)),
    )
    return Link(child, parent, origin, name if name in joints else "", axis, mass, com, kind == "prismatic", follows)


def _limits(path: Path, joint: ET.Element) -> tuple[float, float]:
    limit = joint.find("limit")
    if joint.get("type") == "continuous" or limit is None:
        return -math.pi, math.pi
    place = f"joint {joint.get('name', '')!r}, limit"
    low, high = (_number(path, place, limit.get(key, "0")) for key in ("lower", "upper"))
    if endless(joint.get("type", ""), low, high):
        return -math.pi, math.pi
    if not low < high:
        raise CellError(path, place, f"[{low:g}, {high:g}]", "lower < upper")
    return low, high


def _check_joints(cell: Cell, links: list[Link], flange: int) -> None:
    on_the_way = set()
    index = flange
    while index >= 0:
        on_the_way.add(links[index].joint)
        index = links[index].parent
    for name in cell.robot.joints:
        if name not in on_the_way:
            expected = f"a joint between {cell.robot.base_link!r} and {cell.robot.flange!r}"
            raise CellError(cell.path, "robot.joints", quoted(name), expected)


def _attribute(path: Path, element: ET.Element, tag: str, key: str) -> str:
    child = element.find(tag)
    value = None if child is None else child.get(key)
    if value is None:
        raise CellError(path, f"{element.tag} {element.get('name', '')!r}", f"no <{tag} {key}=...>", "one")
    return value


def _vector(path: Path, element: ET.Element, tag: str, key: str, default: tuple[float, float, float]) -> Float1D:
    child = element.find(tag)
    text = None if child is None else child.get(key)
    if text is None:
        return np.array(default)
    place = f"{element.tag} {element.get('name', '')!r}, {tag} {key}"
    parts = text.split()
    if len(parts) != 3:
        raise CellError(path, place, quoted(text), "three numbers")
    return np.array([_number(path, place, part) for part in parts])


def _number(path: Path, place: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value) or (math.isinf(value) and not place.endswith("limit")):
        raise CellError(path, place, quoted(text), "a finite number")
    return value
