"""Kinematics, statics and bodies of robots with mimic joints, against pinocchio, MuJoCo and finite differences."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from mimicking import COLUMN, JOINTS, POINT, ROBOTS, cell_of, mimic, postures_of
from scipy.optimize import minimize

from calibration_core.cell import Cell
from calibration_core.compensation.robot import with_payload
from calibration_core.errors import CellError
from calibration_core.model.chain import Chain
from calibration_core.model.effects import effect_named
from calibration_core.model.effects.absolute.joint_zero_offset import zero_offset
from calibration_core.model.effects.state import State, state_of
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.kinematics import linear_jacobian, posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of, pinocchio_model
from calibration_core.model.statics import (
    Load,
    gravity_torque,
    gravity_torque_derivative,
    load_torque,
    load_torque_derivative,
)
from calibration_core.model.virtual_joints import before_joint, behind_joint, rotation_twist, translation_twist, work
from calibration_core.motion.speed import Monitored
from calibration_core.motion.trajectory import MotionLimits, plan_motion
from calibration_core.planning.feasible.collision import CollisionModel
from calibration_core.planning.feasible.space import Site, SpaceRules
from calibration_core.timeseries import Float1D, Float2D
from calibration_sim.mechanics.chain import read_chain
from calibration_sim.mechanics.statics import Mechanism


@pytest.fixture(params=ROBOTS)
def chain(request: pytest.FixtureRequest, tmp_path: Path) -> Chain:
    return chain_of(cell_of(request.param, tmp_path))


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
    free = Load(load.force, np.zeros_like(load.torque), POINT, None)  # a moment in base axes has no potential
    found = solve_equilibrium(chain, q, 1 / stiffness, free)
    model = pinocchio_model(chain)
    data = model.createData()

    for k, row in enumerate(q):

        def energy(theta: Float1D, row: Float1D = row, k: int = k) -> float:
            held = pin.computePotentialEnergy(model, data, chain.expanded((row + theta)[None])[0])
            point = posture(chain, (row + theta)[None]).point(POINT)[:, 0]
            return float(0.5 * theta @ (stiffness * theta) + held - load.force[:, k] @ point)

        least = minimize(energy, found.deflection[:, k] * 0.9, method="BFGS", options={"gtol": 1e-7})
        np.testing.assert_allclose(least.x, found.deflection[:, k], atol=2e-6)
        assert energy(found.deflection[:, k]) <= energy(np.zeros(chain.n))


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


def state_at(chain: Chain, q: Float2D, load: Load | None) -> State:
    m, wrench = len(q), None if load is None else np.vstack([load.force, load.torque]).T
    steps, nothing = np.arange(m), np.full(m, np.nan)
    return state_of(
        chain, q, np.full(chain.n, 2e-5), load, np.tile(POINT[:, None], (1, m)),
        point_index=np.zeros(m, dtype=np.int64), wrench=wrench, configuration=steps, step=np.zeros(m, dtype=np.int64),
        time=nothing, temperature=nothing, tracker=np.eye(4), rated_load=10.0,
    )  # fmt: skip


@pytest.mark.parametrize("turns", [True, False])
def test_a_cut_before_a_joint_answers_as_the_moved_frame_of_that_joint_does(chain: Chain, *, turns: bool) -> None:
    q, load = postures_of(chain), load_on(4, turns=turns)
    state = state_at(chain, q, load)
    for joint in range(chain.n):
        answer = state.virtual.answer(before_joint(chain.stage(joint)))
        for kind in range(6):
            axis, h, row = state.at.before[joint, kind % 3], 1e-6, np.zeros((chain.n, 6))
            row[joint, kind] = h
            ends = [
                solve_equilibrium(chain.corrected(sign * row), q, state.compliance, load).at.point(POINT)
                for sign in (1, -1)
            ]
            twist = translation_twist(axis) if kind < 3 else rotation_twist(axis, state.at.origin[joint])
            moved = np.einsum("akm,km->am", answer, twist)
            np.testing.assert_allclose(moved, (ends[0] - ends[1]) / (2 * h), rtol=1e-5, atol=1e-6)


def test_a_cut_behind_a_joint_carries_what_the_joint_and_those_that_mimic_it_carry(chain: Chain) -> None:
    state = state_at(chain, postures_of(chain), load_on(4, turns=False))
    whole = state.at.whole
    assert whole is not None
    acting = np.stack([
        work(np.concatenate(whole.screw(k)), state.virtual.wrench(behind_joint(k))) for k in range(chain.whole.n)
    ])  # fmt: skip
    np.testing.assert_allclose(chain.matrix.T @ acting, state.torque, rtol=1e-10, atol=1e-10)


def test_a_wrong_zero_moves_what_mimics_the_joint_too(chain: Chain) -> None:
    q, load = postures_of(chain), load_on(4, turns=False)
    loaded, free = state_at(chain, q, load), state_at(chain, q, None)
    both = dataclasses.replace(loaded, configuration=np.zeros(4, dtype=np.int64), step=np.arange(4))
    moved = slopes(lambda x: solve_equilibrium(chain, x, loaded.compliance, load).at.point(POINT), q)
    for joint, name in enumerate(chain.joints):
        columns = zero_offset(joint, name, 10.0).columns(both)[:, :, 0]
        np.testing.assert_allclose(columns.T, moved[..., joint] - moved[:, :1, joint], rtol=1e-5, atol=1e-6)
    mass = next(effect_named("tool_weight").candidates(free)).columns(free)
    heavier = Load(np.tile(9.80665 * np.array([[0.0], [0.0], [-1e-3]]), (1, 4)), np.zeros((3, 4)), np.zeros(3), None)
    ends = [solve_equilibrium(chain, q, free.compliance, one).at.point(POINT) for one in (heavier, None)]
    np.testing.assert_allclose(1e3 * (ends[0] - ends[1]), mass[:, :, 0].T, rtol=1e-3, atol=1e-8)


def test_without_masses_a_joint_sags_by_the_moments_of_all_links_that_it_turns(tmp_path: Path) -> None:
    chain = chain_of(cell_of("parallelogram", tmp_path))
    assert chain.mass is not None
    light = dataclasses.replace(chain, mass=np.where(np.arange(6) > 3, 0.0, chain.mass))  # the wrist is lumped together
    known = state_at(light, postures_of(light, 30), None)
    mimics = tuple(dataclasses.replace(one, mass=None, com=None) for one in chain.mimics)
    unknown = dataclasses.replace(known, chain=dataclasses.replace(chain, mass=None, com=None, mimics=mimics))
    offered = list(effect_named("joint_elasticity").candidates(unknown))
    assert [one.location["joint"] for one in offered] == [f"joint_{i}" for i in range(2, 7)]
    for joint, candidate in enumerate(offered[:3], start=1):
        columns = candidate.columns(unknown)
        assert columns.shape[2] == len(candidate.parameters)
        flat, sag = (
            columns.reshape(-1, columns.shape[2]),
            known.joint_column(joint, known.gravity_torque[joint]).ravel(),
        )
        found, *_ = np.linalg.lstsq(flat, sag, rcond=None)
        np.testing.assert_allclose(flat @ found, sag, atol=1e-9 * np.abs(sag).max())


def test_what_lifts_weight_without_masses_is_not_offered(tmp_path: Path) -> None:
    chain = chain_of(cell_of("odd", tmp_path))
    mimics = tuple(dataclasses.replace(one, mass=None, com=None) for one in chain.mimics)
    bare = dataclasses.replace(chain, mass=None, com=None, mimics=mimics)
    offered = effect_named("joint_elasticity").candidates(state_at(bare, postures_of(bare), None))
    assert [one.location["joint"] for one in offered] == ["b", "d"]  # a drives a spindle, c slides


def test_a_payload_weighs_where_the_flange_is(chain: Chain) -> None:
    q, centre = postures_of(chain), np.array([0.1, 0.02, 0.05])
    heavier = with_payload(chain, (4.0, *centre))
    at = posture(chain, q)
    weight = Load(np.tile(4.0 * chain.gravity[:, None], (1, 4)), np.zeros((3, 4)), centre, None)
    np.testing.assert_allclose(
        gravity_torque(heavier, at) - gravity_torque(chain, at), load_torque(at, weight), atol=1e-10
    )


def test_speeds_and_their_bounds_count_what_mimics_a_joint(chain: Chain) -> None:
    rng = np.random.default_rng(2)
    points = ModelParameters(
        joints=chain.joints, compliance=np.zeros(chain.n), geometry=np.zeros((chain.n, 6)), tracker=np.eye(4),
        force_torque=None, wrench_point=POINT, points={"mp1": np.array([0.1, 0.0, 0.05])},
    )  # fmt: skip
    monitored = Monitored.of(chain, points, None)
    assert [name for name in monitored.names if name.endswith(chain.mimics[0].name)]
    q, rate = postures_of(chain, 30), rng.normal(size=(30, chain.n))

    def places(angles: Float2D) -> Float2D:
        at = posture(chain, angles)
        assert at.whole is not None
        return np.stack([*at.whole.origin, *(at.point(point) for point in monitored.points)])

    step = 1e-5
    ahead, here, behind = places(q + step * rate), places(q), places(q - step * rate)
    speed = np.linalg.norm(ahead - behind, axis=1).T / (2 * step)
    np.testing.assert_allclose(monitored.speeds(q, rate), speed, atol=1e-7)
    assert np.all(speed <= np.abs(rate) @ monitored.lever.T + 1e-7)
    bent = np.linalg.norm(ahead - 2 * here + behind, axis=1).T / step**2
    assert np.all(bent <= np.array([monitored.bending(row) for row in rate]) + 1e-3)
    for start, end in itertools.pairwise(q[:6]):
        moved = plan_motion(monitored, start, end, MotionLimits())
        times = np.linspace(0.0, moved.time[-1], 400)
        at, velocity = moved.at(times)
        assert monitored.speeds(at, velocity).max() <= 0.25
        apart = np.linalg.norm(np.diff(places(at), axis=2), axis=1) / np.diff(times)
        assert apart.max() <= 0.25


def test_bodies_stand_where_the_posture_says_and_move_no_farther_than_their_bound(tmp_path: Path) -> None:
    for robot in ROBOTS:
        cell = cell_of(robot, tmp_path)
        chain = chain_of(cell)
        model = CollisionModel.of(
            cell, dataclasses.replace(Site.of(chain, nominal_parameters(cell), cell), floor=None), SpaceRules()
        )
        q = postures_of(chain, 8)
        assert model.clear(q).shape == (8,)
        data, found = model.model.createData(), model.geometry.createData()
        whole = posture(chain, q).whole
        assert whole is not None
        centres = []
        for k, row in enumerate(chain.expanded(q)):
            pin.updateGeometryPlacements(model.model, data, model.geometry, found, row)
            for joint in range(chain.whole.n):
                np.testing.assert_allclose(data.oMi[joint + 1].translation, whole.body_origin[joint, :, k], atol=1e-12)
            centres.append([place.translation.copy() for place in found.oMg])
        for k in range(7):
            apart = np.linalg.norm(np.subtract(centres[k + 1], centres[k]), axis=1)
            assert apart.max() <= np.abs(q[k + 1] - q[k]) @ model.sweep + 1e-9


def test_the_drivers_limits_are_narrowed_by_those_of_what_mimics_them(tmp_path: Path) -> None:
    np.testing.assert_allclose(chain_of(cell_of("column", tmp_path)).limits[0], [0.0, 0.34])  # (0.2 - 0.03) / 0.5
    np.testing.assert_allclose(chain_of(cell_of("parallelogram", tmp_path)).limits[1], [-1.5, 1.2])  # -1.6 <= -q <= 1.2
    still = COLUMN.replace(mimic("lift", 0.5, 0.03), mimic("lift", 0.0, 0.12))
    chain = chain_of(cell_of("column", tmp_path, still))
    assert [one.name for one in chain.mimics] == ["stage_2"]
    np.testing.assert_allclose(chain.limits[0], [0.0, 0.35])
    at = (
        posture(chain, np.zeros((1, 7))).flange_origin
        - posture(chain_of(cell_of("column", tmp_path)), np.zeros((1, 7))).flange_origin
    )
    assert np.linalg.norm(at) == pytest.approx(0.09)


@pytest.mark.parametrize(
    ("old", "new", "place", "found"),
    [
        (mimic("lift"), mimic("stage_3"), "joint 'stage_2', mimic", "'stage_3', a mimic joint itself, of 'lift'"),
        (mimic("lift"), mimic("stage_2"), "joint 'stage_2', mimic", "a circle of mimic joints, stage_2 -> stage_2"),
        (mimic("lift"), mimic("on"), "joint 'stage_2', mimic", "'on', a fixed joint"),
        (mimic("lift"), mimic("nobody"), "joint 'stage_2', mimic", "'nobody', no joint of the URDF"),
        (mimic("lift"), "<mimic/>", "joint 'stage_2', mimic", "nothing"),
        (mimic("lift"), mimic("lift", 1.0, 3.0), "joint 'stage_2', limit", "[0, 0.5]"),
        ('<limit lower="0" upper="0.35"', mimic("joint_1") + '<limit lower="0" upper="0.35"', "robot.joints.0",
         "'lift', a mimic joint"),
        (mimic("lift"), '<mimic joint="lift" multiplier="x"/>', "multiplier", "'x'"),
    ],
)  # fmt: skip
def test_a_mimic_joint_that_cannot_be_used_is_refused_in_one_line(
    tmp_path: Path, old: str, new: str, place: str, found: str
) -> None:
    assert old in COLUMN
    cell = cell_of("column", tmp_path, COLUMN.replace(old, new, 1))
    with pytest.raises(CellError) as caught:
        chain_of(cell)
    assert "\n" not in str(caught.value)
    assert place in str(caught.value)
    assert found in str(caught.value)
