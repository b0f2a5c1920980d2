"""Cells and robots that the tests share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration_core.cell import Cell, load_cell
from calibration_core.files.yaml_file import yaml_text
from calibration_sim.mechanics.chain import Chain, Link
from calibration_sim.mechanics.transforms import translation

CELLS = Path(__file__).resolve().parents[3] / "config" / "cells"


@pytest.fixture
def demo() -> Cell:
    return load_cell(CELLS / "demo.cell.yaml")


@pytest.fixture
def small() -> Cell:
    return load_cell(CELLS / "small.cell.yaml")


@pytest.fixture
def changed(tmp_path: Path) -> Callable[..., Cell]:
    """Return a function that loads a cell again with keys replaced: `changed(cell, robot__stiffness=None)`."""

    def change(cell: Cell, **changes: object) -> Cell:
        data = yaml.safe_load(cell.path.read_text())
        if "urdf" in data["robot"]:
            data["robot"]["urdf"] = str(cell.urdf_path)
        for key, value in changes.items():
            place = data
            *folders, target = key.split("__")
            for folder in folders:
                place = place.setdefault(folder, {})
            if value is None:
                place.pop(target)
            else:
                place[target] = value
        path = tmp_path / "changed.cell.yaml"
        path.write_text(yaml_text(data))
        return load_cell(path)

    return change


@pytest.fixture
def planar() -> Callable[[list[float], list[float]], Chain]:
    """Return a maker of chains along x whose joints turn about -y (positive lifts), each link's weight at its end."""

    def make(lengths: list[float], masses: list[float]) -> Chain:
        links, reach = [], 0.0
        for i, (length, mass) in enumerate(zip(lengths, masses, strict=True)):
            com = np.array([length, 0.0, 0.0])
            links.append(Link(f"link_{i}", i - 1, translation(x=reach), f"j{i}", np.array([0, -1.0, 0]), mass, com))
            reach = length
        links.append(Link("flange", len(lengths) - 1, translation(x=reach), "", np.zeros(3), 0.0, np.zeros(3)))
        names = tuple(f"j{i}" for i in range(len(lengths)))
        return Chain(tuple(links), names, len(lengths), np.tile([-3.0, 3.0], (len(lengths), 1)))

    return make
