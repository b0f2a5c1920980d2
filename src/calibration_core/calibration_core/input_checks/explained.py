"""How much of the motion under load joint springs explain, for the recording as it stands or as it might be meant.

    d p_k = sum_i c_i tau_ik (a_ik x (p_k - o_ik)),   c_i >= 0

equations (2) and (6) of CWA 17384, linear in the joint compliances c.  No weights, no gravity: the question is whether
axes, signs and units belong together at all, and an answer of a few percent does not matter for it.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.optimize import nnls

from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import Posture, linear_jacobian, posture
from calibration_core.model.statics import Load, load_torque
from calibration_core.timeseries import Float1D, Float2D, Int1D


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """Motion under load: m readings in groups (one configuration, one point), of which only differences count.

    Attributes:
        chain: The robot.
        q: (m, n) rad.
        force: (m, 3) N, as recorded.
        torque: (m, 3) N*m, as recorded.
        at: (m, 3) m, the measurement point of each reading in the flange frame.
        moved: (m, 3) m, base axes, what the encoders do not explain, mean of its group taken off.
        group: (m,) index of the group.
        sigma: Claimed standard deviation of a coordinate, m.
    """

    chain: Chain
    q: Float2D
    force: Float2D
    torque: Float2D
    at: Float2D
    moved: Float2D
    group: Int1D
    sigma: float

    @property
    def total(self) -> float:
        """Sum of squares of the motion, m^2."""
        return float(np.sum(self.moved**2))

    @property
    def freedom(self) -> int:
        """Number of independent coordinates."""
        return 3 * (len(self.group) - int(self.group.max()) - 1)


@dataclasses.dataclass(frozen=True)
class Fit:
    """Joint springs fitted to a motion.

    Attributes:
        compliance: Per joint, rad/(N*m), none negative.
        rest: Sum of squares that they leave, m^2.
    """

    compliance: tuple[float, ...]
    rest: float


@dataclasses.dataclass(frozen=True, eq=False)
class Reading:
    """How wrenches are read: about which point (flange frame), and in which axes (None: base axes)."""

    point: Float1D
    rotation: Float2D | None


def fit(motion: Motion, columns: Float2D) -> Fit:
    """Fit joint springs, none negative, to columns of unit compliances ((3 m, n))."""
    scale = np.linalg.norm(columns, axis=0)
    used = np.flatnonzero(scale > 1e-12 * max(float(scale.max(initial=0.0)), 1e-300))
    target = motion.moved.reshape(-1)
    if not len(used):
        return Fit((0.0,) * columns.shape[1], motion.total)
    upper = np.asarray(np.linalg.qr(np.column_stack([columns[:, used] / scale[used], target]), mode="r"))
    solution, _ = nnls(upper[:, :-1], upper[:, -1])
    rest = float(np.sum((upper[:, :-1] @ solution - upper[:, -1]) ** 2))
    compliance = np.zeros(columns.shape[1])
    compliance[used] = solution / scale[used]
    return Fit(tuple(compliance.tolist()), rest)


def columns_of(motion: Motion, at: Posture, force: Float2D, torque: Float2D, reading: Reading) -> Float2D:
    """Return the (3 m, n) motion of the points per unit of each joint's compliance, mean of the groups taken off.

    Args:
        motion: The motion.
        at: The posture of its readings.
        force: (m, 3) N, in the axes of the reading.
        torque: (m, 3) N*m, about its point.
        reading: How the wrench is read.
    """
    load = Load(force.T, torque.T, reading.point, reading.rotation)
    turning = load_torque(at, load)
    lever = linear_jacobian(at, at.point(motion.at.T))
    parts = [(column * turning[i]).T for i, column in enumerate(lever)]
    return np.column_stack([centred(part, motion.group).reshape(-1) for part in parts])


def centred(values: Float2D, group: Int1D) -> Float2D:
    """Take the mean of its group off each row of (m, k) values."""
    count = np.bincount(group)
    means = np.column_stack([np.bincount(group, column) / count for column in values.T])
    return np.asarray(values - means[group])


def posture_of(motion: Motion) -> Posture:
    """Return the posture of every reading."""
    return posture(motion.chain, motion.q)
