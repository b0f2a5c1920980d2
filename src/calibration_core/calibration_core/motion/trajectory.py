"""Motions from rest to rest whose Cartesian speed is bounded everywhere, not only at the samples.

A motion is a straight line in joint space, q = q_0 + s (q_1 - q_0).  The line is cut into intervals; on each, the speed
of every monitored point per unit of ds/dt has a proven upper bound, hence ds/dt has a limit.  Within these limits and
constant limits of the joint accelerations, ds/dt is as large as it can be (forward and backward pass).  Between two
points ds/dt changes linearly, so the cubic Hermite polynomial that controllers lay through positions and velocities is
that very motion: all joints stay on the line, and no rate exceeds those at the points.
"""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np

from calibration_core.errors import TrajectoryError, beyond, rounded_down
from calibration_core.motion.speed import SAFETY_RATED_SPEED, SPEED_ERROR, Monitored, hermite_bound
from calibration_core.timeseries import Float1D, Float2D, read_only

POINT_SPACING = 0.02  # rad of the joint that moves most, between points, where the number of points allows
SHORTEST_MOTION = 0.2  # s
SLACK = 0.01  # wanted relative slack of the bound on one piece of the line
MOST_PIECES = 6000
HALT_TIME = 0.1  # s, that a controller has at least to take the point at which a robot is held
# rad/s^2, of the fastest joint: the default of `stopj` of Universal Robots' URScript.  At 250 mm/s joints 1 to 3 stand
# after less than 0.1 s, wrist joints at 0.8 rad/s after 0.4 s, before the next stage of the stop is due (0.5 s).
HALT_DECELERATION = 2.0
LIMIT_TOLERANCE = 1e-3  # rad, by which a measured start may lie beyond a joint limit


@dataclasses.dataclass(frozen=True)
class MotionLimits:
    """What a motion must not exceed.

    Attributes:
        speed: m/s, of every monitored point.
        margin: Share of `speed` that is kept free: twice what the guard may measure too much (`speed.SPEED_ERROR`), and
            what the controller adds.
        joint_speed: rad/s, one for all joints or one per joint.
        joint_acceleration: rad/s^2, likewise.
        max_points: Points of one trajectory that the controller takes (MotoROS2 takes 200).
    """

    speed: float = SAFETY_RATED_SPEED
    margin: float = 0.05
    joint_speed: float | tuple[float, ...] = 0.8
    joint_acceleration: float | tuple[float, ...] = 0.6
    max_points: int = 200

    def __post_init__(self) -> None:
        """Raise TrajectoryError on limits that make no sense."""
        if not (math.isfinite(self.speed) and 0 < self.speed <= SAFETY_RATED_SPEED):
            raise TrajectoryError(
                "limits", "speed", f"{self.speed:g} m/s", f"above 0, at most {SAFETY_RATED_SPEED} m/s"
            )
        if not 2.0 * SPEED_ERROR <= self.margin < 1:
            expected = f"a share of the speed limit, {2.0 * SPEED_ERROR:g} to below 1"
            raise TrajectoryError("limits", "margin", f"{self.margin:g}", expected)
        for name in ("joint_speed", "joint_acceleration"):
            values = np.atleast_1d(getattr(self, name))
            if not (np.isfinite(values).all() and (values > 0).all()):
                raise TrajectoryError("limits", name, str(getattr(self, name)), "positive numbers")
        if self.max_points < 3:
            raise TrajectoryError("limits", "max_points", str(self.max_points), "at least 3")

    @property
    def allowed(self) -> float:
        """Speed that trajectories are timed for, m/s."""
        return self.speed * (1.0 - self.margin)


def halt(q: Float1D, rate: Float1D, age: float) -> tuple[Float1D, float]:
    """Return where a moving robot can come to rest, and the time in which it does: it slows down along its way.

    A controller that lays a cubic polynomial from where the robot is to that point, at rest, decelerates evenly.

    Args:
        q: (n,) rad, where it was seen.
        rate: (n,) rad/s, how fast it was.
        age: s, since then; what lies outside 0 to `HALT_TIME` says nothing of the robot, but of clocks.

    Returns:
        (n,) rad, and s from now on.
    """
    seconds = max(float(np.abs(rate).max(initial=0.0)) / HALT_DECELERATION, HALT_TIME)
    return q + rate * (min(max(age, 0.0), HALT_TIME) + 0.5 * seconds), seconds


@dataclasses.dataclass(frozen=True, eq=False)
class Trajectory:
    """Points for a controller that interpolates positions and velocities by cubic Hermite polynomials.

    Attributes:
        joints: Names, in the order of the columns.
        time: (m,) s, from zero, strictly increasing.
        position: (m, n) rad; the first row is where the robot stands.
        velocity: (m, n) rad/s; zero in the first and last row.
        speed_bound: m/s, no monitored point is ever faster.
    """

    joints: tuple[str, ...]
    time: Float1D
    position: Float2D
    velocity: Float2D
    speed_bound: float

    def __post_init__(self) -> None:
        """Copy to read-only arrays."""
        for name in ("time", "position", "velocity"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def duration(self) -> float:
        """Length, s."""
        return float(self.time[-1])

    def at(self, time: Float1D) -> tuple[Float2D, Float2D]:
        """Return positions (k, n) rad and velocities (k, n) rad/s at times (k,) s, as controllers interpolate them."""
        t = np.clip(np.asarray(time, dtype=float), 0.0, self.duration)
        i = np.clip(np.searchsorted(self.time, t, side="right") - 1, 0, len(self.time) - 2)
        span = (self.time[i + 1] - self.time[i])[:, None]
        u = (t - self.time[i])[:, None] / span
        start, change = self.position[i], self.position[i + 1] - self.position[i]
        c1, ends = span * self.velocity[i], span * self.velocity[i + 1]
        c2, c3 = 3 * change - 2 * c1 - ends, c1 + ends - 2 * change
        return start + u * (c1 + u * (c2 + u * c3)), (c1 + u * (2 * c2 + 3 * u * c3)) / span


def plan_motion(monitored: Monitored, start: Float1D, goal: Float1D, limits: MotionLimits) -> Trajectory:
    """Time a motion from rest at `start` to rest at `goal`, (n,) rad each.

    Raises:
        TrajectoryError: A value is not finite or beyond the joint limits, or the points do not suffice.
    """
    return plan_path(monitored, np.stack([np.asarray(start, dtype=float), np.asarray(goal, dtype=float)]), limits)


def plan_path(monitored: Monitored, waypoints: Float2D, limits: MotionLimits) -> Trajectory:
    """Time a motion through waypoints (w, n) rad, resting at each.

    Raises:
        TrajectoryError: Fewer than two waypoints, more than the points of one trajectory can serve, a value that is not
            finite or beyond the joint limits.
    """
    waypoints = np.asarray(waypoints, dtype=float)
    _check_waypoints(monitored, waypoints, limits)
    available = (limits.max_points - 1) // (len(waypoints) - 1)
    time, position, velocity = [np.zeros(1)], [waypoints[:1]], [np.zeros((1, waypoints.shape[1]))]
    for start, goal in itertools.pairwise(waypoints):
        t, q, v = _segment(monitored, start, goal, limits, available)
        time.append(t[1:] + time[-1][-1])
        position.append(q[1:])
        velocity.append(v[1:])
    trajectory = Trajectory(
        monitored.chain.joints, np.concatenate(time), np.vstack(position), np.vstack(velocity), limits.allowed
    )
    return dataclasses.replace(trajectory, speed_bound=checked(monitored, trajectory, limits))


def checked(monitored: Monitored, trajectory: Trajectory, limits: MotionLimits) -> float:
    """Return a bound on the speed of every monitored point over the whole trajectory, m/s, or refuse it.

    It assumes cubic interpolation and nothing about how the trajectory was made.

    Raises:
        TrajectoryError: Not one, too many or unordered points, not at rest at its ends, a value that is not finite or
            beyond the joint limits, or a point that may exceed the speed limit.
    """
    time, position, velocity = trajectory.time, trajectory.position, trajectory.velocity
    if not 2 <= len(time) <= limits.max_points:
        raise TrajectoryError("trajectory", "points", str(len(time)), f"2 to {limits.max_points}")
    for name, values in (("time", time), ("position", position), ("velocity", velocity)):
        if not np.isfinite(values).all():
            raise TrajectoryError("trajectory", name, "a value that is not finite", "finite numbers")
    if time[0] != 0.0 or np.any(np.diff(time) <= 0):
        raise TrajectoryError("trajectory", "time", "times that do not increase from zero", "strictly increasing times")
    if velocity[0].any() or velocity[-1].any():
        raise TrajectoryError("trajectory", "velocity", "motion at an end", "rest at the first and last point")
    bound = hermite_bound(monitored, time, position, velocity, 4)
    for pieces in (16, 64, 256):
        if bound.max() <= limits.speed * (1.0 - 0.5 * limits.margin):
            break
        bound = hermite_bound(monitored, time, position, velocity, pieces)
    if bound.max() > limits.speed:
        name = monitored.names[int(np.argmax(bound.max(axis=0)))]
        found, most = 1e3 * float(bound.max()), rounded_down(1e3 * limits.speed)
        raise TrajectoryError("trajectory", name, f"{beyond(found, most, 1)} mm/s at most", f"at most {most:g} mm/s")
    _within_limits(monitored, _turning_points(time, position, velocity), "trajectory")
    return float(bound.max())


def _check_waypoints(monitored: Monitored, waypoints: Float2D, limits: MotionLimits) -> None:
    n = monitored.chain.n
    if waypoints.ndim != 2 or waypoints.shape[1] != n:
        raise TrajectoryError("motion", "joints", f"{waypoints.shape[-1]} angles", f"{n}, one per joint")
    if len(waypoints) < 2:
        raise TrajectoryError(
            "motion", "waypoints", str(len(waypoints)), "at least 2: where it stands and where it goes"
        )
    most = 1 + (limits.max_points - 1) // 8
    if len(waypoints) > most:
        found, expected = f"{len(waypoints)}", f"at most {most} in one trajectory of {limits.max_points} points"
        raise TrajectoryError("motion", "waypoints", found, expected)
    if not np.isfinite(waypoints).all():
        raise TrajectoryError("motion", "waypoints", "an angle that is not finite", "finite angles in rad")
    _within_limits(monitored, waypoints, "motion")
    for name in ("joint_speed", "joint_acceleration"):
        if np.size(getattr(limits, name)) not in {1, n}:
            raise TrajectoryError(
                "limits", name, f"{np.size(getattr(limits, name))} values", f"one, or {n}, one per joint"
            )


def _within_limits(monitored: Monitored, q: Float2D, what: str) -> None:
    low, high = monitored.chain.limits.T
    beyond = np.maximum(low - q, q - high)
    if beyond.max() > LIMIT_TOLERANCE:
        i, j = divmod(int(np.argmax(beyond)), q.shape[1])
        expected = f"[{low[j]:g}, {high[j]:g}], its limits"
        raise TrajectoryError(what, f"point {i}, {monitored.chain.joints[j]}", f"{q[i, j]:g} rad", expected)


def _segment(
    monitored: Monitored, start: Float1D, goal: Float1D, limits: MotionLimits, available: int
) -> tuple[Float1D, Float2D, Float2D]:
    """Time one straight line; at most `available` intervals."""
    line = goal - start
    largest = float(np.abs(line).max())
    if largest < 1e-9:
        return np.array([0.0, SHORTEST_MOTION]), np.stack([start, goal]), np.zeros((2, len(line)))
    acceleration = min(
        float(np.min(limits.joint_acceleration / np.maximum(np.abs(line), 1e-12))), 4 / SHORTEST_MOTION**2
    )
    count = int(np.clip(math.ceil(largest / POINT_SPACING), 8, available))
    rate = _rate_limit(monitored, start, line, limits, count)
    step = 1.0 / count
    ceiling = np.concatenate([[0.0], np.minimum(rate[:-1], rate[1:]), [0.0]]) ** 2
    for i in range(count):
        ceiling[i + 1] = min(ceiling[i + 1], ceiling[i] + 2 * acceleration * step)
    for i in reversed(range(count)):
        ceiling[i] = min(ceiling[i], ceiling[i + 1] + 2 * acceleration * step)
    pace = np.sqrt(ceiling)
    time = np.concatenate([[0.0], np.cumsum(2 * step / (pace[:-1] + pace[1:]))])
    share = np.linspace(0.0, 1.0, count + 1)[:, None]
    position = start + share * line
    position[-1] = goal
    return time, position, pace[:, None] * line


def _rate_limit(monitored: Monitored, start: Float1D, line: Float1D, limits: MotionLimits, count: int) -> Float1D:
    """Return the largest ds/dt on each of `count` intervals, (count,) 1/s, for speeds of points and joints.

    The speed per ds/dt at the middle of a piece, plus half its length times the bound on the second derivative, bounds
    it on the whole piece.
    """
    bending = monitored.bending(line)
    pieces = 4
    while True:
        total = count * pieces
        middle = (np.arange(total) + 0.5) / total
        slope = monitored.speeds(start + middle[:, None] * line, np.broadcast_to(line, (total, len(line))))
        excess = 0.5 / total * bending
        if float(excess.max()) <= SLACK * float(np.median(slope.max(axis=1))) or total >= MOST_PIECES:
            break
        pieces *= 2
    highest = (slope + excess).max(axis=1).reshape(count, pieces).max(axis=1)
    joints = float(np.min(limits.joint_speed / np.maximum(np.abs(line), 1e-12)))
    return np.minimum(limits.allowed / np.maximum(highest, 1e-12), joints)


def _turning_points(time: Float1D, position: Float2D, velocity: Float2D) -> Float2D:
    """Return all points and, per interval and joint, the extremes that a cubic may have between them."""
    span = np.diff(time)[:, None]
    change = np.diff(position, axis=0)
    c1, ends = span * velocity[:-1], span * velocity[1:]
    c2, c3 = 3 * change - 2 * c1 - ends, c1 + ends - 2 * change
    root = np.sqrt(np.maximum(4 * c2**2 - 12 * c3 * c1, 0.0))
    found = [position]
    for sign in (-1.0, 1.0):
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.where(np.abs(c3) > 1e-15, (-2 * c2 + sign * root) / (6 * c3), -c1 / (2 * c2))
        u = np.where(np.isfinite(u), np.clip(u, 0.0, 1.0), 0.0)
        found.append(position[:-1] + u * (c1 + u * (c2 + u * c3)))
    return np.vstack(found)
