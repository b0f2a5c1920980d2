"""Robots with mimic joints from the plan to the diagnosis, with a simulator of other physics, and as files."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mimicking import COLUMN, JOINTS, ROBOTS, cell_of, postures_of

from calibration_core.cell import Cell, load_cell
from calibration_core.cli import main
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.errors import InputError
from calibration_core.formats.calibrated import calibrated_robot
from calibration_core.formats.dh import dh_files
from calibration_core.formats.mjcf import mjcf_files
from calibration_core.formats.ur import ur_files
from calibration_core.formats.urdf import urdf_files
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect
from calibration_core.model.robot import chain_of
from calibration_core.recording.tables.table import write_table
from calibration_sim.cell.protocol import read_plan
from calibration_sim.cell.table import simulate_readings
from calibration_sim.cell.truth import WORKSHOP, Spread, draw_truth
from calibration_sim.effects.effect import Label
from calibration_sim.effects.joints import dead_zone, spring
from calibration_sim.effects.structure import Bearing
from calibration_sim.scenarios.measure import Noise, look
from calibration_sim.scenarios.protocols import make_protocol
from calibration_sim.scenarios.world import World, play

KNOWN_GEOMETRY = Spread(stiffness=0.15, tracker_shift=2e-3, tracker_turn=1e-4, point=2e-4)


@pytest.mark.parametrize("form", [dh_files, mjcf_files, lambda robot: ur_files(robot, None)])
def test_a_format_without_a_word_for_mimic_joints_is_refused(tmp_path: Path, form: Callable) -> None:
    cell = cell_of("column", tmp_path)
    with pytest.raises(InputError, match=r"mimic joints: stage_2, stage_3.*--format urdf") as caught:
        form(calibrated_robot(cell, nominal_parameters(cell)))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_exported_urdf_is_the_calibrated_robot(tmp_path: Path, robot: str) -> None:
    cell = cell_of(robot, tmp_path)
    chain, nominal = chain_of(cell), nominal_parameters(cell)
    driver = chain.mimics[0].driver
    zero = AppliedEffect("joint_zero_offset", {"joint": chain.joints[driver]}, "zero", {"offset": 0.004})
    geometry = np.random.default_rng(3).normal(scale=1e-3, size=(chain.n, 6))
    exported = urdf_files(calibrated_robot(cell, nominal.replace(geometry=geometry, effects=(zero,))), tmp_path)
    assert exported.deviations[0].largest < 1e-9
    again = chain_of(cell_of(robot, tmp_path, exported.files["robot.urdf"].decode()))
    q = postures_of(chain)
    expected = posture(chain.corrected(geometry), q + 0.004 * np.eye(chain.n)[driver])
    np.testing.assert_allclose(posture(again, q).flange_origin, expected.flange_origin, atol=1e-9)
    np.testing.assert_allclose(posture(again, q).flange, expected.flange, atol=1e-9)


def run(*arguments: object) -> None:
    assert main([str(argument) for argument in arguments]) == 0


@pytest.fixture(scope="module", params=[pytest.param("column", marks=pytest.mark.slow), "parallelogram"])
def planned(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Cell:
    """Return a cell with a plan beside it."""
    folder = tmp_path_factory.mktemp(request.param)
    cell = cell_of(request.param, folder)
    run("plan", "--cell", cell.path, "--configurations", 14, "--out", folder / "plan", "--no-report")
    return cell


def test_the_stiffness_of_the_drivers_lies_in_the_intervals(planned: Cell) -> None:
    folder, inside = planned.path.parent, []
    for seed in (3, 4, 5):
        truth = draw_truth(planned, seed, spread=WORKSHOP)
        write_table(
            folder / "recording.csv",
            simulate_readings(planned, truth, read_plan(folder / "plan" / "plan.yaml", planned), seed),
        )
        out = folder / f"identified {seed}"
        run("identify", folder / "recording.csv", "--cell", planned.path, "--out", out, "--no-report")
        for row, true in zip(json.loads((out / "result.json").read_text())["stiffness"], truth.stiffness, strict=True):
            low, high = row["interval_95"]
            inside.append(low <= true <= high)
            assert abs(row["value"] / true - 1) < 0.1
    assert np.mean(inside) >= 0.85  # 95 % of about 20, less two standard deviations


CONCEALED = {
    "nothing": ("parallelogram", None, 2),
    "bearing behind the mimic joint": (
        "parallelogram",
        Bearing(Label("structure", "off_axis_compliance", {"joint": "joint_3"}), 2, (3e-6, 1.8e-6), 0.3),
        1,
    ),
    "bearing of the joint that the column carries": (
        "column",
        Bearing(Label("structure", "off_axis_compliance", {"joint": "joint_1"}), 1, (3e-6, 1.8e-6), 0.3),
        1,
    ),
    "clearance at the driver": (
        "parallelogram",
        spring(Label("joint law", "backlash", {"joint": "joint_2"}), 1, dead_zone(4e-4, 3.0)),
        2,
    ),
}


@pytest.mark.parametrize(
    "concealed", [pytest.param(name, marks=[pytest.mark.slow] if "column" in name else []) for name in CONCEALED]
)
def test_what_a_simulator_of_other_physics_conceals_is_found(tmp_path: Path, concealed: str) -> None:
    robot, effect, seed = CONCEALED[concealed]
    cell = cell_of(robot, tmp_path)
    truth = draw_truth(cell, seed, spread=KNOWN_GEOMETRY)
    world = World(cell, truth) if effect is None else World(cell, truth).with_effects(effect)
    played = play(world, make_protocol(cell, "L14", seed))
    found = diagnose(look(world, played, tuple(cell.frames.measurement_points), Noise(), seed), cell)
    expected = [] if effect is None else [(effect.label.effect, dict(effect.label.location))]
    assert [(one.effect, dict(one.location)) for one in found.findings] == expected
    np.testing.assert_allclose(1 / found.handed_out[0].compliance, truth.stiffness, rtol=0.1)


@pytest.mark.parametrize("robot", [pytest.param("column", marks=pytest.mark.slow), "parallelogram"])
def test_positions_without_load_are_explained_to_their_noise(tmp_path: Path, robot: str) -> None:
    cell = cell_of(robot, tmp_path)
    truth = draw_truth(cell, 5, spread=dataclasses.replace(KNOWN_GEOMETRY, joint_zero=1e-3, joint_shift=3e-4))
    world = World(cell, truth)
    played = play(world, make_protocol(cell, "A100", 5))
    write_table(tmp_path / "rest.csv", look(world, played, tuple(cell.frames.measurement_points), Noise(), 5))
    run("identify", tmp_path / "rest.csv", "--cell", cell.path, "--out", tmp_path / "out", "--no-report")
    fit = json.loads((tmp_path / "out" / "result.json").read_text())["fit"]
    assert fit["rms_before"] > 2e-4
    assert fit["held_out_rms_after"] < 1.3e-5  # of 1e-5


def test_init_writes_a_cell_whose_joints_are_those_with_a_drive(tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_text(COLUMN)
    run("init", tmp_path / "robot.urdf", "--rated-load", 10, "--no-questions", "--out", tmp_path / "new")
    cell = load_cell(tmp_path / "new" / "cell.yaml")
    assert cell.robot.joints == JOINTS["column"]
    assert [one.name for one in chain_of(cell).mimics] == ["stage_2", "stage_3"]
