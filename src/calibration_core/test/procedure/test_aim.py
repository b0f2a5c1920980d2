"""Where a tracker has to look for a target, and whether what it found can be that target."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.errors import CellError
from calibration_core.measurement.aim import Aim
from calibration_core.model.chain import pose_matrix, rotation_about
from calibration_core.model.nominal import nominal_parameters
from calibration_core.timeseries import Float1D, Float2D

CELL = Path(__file__).resolve().parents[4] / "config" / "cells" / "demo.cell.yaml"
Q = np.array([0.1, -0.9, 1.2, 0.3, 0.5, -0.2])


@pytest.fixture
def cell() -> Cell:
    return load_cell(CELL)


def stands(cell: Cell, shift: Float1D, turn: Float1D) -> Float2D:
    """The tracker's pose in the base, (4, 4), where it stands otherwise than the cell file says."""
    pose = nominal_parameters(cell).tracker.copy()
    pose[:3, 3] += shift
    pose[:3, :3] = pose[:3, :3] @ rotation_about(turn)
    return pose


def seen(cell: Cell, name: str, q: Float1D, pose: Float2D) -> Float1D:
    at = Aim(cell).in_base(name, q)
    return np.asarray(pose[:3, :3].T @ (at - pose[:3, 3]))


def test_the_cell_files_pose_is_what_it_begins_with(cell: Cell) -> None:
    stated = cell.frames.tracker
    assert stated is not None
    pose = pose_matrix(np.array(stated.xyz), np.array(stated.rpy))
    for name in cell.points:
        np.testing.assert_allclose(Aim(cell).place(name, Q), seen(cell, name, Q, pose), atol=1e-12)
        assert Aim(cell).fault(name, Q, Aim(cell).place(name, Q)) == ""


def test_without_the_trackers_pose_nobody_can_aim(cell: Cell) -> None:
    frames = cell.frames.model_copy(update={"tracker": None})
    with pytest.raises(CellError, match=r"frames\.tracker"):
        Aim(cell.model_copy(update={"frames": frames}))


def test_what_was_found_makes_the_aim_better(cell: Cell) -> None:
    pose = stands(cell, np.array([0.06, -0.05, 0.03]), np.array([0.01, 0.02, -0.04]))
    aim = Aim(cell)
    other = Q + np.array([0.8, 0.2, -0.3, 0.5, 0.4, 1.0])
    before = np.linalg.norm(aim.place("mp2", other) - seen(cell, "mp2", other, pose))
    for q in (Q, Q + 0.3):
        for name in cell.points:
            found = seen(cell, name, q, pose)
            assert aim.fault(name, q, found) == ""
            aim.keep(name, q, found)
    after = np.linalg.norm(aim.place("mp2", other) - seen(cell, "mp2", other, pose))
    assert before > 0.1
    assert after < 0.02


def test_another_reflector_of_the_same_flange_is_told(cell: Cell) -> None:
    pose = stands(cell, np.array([0.04, 0.02, -0.03]), np.array([0.0, 0.01, 0.02]))
    aim = Aim(cell)
    aim.keep("mp1", Q, seen(cell, "mp1", Q, pose))
    assert aim.fault("mp2", Q, seen(cell, "mp2", Q, pose)) == ""
    fault = aim.fault("mp2", Q, seen(cell, "mp1", Q, pose))
    assert fault.startswith("mp2: a reflector was found 0.30 m from its place, expected at most 0.07")
    assert fault.endswith("; mp1 is there")


def test_what_is_far_from_the_robot_is_no_target_even_at_first(cell: Cell) -> None:
    aim = Aim(cell)
    place = aim.place("mp1", Q)
    assert aim.fault("mp1", Q, place + np.array([0.0, 0.2, 0.0])) == ""
    assert "a reflector was found 1.50 m from its place" in aim.fault("mp1", Q, place + np.array([1.5, 0.0, 0.0]))


def test_a_place_in_inches_read_as_millimetres_is_no_target(cell: Cell) -> None:
    aim = Aim(cell)
    assert aim.fault("mp1", Q, aim.place("mp1", Q) / 25.4) != ""


def test_a_copy_does_not_change_what_is_known(cell: Cell) -> None:
    aim = Aim(cell)
    place = aim.place("mp1", Q)
    tried = aim.copy()
    tried.keep("mp1", Q, place + 0.1)
    np.testing.assert_allclose(aim.place("mp1", Q), place)
    assert np.linalg.norm(tried.place("mp1", Q) - place) > 0.05
