"""The entry points of the nodes.  This module loads nothing: a signal is heeded from the first moment on."""

from __future__ import annotations

from calibration_core.loading import load


def compensation() -> int:
    """Run the node that corrects targets for a calibrated robot."""
    return int(load("calibration.compensation.compensation", "main")())


def force_torque() -> int:
    """Run the node of the force/torque sensor."""
    return int(load("calibration.instruments.force_torque", "main")())


def guard() -> int:
    """Run the node that permits motion."""
    return int(load("calibration.guard.guard", "main")())


def identification() -> int:
    """Run the node that identifies and diagnoses."""
    return int(load("calibration.evaluation.identification", "main")())


def manager() -> int:
    """Run the node that brings the others up and down."""
    return int(load("calibration.manager", "main")())


def panel() -> int:
    """Run the operator's panel."""
    return int(load("calibration.panel", "main")())


def recorder() -> int:
    """Run the node that writes the bag."""
    return int(load("calibration.recorder.recorder", "main")())


def sequencer() -> int:
    """Run the node that carries out plans."""
    return int(load("calibration.sequencer.sequencer", "main")())


def tracker() -> int:
    """Run the node of the laser tracker."""
    return int(load("calibration.instruments.tracker", "main")())
