"""Definitions of message types as text, with those of the types in them, as a bag carries them (`ros2msg`)."""

from __future__ import annotations

import functools
import os
import re
import sys
from pathlib import Path

SEPARATOR = "=" * 80
BUILT_IN = {
    "bool", "byte", "char", "float32", "float64", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64",
    "uint64", "string", "wstring",
}  # fmt: skip
_FIELD = re.compile(r"^\s*([a-zA-Z][\w/]*)(<=\d+)?(\[[^\]]*\])?\s+[a-zA-Z]\w*")


def definition(kind: str) -> str:
    """Return the definition of `package/msg/Name`; empty if it, or one of the types in it, is not installed as text."""
    own = _text(kind)
    if own is None:
        return ""
    parts, done, todo = [own], {kind}, _used(kind, own)
    while todo:
        name = todo.pop(0)
        if name in done:
            continue
        done.add(name)
        text = _text(name)
        if text is None:
            return ""
        package, _, base = name.split("/")
        parts.append(f"{SEPARATOR}\nMSG: {package}/{base}\n{text}")
        todo += _used(name, text)
    return "\n".join(part.rstrip("\n") for part in parts) + "\n"


def _used(kind: str, text: str) -> list[str]:
    """Return the full names of the message types in a definition, in their order."""
    package = kind.split("/", maxsplit=1)[0]
    found = []
    for line in text.splitlines():
        match = _FIELD.match(line.split("#", 1)[0])
        name = match[1] if match else ""
        if not name or name in BUILT_IN:
            continue
        parts = name.split("/")
        found.append(f"{parts[0]}/msg/{parts[-1]}" if len(parts) > 1 else f"{package}/msg/{name}")
    return found


@functools.cache
def _text(kind: str) -> str | None:
    package, group, name = kind.split("/")
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
    for prefix in prefixes:
        file = Path(prefix) / "share" / package / group / f"{name}.msg"
        if file.is_file():
            return file.read_text("utf-8")
    return None
