"""The serial chain in a URDF of somebody else's: which link is the base, which the flange, which joints lie between."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from calibration_core.cell.urdf import urdf_bytes
from calibration_core.errors import CellError, quoted

MOVING = ("revolute", "continuous", "prismatic")
BASES = ("base_link", "base", "link_0", "link0")
FEWEST = 3  # joints of an arm
FARTHEST = 100.0  # m; a tracker reads 80 m at most, so what slides farther is a vehicle
FINGER = 2  # joints in series at the most
OTHER_ARM = 4  # joints beside the chosen ones that make a further arm; a finger has three at the most
FLANGES = (
    "flange", "tool0", "link_ee", "link_eef", "ee_link", "tool_link", "flange_link", "end_effector_link",
    "end_effector", "ee",
)  # fmt: skip
ALONG = 0.98  # cosine of 11 degrees: the z axis of a flange (ISO 9787) and that of the last joint


@dataclasses.dataclass(frozen=True)
class SerialChain:
    """What a cell file says of a URDF.

    Attributes:
        name: Name of the robot; empty where the URDF states none.
        joints: Moving joints from base to flange, without those that mimic others.
        masses: Sum of the masses that the URDF states, kg; 0 where it states none.
        remarks: What somebody should know who takes this chain: a further arm, an unusual flange.
    """

    name: str
    base_link: str
    flange: str
    joints: tuple[str, ...]
    masses: float
    remarks: tuple[str, ...] = ()


class _Path(NamedTuple):
    """From a base to a link: the joints with a drive of their own, and those that mimic one elsewhere."""

    moving: list[str]
    base: str
    end: str
    standing: list[str]


def serial_chain(path: Path, base_link: str | None = None, flange: str | None = None) -> SerialChain:
    """Return the chain to the link that is called a flange, else the one with the most joints of its own drive.

    Of several flanges at one joint the one is taken whose z axis lies along that joint's.  Fingers that hang at one
    link are a gripper, and no joints of the arm.  A joint that mimics one beside the chain stands at that one's zero.

    Raises:
        CellError: The URDF cannot be used, a link is not in it, or it holds no chain of three joints or more.
    """
    if path.suffix == ".xacro":
        raise CellError(path, "", "a xacro file", f"a URDF: xacro {path.name} > robot.urdf makes one")
    root = ET.fromstring(urdf_bytes(path))
    links = [str(link.get("name")) for link in root.findall("link")]
    above = {_link(joint, "child"): joint for joint in root.findall("joint")}
    for place, name in (("base link", base_link), ("flange", flange)):
        if name is not None and name not in links:
            raise CellError(path, place, quoted(name), f"a link of the URDF: {', '.join(links[:40])}")
    chains = [
        found
        for end in ([flange] if flange else links)
        for base in ([base_link] if base_link else _bases(links, above))
        if (found := _between(above, base, end, stated=base_link is not None)) is not None
    ]
    if not chains or max(len(one.moving) for one in chains) < FEWEST:
        most = max((len(one.moving) for one in chains), default=0)
        place = f"from {base_link or 'its base'} to {flange or 'any link'}"
        raise CellError(path, place, f"{most} moving joints", f"a chain of at least {FEWEST}, each with its own drive")
    named = [one for one in chains if _rank(one.end) < len(FLANGES) and len(one.moving) >= FEWEST]
    among = named or chains
    length = max(len(one.moving) for one in among)
    if not named and flange is None:
        longest = next(one.moving for one in chains if len(one.moving) == length)
        length = _without_fingers(above, longest)
    order = {name: index for index, name in enumerate(links)}

    def fitness(one: _Path) -> tuple[bool, bool, int, int]:
        known = _rank(one.end)
        return bool(one.standing), known < len(FLANGES) and not _along(above, one.end), known, order[one.end]

    chosen = min((one for one in among if len(one.moving) == length), key=fitness)
    urdf_bytes(path, chosen.moving)  # whose limits are needed
    masses = sum(float(mass.get("value", 0.0)) for mass in root.findall("link/inertial/mass"))
    remarks = [
        f"Joint {name} mimics a joint beside the arm: it is taken as standing where that one is at zero."
        for name in chosen.standing
    ]
    if base_link is None and chosen.base in above and _drives(above[chosen.base]):
        drive = above[chosen.base].get("name")
        text = f"The arm begins at {chosen.base}: joint {drive} above it is a vehicle's, which travels without limits."
        remarks.append(text)
    if not _along(above, chosen.end):
        text = f"The z axis of {chosen.end} does not lie along the last joint: state sensor, wrench point and targets"
        remarks.append(f"{text} in the axes of {chosen.end}, or give another link with --flange.")
    if flange is None:
        arms = [one for one in chains if len(one.moving) == _without_fingers(above, one.moving)]
        remarks += _further_arms(sorted(arms, key=lambda one: (-len(one.moving), fitness(one))), chosen)
    joints = tuple(chosen.moving)
    return SerialChain(root.get("name", ""), chosen.base, chosen.end, joints, masses, tuple(remarks))


def _further_arms(chains: Sequence[_Path], chosen: _Path) -> list[str]:
    """Return a sentence for every arm that shares at most its carrier with those before."""
    taken, remarks = set(chosen.moving), []
    for one in chains:
        own = set(one.moving) - taken
        if len(own) >= OTHER_ARM:
            taken |= own
            remarks.append(
                f"A further arm with {len(one.moving)} joints ends at {one.end}: --flange {one.end} takes it."
            )
    return remarks


def _rank(link: str) -> int:
    """Return how a link is called, the most telling name first; a name may have a prefix, as in `left_tool0`."""
    last = [re.search(rf"(?:^|[^a-z0-9]){name}$", link.lower()) is not None for name in FLANGES]
    return last.index(True) if True in last else len(FLANGES)


def _along(above: Mapping[str, ET.Element], link: str) -> bool:
    """Tell whether a link's z axis lies along the axis of the moving joint that carries it, or against it."""
    z = np.array([0.0, 0.0, 1.0])
    while (joint := above.get(link)) is not None and (joint.get("type") not in MOVING or _mimics(joint)):
        z = _turned(joint.find("origin"), z)
        link = _link(joint, "parent")
    axis = None if joint is None else joint.find("axis")
    vector = (
        np.array([float(word) for word in str(axis.get("xyz", "1 0 0")).split()]) if axis is not None else np.eye(3)[0]
    )
    return bool(abs(vector @ z) >= ALONG * np.linalg.norm(vector))


def _turned(origin: ET.Element | None, vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a vector in the axes of a joint's parent: R = Rz(y) Ry(p) Rx(r)."""
    angles = [0.0] * 3 if origin is None else [float(word) for word in origin.get("rpy", "0 0 0").split()]
    for axis, angle in enumerate(angles):
        one, other = (axis + 1) % 3, (axis + 2) % 3
        cos, sin = np.cos(angle), np.sin(angle)
        vector = vector.copy()
        vector[one], vector[other] = cos * vector[one] - sin * vector[other], sin * vector[one] + cos * vector[other]
    return vector


def _without_fingers(above: dict[str, ET.Element], moving: list[str]) -> int:
    """Return how many of a chain's joints are the arm's: its last ones are fingers where others hang beside them."""
    joints = {str(joint.get("name")): joint for joint in above.values()}
    others = [_link(one, "child") for name, one in joints.items() if one.get("type") in MOVING and name not in moving]
    for count in range(max(FEWEST, len(moving) - FINGER), len(moving)):
        joint = joints[moving[count]]
        at, child = _link(joint, "parent"), _link(joint, "child")
        if any(_hangs(above, link, at) and link != child and not _hangs(above, link, child) for link in others):
            return count
    return len(moving)


def _hangs(above: dict[str, ET.Element], link: str, at: str) -> bool:
    """Say whether one link hangs below another."""
    passed = 0
    while link in above and passed <= len(above):
        link, passed = _link(above[link], "parent"), passed + 1
        if link == at:
            return True
    return False


def _bases(links: list[str], above: dict[str, ET.Element]) -> list[str]:
    """Return the links where an arm may begin: that of a base's name, or a root, and what a vehicle carries."""
    named = [name for name in BASES if name in links][:1]
    hanging = [name for name in links if name in above and _drives(above[name]) and name not in named]
    if not named:
        return [*(name for name in links if name not in above), *hanging]
    return [*named, *(name for name in hanging if not _hangs(above, named[0], name))]


def _drives(joint: ET.Element) -> bool:
    """Tell whether a joint is that of a vehicle: it floats, or slides without limits."""
    if joint.get("type") != "prismatic" or _mimics(joint):
        return joint.get("type") in {"floating", "planar"}
    limit = joint.find("limit")
    ends = [float(limit.get(key, "inf")) for key in ("lower", "upper")] if limit is not None else [math.inf]
    return max(map(abs, ends)) > FARTHEST


def _between(above: dict[str, ET.Element], base: str, end: str, *, stated: bool) -> _Path | None:
    """Return the path between two links; None where the end hangs elsewhere, or on a vehicle unless that is stated."""
    moving: list[str] = []
    drivers: dict[str, str] = {}
    link = end
    while link != base:
        joint = above.get(link)
        if joint is None:
            return None
        name = str(joint.get("name"))
        if joint.get("type") not in (*MOVING, "fixed") or (_drives(joint) and not stated):
            return None
        if _mimics(joint):
            drivers[name] = str(joint.find("mimic").get("joint"))  # type: ignore[union-attr]  # it mimics
        elif joint.get("type") in MOVING:
            moving.append(name)
        link = _link(joint, "parent")
    standing = [name for name, driver in drivers.items() if driver not in {*moving, *drivers}]
    return _Path(moving[::-1], base, end, standing[::-1])


def _mimics(joint: ET.Element) -> bool:
    return joint.get("type") in MOVING and joint.find("mimic") is not None


def _link(joint: ET.Element, tag: str) -> str:
    element = joint.find(tag)
    return "" if element is None else str(element.get("link"))
