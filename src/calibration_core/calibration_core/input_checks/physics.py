"""How much of the motion under load joints explain that are springs, lag behind their torque, and tilt in bearings.

    theta_i = c_i tau_i - sum_r h_ir stop_r[tau_i] / r,   theta_ix = b_ix m_ix,   theta_iy = b_iy m_iy,   all >= 0

Source of the law of friction: Prandtl-Ishlinskii stop operators (Al-Bender, Lampaert, Swevers 2005).  Strong friction
in every joint leaves springs alone a fifth of the motion, soft bearings or anchors two fifths; of another robot's
motion friction and bearings explain hardly more than springs do.
"""

from __future__ import annotations

import numpy as np

from calibration_core.input_checks.explained import Explanation, Motion, Reading, centred, columns_of, fit, posture_of
from calibration_core.model.effects.joint_law.hysteresis import stop
from calibration_core.model.kinematics import cross, dot, linear_jacobian
from calibration_core.model.statics import Load, load_torque
from calibration_core.timeseries import Float2D

RADII = (0.1, 0.4)  # strengths of the elements, of the largest torque of the joint


def fit_with_physics(motion: Motion, given: Reading) -> Explanation:
    """Fit springs, friction and bearings of every joint, none negative, in this order.

    Args:
        motion: What is explained; the readings of a group stand in the order in which they were taken.
        given: How the cell file says that the wrench is to be read.
    """
    springs = columns_of(motion, posture_of(motion), motion.force, motion.torque, given)
    return fit(motion, np.column_stack([springs, -_lag(motion, given), _tilt(motion, given)]))


def _tilt(motion: Motion, given: Reading) -> Float2D:
    """Return the (3 m, 2 n) m that the points move per unit compliance about x and y of the frame before each joint.

    That of the first joint is the base, which rocks.
    """
    at = posture_of(motion)
    target = at.point(motion.points[motion.point].T)
    force, torque, where = Load(motion.force.T, motion.torque.T, given.point, given.rotation).in_base(at)
    columns = []
    for origin, axis in ((at.origin[joint], at.before[joint, k]) for joint in range(len(at.origin)) for k in range(2)):
        moment = dot(axis, torque + cross(where - origin, force))
        columns.append(centred((cross(axis, target - origin) * moment).T, motion.group).reshape(-1))
    return np.column_stack(columns)


def _lag(motion: Motion, given: Reading) -> Float2D:
    """Return the (3 m, 2 n) m that the friction of every joint moves the points, per its strength."""
    at = posture_of(motion)
    turning = load_torque(at, Load(motion.force.T, motion.torque.T, given.point, given.rotation))
    lever = linear_jacobian(at, at.point(motion.points[motion.point].T))
    groups = [np.flatnonzero(motion.group == g) for g in range(int(motion.group.max()) + 1)]
    columns = []
    for torque, column in zip(turning, lever, strict=True):
        largest = float(np.abs(torque).max())
        for radius in RADII:
            friction = np.zeros(len(torque))
            for rows in groups:
                friction[rows] = stop(torque[None, rows], radius * largest, 0.0)[0]
            columns.append(centred((column * friction).T, motion.group).reshape(-1) / max(largest, 1e-300))
    return np.column_stack(columns)
