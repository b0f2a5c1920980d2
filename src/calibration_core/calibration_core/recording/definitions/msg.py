"""`.msg` text with the definitions of other types behind lines of `=` (https://mcap.dev/spec/registry, ros2msg)."""

from __future__ import annotations

import re

from calibration_core.recording.definitions.fields import MAX_TYPES, SEPARATOR, SIZES, TEXT, MessageField, array_size

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


def parse_msg(text: str, name: str) -> dict[str, tuple[MessageField, ...]]:
    """Return type -> fields of everything in a `.msg` text with further types behind it.

    Raises:
        ValueError: It is none; the text says where.
    """
    types: dict[str, tuple[MessageField, ...]] = {}
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


def _field(line: str, owner: str) -> MessageField | None:
    code = line.split("#", 1)[0].strip()
    if not code or code.startswith("@") or _CONSTANT.fullmatch(code):
        return None
    match = _FIELD.fullmatch(code)
    if match is None:
        msg = f"the line {code[:40]!r}"
        raise ValueError(msg)
    kind = full_name(match["type"], owner)
    if match["array"] is None:
        return MessageField(match["name"], kind)
    if match["size"] is None:
        return MessageField(match["name"], kind, "sequence", 0)
    return MessageField(match["name"], kind, "array", array_size(match["size"]))


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
