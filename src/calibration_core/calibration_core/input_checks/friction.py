"""How much of the motion under load joints explain that are springs and lag behind their torque by friction.

    theta_i = c_i tau_i - sum_r h_ir stop_r[tau_i] / r,   c_i >= 0, h_ir >= 0

Source of the law: Prandtl-Ishlinskii stop operators (Al-Bender, Lampaert, Swevers 2005).  Strong friction in every
joint leaves springs alone a fifth of the motion; of another robot's motion it explains no more than springs do.
"""

from __future__ import annotations

import numpy as np

from calibration_core.input_checks.explained import Explanation, Motion, Reading, centred, columns_of, fit, posture_of
from calibration_core.model.effects.joint_law.hysteresis import stop
from calibration_core.model.kinematics import linear_jacobian
from calibration_core.model.statics import Load, load_torque
from calibration_core.timeseries import Float2D

RADII = (0.1, 0.4)  # strengths of the elements, of the largest torque of the joint


def fit_with_friction(motion: Motion, given: Reading) -> Explanation:
    """Fit joint springs and friction, none negative; the compliances are followed by the friction of every joint.

    Args:
        motion: What is explained; the readings of a group stand in the order in which they were taken.
        given: How the cell file says that the wrench is to be read.
    """
    springs = columns_of(motion, posture_of(motion), motion.force, motion.torque, given)
    return fit(motion, np.column_stack([springs, -_lag(motion, given)]))


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
