"""The program run within this process, and what it wrote."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from calibration_core.cli import main

CELL = Path(__file__).parents[4] / "config" / "cells" / "small.cell.yaml"
WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
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


def rewritten(table: Path, out: Path, change: Callable[[dict[str, str]], dict[str, str] | None]) -> Path:
    """Write a measurement table with every row changed, or left out where the change is None; return its path."""
    with table.open(newline="") as stream:
        rows = [row for row in map(change, csv.DictReader(stream)) if row is not None]
    with out.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return out


def scaled(row: dict[str, str], names: tuple[str, ...], factor: float) -> dict[str, str]:
    """Return a row of a table with some of its numbers multiplied."""
    return row | {name: repr(factor * float(row[name])) for name in names}


def of_displacements(cell: Path, folder: Path) -> Path:
    """Write a cell file that says that its tracker shows displacements; return its path."""
    path = folder / "cell.yaml"
    spherical = "{sigma_range: 8.0e-6, sigma_range_per_m: 4.0e-7, sigma_angle: 3.0e-6,"
    path.write_text(cell.read_text().replace(spherical, "{sigma: 1.5e-5,") + "measurements: {points: displacement}\n")
    return path
