"""What sisters tell of the next robot: in a diagnosis, and in a plan."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cli import main
from calibration_core.errors import InputError
from calibration_core.files.yaml_file import yaml_text
from calibration_core.fleet.next_robot.planning import accuracy_with, needed
from calibration_core.fleet.next_robot.population_file import TypePopulation, read_population
from calibration_core.fleet.next_robot.prior import pooled_joints
from calibration_core.fleet.pooling import Population
from calibration_core.model.identified.gaussian import GaussianEstimate

CELL = Path(__file__).parents[4] / "config" / "cells" / "small.cell.yaml"
JOINTS = ("joint_1", "joint_2")


def population(spread: float) -> TypePopulation:
    joints = {joint: Population(13.0, spread, 1e-4, 1e-4, 100) for joint in JOINTS}
    return TypePopulation("population.yaml", "abc", "kr", joints, {}, "100 robots of plant.csv")


def estimate(y: np.ndarray, covariance: np.ndarray) -> GaussianEstimate:
    value = np.exp(-y)
    names = tuple(f"compliance.{joint}" for joint in JOINTS)
    return GaussianEstimate(names, ("rad/(N*m)",) * 2, value, covariance * np.outer(value, value))


def test_intervals_with_sisters_hold_the_truth() -> None:
    """Two joints that a short measurement tells badly apart: 95 of 100 intervals hold, and they are narrower."""
    rng = np.random.default_rng(8)
    covariance = 0.04**2 * np.array([[1.0, -0.8], [-0.8, 1.0]])
    inside, gain = [], []
    for _ in range(1000):
        truth = 13.0 + 0.03 * rng.standard_normal(2)
        y = truth + np.linalg.cholesky(covariance) @ rng.standard_normal(2)
        for joint, true in zip(pooled_joints(estimate(y, covariance), population(0.03)), truth, strict=True):
            inside.append(joint.low <= math.exp(true) <= joint.high)
            gain.append(joint.pooled_std / joint.raw_std)
    assert 0.93 <= np.mean(inside) <= 0.97
    assert np.mean(gain) < 0.6  # less than the 0.6 of joints that are measured apart


def test_a_joint_that_does_not_belong_stands_for_itself() -> None:
    covariance = 0.01**2 * np.eye(2)
    first, second = pooled_joints(estimate(np.array([12.7, 13.01]), covariance), population(0.03))
    assert not first.belongs
    assert first.pooled == pytest.approx(first.raw)
    assert second.belongs
    assert second.pooled_std < second.raw_std


def test_sisters_save_configurations_where_they_are_alike() -> None:
    """k / (N s^2) + 1 / spread^2 = 1 / accuracy^2."""
    known = {"joint_1": population(0.012).joints["joint_1"], "joint_2": Population(13.0, 0.5, 1e-4, 1e-4, 100)}
    alike, different = needed({"joint_1": 0.01, "joint_2": 0.01}, 18, known, 0.01)
    assert alike.alone == different.alone == 18
    assert alike.together == math.ceil(18 * (1 - (0.01 / 0.012) ** 2))
    assert different.together == 18
    assert accuracy_with(0.01, 18, 6, known["joint_1"]) < 0.011


def written(folder: Path, **joints: dict[str, float]) -> Path:
    path = folder / "population.yaml"
    source = {"source": "plant.csv", "recordings": 300, "failed": 0, "data_set": "abc", "version": "0.1.0"}
    types = {"ten kg": {"robots": 100, "joints": joints, "laws": {}, "effects": {}}}
    path.write_text(yaml_text({"schema": 1, "provenance": source, "types": types}), encoding="utf-8")
    return path


def known_joints() -> dict[str, dict[str, float]]:
    stiffness = (2.2e5, 2.6e5, 1.6e5, 4.5e4, 3.5e4, 2e4)
    rest = {"spread": 0.03, "mean_std": 0.003, "spread_std": 0.002, "robots": 100}
    return {f"joint_{k}": {"log_mean": math.log(value), **rest} for k, value in enumerate(stiffness, start=1)}


def test_a_plan_and_a_diagnosis_take_a_population(tmp_path: Path) -> None:
    file = written(tmp_path, **known_joints())
    asked = ["--cell", str(CELL), "--population", str(file), "--no-report", "-q"]
    plan, made, found = (tmp_path / name for name in ("plan", "made", "found"))
    assert main(["plan", *asked, "--accuracy", "0.02", "--configurations", "6", "--out", str(plan)]) == 0
    content = json.loads((plan / "result.json").read_text())["population"]
    assert content["source"] == "100 robots of plant.csv"
    assert all(one["together"] <= one["alone"] for one in content["joints"] if one["alone"] and one["together"])
    steps = ["--cell", str(CELL), "--plan", str(plan / "plan.yaml"), "--seed", "3", "--no-report", "-q"]
    assert main(["simulate", *steps, "--out", str(made)]) == 0
    assert main(["diagnose", str(made / "measurements.csv"), *asked, "--out", str(found)]) == 0
    result = json.loads((found / "result.json").read_text())["population"]
    assert len(result["sha256"]) == 64
    assert all(one["pooled_std"] <= one["raw_std"] * 1.001 for one in result["joints"] if one["belongs"])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"spread": -1.0}, "spread: found -1.0, expected a finite number"),
        ({"robots": "many"}, "robots: found 'many'"),
        ({"log_mean": None}, "log_mean: found nothing"),
    ],
)
def test_a_wrong_population_is_named(tmp_path: Path, change: dict[str, object], says: str) -> None:
    joints = known_joints()
    joints["joint_2"] |= change  # type: ignore[arg-type]
    with pytest.raises(InputError, match=says):
        read_population(written(tmp_path, **joints), None, tuple(joints))
    with pytest.raises(InputError, match="no 'other', expected one of"):
        read_population(written(tmp_path, **known_joints()), "other", tuple(joints))
