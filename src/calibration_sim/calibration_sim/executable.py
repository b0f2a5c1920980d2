"""The entry point of the simulated cell.  This module loads nothing: a signal is heeded from the first moment on."""

from __future__ import annotations

from calibration_core.loading import load


def simulated_cell() -> int:
    """Run the simulated cell."""
    return int(load("calibration_sim.living_cell.process", "main")())
