"""The serial chain in a URDF of somebody else's: which link is the base, which the flange, which joints lie between."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from xml.etree import ElementTree as ET

from calibration_core.cell.urdf import urdf_bytes
from calibration_core.errors import CellError, quoted

MOVING = ("revolute", "continuous", "prismatic")
BASES = ("base_link", "base", "link_0", "link0")
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
    """Return the chain with the most joints of its own drive.

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
    if not chains or max(len(moving) for moving, _, _ in chains) < 3:
        most = max((len(moving) for moving, _, _ in chains), default=0)
        place = f"from {base_link or 'its base'} to {flange or 'any link'}"
        raise CellError(path, place, f"{most} moving joints", "a chain of at least 3, each with its own drive")
    length = max(len(moving) for moving, _, _ in chains)
    moving, base, end = min(
        (one for one in chains if len(one[0]) == length),
        key=lambda one: (FLANGES.index(one[2]) if one[2] in FLANGES else len(FLANGES), links.index(one[2])),
    )
    masses = sum(float(mass.get("value", 0.0)) for mass in root.findall("link/inertial/mass"))
    return SerialChain(str(root.get("name")), base, end, tuple(moving), masses)


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
