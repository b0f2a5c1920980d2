"""Answers, made once, from which reports are drawn in these tests."""

from __future__ import annotations

import warnings

import pytest
from answers import DAY, make_absolute, make_cell, make_hostile, make_loaded

from calibration_core.cell import Cell
from calibration_core.identification.result.estimate import Identification
from calibration_core.report.content import build
from calibration_core.report.document import Document


@pytest.fixture(scope="session")
def cell() -> Cell:
    return make_cell(
        "KR 240 class", tuple(f"joint_{i}" for i in range(1, 7)), ("mp1", "mp2", "mp3"), True, "Laser tracker AT960"
    )


@pytest.fixture(scope="session")
def loaded(cell: Cell) -> Identification:
    return make_loaded(cell)


@pytest.fixture(scope="session")
def absolute_cell() -> Cell:
    return make_cell("Barrett WAM", tuple(f"j{i}" for i in range(1, 8)), ("target",), False)


@pytest.fixture(scope="session")
def absolute(absolute_cell: Cell) -> Identification:
    return make_absolute(absolute_cell)


@pytest.fixture(scope="session")
def hostile() -> tuple[Identification, Cell]:
    return make_hostile()


@pytest.fixture(scope="session")
def documents(
    loaded: Identification,
    cell: Cell,
    absolute: Identification,
    absolute_cell: Cell,
    hostile: tuple[Identification, Cell],
) -> dict[str, Document]:
    """Reports with all their drawings, made once: drawing takes most of the time.  A warning is an error here."""
    cases = {"loaded": (loaded, cell), "absolute": (absolute, absolute_cell), "hostile": hostile}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return {name: build(*case, DAY) for name, case in cases.items()}


@pytest.fixture(scope="session")
def large() -> tuple[Identification, Cell]:
    cell = make_cell("UR10 class", tuple(f"j{i}" for i in range(1, 8)), ("target",), False)
    return make_absolute(cell, configurations=11_911), cell


@pytest.fixture(scope="session")
def large_document(large: tuple[Identification, Cell]) -> Document:
    return build(*large, DAY)
