"""Columns of the effects on loaded readings against independent computations: turned frames, beams, sensors."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from states import COMPLIANCE, TIP, an_arm, state_at

from calibration_core.model.chain import Chain, rotation_rpy, rotation_z
from calibration_core.model.effects import candidates
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.state import State
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.kinematics import posture
from calibration_core.model.statics import Load
from calibration_core.timeseries import Float1D, Float2D, Float3D

M = 36
STEPS = 4
SENSOR = rotation_rpy(0.1, -0.2, 0.4)
WRENCH_POINT = np.array([0.1, -0.05, 0.25])
SMALL = 1e-6


@pytest.fixture(scope="module")
def chain() -> Chain:
    """Return a robot without masses."""
    return an_arm()


@pytest.fixture(scope="module")
def readings() -> tuple[Float2D, Float2D]:
    """Return angles (M, 6) and wrenches (M, 6): nine configurations of four steps."""
    rng = np.random.default_rng(3)
    q = np.repeat(rng.uniform(-1.2, 1.2, (M // STEPS, 6)), STEPS, axis=0)
    pull = np.repeat(rng.normal(size=(M // STEPS, 6)) * [900, 900, 900, 150, 150, 150], STEPS, axis=0)
    return q, pull * np.tile([0.0, 0.5, 1.0, 0.5], M // STEPS)[:, None]


def load(wrench: Float2D) -> Load:
    return Load(wrench[:, :3].T, wrench[:, 3:].T, WRENCH_POINT, SENSOR)


def state(chain: Chain, q: Float2D, wrench: Float2D, compliance: Float1D = COMPLIANCE, tip: Float1D = TIP) -> State:
    steps = {"configuration": np.repeat(np.arange(M // STEPS), STEPS), "step": np.tile(np.arange(STEPS), M // STEPS)}
    return state_at(chain, q, compliance, load(wrench), tip, wrench=wrench, **steps)


def chosen(state: State, effect: str, variant: str, **location: object) -> Candidate:
    found = [c for c in candidates(state) if c.effect == effect and c.variant == variant]
    found = [c for c in found if all(c.location.get(key) == value for key, value in location.items())]
    assert len(found) == 1, [(c.effect, dict(c.location), c.variant) for c in found]
    return found[0]


def point(chain: Chain, q: Float1D, place: Float1D = TIP) -> Float1D:
    return posture(chain, q[None]).point(place)[:, 0]


def hinged(chain: Chain, joint: int, turn: Float2D) -> Chain:
    """Return the chain with a rotation before a joint, in the frame before it."""
    rotation = chain.rotation.copy()
    rotation[joint] = rotation[joint] @ turn
    return dataclasses.replace(chain, rotation=rotation)


def spring(chain: Chain, q: Float1D, wrench: Float1D, turned: Callable[[float], Chain], place: Float1D) -> Float1D:
    """Return the movement of `place` per unit compliance of a hinge, by virtual work and finite differences."""
    both = [posture(turned(s * SMALL), q[None]) for s in (1, -1)]
    axes = posture(chain, q[None]).flange
    to_base = np.stack([axes[k][:, 0] for k in range(3)], axis=1) @ SENSOR
    force, moment = to_base @ wrench[:3], to_base @ wrench[3:]
    lever = (both[0].point(WRENCH_POINT) - both[1].point(WRENCH_POINT))[:, 0] / (2 * SMALL)
    frames = [np.stack([p.flange[k][:, 0] for k in range(3)], axis=1) for p in both]
    spin = (frames[0] - frames[1]) / (2 * SMALL) @ frames[0].T
    axis = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
    torque = lever @ force + axis @ moment
    return torque * (both[0].point(place) - both[1].point(place))[:, 0] / (2 * SMALL)


STIFF = np.full(6, 1e-16)  # so that the deformed and the nominal posture are the same


def test_principal_directions_that_are_turned_are_a_sum_of_the_three_columns(chain: Chain, readings: tuple) -> None:
    q, wrench = readings
    here = state(chain, q, wrench, STIFF)
    columns = chosen(here, "off_axis_compliance", "before", joint="joint_2").columns(here)
    angle, c1, c2 = 0.4, 3e-7, 1e-7
    r = rotation_z(angle)[:2, :2]
    matrix = r @ np.diag([c1, c2]) @ r.T
    for row in (2, 14):
        expected = sum(
            c * spring(chain, q[row], wrench[row], lambda a, f=f: hinged(
                chain, 1, rotation_z(f) @ rotation_rpy(a, 0, 0) @ rotation_z(-f)), TIP)
            for c, f in ((c1, angle), (c2, angle + np.pi / 2))
        )  # fmt: skip
        seen = columns[row] @ [matrix[0, 0], matrix[1, 1], matrix[0, 1]]
        np.testing.assert_allclose(seen, expected, rtol=1e-5, atol=1e-11)


def test_rocking_of_the_base_is_an_off_axis_compliance_of_the_first_joint(chain: Chain, readings: tuple) -> None:
    here = state(chain, *readings, STIFF)
    base = chosen(here, "base_compliance", "rocking").columns(here)
    first = chosen(here, "off_axis_compliance", "before", joint="joint_1").columns(here)
    np.testing.assert_allclose(base, first, atol=1e-9)


def test_the_base_slides_along_its_own_axes_in_the_order_of_their_names(chain: Chain, readings: tuple) -> None:
    here = state(chain, *readings, STIFF)
    candidate = chosen(here, "base_compliance", "six springs")
    columns = dict(
        zip((p.name for p in candidate.parameters), np.moveaxis(candidate.columns(here), -1, 0), strict=True)
    )
    for k, axis in enumerate("xyz"):
        expected = here.force[k][:, None] * np.eye(3)[k]
        np.testing.assert_allclose(columns[f"translation_{axis}"], expected, atol=1e-6)


def test_a_tool_on_an_oblique_hinge_is_a_sum_of_six_columns(chain: Chain, readings: tuple) -> None:
    q, wrench = readings
    here = state(chain, q, wrench, STIFF)
    columns = chosen(here, "tool_compliance", "oblique rotation").columns(here)
    axis = np.array([0.48, -0.6, 0.64])
    across = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])

    def turned(a: float) -> Chain:
        turn = np.eye(3) + np.sin(a) * across + (1 - np.cos(a)) * across @ across
        return dataclasses.replace(chain, flange_rotation=chain.flange_rotation @ turn)

    x, y, z = axis
    for row in (1, 6, 20):
        seen = columns[row] @ [x * x, y * y, x * y, z * z, x * z, y * z]
        np.testing.assert_allclose(seen, spring(chain, q[row], wrench[row], turned, TIP), rtol=1e-5, atol=1e-4)


def test_a_link_bends_as_a_beam_clamped_at_its_joint(chain: Chain, readings: tuple) -> None:
    """A point force F at the tip of a cantilever of length L and stiffness EI: deflection F L^3/3EI."""
    q, wrench = readings
    at = posture(chain, q)
    here = state(chain, q, wrench, STIFF)
    end, start = at.origin[2], at.origin[1]
    length = np.linalg.norm(end - start, axis=0)
    force = np.cross((end - start).T, [0.3, -0.5, 0.8]).T
    force = 1000 * force / np.linalg.norm(force, axis=0)
    pulled = dataclasses.replace(here, force=force, moment=np.zeros((3, M)), where=end, point=end)
    tube = chosen(here, "link_bending", "tube", link="link_2").columns(pulled)[:, :, 0]
    np.testing.assert_allclose(tube, (force * length**3 / 3).T, rtol=1e-9, atol=1e-6)


def test_a_coupling_is_no_larger_than_a_positive_compliance_matrix_allows(chain: Chain, readings: tuple) -> None:
    here = state(chain, *readings, COMPLIANCE)
    (parameter,) = chosen(here, "joint_coupling", "symmetric", joints=("joint_4", "joint_5")).parameters
    assert parameter.most == pytest.approx(1.5 * np.sqrt(COMPLIANCE[3] * COMPLIANCE[4]))


def sensed(chain: Chain, q: Float2D, wrench: Float2D) -> Float3D:
    rest = solve_equilibrium(chain, q, COMPLIANCE, load(wrench))
    return rest.at.point(np.tile(TIP[:, None], (1, M))).T


def test_sensor_errors_move_the_prediction_as_a_perturbed_wrench_does(chain: Chain, readings: tuple) -> None:
    q, wrench = readings
    here = state(chain, q, wrench)
    plain, size = sensed(chain, q, wrench), 1e-4
    cases = {
        ("wrench_gain", "forces", 1): wrench / (1 + size * np.array([0, 1, 0, 0, 0, 0])),
        ("wrench_frame_misalignment", "small rotation", 2): np.hstack(
            [part @ rotation_z(size).T for part in (wrench[:, :3], wrench[:, 3:])]
        ),
        ("wrench_point_offset", "lever arm", 0): wrench
        + np.hstack([np.zeros((M, 3)), size * np.cross([1, 0, 0], wrench[:, :3])]),
        ("wrench_drift", "linear in time", 2): wrench - size * here.time[:, None] * np.array([0, 0, 1, 0, 0, 0]),
    }
    for (effect, variant, column), other in cases.items():
        expected = (sensed(chain, q, other) - plain) / size
        seen = chosen(here, effect, variant).columns(here)[:, :, column]
        np.testing.assert_allclose(seen, expected, atol=2e-3 * np.abs(expected).max(), err_msg=effect)
    crossed = chosen(here, "wrench_crosstalk", "all axes")
    names = [p.name for p in crossed.parameters]
    other = wrench - size * np.outer(wrench[:, 0], [0, 0, 0, 0, 1, 0])
    expected = (sensed(chain, q, other) - plain) / size
    np.testing.assert_allclose(
        crossed.columns(here)[:, :, names.index("fx_to_ty")], expected, atol=2e-3 * np.abs(expected).max()
    )


def test_a_wrong_zero_changes_the_deflection_as_a_turned_joint_does(chain: Chain, readings: tuple) -> None:
    q, wrench = readings
    here = state(chain, q, wrench)
    for joint in (1, 3):
        other = q + SMALL * np.eye(6)[joint]
        moved = (sensed(chain, other, wrench) - sensed(chain, q, wrench)) / SMALL
        expected = here.since_step_zero(moved)
        seen = chosen(here, "joint_zero_offset", "zero", joint=f"joint_{joint + 1}").columns(here)[:, :, 0]
        np.testing.assert_allclose(seen, expected, atol=0.02 * np.abs(expected).max())


def test_a_wrong_lever_arm_shows_by_the_rotation_of_the_tool(chain: Chain, readings: tuple) -> None:
    q, wrench = readings
    here, other = state(chain, q, wrench), state(chain, q, wrench, tip=TIP + SMALL * np.array([0.0, 1.0, 0.0]))
    expected = here.since_step_zero((other.point - here.point).T) / SMALL
    seen = chosen(here, "measurement_point_offset", "one point", point="#0").columns(here)[:, :, 1]
    np.testing.assert_allclose(seen, expected, atol=1e-5 * np.abs(expected).max() + 1e-9)


def test_nothing_but_compliances_and_clearances_is_held_positive(chain: Chain, readings: tuple) -> None:
    for candidate in candidates(state(chain, *readings)):
        for parameter in candidate.parameters:
            assert parameter.typical > 0
            if parameter.positive:
                assert candidate.family in {"structure", "joint law"}
