"""A robot on a linear unit, from the plan to the prediction, against the simulator's own kinematics and statics."""

from __future__ import annotations

import csv
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration_core.cell import Cell, load_cell
from calibration_core.cli import main
from calibration_core.errors import CellError
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters, tool_point
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import gravity_torque
from calibration_core.motion.speed import Monitored, hermite_bound
from calibration_core.recording.tables.table import write_table
from calibration_sim.cell.protocol import read_plan
from calibration_sim.cell.table import simulate_readings
from calibration_sim.cell.truth import WORKSHOP, draw_truth
from calibration_sim.mechanics.chain import read_chain
from calibration_sim.mechanics.statics import Mechanism

CELLS = Path(__file__).parents[1] / "config" / "cells"
SEEDS = (3, 4, 5)
COLUMN = """<robot name="lift"><link name="base"/><link name="slide"><inertial><origin xyz="0.1 0 0.2"/>
<mass value="30"/></inertial></link><link name="a"><inertial><origin xyz="0.3 0 0"/><mass value="12"/></inertial></link>
<link name="b"><inertial><origin xyz="0 0.2 0"/><mass value="6"/></inertial></link><link name="c">
<inertial><mass value="2"/></inertial></link><link name="end"/>
<joint name="lift" type="prismatic"><parent link="base"/><child link="slide"/><origin xyz="0 0 0.4" rpy="0.02 0 0.3"/>
<axis xyz="0 0 1"/><limit lower="0" upper="0.8" effort="1" velocity="1"/></joint>
<joint name="turn" type="revolute"><parent link="slide"/><child link="a"/><origin xyz="0.1 0 0.1"/>
<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
<joint name="reach" type="prismatic"><parent link="a"/><child link="b"/><origin xyz="0.4 0 0" rpy="0 0.3 0"/>
<axis xyz="1 0 0.2"/><limit lower="-0.1" upper="0.5" effort="1" velocity="1"/></joint>
<joint name="nod" type="revolute"><parent link="b"/><child link="c"/><origin xyz="0.1 0 0"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
<joint name="on" type="fixed"><parent link="c"/><child link="end"/><origin xyz="0.2 0 0"/></joint></robot>"""


def rail_content() -> dict:
    """Return the small cell's robot on a linear unit: gravity along -y, for the rail is z of the base frame."""
    content = yaml.safe_load((CELLS / "small.cell.yaml").read_text())
    robot = content["robot"]
    robot["name"] = "10 kg class on a linear unit"
    robot["dh"].insert(0, {"a": 0.0, "alpha": -np.pi / 2, "d": 0.1, "theta": 0.2})
    robot["joints"].insert(0, "rail")
    robot["joint_types"] = ["prismatic", *["revolute"] * 6]
    robot["joint_limits"].insert(0, [-1.0, 1.0])
    robot["inertials"].insert(0, {"mass": 40.0, "com": [0.0, 0.05, 0.0]})
    robot["stiffness"].insert(0, 5.0e5)
    up = np.array([-np.sin(0.2), np.cos(0.2), 0.0])  # the axis of joint_1
    robot["gravity"] = (-9.80665 * up).tolist()
    content["frames"]["tracker"] = {"xyz": [2.5, 0.6, 0.4], "rpy": [-1.5, 0.1, 3.0]}
    return content


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("rail")
    (place / "rail.cell.yaml").write_text(yaml.safe_dump(rail_content()))
    (place / "lift.urdf").write_text(COLUMN)
    lift = {
        "name": "lift", "frames": {"measurement_points": {"mp1": [0.1, 0.0, 0.0]}},
        "instruments": {"tracker": {"sigma": 1e-5}},
        "robot": {"name": "lift", "urdf": "lift.urdf", "base_link": "base", "flange": "end", "rated_load": 5.0,
                  "joints": ["lift", "turn", "reach", "nod"], "stiffness": [1e6, 1e5, 2e6, 5e4]},
    }  # fmt: skip
    (place / "lift.cell.yaml").write_text(yaml.safe_dump(lift))
    return place


@pytest.fixture(scope="module", params=["rail", "lift"])
def cell(request: pytest.FixtureRequest, folder: Path) -> Cell:
    return load_cell(folder / f"{request.param}.cell.yaml")


def test_kinematics_and_weight_are_those_of_the_simulator(cell: Cell) -> None:
    chain = chain_of(cell)
    assert chain.prismatic == cell.prismatic
    mechanism = Mechanism(read_chain(cell), np.full(chain.n, 1e13), cell.gravity)
    q = np.random.default_rng(1).uniform(*chain.limits.T, (12, chain.n))
    at = posture(chain, q)
    weight = gravity_torque(chain, at)
    for k, row in enumerate(q):
        place = mechanism.forward(row)
        np.testing.assert_allclose(place.translation, at.flange_origin[:, k], atol=1e-12)
        np.testing.assert_allclose(place.rotation, at.flange[:, :, k].T, atol=1e-12)
        held = mechanism.equilibrium(row).torque
        np.testing.assert_allclose(held, -weight[:, k], rtol=1e-5, atol=0.05)


def test_speeds_and_their_bounds_hold_with_sliding_joints(cell: Cell) -> None:
    chain, rng = chain_of(cell), np.random.default_rng(2)
    monitored = Monitored.of(chain, nominal_parameters(cell), tool_point(cell))
    q, rate = rng.uniform(*chain.limits.T, (30, chain.n)), rng.normal(size=(30, chain.n))

    def places(angles: np.ndarray) -> np.ndarray:
        at = posture(chain, angles)
        return np.stack([*at.origin, *(at.point(point) for point in monitored.points)])

    step = 1e-5
    ahead, here, behind = places(q + step * rate), places(q), places(q - step * rate)
    speed = np.linalg.norm(ahead - behind, axis=1).T / (2 * step)
    np.testing.assert_allclose(monitored.speeds(q, rate), speed, atol=1e-8)
    bent = np.linalg.norm(ahead - 2 * here + behind, axis=1).T / step**2
    assert np.all(bent <= np.array([monitored.bending(row) for row in rate]) + 1e-3)
    time = np.arange(30) * 2.0
    bound = hermite_bound(monitored, time, q, 0.1 * rate)
    u = np.linspace(0, 1, 200)[:, None, None]
    h = [2 * u**3 - 3 * u**2 + 1, u**3 - 2 * u**2 + u, -2 * u**3 + 3 * u**2, u**3 - u**2]
    d = [6 * u**2 - 6 * u, 3 * u**2 - 4 * u + 1, -6 * u**2 + 6 * u, 3 * u**2 - 2 * u]
    ends = q[:-1], 0.2 * rate[:-1], q[1:], 0.2 * rate[1:]
    position, moved = (sum(w * e for w, e in zip(weights, ends, strict=True)) for weights in (h, d))
    sampled = monitored.speeds(position.reshape(-1, chain.n), moved.reshape(-1, chain.n) / 2.0)
    assert np.all(bound >= sampled.reshape(200, 29, -1).max(axis=0) - 1e-9)


def run(*arguments: object) -> None:
    assert main([str(argument) for argument in arguments]) == 0


@pytest.fixture(scope="module")
def plan(folder: Path) -> Path:
    run("plan", "--cell", folder / "rail.cell.yaml", "--configurations", 14, "--out", folder / "plan")
    return folder / "plan"


def recorded(folder: Path, plan: Path, seed: int) -> tuple[Path, dict[str, float]]:
    cell = load_cell(folder / "rail.cell.yaml")
    truth = draw_truth(cell, seed, spread=WORKSHOP)
    readings = simulate_readings(cell, truth, read_plan(plan / "plan.yaml", cell), seed)
    path = folder / f"{seed}.csv"
    if not path.exists():
        write_table(path, readings)
    return path, dict(zip(cell.robot.joints, truth.stiffness.tolist(), strict=True))


def test_the_plan_names_the_rail_by_its_distance(plan: Path) -> None:
    with (plan / "table1.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == ["No", "d_1", *(f"theta_{i}" for i in range(2, 8))]
    assert all(-1000 <= float(row["d_1"]) <= 1000 for row in rows)
    assert np.ptp([float(row["d_1"]) for row in rows]) > 500
    assert "d_1:" in (plan / "table1.yaml").read_text()
    assert "d₁ [mm]" in (plan / "report.html").read_text()


def test_the_truth_lies_in_the_intervals(folder: Path, plan: Path) -> None:
    inside = []
    for seed in SEEDS:
        path, truth = recorded(folder, plan, seed)
        out = folder / f"identified {seed}"
        run(
            "identify", path, "--cell", folder / "rail.cell.yaml", "--out", out, *(["--no-report"] * (seed != SEEDS[0]))
        )
        stiffness = json.loads((out / "result.json").read_text())["stiffness"]
        assert [row["unit"] for row in stiffness] == ["N/m", *["N*m/rad"] * 6]
        for row in stiffness:
            low, high = row["interval_95"]
            inside.append(low <= truth[row["joint"]] <= high)
            assert abs(row["value"] / truth[row["joint"]] - 1) < 0.1
    assert "rail [10⁵ N/m]" in (folder / f"identified {SEEDS[0]}" / "report.html").read_text()
    assert np.mean(inside) >= 0.85  # 95 % of 21, less two standard deviations


def test_the_chain_of_commands(folder: Path, plan: Path) -> None:
    cell = folder / "rail.cell.yaml"
    path, truth = recorded(folder, plan, SEEDS[0])
    out = folder / "diagnosed"
    run("diagnose", path, "--cell", cell, "--out", out, "--no-report")
    result = json.loads((out / "result.json").read_text())
    structure = [f for f in result["findings"] if f["family"] in {"structure", "joint law"}]
    assert not structure
    assert not result["unexplained"]["significant"]
    rail = result["stiffness"][0]
    assert abs(rail["value"] / truth["rail"] - 1) < 0.1
    other, _ = recorded(folder, plan, SEEDS[0])
    run("predict", other, "--cell", cell, "--model", out / "model.yaml", "--out", folder / "predicted", "--no-report")
    run("simulate", "--cell", cell, "--plan", plan / "plan.yaml", "--model", out / "model.yaml", "--out",
        folder / "simulated", "--no-report")  # fmt: skip
    with (folder / "predicted" / "predictions.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    last = {}
    for row in rows:
        key = row["configuration"], row["point"]
        first = last.setdefault(key, row)
        moved = [float(row[f"{p}{a}"]) - float(first[f"{p}{a}"]) for p in ("", "p") for a in "xyz"]
        assert np.abs(np.subtract(moved[:3], moved[3:])).max() < 1e-4


def test_a_compliance_that_only_lowers_the_robot_stays_unknown(folder: Path) -> None:
    """At rest the column carries the same weight everywhere: its sag is the height of the tracker, and no other."""
    place = folder / "lift.cell.yaml"
    cell = load_cell(place)
    mechanism = Mechanism(read_chain(cell), np.array(cell.robot.stiffness), cell.gravity)
    rng = np.random.default_rng(4)
    with (folder / "rest.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["configuration", "step", "q1", "q2", "q3", "q4", "point", "x", "y", "z"])
        for k, q in enumerate(rng.uniform(*chain_of(cell).limits.T, (40, 4))):
            flange = mechanism.equilibrium(q).flange
            seen = flange.translation + flange.rotation @ [0.1, 0.0, 0.0] + 1e-5 * rng.standard_normal(3)
            writer.writerow([k + 1, 0, *q, "mp1", *seen])
    out = folder / "at rest"
    run("diagnose", folder / "rest.csv", "--cell", place, "--out", out, "--no-report")
    named = {one["name"]: one for one in yaml.safe_load((out / "model.yaml").read_text())["parameters"]}
    assert all(0 < one["std"] < np.inf for one in named.values())
    assert named["compliance.lift"]["std"] > 10 * named["compliance.lift"]["value"]


def test_a_rail_that_is_declared_rigid_is_not_asked_for(folder: Path, plan: Path) -> None:
    content = rail_content()
    content["robot"]["stiffness"][0] = float("inf")
    (folder / "rigid.cell.yaml").write_text(yaml.safe_dump(content))
    rigid = load_cell(folder / "rigid.cell.yaml")
    truth = draw_truth(load_cell(folder / "rail.cell.yaml"), 7, spread=WORKSHOP)
    stiff = np.array([1e12, *truth.stiffness[1:]])

    readings = simulate_readings(
        rigid, dataclasses.replace(truth, stiffness=stiff), read_plan(plan / "plan.yaml", rigid), 7
    )
    write_table(folder / "rigid.csv", readings)
    for command in ("identify", "diagnose"):
        out = folder / f"rigid {command}"
        run(command, folder / "rigid.csv", "--cell", folder / "rigid.cell.yaml", "--out", out, "--no-report")
        result = json.loads((out / "result.json").read_text())
        rail, *others = result["stiffness"]
        assert rail["value"] in {None, "Infinity", float("inf")}
        assert not rail["identifiable"]
        assert "declared rigid" in rail["reason"]
        assert result["unidentified"] == []
        assert "rail" not in result["reason"]
        assert all(abs(row["value"] / k - 1) < 0.1 for row, k in zip(others, stiff[1:], strict=True))
    run("plan", "--cell", folder / "rigid.cell.yaml", "--configurations", 12, "--out", folder / "rigid", "--no-report")


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"joint_types": ["prismatic"]}, "robot.joint_types"),
        ({"joint_types": ["screw", *["revolute"] * 6]}, "robot.joint_types.0"),
        ({"stiffness": [-1.0, *[1e5] * 6]}, "robot.stiffness.0"),
        ({"stiffness": [float("nan"), *[1e5] * 6]}, "robot.stiffness.0"),
        ({"joint_limits": [[1.0, -1.0], *([-2.0, 2.0] for _ in range(6))]}, "robot.joint_limits.0"),
    ],
)
def test_what_a_cell_may_not_say(tmp_path: Path, change: dict, place: str) -> None:
    content = rail_content()
    content["robot"].update(change)
    (tmp_path / "cell.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(CellError) as caught:
        load_cell(tmp_path / "cell.yaml")
    assert caught.value.place == place
