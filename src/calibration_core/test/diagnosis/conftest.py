"""A recording that several tests of the diagnosis begin with."""

from __future__ import annotations

import pytest
from robots import loaded_readings

from calibration_core.cell import Cell
from calibration_core.timeseries import Readings


@pytest.fixture(scope="session")
def recorded(cell: Cell) -> Readings:
    """Return fourteen loaded configurations of a robot that is softer than the cell file says."""
    return loaded_readings(cell, 3)
