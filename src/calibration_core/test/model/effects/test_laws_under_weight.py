"""Laws of joints under load and weight together, at rest and under load, against their full equilibrium."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from states import COMPLIANCE, TIP, an_arm, state_at

from calibration_core.model.chain import Chain
from calibration_core.model.effects import candidates, catalogue
from calibration_core.model.effects.absolute.approach_direction import sides
from calibration_core.model.effects.applied import acting, with_side_torques
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.joint_law import hysteresis
from calibration_core.model.effects.joint_law.creep import relaxed
from calibration_core.model.effects.joint_law.hysteresis import CHANCE, stop
from calibration_core.model.effects.state import State
from calibration_core.model.effects.structure.gravity_compensator import Triangle, carriers, spring, spring_torque
from calibration_core.model.equilibrium import Equilibrium, solve_equilibrium
from calibration_core.model.statics import Load
from calibration_core.timeseries import Float1D, Float2D

N = 6
STEPS = 5  # of a loaded configuration: up and down
LOADED, RESTING = 6, 12  # configurations: a mixed recording


def a_chain(*gravity: float) -> Chain:
    """Return a robot with masses."""
    com = np.array([[0.2, 0, 0.4], [0.6, 0, 0.1], [0.05, 0.1, 0.2], [0, 0.3, 0.0], [0, 0, 0.05], [0, 0, 0.1]])
    return an_arm(gravity, mass=np.array([400.0, 350.0, 200.0, 90.0, 40.0, 15.0]), com=com)


@pytest.fixture(scope="module")
def chain() -> Chain:
    return a_chain(0.0, 0.0, -9.81)


def posture_and_load() -> tuple[Float2D, Load]:
    rng = np.random.default_rng(11)
    q = rng.uniform(-1.2, 1.2, (LOADED + RESTING, N))
    pull = rng.normal(size=(LOADED, 6)) * [1500, 1500, 1500, 200, 200, 200]
    steps = np.array([0.0, 0.5, 1.0, 0.5, 0.0])
    wrench = np.concatenate([np.repeat(pull, STEPS, axis=0) * np.tile(steps, LOADED)[:, None], np.zeros((RESTING, 6))])
    return np.concatenate([np.repeat(q[:LOADED], STEPS, axis=0), q[LOADED:]]), Load(
        wrench[:, :3].T, wrench[:, 3:].T, TIP, None
    )


def mixed(chain: Chain) -> State:
    q, load = posture_and_load()
    m = len(q)
    configuration = np.concatenate([np.repeat(np.arange(LOADED), STEPS), LOADED + np.arange(RESTING)])
    step = np.concatenate([np.tile(np.arange(STEPS), LOADED), np.zeros(RESTING, dtype=np.int64)])
    wrench = np.concatenate([load.force, load.torque]).T
    return state_at(
        chain, q, COMPLIANCE, load, wrench=wrench, configuration=configuration, step=step, time=np.arange(m) * 40.0
    )


def solved(chain: Chain, law: Callable[[Equilibrium, Float2D], Float2D]) -> Float2D:
    """Return the points of joints that deflect by C tau and by a law of torques and link angles, to equilibrium."""
    q, load = posture_and_load()
    extra = np.zeros((N, len(q)))
    for _ in range(12):
        rest = solve_equilibrium(chain, q + extra.T, COMPLIANCE, load)
        extra = law(rest, (q + extra.T + rest.deflection.T).T)
    return rest.at.point(TIP).T


def chosen(state: State, effect: str, variant: str, joint: str) -> Candidate:
    found = [c for e in catalogue() if e.name == effect for c in (e.forms or e.candidates)(state)]
    found = [c for c in found if c.variant == variant and c.location["joint"] == joint]
    assert len(found) == 1
    return found[0]


def check(chain: Chain, columns: Float2D, law: Callable[[Equilibrium, Float2D], Float1D], joint: int) -> None:
    """Compare a column with the difference that a small share of the law makes to the full equilibrium."""

    def only(share: float) -> Callable[[Equilibrium, Float2D], Float2D]:
        def extra(rest: Equilibrium, link: Float2D) -> Float2D:
            result = np.zeros((N, link.shape[1]))
            result[joint] = share * law(rest, link)
            return result

        return extra

    size = 1e-6 / np.abs(law(solve_equilibrium(chain, posture_and_load()[0], COMPLIANCE, posture_and_load()[1]),
                             posture_and_load()[0].T)).max()  # fmt: skip
    expected = (solved(chain, only(size)) - solved(chain, only(-size))) / (2 * size)
    np.testing.assert_allclose(columns, expected, atol=1e-3 * np.abs(expected).max())
    assert np.abs(expected[-RESTING:]).max() > 0  # it shows in postures at rest


def test_a_compensator_is_one_law_at_rest_and_under_load(chain: Chain) -> None:
    here = mixed(chain)
    shape = Triangle(40.0, 0.4, 0.6)
    columns = spring(here, 1, shape).columns(here)[:, :, 0]

    def torque(link: Float1D) -> Float1D:
        return spring_torque(np.radians(shape.anchor) - link, shape.flatness, shape.preload)

    check(chain, columns, lambda _, link: COMPLIANCE[1] * torque(link[1]), 1)
    # under load: the slope of the torque changes the stiffness of the joint
    first, full = np.arange(LOADED) * STEPS, np.arange(LOADED) * STEPS + 2
    turned = COMPLIANCE[1] * (here.torque[1][full] - here.torque[1][first])
    slope = (torque(here.q[full, 1] + 1e-6) - torque(here.q[full, 1] - 1e-6)) / 2e-6
    gained = COMPLIANCE[1] * (torque(here.q[full, 1] + COMPLIANCE[1] * here.torque[1][full])
                              - torque(here.q[first, 1] + COMPLIANCE[1] * here.torque[1][first]))  # fmt: skip
    np.testing.assert_allclose(gained, COMPLIANCE[1] * slope * turned, rtol=0.05)


def test_a_law_feels_what_a_spring_beside_its_joint_leaves_it_to_carry(chain: Chain) -> None:
    here, shape, size, share = mixed(chain), Triangle(40.0, 0.4, 0.6), -3000.0, 1e-3
    helped = with_side_torques(here, acting([spring(here, 1, shape)], [np.array([size, 0.0])]))
    law = chosen(helped, "nonlinear_stiffness", "total torque", "joint_2")
    reference = helped.largest_torque(1, "total torque")

    def extra(times: float) -> Callable[[Equilibrium, Float2D], Float2D]:
        def deflected(rest: Equilibrium, link: Float2D) -> Float2D:
            beside = size * spring_torque(np.radians(shape.anchor) - link[1], shape.flatness, shape.preload)
            result, carried = np.zeros((N, link.shape[1])), rest.torque[1] + beside
            result[1] = COMPLIANCE[1] * (beside - times * carried * (carried / reference) ** 2)
            return result

        return deflected

    expected = (solved(chain, extra(share)) - solved(chain, extra(-share))) / (2 * share)
    largest = np.abs(expected).max()
    np.testing.assert_allclose(law.columns(helped)[:, :, 0], expected, atol=0.01 * largest)
    assert np.abs(law.columns(here)[:, :, 0] - expected).max() > 0.1 * largest  # the weight alone is another torque
    assert with_side_torques(helped, ()).side_torque is None


def test_a_compensator_stands_at_the_joints_that_the_weight_loads() -> None:
    down = (0.0, 0.0, -9.81)
    assert carriers(mixed(a_chain(*down))) == (1,)
    assert carriers(mixed(a_chain(0.0, 0.0, 0.0))) == ()
    without = a_chain(*down)
    bare = Chain(**{f: getattr(without, f) for f in ("joints", "rotation", "translation", "offset", "flange_rotation",
                                                    "flange_translation", "limits", "gravity")})  # fmt: skip
    assert carriers(mixed(bare)) == (1,)
    wall = mixed(a_chain(9.81, 0.0, 0.0))  # mounted at a wall: joint A bears the arm
    assert 0 in carriers(wall)
    assert {c.location["joint"] for c in candidates(wall) if c.effect == "gravity_compensator"} == {
        wall.chain.joints[j] for j in carriers(wall)
    }


@pytest.mark.parametrize("joint", [1, 2, 4])
def test_joint_laws_act_on_load_and_weight_together(chain: Chain, joint: int) -> None:
    here, name = mixed(chain), chain.joints[joint]
    whole, pulled = np.abs(here.torque[joint]).max(), np.abs(here.load_torque[joint]).max()
    c = COMPLIANCE[joint]
    laws = {
        ("nonlinear_stiffness", "total torque"): lambda t: -c * t * (t / whole) ** 2,
        ("soft_zone", "total torque, below 30 %"): lambda t: c * np.clip(t, -0.3 * pulled, 0.3 * pulled),
        ("backlash", "total torque, within 4 %"): lambda t: np.clip(t / (0.04 * pulled), -1, 1) / 2,
    }
    for (effect, variant), law in laws.items():
        columns = chosen(here, effect, variant, name).columns(here)[:, :, 0]
        check(chain, columns, lambda rest, _, law=law: law(rest.torque[joint]), joint)
    offered = {c.variant for c in candidates(here) if c.effect in {"backlash", "nonlinear_stiffness"}
               and c.location["joint"] == name}  # fmt: skip
    assert not any(variant.startswith("load torque") for variant in offered)


@pytest.mark.parametrize("joint", [1, 2, 4])
def test_a_compliance_follows_several_waves_of_a_turn(chain: Chain, joint: int) -> None:
    here, name = mixed(chain), chain.joints[joint]
    columns = chosen(here, "pose_dependent_stiffness", "to four waves a turn", name).columns(here)
    for k, (wave, order) in enumerate((wave, n) for n in (1, 2, 3, 4) for wave in (np.cos, np.sin)):

        def law(rest: Equilibrium, _: Float2D, wave: Any = wave, order: int = order) -> Float1D:
            return np.asarray(COMPLIANCE[joint] * rest.torque[joint] * wave(order * here.q[:, joint]))

        check(chain, columns[:, :, k], law, joint)
    offered = {c.variant for c in candidates(here) if c.effect == "pose_dependent_stiffness"}
    assert offered == {"one turn"}  # under load; postures at rest are offered both


def test_guessed_masses_leave_open_on_which_torque_a_law_acts(chain: Chain) -> None:
    guessed = Chain(**{**{f: getattr(chain, f) for f in chain.__dataclass_fields__}, "inertials_known": False})
    offered = {c.variant for c in candidates(mixed(guessed)) if c.effect == "nonlinear_stiffness"}
    assert offered == {"total torque", "load torque"}


def test_friction_that_carries_all_it_can_on_arrival_is_against_the_first_change() -> None:
    """So that a load that grows from step 0 on has twice the stroke before everything slips."""
    torque = np.array([[0.0, 1.0, 3.0, 5.0, 3.0], [0.0, -1.0, -3.0, -5.0, -3.0]])
    np.testing.assert_allclose(stop(torque, 2.0, 1.0), [[-2, -1, 1, 2, 0], [2, 1, -1, -2, 0]])
    np.testing.assert_allclose(stop(torque, 2.0, 0.0), [[0, 1, 2, 2, 0], [0, -1, -2, -2, 0]])


def test_friction_begins_with_what_the_weight_strained(chain: Chain) -> None:
    torque = np.array([[5.0, 7.0, 9.0, 7.0, 5.0], [-1.0, 0.0, 1.0, 0.0, -1.0]])
    np.testing.assert_allclose(stop(torque, 2.0, None), [[2, 2, 2, 0, -2], [-1, 0, 1, 0, -1]])
    here = mixed(chain)
    columns = chosen(here, "hysteresis", "from the weight", "joint_2").columns(here)
    scale = here.largest_torque(1)
    at_rest = np.arange(here.m - RESTING, here.m)
    law = -np.clip(here.torque[1], -0.4 * scale, 0.4 * scale) / (0.4 * scale)
    np.testing.assert_allclose(columns[at_rest, :, 3], here.joint_column(1, law)[at_rest])
    free = chosen(here, "hysteresis", "virgin start", "joint_2").columns(here)
    assert np.all(free[at_rest] == 0)


def test_friction_leans_to_the_side_from_which_the_joint_came(chain: Chain) -> None:
    """At rest it is a direction of approach; the first load that slips everything one way wipes it out."""
    here = mixed(chain)
    side = sides(here)[:, 1]
    lean = chosen(here, "hysteresis", "from the side of arrival, below 2 %", "joint_2").columns(here)[:, :, 1]
    at_rest, first = np.arange(here.m - RESTING, here.m), here.step == 0
    np.testing.assert_allclose(lean[at_rest], here.joint_column(1, side)[at_rest])
    np.testing.assert_allclose(lean[first], here.joint_column(1, side)[first])
    slipped = np.abs(np.diff(here.torque[1], prepend=0.0)) > 0.04 * here.largest_torque(1)
    assert np.all(lean[slipped & ~first] == 0)
    names = {c.variant for c in candidates(here) if c.effect == "hysteresis"}
    assert "from the side of arrival" in names


def test_friction_of_teeth_grows_with_the_torque(chain: Chain) -> None:
    here = mixed(chain)
    scale = here.largest_torque(1)
    pressed = (np.abs(here.torque[1]) / scale)[:, None, None]
    for form in ("virgin start", "virgin start, below 6 %"):
        plain, growing = (
            chosen(here, "hysteresis", form + more, "joint_2").columns(here) for more in ("", ", growing")
        )
        np.testing.assert_allclose(growing, plain * pressed)
    several = chosen(here, "hysteresis", "virgin start", "joint_2").columns(here)
    np.testing.assert_allclose(plain[:, :, 0], several[:, :, 1])


def test_what_friction_carries_on_arrival_fades_with_the_first_load(chain: Chain) -> None:
    here = mixed(chain)
    forms = [c for c in candidates(here) if c.effect == "hysteresis" and c.location["joint"] == "joint_2"]
    assert len({c.chances for c in forms}) == 2
    assert forms[0].chances is not None
    moved = forms[0].chances(here)
    assert moved.shape == (here.m, 3, LOADED + RESTING)
    for k in range(LOADED + RESTING):
        assert np.all(moved[here.configuration != k, :, k] == 0)
    size = np.linalg.norm(moved, axis=(1, 2)).reshape(-1)[: LOADED * STEPS].reshape(LOADED, STEPS)
    lever = np.linalg.norm(here.joint_column(1, np.ones(here.m)), axis=1)[: LOADED * STEPS].reshape(LOADED, STEPS)
    assert np.all(np.diff(size / lever, axis=1) <= 1e-15)
    typical_width = forms[0].parameters[0].typical
    np.testing.assert_allclose((size / lever)[:, 0], CHANCE * typical_width, rtol=1e-9)


def test_chance_is_left_out_where_there_are_very_many_configurations(
    chain: Chain, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hysteresis, "MOST", LOADED + RESTING - 1)
    forms = [c for c in candidates(mixed(chain)) if c.effect == "hysteresis"]
    assert forms
    assert all(c.chances is None for c in forms)


def test_creep_of_the_weight_goes_on_from_posture_to_posture(chain: Chain) -> None:
    here = mixed(chain)
    constant = 150.0
    torque = here.torque[1]
    expected = np.zeros(here.m)
    for k in range(here.m):  # the integral as it is defined
        for j in range(1, k + 1):
            since = here.time[k] - (here.time[j] + here.time[j - 1]) / 2
            expected[k] += (torque[j] - torque[j - 1]) * (1 - np.exp(-since / constant))
    np.testing.assert_allclose(relaxed(here, torque, constant, remembered=True), expected, atol=1e-9 * np.ptp(torque))
    forgotten = relaxed(here, torque, constant)
    assert np.all(forgotten[-RESTING:] == 0)
    assert np.all(forgotten[: LOADED * STEPS : STEPS] == 0)


def test_what_moves_nothing_at_rest_is_not_offered_there(chain: Chain) -> None:
    here = mixed(chain)
    rows = np.arange(here.m - RESTING, here.m)
    q, _ = posture_and_load()
    resting = state_at(chain, q[rows], COMPLIANCE, configuration=here.configuration[rows], time=here.time[rows])
    assert not resting.loaded
    for candidate in candidates(resting):
        if candidate.family in {"structure", "joint law"}:
            columns = candidate.columns(resting)
            assert np.isfinite(columns).all()
            assert np.abs(columns).max() > 0, candidate.key
