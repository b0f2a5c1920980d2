"""The entry points of the nodes, by name.  Nothing is loaded before: a signal is heeded from the first moment on."""

from __future__ import annotations

from collections.abc import Callable

from calibration_core.loading import load

MODULES = {
    "compensation": "compensation",
    "force_torque": "instruments.force_torque",
    "guard": "guard.guard",
    "identification": "evaluation.identification",
    "manager": "manager",
    "panel": "panel",
    "recorder": "recorder",
    "sequencer": "sequencer.sequencer",
    "tracker": "instruments.tracker",
}


def __getattr__(name: str) -> Callable[[], int]:
    """Return what runs a node, and returns its exit code."""
    if name not in MODULES:
        raise AttributeError(name)
    return lambda: int(load(f"calibration.{MODULES[name]}", "main")())
