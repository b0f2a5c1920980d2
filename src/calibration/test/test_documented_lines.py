"""Every documented `ros2` line means something: its names, types, fields and arguments exist."""

from __future__ import annotations

import functools
import importlib
import re
import runpy
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from rosidl_parser.definition import NamespacedType

from calibration import process_tree, topics
from calibration.node import NODE_NAMES
from calibration_core.cell import load_cell

ROOT = Path(__file__).resolve().parents[3]
PACKAGE = ROOT / "src" / "calibration"
CELL = load_cell(ROOT / "config" / "cells" / "demo.cell.yaml")
FILES = (ROOT / "README.md", *sorted((PACKAGE / "doc").glob("*.md")), *sorted((PACKAGE / "launch").glob("*.py")),
         *sorted((PACKAGE / "calibration").rglob("*.py")))  # fmt: skip
LAUNCHED = {"real_cell": process_tree.REAL_CELL, "simulated_cell": process_tree.SIMULATED_CELL,
            "replay": process_tree.REPLAY}  # fmt: skip
FREE = {"NAME", "TYPE", "NODE"}  # stands for any
OF_OTHERS = {"bag", "interface", "lifecycle", "node", "param", "pkg", "security"}  # commands about packages of others
REFERENCE = runpy.run_path(str(PACKAGE / "doc" / "reference.py"))


def documented() -> list[Any]:
    """The lines, a document's words around them left out."""
    found = []
    for path in FILES:
        text = path.read_text("utf-8")
        lines = [line.strip() for line in text.splitlines() if line.strip().startswith("ros2 ")]
        lines += re.findall(r"`(ros2 \w+ [^`]+)`", text)  # `ros2 run` alone is a word and no line
        found += [pytest.param(line, id=f"{path.name}: {line[:60]}") for line in dict.fromkeys(lines)]
    return found


@functools.cache
def every_topic() -> dict[str, str]:
    """Topics of the suite, with those that drivers and ROS bring."""
    own = [one for one in vars(topics).values() if isinstance(one, topics.Topic)]
    return {one.name: one.type for one in (*topics.recorded_topics(CELL), *own)} | {"/diagnostics": ""}


def interface(kind: str) -> Any:
    package, group, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.{group}"), name)


def fields_exist(message: Any, given: object) -> None:
    """Every field that is given exists, fields of fields likewise."""
    assert isinstance(given, dict)
    types = dict(zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True))
    assert given.keys() <= types.keys(), f"{set(given) - set(types)} are no fields of {message.__name__}"
    for name, value in given.items():
        if isinstance(types[name], NamespacedType) and isinstance(value, dict):
            kind = types[name]
            fields_exist(interface("/".join([*kind.namespaces, kind.name])), value)


@pytest.mark.parametrize("line", documented())
def test_a_documented_line_means_something(line: str) -> None:
    _, command, *words = shlex.split(line)
    said = [word for word in words if not word.startswith("-")]
    if command == "launch":
        assert said[0] == "calibration"
        arguments = {one.name: one for one in LAUNCHED[said[1].removesuffix(".launch.py")].arguments}
        given = dict(word.split(":=") for word in said[2:])
        assert given.keys() <= arguments.keys()
        assert {name for name, one in arguments.items() if one.default is None} <= given.keys()
        for name, value in given.items():
            assert not arguments[name].choices or value in arguments[name].choices
            arguments[name].type(value)
    elif command == "run":
        assert said[0] == "calibration"
        assert set(said[1:] if "|" in line else said[1:2]) - {"|"} <= set(NODE_NAMES)
    elif command in ("service", "action"):
        action = command == "action"
        if said[1] in FREE:
            return
        assert said[0] == ("send_goal" if action else "call")
        assert said[1] in REFERENCE["access"]("execute" if action else "reply")
        if said[2:] != ["..."]:
            kind = interface(said[2])
            given = yaml.safe_load(said[3]) if len(said) > 3 else {}  # ros2 takes the defaults then
            fields_exist(kind.Goal if action else kind.Request, given)
    elif command == "topic":
        names = [word for word in said[1:] if word.startswith("/")]
        assert said[0] in ("echo", "hz", "info", "list", "pub")
        assert set(names) <= set(every_topic())
        if said[0] == "pub":
            assert said[2] == every_topic()[said[1]]
            fields_exist(interface(said[2]), yaml.safe_load(said[3]))
    else:
        assert command in OF_OTHERS, f"what {line} does is not looked at"


def test_lines_are_found() -> None:
    assert len(documented()) > 15
