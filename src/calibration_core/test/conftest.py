"""What tests of several folders need: a cell, and inputs that are drawn with patience.

Drawn inputs are judged by what comes of them: how long a busy machine takes to draw one is no failure.
"""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, settings
from robots import write_cell

from calibration_core.cell import Cell

settings.register_profile("patient", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")


@pytest.fixture(scope="session")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    """Return the cell of 240 kg or so; a folder whose tests need another one has a fixture of its own."""
    return write_cell(tmp_path_factory.mktemp("cell"))
