"""The hidden truth: reproducible, separate from protocol and noise, written down in full."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration_core.cell import Cell
from calibration_core.errors import CellError
from calibration_sim.cell.truth import WORKSHOP, draw_truth, nominal_truth, write_truth


def test_nominal_truth_is_the_cell_file(demo: Cell) -> None:
    truth = nominal_truth(demo)
    assert truth.stiffness.tolist() == list(demo.robot.stiffness)
    assert truth.tracker.translation.tolist() == list(demo.frames.tracker.xyz)
    assert truth.wrench_point.tolist() == list(demo.frames.wrench_point)
    assert {name: tuple(point) for name, point in truth.points.items()} == dict(demo.frames.measurement_points)


def test_rough_truth_differs_by_stiffness_alone(demo: Cell) -> None:
    nominal = nominal_truth(demo)
    drawn = [draw_truth(demo, seed) for seed in range(300)]
    ratios = np.log([truth.stiffness / nominal.stiffness for truth in drawn])
    assert ratios.std() == pytest.approx(0.15, rel=0.06)
    assert ratios.mean() == pytest.approx(0.0, abs=0.02)
    truth = drawn[0]
    assert not truth.joint_zero.any()
    assert not truth.joint_frame_errors.any()
    assert np.array_equal(truth.tracker.rotation, nominal.tracker.rotation)
    assert np.array_equal(truth.points["mp2"], nominal.points["mp2"])


def test_workshop_truth_moves_everything(demo: Cell) -> None:
    nominal, truth = nominal_truth(demo), draw_truth(demo, 5, spread=WORKSHOP)
    assert truth.joint_zero.all()
    assert truth.joint_frame_errors.all()
    assert 0.0 < np.linalg.norm(truth.tracker.translation - nominal.tracker.translation) < 0.01
    assert truth.tracker.rotation @ truth.tracker.rotation.T == pytest.approx(np.eye(3), abs=1e-14)
    assert all(0.0 < np.linalg.norm(truth.points[p] - nominal.points[p]) < 0.005 for p in truth.points)
    assert np.array_equal(truth.force_torque.translation, nominal.force_torque.translation)


def test_a_seed_gives_one_truth(demo: Cell) -> None:
    first, again, other = (draw_truth(demo, seed, spread=WORKSHOP) for seed in (7, 7, 8))
    assert np.array_equal(first.stiffness, again.stiffness)
    assert np.array_equal(first.joint_frame_errors, again.joint_frame_errors)
    assert not np.any(first.stiffness == other.stiffness)


def test_truth_needs_stiffness(demo: Cell, changed: Callable[..., Cell]) -> None:
    with pytest.raises(CellError, match="stiffness"):
        draw_truth(changed(demo, robot__stiffness=None), 0)


def test_truth_is_written_in_full(demo: Cell, tmp_path: Path) -> None:
    truth = draw_truth(demo, 2, spread=WORKSHOP)
    write_truth(tmp_path / "truth.yaml", truth, demo, seed=2)
    data = yaml.safe_load((tmp_path / "truth.yaml").read_text())
    assert list(data["stiffness"]) == list(demo.robot.joints)
    assert list(data["stiffness"].values()) == truth.stiffness.tolist()
    assert data["measurement_points"]["mp3"] == truth.points["mp3"].tolist()
    assert data["tracker"]["rotation"] == truth.tracker.rotation.tolist()
    assert data["sensors"]["tracker"]["resolution"] == 1e-7
