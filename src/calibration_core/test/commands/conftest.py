"""One plan, one simulated recording and one identified model, made once through the program itself."""

from __future__ import annotations

from pathlib import Path

import pytest
from program import CELL, run


@pytest.fixture(scope="session")
def cell_path() -> Path:
    return CELL


@pytest.fixture(scope="session")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output of `plan`, report included."""
    out = tmp_path_factory.mktemp("plan") / "out"
    assert run("plan", "--cell", CELL, "--out", out, "--configurations", 12, "--seed", 4) == 0
    return out


@pytest.fixture(scope="session")
def simulated(planned: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output of `simulate`, report included."""
    out = tmp_path_factory.mktemp("simulate") / "out"
    assert run("simulate", "--cell", CELL, "--plan", planned / "plan.yaml", "--seed", 1, "--out", out) == 0
    return out


@pytest.fixture(scope="session")
def identified(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output of `identify --no-report`."""
    out = tmp_path_factory.mktemp("identify") / "out"
    assert run("identify", simulated / "recording", "--cell", CELL, "--out", out, "--no-report") == 0
    return out
