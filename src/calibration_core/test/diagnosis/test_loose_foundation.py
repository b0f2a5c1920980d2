"""A base that rocks on its anchors and a first bearing that tilts move the points alike, however large they are.

What the base does is played by its own equations: the wrench of the load about it slides and turns the whole robot.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from robots import cell_dict, loaded_readings

from calibration_core.cell import Cell
from calibration_core.diagnosis.loaded import diagnose_loaded
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.timeseries import Readings

ANCHORED, LOOSE, ON_A_PALLET = 6e-8, 4e-7, 1e-6  # rad/(N*m), for a robot of 240 kg; anchors usually leave 1e-8 to 1e-7
ANCHOR, BOLT = 0.35, 4e8  # m from the axis of joint 1 along x and y; N/m in every direction


def _turned(axis: int, angle: float) -> np.ndarray:
    one, other = [k for k in range(3) if k != axis]
    rotation = np.eye(3)
    rotation[[one, other], [one, other]] = np.cos(angle)
    sign = -1 if axis == 1 else 1
    rotation[one, other], rotation[other, one] = -sign * np.sin(angle), sign * np.sin(angle)
    return rotation


def _flange(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rotation (3, 3) and the place (3,) of the flange in the base, from the rows of the cell file."""
    rotation, place = np.eye(3), np.zeros(3)
    for row, angle in zip(cell_dict()["robot"]["dh"], q, strict=True):
        place = place + rotation @ [0, 0, row["d"]]
        rotation = rotation @ _turned(2, row["theta"] + angle)
        place = place + rotation @ [row["a"], 0, 0]
        rotation = rotation @ _turned(0, row["alpha"])
    return rotation, place


def _rocking(compliance: float) -> np.ndarray:
    """Return (6, 6) what the base does per wrench about it: it turns about level axes."""
    return np.diag([0, 0, 0, compliance, compliance, 0])


def _on_anchors(softer: float) -> np.ndarray:
    """Return (6, 6) what a base on four anchors does, one softer along its bolt: lift and tilt come together."""
    stiffness = np.zeros((6, 6))
    for x, y in itertools.product((ANCHOR, -ANCHOR), repeat=2):
        moved = np.hstack([np.eye(3), [[0, 0, -y], [0, 0, x], [y, -x, 0]]])
        bolt = BOLT / (softer if x == y == ANCHOR else 1)
        stiffness += moved.T @ np.diag([BOLT, BOLT, bolt]) @ moved
    return np.linalg.inv(stiffness)


def _standing(cell: Cell, seed: int, compliance: np.ndarray) -> Readings:
    """Return a recording of a robot whose base slides and turns by compliance times the load's wrench about it."""
    readings, frames = loaded_readings(cell, seed), cell_dict()["frames"]
    roll, pitch, yaw = frames["tracker"]["rpy"]
    tracker, position = _turned(2, yaw) @ _turned(1, pitch) @ _turned(0, roll), readings.position.copy()
    assert readings.wrench is not None
    for k, (q, wrench) in enumerate(zip(readings.q, readings.wrench, strict=True)):
        rotation, flange = _flange(q)
        sensor = rotation @ _turned(2, frames["force_torque"]["rpy"][2])
        force, moment = sensor @ wrench[:3], sensor @ wrench[3:]
        about_base = np.cross(flange + rotation @ frames["force_torque"]["xyz"], force) + moment
        point = flange + rotation @ frames["measurement_points"][readings.points[readings.point[k]]]
        slid, turned = np.split(compliance @ np.concatenate([force, about_base]), 2)
        position[k] += (slid + np.cross(turned, point)) @ tracker
    return dataclasses.replace(readings, position=position)


@pytest.mark.parametrize("compliance", [ANCHORED, LOOSE, ON_A_PALLET])
@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.slow)])
def test_a_rocking_base_is_named_whatever_its_size(cell: Cell, seed: int, compliance: float) -> None:
    _base_is_named(diagnose_loaded(_standing(cell, seed, _rocking(compliance)), cell))


@pytest.mark.parametrize("softer", [5.0, 30.0])
@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.slow)])
def test_a_base_on_one_soft_anchor_is_named(cell: Cell, seed: int, softer: float) -> None:
    found = diagnose_loaded(_standing(cell, seed, _on_anchors(softer)), cell)
    assert found.verdict == "missing_physics"
    _base_is_named(found)


def _base_is_named(found: Diagnosis) -> None:
    (finding,) = found.findings
    said = {(finding.effect, *finding.location.values())}
    said |= {(one.effect, *one.location.values()) for one in finding.cannot_be_told_from}
    assert {("base_compliance", "base"), ("off_axis_compliance", "joint_1")} <= said
    assert all(abs(one.log_bayes_factor - finding.log_bayes_factor) < 5 for one in finding.cannot_be_told_from)
