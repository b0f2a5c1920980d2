"""Plans keep the standard's demands and promise what the fit delivers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import yaml

from calibration_core.cell import Box, Cell
from calibration_core.cell.surroundings import Surroundings
from calibration_core.errors import CellError, PlanError
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import Load
from calibration_core.planning.feasible.loads import LoadRules
from calibration_core.planning.feasible.order import clear_paths, short_order
from calibration_core.planning.feasible.space import Site, SpaceRules, joint_range, measurable, positions
from calibration_core.planning.loaded import PlanningRules, ground_of, largest_part, make_plan
from calibration_core.planning.plans.plan import Plan
from calibration_core.planning.plans.plan_file import plan_text


def test_counts_and_limits(plan: Plan, demo_cell: Cell) -> None:
    assert len(plan.primary) == 18
    assert len(plan.spares) == 9
    assert [c.number for c in plan.configurations] == list(range(1, 28))
    chain = chain_of(demo_cell)
    low, high = joint_range(chain, SpaceRules())
    q = np.array([c.q for c in plan.configurations])
    assert len(np.unique(q, axis=0)) == 27  # every posture once
    assert np.all((q >= low) & (q <= high))
    site = Site.of(chain, nominal_parameters(demo_cell), demo_cell)
    assert measurable(site, q, SpaceRules()).all()
    assert positions(posture(chain, q), site.points)[:, 2].min() > 0


def test_loads(plan: Plan, demo_cell: Cell) -> None:
    rated = demo_cell.robot.rated_load * 9.80665
    for configuration in plan.configurations:
        force = configuration.steps[:, :3]
        size = np.linalg.norm(force, axis=1)
        assert size == pytest.approx(rated * np.array([0, 0.25, 0.5, 0.75, 1, 0.75, 0.5, 0.25, 0]))
        tilt = np.arccos(-force[4, 2] / size[4])
        assert 0.43 < tilt < 1.14
        assert not configuration.steps[:, 3:].any()


def test_range_of_the_sensor_limits_the_pull(demo_cell: Cell) -> None:
    lever = np.linalg.norm(np.array(demo_cell.frames.wrench_point) - np.array(demo_cell.frames.force_torque.xyz))
    rules = PlanningRules(load=LoadRules(levels=(0.0, 1.0), largest_torque=100.0))
    plan = make_plan(demo_cell, configurations=12, rules=rules)
    assert np.linalg.norm(plan.configurations[0].steps[1, :3]) * lever == pytest.approx(100.0)
    rules = PlanningRules(load=LoadRules(largest_force=500.0))
    plan = make_plan(demo_cell, configurations=12, rules=rules)
    assert np.linalg.norm(plan.configurations[0].steps[4]) == pytest.approx(500)


def test_promised_uncertainty_is_what_the_fit_has(plan: Plan, demo_cell: Cell) -> None:
    """Against derivatives of the exact equilibrium, differences to step 0 with their full covariance."""
    chain, parameters = chain_of(demo_cell), nominal_parameters(demo_cell)
    total, step = np.zeros((6, 6)), 1e-3
    sigma = demo_cell.instruments.tracker.sigma
    wrench_sigma = np.r_[np.full(3, 1.0), np.full(3, 0.5)]
    for configuration in plan.primary:
        k = len(configuration.steps)

        def points(compliance: np.ndarray, steps: np.ndarray, q: np.ndarray = configuration.q) -> np.ndarray:
            load = Load(steps[:, :3].T, steps[:, 3:].T, parameters.wrench_point, None)
            at = solve_equilibrium(chain, np.tile(q, (len(steps), 1)), compliance, load).at
            return np.concatenate([at.point(point) for point in parameters.points.values()]).T  # (k, 9)

        columns = []
        for j in range(6):
            shifted = parameters.compliance.copy()
            shifted[j] *= 1 + step
            before, after = points(parameters.compliance, configuration.steps), points(shifted, configuration.steps)
            columns.append((after - before).ravel() / (step * parameters.compliance[j]))
        columns = np.stack(columns, axis=1).reshape(k, 9, 6)
        # the sensor reads at its own origin: an error of its force there is force and torque at the wrench point
        at = posture(chain, configuration.q[None])
        lever = (at.point(parameters.force_torque[:3, 3]) - at.point(parameters.wrench_point))[:, 0]
        cross = np.array([[0, -lever[2], lever[1]], [lever[2], 0, -lever[0]], [-lever[1], lever[0], 0]])
        move = np.block([[np.eye(3), np.zeros((3, 3))], [cross, np.eye(3)]])
        unit = np.vstack([np.zeros(6), np.diag(wrench_sigma) @ move.T])
        moved = points(parameters.compliance, unit)
        noise = np.eye(9) * sigma**2 + (moved[1:] - moved[0]).T @ (moved[1:] - moved[0])
        differences = columns[1:] - columns[0]
        covariance = np.kron(np.eye(k - 1) + 1, noise)
        flat = differences.reshape(-1, 6)
        total += flat.T @ np.linalg.solve(covariance, flat)
    std = np.sqrt(np.diag(np.linalg.inv(total)))
    assert plan.expected is not None
    np.testing.assert_allclose(plan.expected.compliance_std, std, rtol=0.03)
    np.testing.assert_allclose(plan.expected.stiffness_std, std / parameters.compliance, rtol=0.03)


def test_choice_beats_chance_and_is_certified(plan: Plan, demo_cell: Cell) -> None:
    assert plan.expected is not None
    assert 0.9 < plan.expected.efficiency <= 1
    even = make_plan(demo_cell, rules=PlanningRules(kept=0.9)).expected
    told = make_plan(demo_cell, rules=PlanningRules(kept=1.0)).expected
    assert even is not None
    assert told is not None
    assert even.spacing < plan.expected.spacing <= told.spacing
    assert told.efficiency >= plan.expected.efficiency > even.efficiency


def test_order_is_short() -> None:
    place = np.random.default_rng(3).uniform(size=(15, 2))
    cost = np.linalg.norm(place[:, None] - place[None], axis=2)
    way = short_order(cost, 4)
    assert way[0] == 4
    assert sorted(way) == list(range(15))
    assert cost[way[:-1], way[1:]].sum() < 0.6 * cost[np.arange(14), np.arange(1, 15)].sum()


def test_startup_cycle_moves_every_joint(plan: Plan, demo_cell: Cell) -> None:
    chain = chain_of(demo_cell)
    low, high = joint_range(chain, SpaceRules())
    assert np.all(np.ptp(plan.startup_cycle, axis=0) > 0.6 * (high - low))
    site = Site.of(chain, nominal_parameters(demo_cell), demo_cell)
    assert plan.reference is not None
    cycle = np.vstack([plan.reference.q, plan.startup_cycle])
    assert clear_paths(site, cycle[:-1], cycle[1:], SpaceRules()).all()
    assert np.array_equal(cycle[-1], cycle[0])


def test_without_stiffness_and_tracker_pose(small_cell: Cell) -> None:
    robot = small_cell.robot.model_copy(update={"stiffness": None})
    frames = small_cell.frames.model_copy(update={"tracker": None})
    plan = make_plan(small_cell.model_copy(update={"robot": robot, "frames": frames}), configurations=12)
    assert plan.expected is not None
    assert plan.expected.stiffness_std is None
    assert np.all(plan.expected.compliance_std > 0)


def test_tracker_behind_the_robot_is_respected(demo_cell: Cell) -> None:
    chain = chain_of(demo_cell)
    site = Site.of(chain, nominal_parameters(demo_cell), demo_cell)
    away = dataclasses.replace(site, tracker=np.array([-6.0, 0.0, 1.5]))
    q = np.zeros((1, 6))
    q[0, 4] = 0.7
    rules = SpaceRules(dexterity=0.02)
    turned = np.array([[np.pi - 0.1, 0, 0, 0, 0.7, 0]])
    assert not measurable(away, q, rules)[0] or not measurable(site, turned, rules)[0]
    assert measurable(away, turned, rules)[0]


def test_no_target_hides_another(plan: Plan, demo_cell: Cell) -> None:
    """A tracker with one beam would find the nearer of two that stand on one line of sight."""
    site = Site.of(chain_of(demo_cell), nominal_parameters(demo_cell), demo_cell)
    assert site.tracker is not None
    q = np.array([c.q for c in plan.configurations])
    sight = np.moveaxis(positions(posture(site.chain, q), site.points), 2, 0) - site.tracker  # (m, p, 3)
    for k, direction in enumerate(np.moveaxis(sight / np.linalg.norm(sight, axis=2, keepdims=True), 1, 0)):
        aside = np.linalg.norm(np.cross(sight, direction[:, None]), axis=2)
        assert np.delete(aside, k, axis=1).min() >= SpaceRules().beam
    close = dataclasses.replace(site, points=site.points[:1] + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.02]]))
    assert measurable(close, q, SpaceRules()).any(), "targets that are 20 mm apart can be measured"


def test_operating_space(demo_cell: Cell) -> None:
    box = ((0.8, 2.4), (-1.2, 1.2), (0.5, 2.0))
    plan = make_plan(demo_cell, configurations=12, rules=PlanningRules(space=SpaceRules(box=box)))
    points = np.array(list(demo_cell.frames.measurement_points.values()))
    where = positions(posture(chain_of(demo_cell), plan.table1()[1]), points)
    low, high = np.array(box).T
    assert np.all((where >= low[:, None]) & (where <= high[:, None]))


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"rules": PlanningRules(space=SpaceRules(dexterity=0.9), batches=2)}, "away from singularities"),
        ({"rules": PlanningRules(space=SpaceRules(tracker_range=(40.0, 60.0)), batches=2)}, "in the tracker's sight"),
    ],
)
def test_impossible_demands(demo_cell: Cell, arguments: dict, text: str) -> None:
    with pytest.raises(PlanError, match=text) as caught:
        make_plan(demo_cell, **arguments)
    assert "\n" not in str(caught.value)


def on_floor(cell: Cell, floor: float | str) -> Cell:
    return cell.model_copy(update={"surroundings": Surroundings(floor=floor)})


def test_the_floor_is_the_cells(demo_cell: Cell) -> None:
    with pytest.raises(PlanError, match="above the floor"):
        make_plan(on_floor(demo_cell, 3.5))
    assert on_floor(demo_cell, "none").floor is None
    hanging = demo_cell.robot.model_copy(update={"gravity": (0.0, 0.0, 9.80665)})
    assert on_floor(demo_cell.model_copy(update={"robot": hanging}), 2.5).floor == -2.5  # against gravity


def test_a_robot_with_a_low_shoulder_is_planned(small_cell: Cell) -> None:
    """Its upper arm comes near the floor in every posture: that is its shape, and no collision."""
    rows = list(small_cell.robot.dh)
    rows[0] = rows[0].model_copy(update={"d": 0.05})
    low = small_cell.model_copy(update={"robot": small_cell.robot.model_copy(update={"dh": tuple(rows)})})
    plan = make_plan(low, configurations=12)
    assert len(plan.primary) == 12
    assert plan.expected is not None
    assert any("floor" in pair for pair in plan.expected.unjudged)


@pytest.mark.slow
def test_a_divided_free_space_is_measured_in_its_largest_part(demo_cell: Cell) -> None:
    """No straight motion leads from one side of the wall to the other."""
    wall = Box(name="wall", xyz=(1.0, 0.0, 1.5), size=(0.02, 3.0, 3.0))
    divided = demo_cell.model_copy(update={"boxes": (wall,)})
    plan = make_plan(divided, configurations=12)
    assert plan.expected is not None
    assert plan.expected.unclear_moves == 0
    q = np.array([one.q for one in (*plan.primary, *plan.spares)])
    ground = ground_of(divided, nominal_parameters(divided), SpaceRules(), None)
    with pytest.raises(PlanError, match=r"18 of 18 postures .* more free space beside wall, the floor"):
        largest_part(ground, q, 30)


def test_wrench_point_is_needed(demo_cell: Cell) -> None:
    frames = demo_cell.frames.model_copy(update={"wrench_point": None})
    with pytest.raises(CellError, match="wrench_point"):
        make_plan(demo_cell.model_copy(update={"frames": frames}))


def test_a_joint_that_does_not_show_is_said_before_the_day_in_the_cell(small_cell: Cell) -> None:
    """A single point and the wrench point on the last axis."""
    points = {"measurement_points": {"mp": (0.0, 0.0, 0.1)}, "wrench_point": (0.0, 0.0, 0.12)}
    frames = small_cell.frames.model_copy(update=points)
    plan = make_plan(small_cell.model_copy(update={"frames": frames}), configurations=12)
    assert plan.expected is not None
    assert plan.expected.unidentifiable == (5,)
    assert np.isinf(plan.expected.compliance_std[5])
    assert np.isfinite(plan.expected.compliance_std[:5]).all()
    again = yaml.safe_load(plan_text(plan))["expected"]
    assert again["compliance_std"][5] is None


@pytest.mark.parametrize("n", [3, pytest.param(4, marks=pytest.mark.slow), 7])
def test_any_number_of_joints(small_cell: Cell, n: int) -> None:
    robot = small_cell.robot
    rows, limits = list(robot.dh), list(robot.joint_limits)
    if n == 7:
        rows.insert(4, rows[3].model_copy(update={"d": 0.15}))
        limits.insert(4, (-2.0, 2.0))
    changes = {
        "dh": tuple(rows[:n]), "joint_limits": tuple(limits[:n]), "joints": tuple(f"j{i}" for i in range(n)),
        "stiffness": (1e5,) * n, "inertials": None,
    }  # fmt: skip
    cell = on_floor(small_cell.model_copy(update={"robot": robot.model_copy(update=changes)}), "none")
    rules = PlanningRules(space=SpaceRules(dexterity=0.02, body=0.03))
    plan = make_plan(cell, configurations=12, rules=rules)
    assert plan.table1()[1].shape == (18, n)
    assert plan.expected is not None
    assert plan.expected.efficiency > 0.9
    assert np.isfinite(plan.expected.stiffness_std).all()
