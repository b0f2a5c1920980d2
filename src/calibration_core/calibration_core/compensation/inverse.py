"""Joint angles that bring a tool to a place: Newton's method for many places at once, the branch kept.

No analytic inverse exists for a calibrated robot.  From the nominal solution Newton's method needs two or three steps;
from far away the steps are damped (Levenberg 1944) and short, so that the branch of the start is kept.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import Posture, linear_jacobian, posture, turned
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Int1D

REACHED = 1e-9  # m, and rad times the robot's reach
NEAR = 12  # steps from a nominal solution
FAR = 150  # steps from anywhere
LONGEST = 0.25  # rad or m a step, from far away
DAMPED = 1e-2  # of the scaled Jacobian, from far away
SINGULAR = 5e-3  # smallest singular value of the Jacobian, lengths in units of the reach: 1 / 200 of the joints' rates

Solve = Callable[[Float2D, Int1D], tuple[Float2D, Float3D, Float3D]]
"""Angles (k, n) and which places -> origin (3, k), axes (3, 3, k) of the tool, and its Jacobian (k, 6, n)."""


@dataclasses.dataclass(frozen=True, eq=False)
class Reached:
    """Where Newton's method ended.

    Attributes:
        q: (m, n) rad.
        arrived: (m,) whether the tool is at its target.
        error: (m, 3) m, target - tool.
        singular: (m,) smallest singular value of the Jacobian there, lengths in units of the robot's reach.
    """

    q: Float2D
    arrived: Bool1D
    error: Float2D
    singular: Float1D


def jacobian(at: Posture, point: Float2D) -> Float3D:
    """Return the (k, 6, n) Jacobian of a point (3, k) m at the flange: velocity and angular velocity, base axes."""
    linear = linear_jacobian(at, point)
    angular = at.spins
    return np.moveaxis(np.concatenate([linear, angular], axis=1), (0, 1, 2), (2, 1, 0))


def rigid(chain: Chain, tool: Float2D) -> Solve:
    """Return the forward kinematics of a rigid, unloaded robot with a tool, (4, 4) in the flange frame."""

    def solve(q: Float2D, _: Int1D) -> tuple[Float2D, Float3D, Float3D]:
        at = posture(chain, q)
        origin = at.point(tool[:3, 3])
        return origin, turned(at.flange, tool[:3, :3]), jacobian(at, origin)

    return solve


def reach_for(
    target: Float2D, axes: Float3D, start: Float2D, solve: Solve, reach: float, *, far: bool = False
) -> Reached:
    """Move the joints until the tool is at its target; joint limits are not looked at.

    A robot of fewer than six joints is brought to the position alone.

    Args:
        target: (3, m) m, base frame.
        axes: (3, 3, m) columns of the tool's axes there.
        start: (m, n) rad.
        solve: The robot's forward kinematics.
        reach: m, a length scale of the robot.
        far: Whether the start may be far away.
    """
    q = np.array(start, dtype=float)
    m, n = q.shape
    counted = 6 if n >= 6 else 3
    error = np.zeros((m, 3))
    singular = np.zeros(m)
    arrived = np.zeros(m, dtype=bool)
    active = np.arange(m)
    for _ in range(FAR if far else NEAR):
        origin, now, derivative = solve(q[active], active)
        missing = np.concatenate([(target[:, active] - origin) / reach, turning(now, axes[:, :, active])])[:counted].T
        derivative = derivative[:, :counted].copy()
        derivative[:, :3] /= reach
        error[active] = (target[:, active] - origin).T
        there = np.abs(missing).max(axis=1) < REACHED / reach
        if there.any():
            done = active[there]
            arrived[done] = True
            singular[done] = np.linalg.svd(derivative[there], compute_uv=False)[:, -1]
        active, missing, derivative = active[~there], missing[~there], derivative[~there]
        if not len(active):
            break
        step = _step(derivative, missing, DAMPED if far else 0.0)
        if far:
            step *= np.minimum(1.0, LONGEST / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-12))
        q[active] += step
    if len(active):
        derivative = solve(q[active], active)[2][:, :counted].copy()
        derivative[:, :3] /= reach
        singular[active] = np.linalg.svd(derivative, compute_uv=False)[:, -1]
    return Reached(q, arrived, error, singular)


def _step(derivative: Float3D, missing: Float2D, damping: float) -> Float2D:
    """Return the damped step (k, n); damping fades with what is missing, so that the end is Newton's."""
    rows = derivative.shape[1]
    size = np.minimum(np.abs(missing).max(axis=1), 1.0)
    square = derivative @ np.swapaxes(derivative, 1, 2)
    square[:, np.arange(rows), np.arange(rows)] += (damping**2 * size + 1e-14)[:, None]
    return np.asarray(np.einsum("kin,ki->kn", derivative, np.linalg.solve(square, missing[:, :, None])[:, :, 0]))


def turning(now: Float3D, then: Float3D) -> Float2D:
    """Return the (3, k) rad rotation vectors that turn axes (3, 3, k), columns, into others, base axes."""
    relative = np.einsum("abk,ack->bck", then, now)  # R = then now^T, by rows
    twice_sin = np.stack([
        relative[2, 1] - relative[1, 2], relative[0, 2] - relative[2, 0], relative[1, 0] - relative[0, 1]
    ])  # fmt: skip
    length = np.linalg.norm(twice_sin, axis=0)
    angle = np.arctan2(length, np.einsum("aak->k", relative) - 1.0)
    half_turn = (length < 1e-9) & (angle > 1.0)  # any axis will do: the next step knows better
    scale = np.where(length > 1e-12, angle / np.where(length > 1e-12, length, 1.0), 0.5)
    vector = twice_sin * scale
    vector[0, half_turn] = np.pi
    return np.asarray(vector)


def axes_of(rpy: Float2D) -> Float3D:
    """Return the (3, 3, m) columns of Rz(yaw) Ry(pitch) Rx(roll), angles (m, 3) rad."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy.T), np.sin(rpy.T)
    x = np.stack([cy * cp, sy * cp, -sp])
    y = np.stack([cy * sp * sr - sy * cr, sy * sp * sr + cy * cr, cp * sr])
    z = np.stack([cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr])
    return np.stack([x, y, z])


def rpy_of_axes(axes: Float3D) -> Float2D:
    """Return roll, pitch, yaw (m, 3) rad of axes (3, 3, m), columns: the inverse of `axes_of`."""
    x, y, z = axes
    return np.stack([np.arctan2(y[2], z[2]), np.arctan2(-x[2], np.hypot(x[0], x[1])), np.arctan2(x[1], x[0])], axis=1)


def into_limits(q: Float2D, chain: Chain) -> Float2D:
    """Return (m, n) angles of the same posture within the limits, by whole turns, wherever that is possible.

    A whole turn of a joint that others mimic is another posture.
    """
    low, high = chain.limits.T
    turns = np.where(
        q < low, np.ceil((low - q) / (2 * np.pi)), np.where(q > high, -np.ceil((q - high) / (2 * np.pi)), 0)
    )
    moved = q + 2 * np.pi * turns
    fits = (moved >= low) & (moved <= high) & np.isin(np.arange(chain.n), chain.circling)
    return np.where(fits, moved, q)
