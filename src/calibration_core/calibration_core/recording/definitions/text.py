"""Message definitions as a bag carries them: text to fields, with bounds on everything and nothing evaluated.

Read are `.msg` text with the definitions of other types behind lines of `=` (https://mcap.dev/spec/registry, ros2msg)
and the part of OMG IDL in which `rosidl` writes the same.  Constants and defaults are passed over: a reader of
messages does not need them.
"""

from __future__ import annotations

from collections.abc import Callable

from calibration_core.recording.definitions.fields import SIZES, TEXT, MessageField, Types
from calibration_core.recording.definitions.idl import parse_idl
from calibration_core.recording.definitions.msg import parse_msg

MAX_TEXT = 1 << 16  # characters; the longest of ROS 2 with all its comments has 20,000
MAX_FIELDS = 256  # of one type


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
    types = parse_idl(text) if form == "ros2idl" else parse_msg(text, name)
    return _needed(types, name, known)


def _needed(types: dict[str, tuple[MessageField, ...]], name: str, known: Callable[[str], Types] | None) -> Types:
    """Return the type and those in it, each once; raise where one is missing, too wide, or holds itself."""
    found: dict[str, tuple[MessageField, ...]] = {}

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
