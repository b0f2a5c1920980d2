"""What planned arcs are worth is said beforehand, and shorter ones are worth less."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from calibration_core.cell import load_cell
from calibration_core.planning.phases import PlannedSweep
from calibration_core.planning.plans.plan import Plan, PlannedConfiguration
from calibration_core.report.documents.arcs import describe_arcs

CELL = load_cell(Path(__file__).parents[4] / "config/cells/demo.cell.yaml")


def _plan(arc: float) -> Plan:
    sweep = PlannedSweep(0, np.array([-arc / 2, -1.1, 1.3, 0.3, 0.9, -0.2]), arc, 24)
    preparation = tuple(
        PlannedConfiguration(1000 + k, q, np.zeros((1, 6)), phase="base_frame") for k, q in enumerate(sweep.q)
    )
    return Plan("robot", CELL.robot.joints, (), np.zeros((0, 6)), preparation=preparation)


def test_arc_and_accuracy_are_told() -> None:
    (wide,), (narrow,) = describe_arcs(_plan(np.radians(170)), CELL), describe_arcs(_plan(np.radians(60)), CELL)
    assert wide.startswith("joint_1: 170 degrees in 24 standstills fix a circle's centre to 14 µm")
    assert narrow.startswith("joint_1: 60 degrees in 24 standstills")
    assert "degrees are enough" in narrow


def test_a_plan_without_sweeps_tells_nothing() -> None:
    assert describe_arcs(dataclasses.replace(_plan(1.0), preparation=()), CELL) == ()
