"""Columns of the effects on absolute positions against finite differences of the kinematics, and back from a file."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from states import state_at

from calibration_core.cell import Cell
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.chain import Chain
from calibration_core.model.effects import candidates
from calibration_core.model.effects.absolute.approach_direction import last_motion
from calibration_core.model.effects.absolute.geometry_error import frame_error
from calibration_core.model.effects.absolute.joint_elasticity import turned
from calibration_core.model.effects.absolute.transmission_error import HIGHEST, distinguishable_orders, harmonic
from calibration_core.model.effects.applied import applied, applied_shift, restored
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.state import State
from calibration_core.model.effects.structure.gravity_compensator import spring_torque
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.identified.model_file import model_text, read_model
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Provenance, Readings

ROWS = ((0.33, -np.pi / 2, 0.645), (1.15, 0.0, 0.0), (0.115, -np.pi / 2, 0.0),
        (0.0, np.pi / 2, 1.22), (0.0, -np.pi / 2, 0.0), (0.0, 0.0, 0.215))  # fmt: skip
POINT = np.array([0.11, -0.06, 0.12])
SMALL = 1e-6
M = 40


@pytest.fixture(scope="module")
def cell() -> Cell:
    robot = {
        "name": "test robot",
        "dh": [{"a": a, "alpha": alpha, "d": d} for a, alpha, d in ROWS],
        "joints": [f"joint_{i + 1}" for i in range(6)],
        "joint_limits": [[-3.0, 3.0]] * 6,
        "rated_load": 100.0,
        "inertials": [{"mass": mass, "com": [-0.1, 0.05, 0.02]} for mass in (180.0, 220.0, 120.0, 40.0, 20.0, 10.0)],
    }
    return Cell.model_validate(
        {"name": "test", "robot": robot, "frames": {"measurement_points": {"mp1": POINT.tolist()}},
         "instruments": {"tracker": {"sigma": 2e-5}}}
    )  # fmt: skip


@pytest.fixture(scope="module")
def chain(cell: Cell) -> Chain:
    return chain_of(cell)


@pytest.fixture(scope="module")
def q() -> np.ndarray:
    return np.random.default_rng(0).uniform(-1.6, 1.6, (M, 6))


def make_state(chain: Chain, q: np.ndarray, compliance: float = 0.0) -> State:
    m = len(q)
    warm = {"time": np.full(m, np.nan), "temperature": np.linspace(18, 27, m)}
    return state_at(chain, q, compliance, point=POINT, rated_load=100.0, **warm)


def at(chain: Chain, q: np.ndarray) -> np.ndarray:
    return posture(chain, q).point(POINT).T


def find(state: State, effect: str, **wanted: str) -> Candidate:
    return next(
        c for c in candidates(state)
        if c.effect == effect and all(c.location.get(key, c.variant) == value for key, value in wanted.items())
    )  # fmt: skip


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("order", [1, 17])
def test_transmission_error(chain: Chain, q: np.ndarray, joint: int, order: int) -> None:
    columns = harmonic(joint, chain.joints[joint], order, 100.0).columns(make_state(chain, q))
    for k, wave in enumerate((np.sin, np.cos)):
        turned_on = q.copy()
        turned_on[:, joint] += SMALL * wave(order * q[:, joint])
        assert np.allclose(columns[..., k], (at(chain, turned_on) - at(chain, q)) / SMALL, atol=1e-5)


def test_orders_that_the_sampling_carries() -> None:
    assert distinguishable_orders(np.linspace(-1.5, 1.5, 31)) == 31  # 30 intervals over 3 rad: half a period each
    assert distinguishable_orders(np.repeat([0.0, 0.5, 1.0], 50)) == 6  # repeated angles are one sample
    assert distinguishable_orders(np.zeros(100)) == 0
    assert distinguishable_orders(np.random.default_rng(1).uniform(-1, 1, 5000)) == HIGHEST


def test_approach_direction(chain: Chain, q: np.ndarray) -> None:
    state = make_state(chain, q)
    candidate = find(state, "approach_direction", joint="joint_2")
    moved = q.copy()
    moved[1:, 1] += SMALL * np.sign(np.diff(q[:, 1]))
    assert np.allclose(candidate.columns(state)[..., 0], (at(chain, moved) - at(chain, q)) / SMALL, atol=1e-5)
    whole = find(state, "approach_direction", robot="all joints")
    assert whole.columns(state).shape == (M, 3, 6)
    assert np.array_equal(whole.columns(state)[..., 1], candidate.columns(state)[..., 0])


def test_a_joint_keeps_its_side_until_it_travelled_the_reversal() -> None:
    q = np.array([[0.0], [0.1], [0.0995], [0.0991], [0.0988], [0.3], [0.3], [0.2995]])
    assert last_motion(q, 1e-3).ravel().tolist() == [0, 1, 1, 1, -1, 1, 1, 1]
    assert last_motion(np.zeros((3, 2)), 1e-3).tolist() == [[0, 0]] * 3


def test_wrist_coupling(chain: Chain, q: np.ndarray) -> None:
    state = make_state(chain, q)
    found = {(c.location["joint"], c.variant) for c in candidates(state) if c.effect == "wrist_coupling"}
    assert found == {("joint_5", "follows joint_4"), ("joint_6", "follows joint_4"), ("joint_6", "follows joint_5")}
    moved = q.copy()
    moved[:, 4] += SMALL * q[:, 3]
    columns = find(state, "wrist_coupling", joint="joint_5").columns(state)[..., 0]
    assert np.allclose(columns, (at(chain, moved) - at(chain, q)) / SMALL, atol=1e-5)


def test_thermal_growth_of_the_arm_is_a_scale_up_to_the_flange(chain: Chain, q: np.ndarray) -> None:
    state = make_state(chain, q)
    grown = dataclasses.replace(
        chain, translation=chain.translation * (1 + SMALL), flange_translation=chain.flange_translation * (1 + SMALL)
    )
    change = (posture(grown, q).point(POINT).T - at(chain, q)) / SMALL
    columns = find(state, "thermal_growth", robot="arm").columns(state)[..., 0]
    assert np.allclose(columns, (state.temperature - 20.0)[:, None] * change, atol=1e-4)
    links = [c for c in candidates(state) if c.effect == "thermal_growth" and "link" in c.location]
    parts = [c.columns(state)[..., 0] for c in links]
    assert np.allclose(sum(parts), columns)


def test_no_growth_without_temperatures(chain: Chain, q: np.ndarray) -> None:
    blind = dataclasses.replace(make_state(chain, q), temperature=np.full(M, np.nan))
    assert not [c for c in candidates(blind) if c.effect == "thermal_growth"]


@pytest.mark.parametrize("joint", range(1, 6))
def test_joint_elasticity_against_the_equilibrium(chain: Chain, q: np.ndarray, joint: int) -> None:
    state = make_state(chain, q)
    compliance = np.zeros(6)
    compliance[joint] = 1e-10
    sag = (solve_equilibrium(chain, q, compliance, None).at.point(POINT).T - at(chain, q)) / 1e-10
    columns = find(state, "joint_elasticity", joint=chain.joints[joint]).columns(state)[..., 0]
    assert np.allclose(columns, sag, atol=1e-4 * np.abs(sag).max())


def test_turned_gravity_is_perpendicular_and_of_the_same_size() -> None:
    gravity = np.array([1.0, -2.0, -9.5])
    for other in turned(gravity):
        assert np.isclose(other @ gravity, 0.0)
        assert np.isclose(np.linalg.norm(other), np.linalg.norm(gravity))


def test_tool_weight_against_the_equilibrium(chain: Chain, q: np.ndarray) -> None:
    state = make_state(chain, q, compliance=1e-8)
    mass, com = chain.mass.copy(), chain.com.copy()
    centre = chain.flange_rotation @ POINT + chain.flange_translation  # in the last link's body frame
    com[-1] = (mass[-1] * com[-1] + 0.1 * centre) / (mass[-1] + 0.1)
    mass[-1] += 0.1
    heavier = dataclasses.replace(chain, mass=mass, com=com)
    before, after = (solve_equilibrium(c, q, np.full(6, 1e-8), None).at.point(POINT).T for c in (chain, heavier))
    columns = find(state, "tool_weight", tool="tool").columns(state)
    moved = columns @ (0.1 * np.concatenate([[1.0], POINT]))
    assert np.allclose(moved, after - before, atol=1e-3 * np.abs(after - before).max())


def test_cable_force_pulls_towards_the_holder(chain: Chain, q: np.ndarray) -> None:
    state = make_state(chain, q, compliance=1e-8)
    candidate = find(state, "cable_force", variant="held at joint_3")
    pull = state.at.origin[2] - state.at.flange_origin
    pull = pull / np.linalg.norm(pull, axis=0)
    work = []  # Maxwell and Betti: the flange answers a unit force along the pull with the same work
    for joint in range(6):
        lever = np.cross(state.at.axis(joint).T, (state.at.flange_origin - state.at.origin[joint]).T)
        work.append(np.sum(lever * pull.T, axis=1) * 1e-8)
    moved = sum(state.joint_column(joint, deflection) for joint, deflection in enumerate(work))
    assert np.allclose(candidate.columns(state)[..., 0], moved, atol=1e-12)
    assert not [c for c in candidates(make_state(chain, q)) if c.effect in {"cable_force", "tool_weight"}]


def test_geometry_error(chain: Chain, q: np.ndarray) -> None:
    columns = frame_error(2, "joint_3", 100.0).columns(make_state(chain, q))
    for kind in range(6):
        geometry = np.zeros((6, 6))
        geometry[2, kind] = SMALL
        change = (at(chain.corrected(geometry), q) - at(chain, q)) / SMALL
        assert np.allclose(columns[..., kind], change, atol=1e-5)


def test_effects_come_back_from_their_file_and_predict(cell: Cell, chain: Chain, q: np.ndarray, tmp_path) -> None:
    state = make_state(chain, q)
    rng = np.random.default_rng(3)
    chosen = [
        harmonic(1, "joint_2", 17, 100.0),
        find(state, "approach_direction", robot="all joints"),
        find(state, "approach_direction", joint="joint_1"),
        find(state, "wrist_coupling", joint="joint_5"),
        find(state, "thermal_growth", link="link_3"),
    ]
    effects = tuple(applied(c, 1e-5 * rng.standard_normal(len(c.parameters)), state) for c in chosen)
    parameters = nominal_parameters(cell).replace(effects=effects)
    path = tmp_path / "model.yaml"
    path.write_text(model_text(parameters, cell), encoding="utf-8")
    again = read_model(path, cell)
    assert again.effects == effects
    assert np.allclose(applied_shift(again.effects, state), applied_shift(effects, state))
    readings = Readings(
        points=("mp1",), configuration=np.arange(M), step=np.zeros(M, dtype=np.int64),
        point=np.zeros(M, dtype=np.int64),
        q=q, position=np.zeros((M, 3)), wrench=None, time=np.full(M, np.nan), temperature=state.temperature,
        provenance=Provenance("made", "csv", {}, {}),
    )  # fmt: skip
    shift = predict_readings(readings, cell, again) - predict_readings(readings, cell, again.replace(effects=()))
    assert np.allclose(shift, applied_shift(effects, state), atol=1e-12)  # tracker in the base frame


def test_what_a_recording_cannot_carry_is_refused(chain: Chain, q: np.ndarray) -> None:
    state = make_state(chain, q)
    growth = applied(find(state, "thermal_growth", robot="arm"), np.array([1e-5]), state)
    blind = dataclasses.replace(state, temperature=np.full(M, np.nan))
    with pytest.raises(ValueError, match="thermal_growth"):
        restored(growth, blind)


def test_a_compensator_pulls_as_the_slope_of_its_spring_energy() -> None:
    side, arm, free = 0.2, 0.75, 0.45

    def energy(angle: np.ndarray) -> np.ndarray:
        return 0.5 * (np.sqrt(side**2 + arm**2 + 2 * side * arm * np.cos(angle)) - free) ** 2

    angle = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    slope = -(energy(angle + SMALL) - energy(angle - SMALL)) / (2 * SMALL)
    size = side**2 + arm**2
    seen = spring_torque(angle, 2 * side * arm / size, free / np.sqrt(size))
    np.testing.assert_allclose(seen, slope / np.abs(slope).max(), atol=1e-6)
