"""The serial chain in a URDF of somebody else's: which link is the base, which the flange, which joints lie between."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from xml.etree import ElementTree as ET

from calibration_core.cell.urdf import urdf_bytes
from calibration_core.errors import CellError, quoted

MOVING = ("revolute", "continuous", "prismatic")
BASES = ("base_link", "base", "link_0", "link0")
FEWEST = 3  # joints of an arm
FINGER = 2  # joints in series at the most
FLANGES = ("flange", "tool0", "link_ee", "ee_link", "tool_link")


@dataclasses.dataclass(frozen=True)
class SerialChain:
    """What a cell file says of a URDF.

    Attributes:
        name: Name of the robot.
        base_link: Base.
        flange: Flange.
        joints: Moving joints from base to flange, without those that mimic others.
        masses: Sum of the masses that the URDF states, kg; 0 where it states none.
    """

    name: str
    base_link: str
    flange: str
    joints: tuple[str, ...]
    masses: float


def serial_chain(path: Path, base_link: str | None = None, flange: str | None = None) -> SerialChain:
    """Return the chain to the link that is called a flange, else the one with the most joints of its own drive.

    Fingers that hang at one link are a gripper, and no joints of the arm.

    Args:
        path: The URDF.
        base_link: Base, if it is not to be found by its name.
        flange: Flange, likewise.

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
        (moving, base, end)
        for end in ([flange] if flange else links)
        for base in ([base_link] if base_link else _bases(links, above))
        if (moving := _between(above, base, end)) is not None
    ]
    if not chains or max(len(moving) for moving, _, _ in chains) < FEWEST:
        most = max((len(moving) for moving, _, _ in chains), default=0)
        place = f"from {base_link or 'its base'} to {flange or 'any link'}"
        raise CellError(path, place, f"{most} moving joints", f"a chain of at least {FEWEST}, each with its own drive")
    named = [one for one in chains if _rank(one[2]) < len(FLANGES) and len(one[0]) >= FEWEST]
    among = named or chains
    length = max(len(moving) for moving, _, _ in among)
    if not named and flange is None:
        longest = next(moving for moving, _, _ in chains if len(moving) == length)
        length = _without_fingers(above, longest)
    moving, base, end = min(
        (one for one in among if len(one[0]) == length), key=lambda one: (_rank(one[2]), links.index(one[2]))
    )
    masses = sum(float(mass.get("value", 0.0)) for mass in root.findall("link/inertial/mass"))
    return SerialChain(str(root.get("name")), base, end, tuple(moving), masses)


def _rank(link: str) -> int:
    """Return how a link is called, the most telling name first; a name may have a prefix, as in `left_tool0`."""
    return next((k for k, name in enumerate(FLANGES) if link == name or link.endswith(f"_{name}")), len(FLANGES))


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
    named = [name for name in BASES if name in links]
    return named[:1] or [name for name in links if name not in above]


def _between(above: dict[str, ET.Element], base: str, end: str) -> list[str] | None:
    """Return the names of the joints with a drive of their own; None where the end hangs elsewhere.

    What mimics one of these is passed over; what mimics a joint elsewhere makes None, too.
    """
    moving: list[str] = []
    drivers, mimics = set[str](), set[str]()
    while end != base:
        joint = above.get(end)
        if joint is None:
            return None
        mimic = joint.find("mimic")
        if joint.get("type") in MOVING and mimic is not None:
            drivers.add(str(mimic.get("joint")))
            mimics.add(str(joint.get("name")))
        elif joint.get("type") in MOVING:
            moving.append(str(joint.get("name")))
        elif joint.get("type") != "fixed":
            return None
        end = _link(joint, "parent")
    return moving[::-1] if drivers <= {*moving, *mimics} else None


def _link(joint: ET.Element, tag: str) -> str:
    element = joint.find(tag)
    return "" if element is None else str(element.get("link"))
