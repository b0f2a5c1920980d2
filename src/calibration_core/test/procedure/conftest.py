"""Cells and plans that the procedure's tests run on."""

from __future__ import annotations

from pathlib import Path

import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.procedure.plan import Plan
from calibration_core.procedure.planning import make_plan

CELLS = Path(__file__).parents[4] / "config" / "cells"


@pytest.fixture(scope="session")
def demo_cell() -> Cell:
    """Return the 240 kg robot, described by a URDF."""
    return load_cell(CELLS / "demo.cell.yaml")


@pytest.fixture(scope="session")
def small_cell() -> Cell:
    """Return the 10 kg robot, described by DH rows, with a spherical tracker."""
    return load_cell(CELLS / "small.cell.yaml")


@pytest.fixture(scope="session")
def plan(demo_cell: Cell) -> Plan:
    """Return the default plan of the demo cell."""
    return make_plan(demo_cell)
