"""How fast every monitored point of the robot moves, and how fast it can at most move between samples.

Monitored are the flange, the tool, the wrench point, the sensor, every measurement point and every joint's origin
(CWA 17384, 7.1: the Cartesian speed shall not exceed 250 mm/s).  Joints that mimic others move with them and count.

A speed that is measured as a path divided by a time is wrong by at most `path_error` divided by that time, at any rate
of the joint states.  `SPEED_ERROR` is what that may come to: a measured speed is a mean over as long as that takes.
Below the limit there is room for it twice: motions are planned for no more than `limit * (1 - 2 * SPEED_ERROR)`, and
stopped where more than `limit * (1 - SPEED_ERROR)` is measured.  Whatever is faster than the limit is then stopped, and
no planned motion is.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import cross, posture
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float1D, Float2D, FloatND, Int1D, read_only

SAFETY_RATED_SPEED = 0.25  # m/s (CWA 17384, 7.1)
SPEED_ERROR = 0.02  # share of the limit by which a measured speed may be wrong
REFINED = (1, 4, 16, 64, 256)  # pieces per interval, as long as a bound is too large
CHUNK = 500  # intervals at once


@dataclasses.dataclass(frozen=True, eq=False)
class Monitored:
    """The robot's points whose speed matters.

    Attributes:
        names: Of all points: the joints' origins (`origin of joint_1`), then the points on the flange.
        points: (p, 3) m, the points on the flange, in its frame.
        lever: (k, n) m/rad, no point k ever moves faster per unit rate of joint j: no distance from the joint's origin
            is larger; 1 (m/m) where the joint slides, zero where it does not move the point.  What the joints add that
            mimic it is included.
    """

    chain: Chain
    names: tuple[str, ...]
    points: Float2D
    lever: Float2D

    @staticmethod
    def of(chain: Chain, parameters: ModelParameters, tool: Float1D | None) -> Monitored:
        """Return all monitored points of a robot with these frames and points, and its tool, (3,) m, flange frame.

        Without a tool of its own the tool is the wrench point.
        """
        named = {"flange": np.zeros(3)}
        if tool is not None:
            named["tool"] = np.asarray(tool)
        if parameters.wrench_point is not None:
            named["wrench point"] = np.asarray(parameters.wrench_point)
        if parameters.force_torque is not None:
            named["force/torque sensor"] = parameters.force_torque[:3, 3]
        named |= {name: np.asarray(point) for name, point in parameters.points.items()}
        points = np.stack(list(named.values()))
        origins = tuple(f"origin of {joint}" for joint in chain.whole.joints)
        lever = _levers(chain.whole, points)
        if chain.mimics:
            lever = lever @ np.abs(chain.matrix)
        return Monitored(chain, (*origins, *named), read_only(points), read_only(lever))

    @functools.cached_property
    def _each(self) -> Float2D:
        """(k, N) m/rad, `lever` of every moving joint by itself, those that mimic others too."""
        return self.lever if not self.chain.mimics else _levers(self.chain.whole, self.points)

    def speeds(self, q: Float2D, rate: Float2D) -> Float2D:
        """Return the speeds of all points, (m, k) m/s, at joint positions and rates, (m, n) rad and rad/s.

        Source: v(o_i+1) = v(o_i) + omega_i x (o_i+1 - o_i), from the base outwards; a sliding joint adds to v.
        """
        at, rate = posture(self.chain.whole, self.chain.expanded(q)), self._moving(rate)
        turning = np.zeros((3, len(q)))
        velocity = np.zeros((3, len(q)))
        speeds = np.empty((len(self.names), len(q)))
        here = at.origin[0]
        for i, origin in enumerate(at.origin):
            velocity = velocity + cross(turning, origin - here)
            speeds[i] = np.linalg.norm(velocity, axis=0)
            turning = turning + at.spin(i) * rate[:, i]
            if at.prismatic[i]:
                velocity = velocity + at.axis(i) * rate[:, i]
            here = origin
        for k, point in enumerate(self.points, start=self.chain.whole.n):
            speeds[k] = np.linalg.norm(velocity + cross(turning, at.point(point) - here), axis=0)
        return speeds.T

    def bending(self, rate: Float1D) -> Float1D:
        """Bound the second derivative of every point along a straight line in joint space, (k,) m.

        d2p/dq_i dq_j = a_i x dp/dq_j for i <= j has at most the length of the lever of the outer joint, so
        |p''| <= sum_ij |r_i| |r_j| R_max(i,j); it is zero where the inner joint slides.

        Args:
            rate: (n,) rad, direction of the line: dq/ds.
        """
        return np.asarray(self._each @ self._pairs(np.abs(self._moving(rate))))

    def acceleration(self, slope: FloatND, fastest: FloatND) -> FloatND:
        """Bound the acceleration of every point, (..., k) m/s^2: sum_i |q.._i| R_i + sum_ij |q._i| |q._j| R_max(i,j).

        Args:
            slope: (..., n) rad/s^2, largest |q..|.
            fastest: (..., n) rad/s, largest |q.|.
        """
        return np.asarray(
            (self._moving(slope, largest=True) + self._pairs(self._moving(fastest, largest=True))) @ self._each.T
        )

    def path_error(self, joint_error: float, time_error: float, speed: float) -> Float1D:
        """Bound how far the path of every point between two joint states may be measured wrongly, (k,) m.

        The difference of two joint states is wrong by at most one step of their quantisation, or by their noise; every
        joint adds that times its lever.  The time between them is wrong by what their stamps are, and the path by what
        the robot moves meanwhile.  A path of T s is thus a mean speed within `path_error / T`.

        Args:
            joint_error: rad, m where a joint slides: of the difference of two joint states, at most.
            time_error: s, of the time between two joint states, at most.
            speed: m/s, of the fastest point.
        """
        return np.asarray(self.lever.sum(axis=1) * joint_error + speed * time_error)

    def _pairs(self, size: FloatND) -> FloatND:
        """Return, per outer joint j, |r_j| times the sum of |r_i| over all inner joints that turn, j counted once.

        Args:
            size: (..., N) rates of all moving joints, not negative.
        """
        turning = np.where(self.chain.whole.prismatic, 0.0, size)
        return np.asarray(size * (2.0 * np.cumsum(turning, axis=-1) - turning))

    def _moving(self, rate: FloatND, *, largest: bool = False) -> FloatND:
        """Return the rates of all moving joints, (..., N), from those of the own ones, (..., n), or from bounds."""
        if not self.chain.mimics:
            return rate
        return np.asarray(rate @ (np.abs(self.chain.matrix) if largest else self.chain.matrix).T)


def _levers(chain: Chain, points: Float2D) -> Float2D:
    n, travel = chain.n, chain.travel
    links = np.linalg.norm(chain.translation, axis=1)
    reach = np.zeros((n, n))
    for i in range(n):
        for j in range(i):
            reach[i, j] = links[j + 1 : i + 1].sum() + travel[j + 1 : i].sum()
    ends = np.linalg.norm(chain.flange_translation + points @ chain.flange_rotation.T, axis=1)
    beyond = np.array([links[j + 1 :].sum() + travel[j + 1 :].sum() for j in range(n)])
    levers = np.vstack([reach, ends[:, None] + beyond])
    moves = np.vstack([np.tri(n, k=-1), np.ones((len(points), n))])  # which joint moves which point
    return np.where(chain.prismatic, moves, levers)


def hermite_bound(
    monitored: Monitored, time: Float1D, position: Float2D, velocity: Float2D, pieces: int = 16
) -> Float2D:
    """Bound every point's speed over every interval of a trajectory that is interpolated by cubic Hermite polynomials.

    It holds for any such trajectory, whoever made it.

    Args:
        monitored: The points.
        time: (m,) s, increasing.
        position: (m, n) rad.
        velocity: (m, n) rad/s.
        pieces: Pieces per interval; more are tighter.

    Returns:
        (m - 1, k) m/s.
    """
    return _interval_bound(monitored, np.diff(time), position[:-1], position[1:], velocity[:-1], velocity[1:], pieces)


def first_beyond(
    monitored: Monitored, time: Float1D, position: Float2D, velocity: Float2D | None, speed: float
) -> tuple[int, int, float] | None:
    """Return the first interval of a trajectory on which a point may exceed a speed, or None.

    The joints move on straight lines or, where there are velocities, on those or on cubic Hermite polynomials:
    controllers do either.

    Args:
        monitored: The points.
        time: (m,) s, increasing.
        position: (m, n) rad, m where a joint slides.
        velocity: (m, n) rad/s, m/s where a joint slides; None: none.
        speed: m/s.

    Returns:
        Number of the interval, from 0; number of the point that may be fastest; its bound, m/s.
    """
    for begin in range(0, len(time) - 1, CHUNK):
        open_ones = np.arange(begin, min(begin + CHUNK, len(time) - 1))
        bound = np.zeros((0, len(monitored.names)))
        for pieces in REFINED:
            bound = _either_bound(monitored, time, position, velocity, open_ones, pieces)
            beyond = ~(bound.max(axis=1) <= speed)
            open_ones, bound = open_ones[beyond], bound[beyond]
            if not len(open_ones):
                break
        if len(open_ones):
            point = int(np.argmax(bound[0]))
            return int(open_ones[0]), point, float(bound[0, point])
    return None


def _either_bound(
    monitored: Monitored, time: Float1D, position: Float2D, velocity: Float2D | None, intervals: Int1D, pieces: int
) -> Float2D:
    span = np.diff(time)[intervals]
    start, end = position[intervals], position[intervals + 1]
    rate = (end - start) / span[:, None]
    bound = _interval_bound(monitored, span, start, end, rate, rate, pieces)
    if velocity is None:
        return bound
    cubic = _interval_bound(monitored, span, start, end, velocity[intervals], velocity[intervals + 1], pieces)
    return np.maximum(bound, cubic)


def _interval_bound(
    monitored: Monitored, span: Float1D, start: Float2D, end: Float2D, first: Float2D, last: Float2D, pieces: int
) -> Float2D:
    """Bound every point's speed, (m, k) m/s, on m cubics between positions and velocities, (m, n) each, of span (m,) s.

    On a piece of half-length h about its middle, the speed is at most that in the middle plus h times a bound on the
    acceleration (`Monitored.acceleration`), each factor at its largest on the piece.
    """
    span = span[:, None]
    middle = (np.arange(pieces) + 0.5) / pieces
    # per interval and joint: q(u) = c0 + c1 u + c2 u^2 + c3 u^3, u = 0 ... 1
    change = end - start
    c1, ends = span * first, span * last
    c2, c3 = 3 * change - 2 * c1 - ends, c1 + ends - 2 * change
    u = middle[None, :, None]
    q = start[:, None] + c1[:, None] * u + c2[:, None] * u**2 + c3[:, None] * u**3
    rate = (c1[:, None] + 2 * c2[:, None] * u + 3 * c3[:, None] * u**2) / span[:, None]
    half = 0.5 / pieces
    slope = (
        np.maximum(
            np.abs(2 * c2[:, None] + 6 * c3[:, None] * (u - half)),
            np.abs(2 * c2[:, None] + 6 * c3[:, None] * (u + half)),
        )
        / (span**2)[:, None]
    )
    m, n = change.shape
    reach = half * span[:, None]  # s
    fastest = np.abs(rate) + slope * reach
    speed = monitored.speeds(q.reshape(-1, n), rate.reshape(-1, n)).reshape(m, pieces, -1)
    bound: Float2D = (speed + reach * monitored.acceleration(slope, fastest)).max(axis=1)
    return bound
