"""A URDF as a file of somebody else's: read as text, and refused before any parser of robots sees it.

What is refused: files that are too large, define entities or a document type, are no UTF-8, nest too deeply or hold too
many elements; names that are missing or used twice; numbers that are none; masses below zero; angles of a pose beyond a
turn, as degrees are; limits that are no interval, or not in radians.  The first fault ends the reading, in one line
with its place.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import cast
from xml.etree import ElementTree as ET

from calibration_core.cell.values import IN_DEGREES, TURN
from calibration_core.errors import CellError, quoted
from calibration_core.files.names import NAME, is_name
from calibration_core.files.regular import read_regular

MAX_BYTES = 8 << 20
MAX_ELEMENTS = 50_000
MAX_LINKS = 300  # a robot with tool, cables and cell has a few dozen; a chain of thousands stops the solvers
MAX_DEPTH = 32
MOST_RADIANS = 4 * math.pi * 1.001  # two turns either way; more is what degrees look like
UNLIMITED = 3600.0  # ten turns in degrees; a larger limit, such as 999999 or inf, is none: the joint turns endlessly
WORLD = "world"  # the frame that Drake and Gazebo let a URDF hang on without a link of that name
RADIANS = "radians, at most two turns (12.57) either way: are these degrees? Divide by 57.29578"
FORBIDDEN = re.compile(rb"<!\s*(DOCTYPE|ENTITY|ELEMENT|ATTLIST|NOTATION)", re.IGNORECASE)
ENCODING = re.compile(rb"^\s*<\?xml[^>]*encoding\s*=\s*[\"']([^\"']*)[\"']", re.IGNORECASE)
NUMBERS = {
    "origin": ("xyz", "rpy"), "axis": ("xyz",), "mass": ("value",), "box": ("size",), "mesh": ("scale",),
    "sphere": ("radius",), "cylinder": ("radius", "length"), "limit": ("lower", "upper"),
    "mimic": ("multiplier", "offset"),
}  # fmt: skip
COUNT = {"xyz": (3,), "rpy": (3,), "size": (3,), "scale": (1, 3)}  # all others are single numbers
TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")


XACRO = re.compile(rb"<xacro:\w+")
COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)


def urdf_bytes(path: Path, limited: Collection[str] = ()) -> bytes:
    """Return the content of a URDF that can be read without harm.

    Args:
        path: The file.
        limited: Joints whose limits are needed; a gripper's, or those that the cell file states, are not looked at.

    Raises:
        CellError: The file cannot be used; file, place, what was found and what was expected.
    """
    raw = read_regular(path, MAX_BYTES, "URDF (robot.urdf of the cell file)", CellError)
    return _harmless(path, raw, tuple(limited))


@functools.lru_cache(maxsize=4)
def _harmless(path: Path, raw: bytes, limited: tuple[str, ...]) -> bytes:
    try:
        raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise CellError(path, f"byte {error.start}", quoted(raw[error.start : error.start + 1]), "UTF-8") from None
    named = ENCODING.match(raw)
    if named is not None and named.group(1).lower() not in {b"utf-8", b"us-ascii", b"ascii"}:
        raise CellError(path, "line 1", f"encoding {quoted(named.group(1).decode())}", "UTF-8")
    macro = XACRO.search(COMMENT.sub(lambda text: b"\n" * text.group().count(b"\n"), raw))
    if macro is not None:
        text = f"{quoted(macro.group().decode() + '>')}, an element of xacro"
        raise CellError(path, "", text, "a URDF; this makes one: xacro FILE > robot.urdf")
    forbidden = FORBIDDEN.search(raw)
    if forbidden is not None:
        line = raw.count(b"\n", 0, forbidden.start()) + 1
        raise CellError(path, f"line {line}", quoted(forbidden.group().decode()), "a URDF without document type")
    root = _tree(path, raw)
    if any(parent.get("link") == WORLD for parent in root.iterfind("joint/parent")) and not any(
        link.get("name") == WORLD for link in root.iterfind("link")
    ):
        head, end, tail = raw.rpartition(b"</robot")
        raw = b"".join((head, f'<link name="{WORLD}"/>'.encode(), end, tail))
        root = _tree(path, raw)
    _check(path, root, limited)
    return raw


def endless(kind: str, low: float, high: float) -> bool:
    """Tell whether a joint of a type and with these limits turns without end."""
    return kind == "continuous" or (kind == "revolute" and max(abs(low), abs(high)) > UNLIMITED)


def urdf_joint_types(path: Path) -> dict[str, str]:
    """Return the types of a URDF's joints by their names; errors as `urdf_bytes`."""
    root = ET.fromstring(urdf_bytes(path))
    return {str(joint.get("name")): str(joint.get("type")) for joint in root.findall("joint")}


def urdf_limits(path: Path, joints: Collection[str]) -> dict[str, tuple[float, float]]:
    """Return the limits, rad or m, that a URDF states of some joints, by their names; errors as `urdf_bytes`."""
    return {
        str(joint.get("name")): (float(limit.get("lower", "nan")), float(limit.get("upper", "nan")))
        for joint in ET.fromstring(urdf_bytes(path, joints)).findall("joint")
        if joint.get("name") in joints
        for limit in joint.findall("limit")[:1]
    }


def _tree(path: Path, raw: bytes) -> ET.Element:
    """Parse, and end as soon as there is too much or too deep."""
    parser: ET.XMLPullParser[ET.Element] = ET.XMLPullParser(("start", "end"))
    depth = count = 0
    root: ET.Element | None = None
    try:
        for begin in range(0, len(raw), 1 << 16):
            parser.feed(raw[begin : begin + (1 << 16)])
            for event, element in cast("Iterator[tuple[str, ET.Element]]", parser.read_events()):
                root = element if root is None else root
                depth += 1 if event == "start" else -1
                count += event == "start"
                if depth > MAX_DEPTH:
                    raise CellError(path, "", f"more than {MAX_DEPTH} levels of elements", "a URDF")
                if count > MAX_ELEMENTS:
                    raise CellError(path, "", f"more than {MAX_ELEMENTS} elements", "a URDF of one robot")
        parser.close()
    except ET.ParseError as error:
        raise CellError(path, f"line {error.position[0]}", str(error), "well-formed XML (URDF)") from None
    if root is None:
        raise CellError(path, "", "an empty file", "a URDF")
    if root.tag != "robot":
        raise CellError(path, "", quoted(f"<{root.tag}>"), "<robot> as the outermost element")
    return root


def _check(path: Path, root: ET.Element, limited: Collection[str]) -> None:
    links, joints = root.findall("link"), root.findall("joint")
    if len(links) > MAX_LINKS or len(joints) > MAX_LINKS:
        found = f"{len(links)} links and {len(joints)} joints"
        raise CellError(path, "robot", found, f"at most {MAX_LINKS} of each")
    names = _unique(path, links)
    _unique(path, joints)
    parent_of: dict[str, str] = {}
    for joint in joints:
        place = f"joint {quoted(joint.get('name', ''))}"
        if joint.get("type") not in TYPES:
            raise CellError(path, place, f"type {quoted(joint.get('type'))}", f"one of {', '.join(TYPES)}")
        ends = [(tag, joint.find(tag)) for tag in ("parent", "child")]
        for tag, element in ends:
            name = None if element is None else element.get("link")
            if name not in names:
                raise CellError(path, f"{place}, {tag}", quoted(name) if name else "nothing", "a link of this file")
        child = str(joint.find("child").get("link"))  # type: ignore[union-attr]  # looked at above
        if child in parent_of:
            raise CellError(path, place, f"link {quoted(child)} has a second parent joint", "a tree of links")
        parent_of[child] = str(joint.find("parent").get("link"))  # type: ignore[union-attr]
    _no_circle(path, parent_of)
    for owner in (*links, *joints):
        _numbers(path, owner)
    for link in links:
        _mass(path, link)
    for joint in joints:
        if joint.get("name") in limited:
            _limits(path, joint)


def _unique(path: Path, elements: list[ET.Element]) -> set[str]:
    names: set[str] = set()
    for element in elements:
        name = element.get("name")
        if not name:
            raise CellError(path, element.tag, "no name", 'an attribute name="..."')
        if not is_name(name):
            raise CellError(path, element.tag, quoted(name), NAME)
        if name in names:
            raise CellError(path, f"{element.tag} {quoted(name)}", "the name twice", "every name once")
        names.add(name)
    return names


def _no_circle(path: Path, parent_of: dict[str, str]) -> None:
    for link in parent_of:
        seen, here = {link}, link
        while here in parent_of:
            here = parent_of[here]
            if here in seen:
                raise CellError(path, f"link {quoted(here)}", "a circle of joints", "a tree of links")
            seen.add(here)


def _numbers(path: Path, owner: ET.Element) -> None:
    """Refuse numbers that are none, or too few of them, anywhere in a link or joint."""
    for place, element in _below(owner):
        for key in NUMBERS.get(element.tag, ()):
            text = element.get(key)
            if text is None:
                continue
            parts = text.replace(",", " ").split() if key == "scale" else text.split()
            wanted = COUNT.get(key, (1,))
            if len(parts) not in wanted:
                expected = " or ".join(str(count) for count in wanted)
                raise CellError(path, f"{place}, {key}", quoted(text), f"{expected} number{'s' * (wanted != (1,))}")
            values = [_number(path, f"{place}, {key}", part, open_ended=element.tag == "limit") for part in parts]
            if key == "rpy" and max(map(abs, values)) > TURN:
                raise CellError(path, f"{place}, {key}", quoted(text), IN_DEGREES)


def _below(owner: ET.Element) -> Iterator[tuple[str, ET.Element]]:
    start = f"{owner.tag} {quoted(owner.get('name'))}"
    rest = [(start, child) for child in reversed(owner)]
    while rest:
        place, element = rest.pop()
        here = f"{place}, {element.tag}"
        yield here, element
        rest += [(here, child) for child in reversed(element)]


def _number(path: Path, place: str, text: str, *, open_ended: bool = False) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value) or (math.isinf(value) and not open_ended):
        raise CellError(path, place, quoted(text), "a finite number")
    return value


def _mass(path: Path, link: ET.Element) -> None:
    inertial = link.find("inertial")
    if inertial is None:
        return
    place = f"link {quoted(link.get('name'))}, inertial, mass"
    mass = inertial.find("mass")
    if mass is None or mass.get("value") is None:
        raise CellError(path, place, "nothing", "a mass in kg")
    if _number(path, place, str(mass.get("value"))) < 0.0:
        raise CellError(path, place, quoted(mass.get("value")), "a mass of at least zero, kg")


def _limits(path: Path, joint: ET.Element) -> None:
    kind, limit = joint.get("type"), joint.find("limit")
    if kind not in {"revolute", "prismatic"} or joint.find("mimic") is not None:
        return
    place = f"joint {quoted(joint.get('name'))}, limit"
    cure = "; or state robot.joint_limits in the cell file"
    if limit is None or limit.get("lower") is None or limit.get("upper") is None:
        raise CellError(path, place, "no lower and upper", f"both, in {'rad' if kind == 'revolute' else 'm'}{cure}")
    low, high = (float(str(limit.get(key))) for key in ("lower", "upper"))  # numbers, as looked at above
    if endless(str(kind), low, high):
        return
    if not low < high:
        raise CellError(path, place, f"[{low:g}, {high:g}]", f"lower < upper{cure}")
    if kind == "revolute" and max(abs(low), abs(high)) > MOST_RADIANS:
        raise CellError(path, place, f"[{low:g}, {high:g}]", f"{RADIANS}{cure}")
