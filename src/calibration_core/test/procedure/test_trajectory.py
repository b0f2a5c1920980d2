"""No monitored point is ever faster than the bound, and cruising is not much slower."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest

from calibration_core.cell import Cell
from calibration_core.errors import TrajectoryError
from calibration_core.model.chain import Chain, rotation_rpy
from calibration_core.model.kinematics import by_axis, linear_jacobian, posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.motion.speed import Monitored, hermite_bound
from calibration_core.motion.trajectory import (
    HALT_DECELERATION,
    HALT_TIME,
    MotionLimits,
    Trajectory,
    checked,
    halt,
    plan_motion,
    plan_path,
)
from calibration_core.planning.plans.plan import Plan

LIMITS = MotionLimits()


@pytest.fixture(scope="module", params=["demo", "small"])
def monitored(request: pytest.FixtureRequest) -> Monitored:
    cell: Cell = request.getfixturevalue(f"{request.param}_cell")
    return Monitored.of(chain_of(cell), nominal_parameters(cell), None)


def _random_motion(monitored: Monitored, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    low, high = monitored.chain.limits.T
    return rng.uniform(low, high), rng.uniform(low, high)


def _random_chain(seed: int, n: int) -> Chain:
    rng = np.random.default_rng(seed)
    return Chain(
        joints=tuple(f"joint_{i + 1}" for i in range(n)),
        rotation=np.stack([rotation_rpy(*rng.uniform(-2, 2, 3)) for _ in range(n)]),
        translation=rng.uniform(-0.8, 0.8, (n, 3)),
        offset=rng.uniform(-1, 1, n),
        flange_rotation=rotation_rpy(*rng.uniform(-2, 2, 3)),
        flange_translation=rng.uniform(-0.3, 0.3, 3),
        limits=np.tile([-3.0, 3.0], (n, 1)),
        gravity=np.zeros(3),
    )


def test_speeds_are_jacobians_times_rates(monitored: Monitored) -> None:
    rng = np.random.default_rng(1)
    q, rate = rng.uniform(-2, 2, (5, 6)), rng.uniform(-1, 1, (5, 6))
    speeds, at = monitored.speeds(q, rate), posture(monitored.chain, q)
    for k, point in enumerate(monitored.points, start=6):
        columns = by_axis(linear_jacobian(at, at.point(point)))
        expected = np.linalg.norm(np.einsum("anm,mn->am", columns, rate), axis=0)
        np.testing.assert_allclose(speeds[:, k], expected, rtol=1e-12)
    step = 1e-6
    for i in range(6):
        high, low = (
            posture(monitored.chain, q + step * rate).origin[i],
            posture(monitored.chain, q - step * rate).origin[i],
        )
        np.testing.assert_allclose(speeds[:, i], np.linalg.norm(high - low, axis=0) / (2 * step), atol=1e-8)
    assert len(monitored.names) == speeds.shape[1]


@pytest.mark.parametrize("n", [3, 6, 7])
def test_levers_and_second_derivatives_are_never_exceeded(n: int) -> None:
    chain = _random_chain(n, n)
    rng = np.random.default_rng(n)
    points = rng.uniform(-0.4, 0.4, (3, 3))
    names = tuple(f"p{i}" for i in range(n + 3))
    cell_like = Monitored(chain, names, points, np.empty(0))
    from calibration_core.motion.speed import _levers

    monitored = dataclasses.replace(cell_like, lever=_levers(chain, points))
    q = rng.uniform(-3, 3, (4000, n))
    at = posture(chain, q)
    positions = [*at.origin, *(at.point(point) for point in points)]
    for k, position in enumerate(positions):
        for j in range(n):
            if k < n and j >= k:
                assert monitored.lever[k, j] == 0
            else:
                distance = np.linalg.norm(position - at.origin[j], axis=0)
                assert distance.max() <= monitored.lever[k, j] * (1 + 1e-12)
    line, h = rng.uniform(-1, 1, n), 1e-4

    def where(s: float) -> np.ndarray:
        there = posture(chain, q + s * line)
        return np.stack([*there.origin, *(there.point(point) for point in points)])

    second = np.linalg.norm(where(h) - 2 * where(0) + where(-h), axis=1) / h**2
    assert np.all(second.max(axis=1) <= monitored.bending(line) + 1e-6)


def test_two_hundred_motions_never_exceed_the_limit_and_use_it(monitored: Monitored) -> None:
    rng = np.random.default_rng(0)
    cruise = []
    for _ in range(200):
        start, goal = _random_motion(monitored, rng)
        trajectory = plan_motion(monitored, start, goal, LIMITS)
        assert len(trajectory.time) <= 200
        time = np.sort(np.concatenate([rng.uniform(0, trajectory.duration, 300), trajectory.time]))
        q, rate = trajectory.at(time)
        speed = monitored.speeds(q, rate).max(axis=1)
        assert speed.max() <= LIMITS.allowed * (1 + 1e-9)
        assert speed.max() <= trajectory.speed_bound <= LIMITS.speed
        assert np.abs(rate).max() <= LIMITS.joint_speed * (1 + 1e-9)
        line = np.abs(goal - start)
        pace = np.abs(trajectory.velocity).max(axis=1) / line.max()
        change = np.abs(np.diff(pace)) / np.diff(trajectory.time)
        accelerating = change > 0.9 * (LIMITS.joint_acceleration / line.max())
        assert change.max() <= LIMITS.joint_acceleration / line.max() * (1 + 1e-6)
        which = np.clip(np.searchsorted(trajectory.time, time, side="right") - 1, 0, len(change) - 1)
        used = np.maximum(speed / LIMITS.speed, np.abs(rate).max(axis=1) / LIMITS.joint_speed)
        cruise.append(used[~accelerating[which]].mean())
    assert np.mean(cruise) >= 0.9
    assert np.min(cruise) >= 0.8


def test_goal_form_of_every_driver(monitored: Monitored) -> None:
    start, goal = _random_motion(monitored, np.random.default_rng(3))
    trajectory = plan_motion(monitored, start, goal, LIMITS)
    assert trajectory.time[0] == 0
    assert np.all(np.diff(trajectory.time) > 0)
    assert np.array_equal(trajectory.position[0], start)
    assert np.array_equal(trajectory.position[-1], goal)
    assert not trajectory.velocity[[0, -1]].any()
    assert trajectory.velocity.shape == trajectory.position.shape
    assert np.all(np.diff(trajectory.time) > 5e-3)
    q, rate = trajectory.at(trajectory.time)
    np.testing.assert_allclose(q, trajectory.position, atol=1e-12)
    np.testing.assert_allclose(rate[:-1], trajectory.velocity[:-1], atol=1e-9)
    low, high = np.minimum(start, goal), np.maximum(start, goal)
    q, _ = trajectory.at(np.linspace(0, trajectory.duration, 5000))
    assert np.all((q >= low - 1e-9) & (q <= high + 1e-9))  # joints stay between where they start and end
    share = (q - start) / (goal - start)
    np.testing.assert_allclose(share, share[:, :1] @ np.ones((1, 6)), atol=1e-9)  # on the straight line


def test_bound_on_any_cubic_trajectory(monitored: Monitored) -> None:
    """Random points and velocities that nobody timed: sampling never finds more than the bound, pieces tighten it."""
    rng = np.random.default_rng(5)
    time = np.cumsum(rng.uniform(0.1, 1.0, 8)) - 0.1
    position, velocity = np.cumsum(rng.normal(0, 0.3, (8, 6)), axis=0), rng.normal(0, 0.5, (8, 6))
    coarse, fine = (hermite_bound(monitored, time, position, velocity, pieces) for pieces in (4, 256))
    assert np.all(fine <= coarse * (1 + 1e-9))
    whole = Trajectory(monitored.chain.joints, time, position, velocity, np.inf)
    for i, (begin, end) in enumerate(pairwise(time)):
        q, rate = whole.at(np.linspace(begin, end - 1e-12, 2000))
        speed = monitored.speeds(q, rate).max(axis=0)
        assert np.all(speed <= fine[i])
        assert fine[i].max() < 1.1 * speed.max() + 0.02


def test_path_rests_at_every_waypoint(monitored: Monitored, plan: Plan) -> None:
    middle = monitored.chain.limits.mean(axis=1)
    waypoints = np.stack([middle, middle + 0.2, middle + 0.1, middle + 0.1, middle - 0.3])
    trajectory = plan_path(monitored, waypoints, LIMITS)
    at_rest = np.flatnonzero(~trajectory.velocity.any(axis=1))
    np.testing.assert_allclose(trajectory.position[at_rest], waypoints, atol=1e-12)
    assert len(trajectory.time) <= LIMITS.max_points


@pytest.mark.parametrize("size", [1e-7, 1e-4, 1e-2])
def test_small_motions(monitored: Monitored, size: float) -> None:
    start = monitored.chain.limits.mean(axis=1)
    trajectory = plan_motion(monitored, start, start + size, LIMITS)
    assert trajectory.duration >= 0.19
    assert np.array_equal(trajectory.position[-1], start + size)


def test_no_motion_is_a_pause(monitored: Monitored) -> None:
    start = monitored.chain.limits.mean(axis=1)
    trajectory = plan_motion(monitored, start, start, LIMITS)
    assert len(trajectory.time) == 2
    assert trajectory.speed_bound == 0


@pytest.mark.parametrize("margin", [0.04, 0.3])
def test_margin_and_few_points(monitored: Monitored, margin: float) -> None:
    limits = MotionLimits(margin=margin, max_points=40)
    start, goal = _random_motion(monitored, np.random.default_rng(9))
    trajectory = plan_motion(monitored, start, goal, limits)
    q, rate = trajectory.at(np.linspace(0, trajectory.duration, 20000))
    assert monitored.speeds(q, rate).max() <= 0.25 * (1 - margin)
    assert len(trajectory.time) <= 40


@pytest.mark.parametrize(
    ("waypoints", "text"),
    [
        (np.zeros((1, 6)), "at least 2"),
        (np.zeros((40, 6)), "at most 25"),
        (np.zeros((2, 5)), "one per joint"),
        (np.full((2, 6), np.nan), "not finite"),
        (np.array([np.zeros(6), np.r_[9.0, np.zeros(5)]]), "joint_1.*9 rad"),
    ],
)
def test_impossible_motions_are_refused_beforehand(monitored: Monitored, waypoints: np.ndarray, text: str) -> None:
    with pytest.raises(TrajectoryError, match=text) as caught:
        plan_path(monitored, waypoints, LIMITS)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "change",
    [
        {"speed": 0.3}, {"speed": 0.0}, {"speed": np.nan}, {"margin": 0.03}, {"margin": 1.0}, {"joint_speed": 0.0},
        {"joint_acceleration": (1.0, np.inf)}, {"max_points": 2},
    ],
)  # fmt: skip
def test_impossible_limits(change: dict) -> None:
    with pytest.raises(TrajectoryError, match=next(iter(change))):
        MotionLimits(**change)


def test_foreign_trajectories_are_checked(monitored: Monitored) -> None:
    start, goal = _random_motion(monitored, np.random.default_rng(4))
    good = plan_motion(monitored, start, goal, LIMITS)
    assert checked(monitored, good, LIMITS) == good.speed_bound
    hasty = dataclasses.replace(good, time=0.8 * good.time, velocity=good.velocity / 0.8)
    with pytest.raises(TrajectoryError, match="mm/s"):
        checked(monitored, hasty, LIMITS)
    overshoot = good.velocity.copy()
    overshoot[100] *= 3  # fast between points although the points are close together
    with pytest.raises(TrajectoryError, match="mm/s"):
        checked(monitored, dataclasses.replace(good, velocity=overshoot), LIMITS)
    moving = good.velocity.copy()
    moving[-1] = 0.01
    position = good.position.copy()
    position[50, 0] = 4.0
    broken = good.position.copy()
    broken[50, 0] = np.nan
    for change, text in (
        ({"velocity": moving}, "rest"),
        ({"time": good.time[::-1].copy()}, "increas"),
        ({"position": broken}, "finite"),
        ({"time": good.time[:1], "position": position[:1], "velocity": moving[:1]}, "2 to 200"),
    ):
        with pytest.raises(TrajectoryError, match=text):
            checked(monitored, dataclasses.replace(good, **change), LIMITS)


def test_overshoot_of_a_joint_limit_between_points_is_seen(monitored: Monitored) -> None:
    low, high = monitored.chain.limits.T
    near = np.clip(np.zeros(6), low, high)
    near[5] = high[5] - 1e-3
    position = np.stack([near - np.eye(6)[5] * 0.05, near, near - np.eye(6)[5] * 0.05])
    velocity = np.zeros((3, 6))
    velocity[1, 5] = 0.1  # passes the point upwards: the cubic swings beyond it
    swing = Trajectory(monitored.chain.joints, np.array([0.0, 2.0, 4.0]), position, velocity, 0.0)
    with pytest.raises(TrajectoryError, match=r"joint_6.*limits"):
        checked(monitored, swing, LIMITS)


def test_plan_can_be_driven(demo_cell: Cell, plan: Plan) -> None:
    monitored = Monitored.of(chain_of(demo_cell), nominal_parameters(demo_cell), None)
    assert plan.reference is not None
    way = [plan.reference.q, *plan.startup_cycle, *(c.q for c in plan.configurations)]
    total = sum(plan_motion(monitored, a, b, LIMITS).duration for a, b in pairwise(way))
    assert 0 < total < 3600


def test_the_tool_is_watched_besides_flange_and_points(demo_cell: Cell) -> None:
    """A tool that reaches farther than all else is faster under a turn of the first joint, by its distance."""
    chain, parameters, tool = chain_of(demo_cell), nominal_parameters(demo_cell), np.array([0.0, 0.0, 2.0])
    monitored, without = (Monitored.of(chain, parameters, one) for one in (tool, None))
    assert set(monitored.names) - set(without.names) == {"tool"}
    q, rate = np.zeros((1, chain.n)), np.eye(1, chain.n) * 0.1
    speed = dict(zip(monitored.names, monitored.speeds(q, rate)[0], strict=True))
    place = posture(chain, q).point(tool)[:, 0]
    assert speed["tool"] == pytest.approx(0.1 * np.hypot(*place[:2]), rel=1e-9)
    assert speed["tool"] == max(speed.values())


@pytest.mark.parametrize("age", [0.0, 0.02, 0.1])
@pytest.mark.parametrize("speed", [1e-6, 0.05, 0.3, 0.8])
def test_a_robot_that_is_halted_never_goes_back_and_never_faster(speed: float, age: float) -> None:
    """As a controller moves it: by a cubic from where the robot is by now to the point, at rest."""
    rate = speed * np.array([1.0, -0.5, 0.0])
    seen = np.array([0.3, -0.2, 1.0])
    where, seconds = halt(seen, rate, age)
    left = where - (seen + rate * age)
    at = np.linspace(0.0, 1.0, 201)[:, None]
    velocity = 6.0 * (at - at**2) * left / seconds + (1.0 - 4.0 * at + 3.0 * at**2) * rate  # cubic Hermite
    assert np.allclose(velocity[-1], 0.0, atol=1e-12)
    along = velocity * np.sign(rate)
    assert (along >= -1e-12).all()
    assert (along <= np.abs(rate) + 1e-12).all()
    assert np.abs(np.diff(velocity, axis=0)).max() / (seconds / 200) <= HALT_DECELERATION * (1.0 + 1e-6)
    assert seconds >= HALT_TIME


def test_a_robot_at_rest_is_held_where_it_is_and_clocks_that_differ_do_not_throw_it() -> None:
    q, rate = np.array([0.1, 0.2]), np.array([0.4, 0.0])
    assert halt(q, np.zeros(2), 0.05)[0].tolist() == q.tolist()
    for age in (-3600.0, 3600.0, math.inf):
        where, _ = halt(q, rate, age)
        assert 0.0 < where[0] - q[0] <= 0.4 * (HALT_TIME + 0.5 * 0.2) + 1e-12
