"""Message definitions as a bag carries them: text to fields, with bounds on everything and nothing evaluated.

Read are `.msg` text with the definitions of other types behind lines of `=` (https://mcap.dev/spec/registry, ros2msg)
and the part of OMG IDL in which `rosidl` writes the same.  Constants and defaults are passed over: a reader of
messages does not need them.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping
from typing import Literal

MAX_TEXT = 1 << 16  # characters; the longest of ROS 2 with all its comments has 20,000
MAX_TYPES = 64
MAX_FIELDS = 256  # of one type
MAX_ARRAY = 1 << 16
SEPARATOR = re.compile(r"^={80}[ \t]*$", re.MULTILINE)
SIZES = {
    "bool": 1, "int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4,
    "float32": 4, "int64": 8, "uint64": 8, "float64": 8,
}  # fmt: skip
TEXT = "string"
ALIASES = {
    "byte": "uint8", "char": "uint8",
    "time": "builtin_interfaces/msg/Time", "duration": "builtin_interfaces/msg/Duration",
}  # fmt: skip
HEADER = "std_msgs/msg/Header"
_FIELD = re.compile(
    r"(?P<type>[A-Za-z][A-Za-z0-9_/]*)(?:<=\d{1,10})?"
    r"(?P<array>\[(?:(?P<size>\d{1,10})|<=\d{1,10})?\])?[ \t]+(?P<name>[A-Za-z][A-Za-z0-9_]*)(?:[ \t]+\S.*)?"
)
_CONSTANT = re.compile(r"[a-z][a-z0-9]*(?:<=\d{1,10})?[ \t]+[A-Z][A-Za-z0-9_]*[ \t]*=.*")


@dataclasses.dataclass(frozen=True)
class Field:
    """One field of a message type.

    Attributes:
        name: Its name.
        type: A key of `SIZES`, `string`, or the name of a message type.
        shape: One value, a fixed number of them, or a number that the message states.
        size: Number of values of an array.
    """

    name: str
    type: str
    shape: Literal["one", "array", "sequence"] = "one"
    size: int = 1


Types = Mapping[str, tuple[Field, ...]]


def parse_definition(text: str, name: str, form: str, known: Callable[[str], Types] | None = None) -> Types:
    """Return the fields of a type and of every type that it needs.

    Args:
        text: The definition.
        name: The type that it is of, e.g. `std_msgs/msg/String`.
        form: `ros2msg` or `ros2idl`; anything else is taken for `ros2msg`.
        known: Gives the fields of a type that the text needs and does not define; empty if it does not know it.

    Raises:
        ValueError: It is no such definition, larger than any real one, or not complete; the text says what.
    """
    if len(text) > MAX_TEXT:
        msg = f"{len(text)} characters"
        raise ValueError(msg)
    if form == "ros2idl":
        from calibration_core.recording.definition_idl import parse_idl  # rare

        types = parse_idl(text)
    else:
        types = parse_msg(text, name)
    return _needed(types, name, known)


def parse_msg(text: str, name: str) -> dict[str, tuple[Field, ...]]:
    """Return type -> fields of everything in a `.msg` text with further types behind it.

    Raises:
        ValueError: It is none; the text says where.
    """
    types: dict[str, tuple[Field, ...]] = {}
    for i, part in enumerate(SEPARATOR.split(text)[: MAX_TYPES + 1]):
        lines = part.strip("\n").split("\n")
        owner = name
        if i > 0:
            if not lines[0].startswith("MSG: "):
                msg = f"{lines[0][:40]!r} for the name of a type"
                raise ValueError(msg)
            owner = full_name(lines.pop(0)[5:].strip(), "")
        types[owner] = tuple(field for line in lines if (field := _field(line, owner)) is not None)
    if len(types) > MAX_TYPES:
        msg = f"more than {MAX_TYPES} types"
        raise ValueError(msg)
    return types


def _field(line: str, owner: str) -> Field | None:
    code = line.split("#", 1)[0].strip()
    if not code or code.startswith("@") or _CONSTANT.fullmatch(code):
        return None
    match = _FIELD.fullmatch(code)
    if match is None:
        msg = f"the line {code[:40]!r}"
        raise ValueError(msg)
    kind = full_name(match["type"], owner)
    if match["array"] is None:
        return Field(match["name"], kind)
    if match["size"] is None:
        return Field(match["name"], kind, "sequence", 0)
    return Field(match["name"], kind, "array", array_size(match["size"]))


def array_size(text: str) -> int:
    """Return the size of an array.

    Raises:
        ValueError: It is zero or larger than any real one.
    """
    size = int(text)
    if not 0 < size <= MAX_ARRAY:
        msg = f"an array of {size}"
        raise ValueError(msg)
    return size


def full_name(name: str, owner: str) -> str:
    """Return the full name of a type as the type `owner` names it: `Header` -> `std_msgs/msg/Header`."""
    if name in SIZES or name == TEXT:
        return name
    if name in ALIASES:
        return ALIASES[name]
    parts = name.split("/")
    if len(parts) == 1:
        return HEADER if name == "Header" else f"{owner.rpartition('/')[0]}/{name}"
    return name if len(parts) == 3 else f"{parts[0]}/msg/{parts[-1]}"


def _needed(types: dict[str, tuple[Field, ...]], name: str, known: Callable[[str], Types] | None) -> Types:
    """Return the type and those in it, each once; raise where one is missing, too wide, or holds itself."""
    found: dict[str, tuple[Field, ...]] = {}

    def visit(one: str, above: tuple[str, ...]) -> None:
        if one in above:
            msg = f"{one[:60]}, which holds itself"
            raise ValueError(msg)
        if one in found:
            return
        if one not in types and known is not None:
            found.update(known(one))
        if one in found:
            return
        if one not in types:
            msg = f"no definition of {one[:60]!r}"
            raise ValueError(msg)
        if len(types[one]) > MAX_FIELDS:
            msg = f"{len(types[one])} fields"
            raise ValueError(msg)
        found[one] = types[one]
        for field in types[one]:
            if field.type not in SIZES and field.type != TEXT:
                visit(field.type, (*above, one))

    visit(name, ())
    return found
