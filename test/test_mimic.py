"""Mimic joints between base and flange: telescopic columns, parallelogram arms, and stranger gears."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from scipy.optimize import minimize

from calibration_core.cell import Cell, load_cell
from calibration_core.model.chain import Chain
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.kinematics import linear_jacobian, posture
from calibration_core.model.robot import chain_of, pinocchio_model
from calibration_core.model.statics import (
    Load,
    gravity_torque,
    gravity_torque_derivative,
    load_torque,
    load_torque_derivative,
)
from calibration_core.timeseries import Float1D, Float2D
from calibration_sim.mechanics.chain import read_chain
from calibration_sim.mechanics.statics import Mechanism

CELLS = Path(__file__).parents[1] / "config" / "cells"
BALL = '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/>'
POINT = np.array([0.05, -0.03, 0.12])


def joint(
    name: str, kind: str, xyz: str, axis: str, limit: str, mimic: str = "", rpy: str = "0 0 0"
) -> tuple[str, str]:
    """Return a joint without its links, and the name of the link that it carries."""
    low, high = limit.split()
    bounds = f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/>'
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{bounds}{mimic}',
        name,
    )


def urdf(*joints: tuple[str, str], masses: tuple[float, ...], flange: str = "0 0 0.08") -> str:
    """Return a URDF of a serial chain: links named after the joints that carry them."""
    parents = ["base", *(f"{name}_link" for _, name in joints)]
    links = "".join(
        f'<link name="{name}"><inertial><origin xyz="0.02 {0.01 * k} {0.05 + 0.02 * k}"/><mass value="{mass}"/>{BALL}</inertial></link>'
        for k, (name, mass) in enumerate(zip(parents[1:], masses, strict=True))
    )
    rest = "".join(
        f'{text}<parent link="{parent}"/><child link="{name}_link"/></joint>'
        for (text, name), parent in zip(joints, parents, strict=False)
    )
    end = f'<joint name="on" type="fixed"><parent link="{parents[-1]}"/><child link="flange"/><origin xyz="{flange}"/></joint>'
    return f'<robot name="r"><link name="base"/><link name="flange"/>{links}{rest}{end}</robot>'


def mimic(driver: str, multiplier: float = 1.0, offset: float = 0.0) -> str:
    return f'<mimic joint="{driver}" multiplier="{multiplier}" offset="{offset}"/>'


ARM = (
    joint("joint_1", "revolute", "0 0 0.3", "0 0 1", "-2.9 2.9"),
    joint("joint_2", "revolute", "0.1 0 0.2", "0 1 0", "-1.5 1.9"),
    joint("joint_3", "revolute", "0 0 0.6", "0 1 0", "-2.2 1.2"),
    joint("joint_4", "revolute", "0.1 0 0.1", "1 0 0", "-3 3"),
    joint("joint_5", "revolute", "0.5 0 0", "0 1 0", "-2 2"),
    joint("joint_6", "revolute", "0.1 0 0", "1 0 0", "-3 3"),
)
ARM_MASSES = (25.0, 18.0, 12.0, 6.0, 3.0, 1.0)
COLUMN = urdf(
    joint("lift", "prismatic", "0 0 0.4", "0 0 1", "0 0.35", rpy="0.01 0 0.2"),
    joint("stage_2", "prismatic", "0.02 0 0.3", "0 0 1", "0 0.5", mimic("lift"), rpy="0 0.01 0"),
    joint("stage_3", "prismatic", "0 0.01 0.3", "0 0 1", "0 0.2", mimic("lift", 0.5, 0.03)),
    *ARM,
    masses=(60.0, 50.0, 40.0, *ARM_MASSES),
    flange="0.05 0 0",
)  # fmt: skip
PARALLELOGRAM = urdf(
    *ARM[:2],
    joint("keeps_level", "revolute", "0 0 0.7", "0 1 0", "-1.2 1.6", mimic("joint_2", -1.0)),
    joint("joint_3", "revolute", "0.05 0 0.1", "0 1 0", "-1.2 1.2"),
    *ARM[3:],
    masses=(40.0, 25.0, 8.0, 14.0, 6.0, 3.0, 1.0),
    flange="0.05 0 0",
)  # fmt: skip
ODD = urdf(
    joint("before", "revolute", "0 0 0.2", "0 1 0.2", "-2 2", mimic("b", 0.4, 0.1)),
    joint("a", "revolute", "0.1 0 0.3", "0 0 1", "-2 2"),
    joint("b", "revolute", "0.1 0 0.3", "0 1 0", "-1 1.5"),
    joint("spindle", "prismatic", "0.2 0 0.2", "1 0 0.3", "-1 1", mimic("a", 0.08, 0.02)),
    joint("c", "prismatic", "0.1 0.1 0", "1 0 0", "-0.2 0.4", rpy="0.1 0.4 0"),
    joint("d", "revolute", "0.1 0 0", "0 1 0", "-2 2"),
    joint("behind", "revolute", "0.1 0 0.1", "1 1 0", "-3 3", mimic("c", -1.5, 0.2)),
    masses=(20.0, 15.0, 12.0, 9.0, 6.0, 4.0, 2.0),
)  # fmt: skip
ROBOTS = {"column": COLUMN, "parallelogram": PARALLELOGRAM, "odd": ODD}
STIFFNESS = {
    "column": [6e5, 1.2e5, 1.5e5, 9e4, 2.5e4, 2e4, 1.2e4],
    "parallelogram": [1.2e5, 1.5e5, 9e4, 2.5e4, 2e4, 1.2e4],
    "odd": [1.2e5, 1.5e5, 6e5, 2e4],
}
JOINTS = {
    "column": ("lift", *(f"joint_{i}" for i in range(1, 7))),
    "parallelogram": tuple(f"joint_{i}" for i in range(1, 7)),
    "odd": ("a", "b", "c", "d"),
}


def content_of(robot: str, folder: Path) -> dict:
    """Return a cell file with one of the robots, which is written beside it."""
    (folder / "robot.urdf").write_text(ROBOTS[robot])
    content = yaml.safe_load((CELLS / "small.cell.yaml").read_text())
    content["robot"] = {
        "name": f"{robot} robot",
        "urdf": "robot.urdf",
        "base_link": "base",
        "flange": "flange",
        "joints": list(JOINTS[robot]),
        "rated_load": 10.0,
        "stiffness": STIFFNESS[robot],
    }
    content["frames"]["tracker"] = {"xyz": [3.5, -0.4, 0.9], "rpy": [0.0, 0.0, 3.0]}
    return content


def cell_of(robot: str, folder: Path, text: str | None = None, **changes: object) -> Cell:
    content = content_of(robot, folder)
    content["robot"] |= changes
    if text is not None:
        (folder / "robot.urdf").write_text(text)
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(content))
    return load_cell(path)


@pytest.fixture(params=ROBOTS)
def chain(request: pytest.FixtureRequest, tmp_path: Path) -> Chain:
    return chain_of(cell_of(request.param, tmp_path))


def postures_of(chain: Chain, m: int = 4) -> Float2D:
    return np.random.default_rng(1).uniform(chain.limits[:, 0], chain.limits[:, 1], (m, chain.n))


def load_on(m: int, *, turns: bool) -> Load:
    rng = np.random.default_rng(2)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0] if turns else None
    return Load(rng.normal(scale=80, size=(3, m)), rng.normal(scale=15, size=(3, m)), POINT, rotation)


def slopes(function: object, q: Float2D, step: float = 1e-6) -> Float2D:
    """Return the derivatives by central differences, (..., n) behind what the function returns, (..., m)."""
    moved = [(function(q + step * row) - function(q - step * row)) / (2 * step) for row in np.eye(q.shape[1])]
    return np.stack(moved, axis=-1)


def expanded(cell: Cell, model: object, row: Float1D) -> Float1D:
    """Return the configuration of pinocchio's own model of the URDF, by the tags of the file alone."""
    import xml.etree.ElementTree as ET

    where = dict(zip(cell.robot.joints, row, strict=True))
    q = np.zeros(model.nq)
    for one in ET.parse(cell.urdf_path).getroot().iter("joint"):
        tag, name = one.find("mimic"), one.get("name")
        if one.get("type") == "fixed":
            continue
        value = (
            where[name]
            if tag is None
            else float(tag.get("multiplier")) * where[tag.get("joint")] + float(tag.get("offset"))
        )
        q[model.joints[model.getJointId(name)].idx_q] = value
    return q


@pytest.mark.parametrize("robot", ROBOTS)
def test_kinematics_and_weight_are_pinocchios(tmp_path: Path, robot: str) -> None:
    cell = cell_of(robot, tmp_path)
    chain = chain_of(cell)
    q = postures_of(chain)
    at, weight = posture(chain, q), gravity_torque(chain, posture(chain, q))
    jacobian = linear_jacobian(at, at.point(POINT))
    model = pin.buildModelFromUrdf(str(cell.urdf_path))
    model.gravity.linear = chain.gravity.copy()
    data, frame = model.createData(), model.getFrameId("flange")
    assert model.nq == chain.whole.n
    drives = np.stack(
        [expanded(cell, model, row) - expanded(cell, model, np.zeros(chain.n)) for row in np.eye(chain.n)]
    ).T
    order = [model.joints[model.getJointId(name)].idx_v for name in chain.whole.joints]
    np.testing.assert_allclose(chain.matrix, drives[order], atol=1e-15)
    assert pinocchio_model(chain).nq == chain.whole.n
    for k, row in enumerate(q):
        full = expanded(cell, model, row)
        pin.framesForwardKinematics(model, data, full)
        place = data.oMf[frame]
        np.testing.assert_allclose(at.flange[:, :, k].T, place.rotation, atol=1e-12)
        np.testing.assert_allclose(at.flange_origin[:, k], place.translation, atol=1e-12)
        of_all = pin.computeFrameJacobian(model, data, full, frame, pin.LOCAL_WORLD_ALIGNED)
        lever = place.rotation @ POINT
        moved = of_all[:3] - np.array([np.cross(lever, w) for w in of_all[3:].T]).T
        np.testing.assert_allclose(jacobian[:, :, k].T, moved @ drives, atol=1e-12)
        np.testing.assert_allclose(at.spins[:, :, k].T, of_all[3:] @ drives, atol=1e-12)
        held = pin.computeGeneralizedGravity(model, data, full)
        np.testing.assert_allclose(weight[:, k], -held @ drives, atol=1e-10)


@pytest.mark.parametrize("turns", [True, False])
def test_every_derivative_is_that_of_finite_differences(chain: Chain, *, turns: bool) -> None:
    q, load = postures_of(chain), load_on(4, turns=turns)
    at = posture(chain, q)

    np.testing.assert_allclose(
        np.moveaxis(linear_jacobian(at, at.point(POINT)), 0, -1),
        slopes(lambda x: posture(chain, x).point(POINT), q),
        atol=1e-8,
    )
    pulled = slopes(lambda x: load_torque(posture(chain, x), load), q)
    np.testing.assert_allclose(np.moveaxis(load_torque_derivative(at, load), 1, -1), pulled, atol=1e-5)
    sag = slopes(lambda x: gravity_torque(chain, posture(chain, x)), q)
    np.testing.assert_allclose(np.moveaxis(gravity_torque_derivative(chain, at), 1, -1), sag, atol=1e-5)

    compliance = 1e-6 * np.ones(chain.n)
    rest = solve_equilibrium(chain, q, compliance, load)
    moved = slopes(lambda x: _bent(chain, q, compliance, load, x[0]), compliance[None], 1e-10)
    np.testing.assert_allclose(
        np.moveaxis(rest.loaded_point_jacobian(POINT) * rest.torque, 1, -1), moved, rtol=1e-4, atol=1e-4
    )


def _bent(chain: Chain, q: Float2D, compliance: Float1D, load: Load, changed: Float1D) -> Float2D:
    return solve_equilibrium(chain, q, changed, load).at.point(POINT)


def test_the_equilibrium_has_the_least_potential_energy_with_springs_at_the_drivers_alone(chain: Chain) -> None:
    q, load = postures_of(chain, 2), load_on(2, turns=False)
    stiffness = np.linspace(2e4, 6e4, chain.n)
    rest = solve_equilibrium(chain, q, 1 / stiffness, load)
    model = pinocchio_model(chain)
    data = model.createData()

    for k, row in enumerate(q):
        start = posture(chain, row[None]).flange[:, :, 0].T

        def energy(theta: Float1D, row: Float1D = row, k: int = k) -> float:
            held = pin.computePotentialEnergy(model, data, chain.expanded((row + theta)[None])[0])
            point = posture(chain, (row + theta)[None]).point(POINT)[:, 0]
            return float(0.5 * theta @ (stiffness * theta) + held - load.force[:, k] @ point)

        free = Load(load.force, np.zeros_like(load.torque), POINT, None)  # a moment in base axes has no potential
        found = solve_equilibrium(chain, q, 1 / stiffness, free)
        least = minimize(energy, found.deflection[:, k] * 0.9, method="BFGS", options={"gtol": 1e-7})
        np.testing.assert_allclose(least.x, found.deflection[:, k], atol=2e-6)
        assert energy(found.deflection[:, k]) <= energy(np.zeros(chain.n))
        assert start.shape == (3, 3)
    assert rest.deflection.shape == (chain.n, 2)


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_simulator_of_other_physics_says_the_same(tmp_path: Path, robot: str) -> None:
    cell = cell_of(robot, tmp_path)
    chain, stiffness = chain_of(cell), np.linspace(2e4, 6e4, len(JOINTS[robot]))
    theirs = read_chain(cell)
    np.testing.assert_allclose(theirs.limits, chain.limits)
    mechanism = Mechanism(theirs, stiffness, cell.gravity, wrench_point=POINT)
    q, load = postures_of(chain), load_on(4, turns=False)
    rest = solve_equilibrium(chain, q, 1 / stiffness, load)
    _, _, flange = mechanism.postures(q)
    np.testing.assert_allclose(flange.T, posture(chain, q).flange_origin, atol=1e-12)
    jacobian = linear_jacobian(posture(chain, q), posture(chain, q).flange_origin)
    np.testing.assert_allclose(mechanism.jacobians(q)[:, :3], np.moveaxis(jacobian, (0, 2), (2, 0)), atol=1e-12)
    for k, row in enumerate(q):
        found = mechanism.equilibrium(row, np.concatenate([load.force[:, k], load.torque[:, k]]))
        np.testing.assert_allclose(found.deflection, rest.deflection[:, k], rtol=1e-6, atol=1e-10)
        np.testing.assert_allclose(found.flange.translation, rest.at.flange_origin[:, k], atol=1e-9)
