"""The exported MuJoCo model, bent by MuJoCo itself, against our own equilibrium: joints, weight, load, more springs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.formats.calibrated import calibrated_robot
from calibration_core.formats.mjcf import mjcf_files
from calibration_core.model.effects.applied import applied_shift
from calibration_core.model.effects.state import state_of
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect, ModelParameters
from calibration_core.model.statics import Load

CELLS = Path(__file__).parents[1] / "config" / "cells"
FORCE, TORQUE = np.array([300.0, -250.0, -900.0]), np.array([40.0, 60.0, -30.0])
SIX = {
    **{f"rotation_{axis}": 6e-8 for axis in "xyz"},
    "rotation_xy": 1e-8,
    **{f"translation_{axis}": 8e-9 for axis in "xyz"},
}
EFFECTS = {
    "none": (),
    "off-axis before": (AppliedEffect("off_axis_compliance", {"joint": "joint_2"}, "before",
                                      {"compliance_x": 2e-7, "compliance_y": 1e-7, "compliance_xy": 5e-8}),),
    "off-axis behind": (AppliedEffect("off_axis_compliance", {"joint": "joint_3"}, "behind",
                                      {"compliance_x": 2e-7, "compliance_y": 1e-7, "compliance_xy": -5e-8}),),
    "off-axis isotropic": (AppliedEffect("off_axis_compliance", {"joint": "joint_1"}, "isotropic",
                                         {"compliance": 2e-7}),),
    "base": (AppliedEffect("base_compliance", {"base": "base"}, "six springs", SIX),),
    "tool": (AppliedEffect("tool_compliance", {"tool": "tool"}, "six springs",
                           {key: 10 * value for key, value in SIX.items() if key != "rotation_xy"}),),
    "link": (AppliedEffect("link_bending", {"link": "link_2"}, "bending and torsion",
                           {"bending_1": 3e-7, "bending_2": 2e-7, "bending_12": 5e-8, "torsion": 4e-7}),),
    "coupling": (AppliedEffect("joint_coupling", {"joints": ("joint_2", "joint_3")}, "symmetric",
                               {"compliance": 1e-7}),),
}  # fmt: skip


def parameters_of(cell: Cell, effects: tuple[AppliedEffect, ...]) -> ModelParameters:
    parameters = nominal_parameters(cell)
    geometry = np.random.default_rng(11).normal(size=(6, 6)) * 5e-4
    return parameters.replace(geometry=geometry, effects=effects)


def at_rest(model: Any, q: Any, force: Any, torque: Any) -> Any:
    """Where MuJoCo's robot comes to rest: (p, 3) m, the points; time goes on until nothing moves."""
    data = mujoco.MjData(model)
    data.ctrl[:] = q
    for name, value in zip(("joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"), q, strict=True):
        data.qpos[model.jnt_qposadr[model.joint(name).id]] = value
    flange, point = model.body("flange").id, model.site("wrench_point").id
    for _ in range(400):
        for _ in range(50):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            data.qfrc_applied[:] = 0.0
            mujoco.mj_applyFT(model, data, force, torque, data.site_xpos[point], flange, data.qfrc_applied)
            mujoco.mj_step(model, data)
        if np.abs(data.qvel).max() < 1e-9:
            break
    assert np.abs(data.qvel).max() < 1e-6, "it has not come to rest"
    return np.array([data.site(name).xpos for name in ("mp1", "mp2", "mp3")])


def ours(cell: Cell, parameters: ModelParameters, q: Any, force: Any, torque: Any) -> Any:
    """Our equilibrium with the effects, (p, 3) m."""
    chain = calibrated_robot(cell, parameters).chain
    points = np.stack(list(parameters.points.values()))
    assert parameters.wrench_point is not None
    load = Load(np.tile(force, (3, 1)).T, np.tile(torque, (3, 1)).T, parameters.wrench_point, None)
    rest = solve_equilibrium(chain, np.tile(q, (3, 1)), parameters.compliance, load)
    state = state_of(
        chain, np.tile(q, (3, 1)), parameters.compliance, load, points.T, point_index=np.arange(3),
        wrench=np.tile(np.concatenate([force, torque]), (3, 1)), configuration=np.zeros(3, dtype=int),
        step=np.zeros(3, dtype=int), time=np.zeros(3), temperature=np.full(3, 20.0), tracker=parameters.tracker,
        rated_load=cell.robot.rated_load,
    )  # fmt: skip
    return rest.at.point(points.T).T + applied_shift(parameters.effects, state)


@pytest.mark.parametrize("name", EFFECTS)
def test_mujoco_bends_as_the_model_does(name: str) -> None:
    """Deflection under weight and under a load, at postures that differ: within 1 % of ours."""
    cell = load_cell(CELLS / "demo.cell.yaml")
    parameters = parameters_of(cell, EFFECTS[name])
    robot = calibrated_robot(cell, parameters)
    exported = mjcf_files(robot)
    assert exported.held == robot.further == EFFECTS[name]
    model = mujoco.MjModel.from_xml_string(exported.files["robot.xml"].decode())
    stiff = parameters.replace(compliance=np.zeros(6), effects=())
    rng = np.random.default_rng(4)
    for loaded in (False, True):
        force, torque = (FORCE, TORQUE) if loaded else (np.zeros(3), np.zeros(3))
        q = rng.uniform(-0.6, 0.6, 6)
        rigid = ours(cell, stiff, q, force, torque)
        deflection = at_rest(model, q, force, torque) - rigid
        expected = ours(cell, parameters, q, force, torque) - rigid
        assert np.linalg.norm(expected) > 1e-4
        assert np.linalg.norm(deflection - expected) < 0.01 * np.linalg.norm(expected)


def test_a_law_that_is_no_spring_is_left_out() -> None:
    cell = load_cell(CELLS / "demo.cell.yaml")
    effect = AppliedEffect("backlash", {"joint": "joint_2"}, "load torque", {"gap": 1e-4, "reference_torque": 1e3})
    robot = calibrated_robot(cell, parameters_of(cell, (effect,)))
    exported = mjcf_files(robot)
    assert exported.held == ()
    assert "backlash at joint_2" in exported.files["robot.xml"].decode()


def test_a_robot_without_masses_bends_under_the_load_alone() -> None:
    cell = load_cell(CELLS / "small.cell.yaml")
    cell = cell.model_copy(update={"robot": cell.robot.model_copy(update={"inertials": None})})
    parameters = parameters_of(cell, ())
    model = mujoco.MjModel.from_xml_string(mjcf_files(calibrated_robot(cell, parameters)).files["robot.xml"].decode())
    q = np.array([0.2, -0.3, 0.4, 0.1, 0.5, 0.2])
    expected = ours(cell, parameters, q, FORCE / 20, TORQUE / 20)
    rigid = ours(cell, parameters.replace(compliance=np.zeros(6)), q, FORCE, TORQUE)
    found = at_rest(model, q, FORCE / 20, TORQUE / 20)
    assert np.linalg.norm(found - expected) < 0.01 * np.linalg.norm(expected - rigid)
