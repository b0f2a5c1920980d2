"""Equilibrium against closed forms, and what must hold for any robot."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from scipy.optimize import brentq

from calibration_core.cell import Cell
from calibration_core.errors import EquilibriumError
from calibration_sim.cell.configurations import random_protocol
from calibration_sim.cell.table import build_mechanism
from calibration_sim.cell.truth import draw_truth
from calibration_sim.mechanics.chain import Chain, read_chain
from calibration_sim.mechanics.statics import Mechanism

G = 9.80665
GRAVITY = np.array([0.0, 0.0, -G])
Planar = Callable[[list[float], list[float]], Chain]


def test_cantilever_under_its_own_weight(planar: Planar) -> None:
    """One link: K theta = -m g L cos(theta), root found by bisection."""
    stiffness, mass, length = 5e3, 40.0, 1.2
    rest = Mechanism(planar([length], [mass]), [stiffness], GRAVITY).equilibrium([0.0])
    expected = brentq(lambda t: stiffness * t + mass * G * length * np.cos(t), -0.5, 0.0, xtol=1e-15)
    assert rest.deflection[0] == pytest.approx(expected, rel=1e-10)
    assert rest.deflection[0] < 0.0
    assert rest.torque[0] == pytest.approx(-stiffness * rest.deflection[0], rel=1e-11)
    assert rest.flange.translation == pytest.approx([length * np.cos(expected), 0.0, length * np.sin(expected)])


def test_cantilever_under_a_pure_torque(planar: Planar) -> None:
    """A torque about the axis deflects by torque over stiffness, whatever the arm; one across it does nothing."""
    mechanism = Mechanism(planar([0.8], [0.0]), [2e4], np.zeros(3))
    assert mechanism.equilibrium([0.3], [0, 0, 0, 0, -50.0, 0]).deflection[0] == pytest.approx(50.0 / 2e4, rel=1e-11)
    assert mechanism.equilibrium([0.3], [0, 0, 0, 70.0, 0, 30.0]).deflection[0] == pytest.approx(0.0, abs=1e-14)


def test_two_links_in_a_plane(planar: Planar) -> None:
    """Two links with weights and a tip force: residuals of the textbook torques vanish at the deflected pose."""
    lengths, masses, stiffness = [1.0, 0.7], [30.0, 15.0], np.array([3e4, 1e4])
    force = np.array([120.0, 0.0, -300.0])
    q = np.array([0.4, -0.9])
    rest = Mechanism(planar(lengths, masses), stiffness, GRAVITY).equilibrium(q, [*force, 0, 0, 0])
    first, second = np.cumsum(q + rest.deflection)
    elbow = lengths[0] * np.array([np.cos(first), np.sin(first)])
    fore = lengths[1] * np.array([np.cos(second), np.sin(second)])
    pull = force[[0, 2]]

    def moment(arm: np.ndarray, f: np.ndarray) -> float:
        return float(arm[0] * f[1] - arm[1] * f[0])

    weights = [np.array([0.0, -m * G]) for m in masses]
    second_torque = moment(fore, weights[1]) + moment(fore, pull)
    first_torque = moment(elbow, weights[0]) + moment(elbow + fore, weights[1]) + moment(elbow + fore, pull)
    assert stiffness * rest.deflection == pytest.approx([first_torque, second_torque], rel=1e-10)
    tip = elbow + fore
    assert rest.flange.translation == pytest.approx([tip[0], 0.0, tip[1]], abs=1e-14)


def test_gravity_sags_and_turns_with_gravity(planar: Planar) -> None:
    chain = planar([1.0, 1.0], [10.0, 10.0])
    down = Mechanism(chain, [1e5, 1e5], GRAVITY).equilibrium([0.0, 0.0])
    up = Mechanism(chain, [1e5, 1e5], -GRAVITY).equilibrium([0.0, 0.0])
    assert np.all(down.deflection < 0.0)
    assert up.deflection == pytest.approx(-down.deflection, rel=1e-10)
    assert down.flange.translation[2] < 0.0 < up.flange.translation[2]


def test_wrench_acts_at_the_wrench_point(planar: Planar) -> None:
    """A force beside the flange equals the force at the flange plus its moment."""
    chain, q = planar([1.0, 0.6], [0.0, 0.0]), [0.2, 0.5]
    arm = np.array([0.0, 0.1, 0.3])
    force = np.array([50.0, 20.0, -200.0])
    beside = Mechanism(chain, [1e5, 5e4], np.zeros(3), wrench_point=arm).equilibrium(q, [*force, 0, 0, 0])
    moment = np.cross(beside.flange.rotation @ arm, force)
    at = Mechanism(chain, [1e5, 5e4], np.zeros(3)).equilibrium(q, [*force, *moment])
    assert beside.deflection == pytest.approx(at.deflection, rel=1e-9)


@pytest.mark.parametrize("name", ["demo", "small"])
def test_balance_of_mujocos_own_forces(name: str, request: pytest.FixtureRequest) -> None:
    """At the solution, a full forward pass of MuJoCo with the wrench applied leaves no acceleration."""
    cell: Cell = request.getfixturevalue(name)
    truth = draw_truth(cell, 3)
    mechanism = build_mechanism(cell, truth)
    for configuration in random_protocol(cell, 6, 3).configurations:
        wrench = configuration.wrenches[4]
        rest = mechanism.equilibrium(configuration.q, wrench)
        assert rest.residual <= 1e-9
        model, data = mechanism.model, mujoco.MjData(mechanism.model)
        data.qpos[:] = configuration.q + rest.deflection
        mujoco.mj_forward(model, data)
        body = model.body("flange").id
        point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ truth.wrench_point
        load = np.zeros(model.nv)
        mujoco.mj_applyFT(model, data, wrench[:3], wrench[3:], point, body, load)
        unbalanced = data.qfrc_passive - data.qfrc_bias + load
        assert np.max(np.abs(unbalanced)) <= 1e-9 * np.max(np.abs(data.qfrc_passive))
        assert data.qfrc_passive == pytest.approx(-truth.stiffness * rest.deflection, rel=1e-6, abs=1e-5)


def test_reversed_load_flips_the_deflection_to_first_order(demo: Cell) -> None:
    """The even part is second order: a tenth of the load leaves a hundredth of it."""
    truth = draw_truth(demo, 1)
    mechanism = build_mechanism(demo, truth)
    q = random_protocol(demo, 1, 1).configurations[0].q
    wrench = np.array([900.0, -600.0, -2000.0, 0.0, 0.0, 0.0])
    unloaded = mechanism.equilibrium(q).deflection
    even = {}
    for share in (1.0, 0.1):
        forth = mechanism.equilibrium(q, share * wrench).deflection - unloaded
        back = mechanism.equilibrium(q, -share * wrench).deflection - unloaded
        even[share] = np.linalg.norm(forth + back)
        assert even[share] < 0.02 * np.linalg.norm(forth)
    assert even[0.1] == pytest.approx(0.01 * even[1.0], rel=0.05)


def test_deflection_grows_with_gravity_and_load_as_in_the_compliance(demo: Cell) -> None:
    """Doubling all springs halves the deflection under load to first order."""
    chain, q = read_chain(demo), [0.2, 0.1, -0.1, 0.4, 0.6, 0.2]
    stiffness = np.array(demo.robot.stiffness)
    wrench = [500.0, 500.0, -1500.0, 0.0, 0.0, 0.0]
    soft, hard = (Mechanism(chain, k * stiffness, demo.gravity).equilibrium(q, wrench).deflection for k in (1.0, 2.0))
    assert hard == pytest.approx(soft / 2.0, rel=0.02)


def test_encoder_offset_is_a_turned_joint(planar: Planar) -> None:
    chain = planar([1.0, 0.5], [20.0, 5.0])
    offset = np.array([0.02, -0.01])
    shifted = Mechanism(chain, [1e5, 1e5], GRAVITY, joint_zero=offset).equilibrium([0.3, 0.4])
    plain = Mechanism(chain, [1e5, 1e5], GRAVITY).equilibrium(np.array([0.3, 0.4]) + offset)
    assert shifted.flange.translation == pytest.approx(plain.flange.translation, abs=1e-13)
    assert shifted.deflection == pytest.approx(plain.deflection, abs=1e-13)


def test_joint_frame_errors_shift_and_turn_in_the_joints_own_axes(planar: Planar) -> None:
    """With joint 0 turned by 90 degrees, a shift of joint 1's frame along its nominal x lifts everything behind it."""
    chain = planar([1.0, 0.5], [0.0, 0.0])
    errors = np.zeros((2, 6))
    errors[1, 0] = 0.01
    errors[1, 5] = 0.02
    place = Mechanism(chain, [1.0, 1.0], np.zeros(3), joint_frame_errors=errors).forward([np.pi / 2, 0.0])
    lift = 1.0 + 0.01 + 0.5 * np.cos(0.02)
    assert place.translation == pytest.approx([0.0, 0.5 * np.sin(0.02), lift], abs=1e-12)


def test_a_load_beyond_the_springs_is_refused(planar: Planar) -> None:
    mechanism = Mechanism(planar([1.0, 1.0, 1.0], [0.0, 0.0, 0.0]), [1.0, 1.0, 1.0], np.zeros(3))
    with pytest.raises(EquilibriumError):
        mechanism.equilibrium([0.0, 0.0, 0.0], [-1e12, 0.0, 1e12, 0.0, 1e12, 0.0])


def test_jacobian_against_differences(small: Cell) -> None:
    mechanism = Mechanism(read_chain(small), small.robot.stiffness, small.gravity)
    rng = np.random.default_rng(0)
    q, point, step = rng.uniform(-1.0, 1.0, 6), np.array([0.1, -0.2, 0.3]), 1e-6
    jacobian = mechanism.jacobian(q, point)
    for i in range(6):
        forth, back = (mechanism.forward(q + s * step * np.eye(6)[i]) for s in (1.0, -1.0))
        linear = (forth.apply(point) - back.apply(point)) / (2 * step)
        turned = (forth.rotation - back.rotation) / (2 * step) @ mechanism.forward(q).rotation.T
        assert jacobian[:3, i] == pytest.approx(linear, abs=1e-8)
        assert jacobian[3:, i] == pytest.approx([turned[2, 1], turned[0, 2], turned[1, 0]], abs=1e-8)
