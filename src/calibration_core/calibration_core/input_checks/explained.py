"""How much of the motion under load joint springs explain, for the recording as it stands or as it might be meant.

    d p_k = sum_i c_i tau_ik (a_ik x (p_k - o_ik)),   c_i >= 0

equations (2) and (6) of CWA 17384, linear in the joint compliances c.  No weights, no gravity: the question is whether
axes, signs and units belong together at all, and an answer of a few percent does not matter for it.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np

from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import Posture, linear_jacobian, posture
from calibration_core.model.statics import Load, load_torque
from calibration_core.timeseries import Float1D, Float2D, Int1D

SCATTER = 12  # coordinates from which the noise shows
WILD = 5.0  # times the median residual
DIRECTION = 0.2  # share of the largest pull: less across the others is no direction of its own


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """Motion under load: m readings in groups (one configuration, one point), of which only differences count.

    Attributes:
        q: (m, n) rad.
        force: (m, 3) N, as recorded.
        torque: (m, 3) N*m, as recorded.
        point: (m,) index of the measurement point of each reading.
        points: (k, 3) m, the points, flange frame.
        moved: (m, 3) m, base axes, what the encoders do not explain, mean of its group taken off.
        group: (m,) index of the group.
        sigma: Claimed standard deviation of a coordinate, m.
    """

    chain: Chain
    q: Float2D
    force: Float2D
    torque: Float2D
    point: Int1D
    points: Float2D
    names: tuple[str, ...]
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

    @functools.cached_property
    def noise(self) -> float:
        """Sum of squares, m^2, that no response in proportion to the pull explains; that of the claimed noise at least.

        A group of r directions of pull and k readings shows it in 3 (k - 1 - r) coordinates.
        """
        load = centred(self.force if np.any(self.force) else self.torque, self.group)
        left, count = 0.0, 0
        for rows in (np.flatnonzero(self.group == g) for g in range(int(self.group.max()) + 1)):
            basis, size, _ = np.linalg.svd(load[rows], full_matrices=False)
            pulled = basis[:, size > DIRECTION * size[0]]
            free = 3 * (len(rows) - 1 - pulled.shape[1])
            if free > 0:
                left += float(np.sum((self.moved[rows] - pulled @ (pulled.T @ self.moved[rows])) ** 2))
                count += free
        variance = left / count if count >= SCATTER else 0.0
        return self.freedom * max(variance, self.sigma**2)

    @functools.cached_property
    def independent(self) -> float:
        """Number of coordinates that physics beside the joints leaves independent.

        Steps along one direction of pull repeat each other, and a direction of pull moves a rigid tool by six.
        """
        load = centred(self.force if np.any(self.force) else self.torque, self.group)
        squares = _sums((load[:, :, None] * load[:, None, :]).reshape(-1, 9), self.group).reshape(-1, 3, 3)
        pulls = np.sqrt(np.clip(np.linalg.eigvalsh(squares), 0.0, None))
        directions = int(np.sum(pulls > DIRECTION * pulls.max()))
        return min(3.0 * directions * min(1.0, 2.0 / len(self.names)), float(self.freedom))


@dataclasses.dataclass(frozen=True, eq=False)
class Explanation:
    """Joint springs fitted to a motion.

    Attributes:
        compliance: Per joint, rad/(N*m), none negative.
        rest: Sum of squares that they leave, m^2.
        left: (m, 3) m, what they leave of every reading.
    """

    compliance: tuple[float, ...]
    rest: float
    left: Float2D


@dataclasses.dataclass(frozen=True, eq=False)
class Reading:
    """How wrenches are read: about which point (flange frame), and in which axes (None: base axes)."""

    point: Float1D
    rotation: Float2D | None


def fit(motion: Motion, columns: Float2D, limit: float = math.inf) -> Explanation:
    """Fit joint springs, none negative, to columns of unit compliances.

    Args:
        motion: What is explained.
        columns: (3 m, n) m per rad/(N*m).
        limit: m^2; where springs of any sign leave no less, rigid joints are returned: nothing better is there.
    """
    scale, used = seen_columns(columns)
    target = motion.moved.reshape(-1)
    if not len(used):
        return Explanation((0.0,) * columns.shape[1], motion.total, motion.moved)
    upper = np.asarray(np.linalg.qr(np.column_stack([columns[:, used] / scale[used], target]), mode="r"))
    solution = nonnegative(upper[:, :-1], upper[:, -1], limit)
    rest = float(np.sum((upper[:, :-1] @ solution - upper[:, -1]) ** 2))
    compliance = np.zeros(columns.shape[1])
    compliance[used] = solution / scale[used]
    return Explanation(tuple(compliance.tolist()), rest, motion.moved - (columns @ compliance).reshape(-1, 3))


def seen_columns(columns: Float2D) -> tuple[Float1D, Int1D]:
    """Return the length of every column, and the indices of those that are not zero."""
    scale = np.linalg.norm(columns, axis=0)
    return scale, np.flatnonzero(scale > 1e-12 * max(float(scale.max(initial=0.0)), 1e-300))


def without_wild(motion: Motion, best: Explanation) -> Motion:
    """Return the motion without single readings that stand out of what a fit leaves of all others.

    Their group's mean holds a part of them, so that it is taken again.
    """
    length = np.linalg.norm(best.left, axis=1)
    sound = length <= WILD * max(float(np.median(length)), motion.sigma)
    kept = (np.bincount(motion.group, sound) > 1)[motion.group] & sound
    if kept.all() or not kept.any():
        return motion
    group = np.unique(motion.group[kept], return_inverse=True)[1].reshape(-1)
    return dataclasses.replace(
        motion,
        q=motion.q[kept],
        force=motion.force[kept],
        torque=motion.torque[kept],
        point=motion.point[kept],
        moved=centred(motion.moved[kept], group),
        group=group,
    )


def nonnegative(matrix: Float2D, target: Float1D, limit: float) -> Float1D:
    """Solve least squares with no negative entry; zeros where entries of any sign leave no less than `limit`."""
    solved, _, rank, _ = np.linalg.lstsq(matrix, target, rcond=1e-9)
    if rank == matrix.shape[1] and (solved >= 0).all():
        return np.asarray(solved, dtype=np.float64)
    if float(np.sum((matrix @ solved - target) ** 2)) >= limit:
        return np.zeros(matrix.shape[1])
    from scipy.optimize import nnls  # slow to load, and few recordings meet the bound

    bounded, _ = nnls(matrix, target)
    return np.asarray(bounded, dtype=np.float64)


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
    lever = linear_jacobian(at, at.point(motion.points[motion.point].T))
    parts = (lever * turning[:, None]).transpose(2, 1, 0)  # (m, 3, n)
    m, _, n = parts.shape
    return centred(parts.reshape(m, 3 * n), motion.group).reshape(3 * m, n)


def centred(values: Float2D, group: Int1D) -> Float2D:
    """Take the mean of its group off each row of (m, k) values."""
    means = _sums(values, group) / np.bincount(group)[:, None]
    return np.asarray(values - means[group])


def _sums(values: Float2D, group: Int1D) -> Float2D:
    """Return the sum of the rows of each group, (g, k), of (m, k) values; groups are numbered from 0, none is empty."""
    order = np.argsort(group, kind="stable")
    starts = np.searchsorted(group[order], np.arange(int(group.max()) + 1))
    return np.asarray(np.add.reduceat(values[order], starts, axis=0))


def posture_of(motion: Motion) -> Posture:
    """Return the posture of every reading."""
    return posture(motion.chain, motion.q)
