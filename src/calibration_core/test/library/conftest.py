"""One recording and what is identified from it, for all tests of the library."""

from __future__ import annotations

from pathlib import Path

import pytest

import calibration_core as cal

ROOT = Path(__file__).resolve().parents[4]


@pytest.fixture(scope="session")
def cell() -> cal.Cell:
    return cal.load_cell(ROOT / "config" / "cells" / "small.cell.yaml")


@pytest.fixture(scope="session")
def recording(cell: cal.Cell) -> cal.Recording:
    return cal.load_recording(ROOT / "bags" / "small_loaded", cell)


@pytest.fixture(scope="session")
def plan(cell: cal.Cell) -> cal.PlanResult:
    """Return configurations that several tests simulate."""
    return cal.plan(cell, configurations=12, spares=0.0, seed=3, load_levels=(0.0, 0.5, 1.0, 0.0))


@pytest.fixture(scope="session")
def identified(recording: cal.Recording) -> cal.IdentificationResult:
    return cal.identify(recording)
