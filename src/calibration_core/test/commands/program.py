"""The program run within this process, and what it wrote."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from calibration_core.cli import main

CELL = Path(__file__).parents[4] / "config" / "cells" / "small.cell.yaml"
KEYS = (
    "schema", "command", "robot", "recording", "stiffness", "fit", "verdict", "findings", "anomalies", "unexplained",
    "next_measurements",
)  # fmt: skip


def run(*arguments: object) -> int:
    """Run the program with these arguments; return its exit code."""
    return main([str(argument) for argument in arguments])


def result_of(directory: Path) -> dict[str, Any]:
    """Read result.json; its keys begin with the fixed ones, in their order."""
    content: dict[str, Any] = json.loads((directory / "result.json").read_text(encoding="utf-8"))
    assert tuple(content)[: len(KEYS)] == KEYS
    assert content["schema"] == 1
    assert set(content["fit"]) >= {
        "rms_before", "rms_after", "held_out_rms_before", "held_out_rms_after", "noise", "unit",
    }  # fmt: skip
    return content


def names(directory: Path) -> set[str]:
    """Return everything in a directory, hidden leftovers too."""
    return {path.name for path in directory.iterdir()}
