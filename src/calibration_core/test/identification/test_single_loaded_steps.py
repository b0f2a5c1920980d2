"""Recordings whose unloaded readings were left out: positions of loaded robots, one step a configuration."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

import calibration_core as calibration

CELL = Path(__file__).resolve().parents[4] / "config" / "cells" / "small.cell.yaml"
NOISE = 2e-5  # m
STATED = 1.15  # times the true stiffness


def test_a_joint_that_only_the_load_turns_is_not_called_unloaded() -> None:
    """Gravity does not turn the flange of a robot whose tool has no weight; the pull does."""
    cell = calibration.load_cell(CELL)
    plan = calibration.plan(cell, configurations=16, seed=3, load_levels=(0, 1, 0))
    readings = calibration.simulate(cell, plan=plan, seed=3).recording.readings
    readings = readings.select(np.flatnonzero(readings.step == 1))
    noise = NOISE * np.random.default_rng(1).standard_normal(readings.position.shape)
    readings = dataclasses.replace(readings, position=readings.position + noise)
    assert cell.robot.stiffness is not None
    stiffness = tuple(STATED * one for one in cell.robot.stiffness)
    stated = cell.model_copy(update={"robot": cell.robot.model_copy(update={"stiffness": stiffness})})
    found = calibration.identify(calibration.Recording(readings, stated)).to_dict()
    fitted = {row["joint"]: row["reason"] for row in found["stiffness"] if row["std"] is not None}
    assert "joint_6" in fitted
    assert not [reason for reason in fitted.values() if reason.startswith("not fitted")], fitted
