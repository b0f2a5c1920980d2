"""Writes reference.md from the tables of the code: launch arguments, parameters, topics, services, actions.

source install/setup.bash && .venv/bin/python src/calibration/doc/reference.py
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

from calibration import node as nodes
from calibration import process_tree, topics
from calibration.executables import MODULES
from calibration.instruments.acquisition import COMMON
from calibration.node import Declared
from calibration_core.cell import load_cell
from calibration_sim.living_cell.messages import PARAMETERS as OF_SIMULATED_CELL

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]
FILE = HERE / "reference.md"
POLICIES = HERE.parent / "security" / "policies.xml"
TREES = {
    "real_cell": process_tree.REAL_CELL,
    "simulated_cell": process_tree.SIMULATED_CELL,
    "replay": process_tree.REPLAY,
}
HEAD = """# Reference

Made by `reference.py` from the tables of the code; a test compares. What to do with it stands in [nodes.md](nodes.md).
Names are relative to the namespace of the cell. SI units: m, rad, N, N·m, s.
"""


def table(columns: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table in Markdown."""
    lines = [list(columns), *map(list, rows)]
    lines.insert(1, ["---"] * len(lines[0]))
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines) + "\n"


def code(value: object) -> str:
    """Return a value as it is written in a parameter file."""
    text = str(value).lower() if isinstance(value, bool) else str(value)
    return f"`{text}`" if text else ""


def declared(name: str) -> tuple[Declared, ...]:
    """Return the parameters of a node of the package `calibration`."""
    own = importlib.import_module(f"calibration.{MODULES[name]}").PARAMETERS
    common = COMMON if name in ("tracker", "force_torque") else ()
    return tuple({one.name: one for one in (*common, *own)}.values())  # a node may state a common one otherwise


def bounds(one: Declared) -> str:
    """Return what is allowed."""
    if one.choices:
        return ", ".join(map(code, one.choices))
    low, high = ("" if one.low is None else f"{one.low:g}"), ("" if one.high is None else f"{one.high:g}")
    return f"{low} to {high}".strip() if low or high else ""


def launch_arguments() -> Iterator[str]:
    """Yield a section for each launch file."""
    for name, tree in TREES.items():
        yield f"### `{name}.launch.py`\n"
        rows = [
            (code(one.name), "must be said" if one.default is None else code(one.default),
             ", ".join(map(code, one.choices)), one.description)
            for one in tree.arguments
        ]  # fmt: skip
        yield table(("argument", "default", "choices", ""), rows)


def parameters() -> Iterator[str]:
    """Yield a section for each node."""
    for name in sorted(nodes.NODE_NAMES):
        yield f"### `{name}`\n"
        if name == "simulated_cell":
            simulated = [(code(key), code(value), text) for key, (value, text) in OF_SIMULATED_CELL.items()]
            yield table(("parameter", "default", ""), simulated)
            continue
        rows = [
            (code(one.name), "must be given" if one.required else code(one.default), bounds(one),
             "" if one.read_only else "yes", one.description)
            for one in declared(name)
        ]  # fmt: skip
        yield table(("parameter", "default", "allowed", "while it runs", ""), rows)


def access(kind: str) -> dict[str, list[str]]:
    """Return which nodes do something with a name, by the security policy; names as in the graph without namespace."""
    found: dict[str, list[str]] = {}
    for profile in ET.parse(POLICIES).getroot().iter("profile"):
        node = str(profile.get("node"))
        for group in profile:
            for one in group if kind in group.attrib else ():
                text = str(one.text)
                name = f"/{node}{text[1:]}" if text.startswith("~") else f"/{text.lstrip('/')}"
                found.setdefault(name, []).append(node)
    return found


def messages() -> str:
    """Return the table of the suite's topics."""
    cell = load_cell(ROOT / "config" / "cells" / "demo.cell.yaml")
    own = [one for one in vars(topics).values() if isinstance(one, topics.Topic)]
    every = {one.name: one for one in (*topics.recorded_topics(cell), *own)}
    publish, subscribe = access("publish"), access("subscribe")
    recorded = {one.name for one in topics.recorded_topics(cell)}
    rows = [
        (code(name), code(one.type), one.quality.value, ", ".join(publish.get(name, ["driver"])),
         ", ".join(who for who in subscribe.get(name, []) if who != "recorder"), "yes" if name in recorded else "")
        for name, one in sorted(every.items())
    ]  # fmt: skip
    return table(("topic", "type", "carried as", "from", "to", "recorded"), rows)


def offered(kind: str) -> str:
    """Return the table of services or actions."""
    asks = access("request" if kind == "reply" else "call")
    rows = [
        (code(name), ", ".join(who), ", ".join(asks.get(name, [])) or "operator")
        for name, who in sorted(access(kind).items())
    ]
    return table(("name", "of", "asked by"), rows)


def reference() -> str:
    """Return the whole file."""
    carried = ", ".join(f"`{one.value}`" for one in topics.Quality)
    return "\n".join(
        [
            HEAD,
            "## Launch arguments\n",
            *launch_arguments(),
            "## Parameters\n",
            "A name that is not in these tables is an error.\n",
            *parameters(),
            "## Topics\n",
            "Topics of drivers are those of the demonstration cell; the cell file names others.",
            f"Carried as {carried}: see `Quality` in `topics.py`.\n",
            messages(),
            "## Services\n",
            "Types: `ros2 service type NAME`, fields: `ros2 interface show TYPE`.\n",
            offered("reply"),
            "## Actions\n",
            offered("execute"),
        ]
    )


if __name__ == "__main__":
    FILE.write_text(reference(), encoding="utf-8")
    sys.stdout.write(f"{FILE}\n")
