"""Forward kinematics and Jacobians of many configurations at once.

Arrays have the configurations last ((3, m) and so on), so that every operation runs over contiguous memory; a Python
loop runs over joints only.  pinocchio does one configuration per call, which costs more than twice as much at
100,000 configurations (`make bench` measures both); the tests compare the two.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from calibration_core.model.chain import Chain
from calibration_core.timeseries import Float1D, Float2D, Float3D, Float4D, FloatND, Int1D


@dataclasses.dataclass(frozen=True, eq=False)
class Posture:
    """Where everything is, in the base frame, for m configurations of n joints.

    Attributes:
        before: (n, 3, 3, m) columns x, y, z of the frame before every joint; z is the joint's axis.
        origin: (n, 3, m) position of that frame, m.
        body: (n, 3, 3, m) columns of the link's body frame after the joint's motion.
        body_origin: (n, 3, m) position of that frame, m: that of the frame before unless the joint slides.
        prismatic: Per joint, whether it slides.
        flange: (3, 3, m) columns of the flange frame.
        flange_origin: (3, m), m.
        whole: Where joints mimic others, all N moving joints as joints of their own (`Chain.whole`); None: none does.
        matrix: (N, n) how those go with the n joints; None as `whole`.
    """

    before: Float4D
    origin: Float3D
    body: Float4D
    body_origin: Float3D
    prismatic: tuple[bool, ...]
    flange: Float3D
    flange_origin: Float2D
    whole: Posture | None = None
    matrix: Float2D | None = None

    def of_readings(self, rows: Int1D) -> Posture:
        """Return the posture of other readings, each that of one of these (indices)."""
        names = ("before", "origin", "body", "body_origin", "flange", "flange_origin")
        taken = {name: getattr(self, name).take(rows, axis=-1) for name in names}
        return dataclasses.replace(self, **taken, whole=None if self.whole is None else self.whole.of_readings(rows))

    @property
    def moving(self) -> Posture:
        """The posture of all moving joints, each taken as a joint of its own; this one where none mimics another."""
        return self if self.whole is None else self.whole

    def axis(self, joint: int) -> Float2D:
        """Return the (3, m) unit vectors along a joint's axis, base axes."""
        return np.asarray(self.before[joint, 2])

    def spin(self, joint: int) -> Float2D:
        """Return the flange's (3, m) angular velocity per unit joint rate, base axes; zero where the joint slides."""
        return np.asarray(self.spins[joint])

    def screw(self, joint: int) -> tuple[Float2D, Float2D]:
        """Return a joint's unit twist of the flange: angular (3, m) and linear velocity (3, m) of the base origin."""
        return self.spin(joint), self.shifts[joint]

    @property
    def axes(self) -> Float3D:
        """(n, 3, m) unit vectors along the joints' axes, base axes."""
        return self.before[:, 2]

    @functools.cached_property
    def spins(self) -> Float3D:
        """(n, 3, m) angular velocities of the flange per unit joint rate, base axes; zero where a joint slides."""
        if self.whole is not None:
            return self.gathered(self.whole.spins)
        if not any(self.prismatic):
            return self.axes
        return np.where(np.array(self.prismatic)[:, None, None], 0.0, self.axes)

    @functools.cached_property
    def shifts(self) -> Float3D:
        """(n, 3, m) linear velocities of the base origin, taken with the flange, per unit joint rate, base axes."""
        if self.whole is not None:
            return self.gathered(self.whole.shifts)
        return self.slid(by_joint(cross(by_axis(self.origin), by_axis(self.axes))))

    def point(self, point: Float1D) -> Float2D:
        """Return the (3, m) positions of a point given in the flange frame ((3,) or (3, m)), m, base frame."""
        return self.flange_origin + turn(self.flange, point)

    def gathered(self, parts: FloatND) -> FloatND:
        """Return what the n joints bring about, (n, ...), from what all N moving joints do by themselves, (N, ...).

        A joint and those that mimic it move together: velocities add up, and so do torques, by virtual work.
        """
        assert self.matrix is not None  # noqa: S101 - asked for only where joints mimic others
        return np.tensordot(self.matrix.T, parts, axes=1)

    def slid(self, velocity: Float3D) -> Float3D:
        """Put the axis in the place of what a sliding joint would do if it turned, (n, 3, m)."""
        for i in np.flatnonzero(self.prismatic):
            velocity[i] = self.axes[i]
        return velocity


def by_axis(vectors: Float3D) -> Float3D:
    """Return vectors (n, 3, m) as (3, n, m), for `cross` and `dot`; a view."""
    return vectors.transpose(1, 0, 2)


by_joint = by_axis  # and back


def differing(*several: FloatND) -> tuple[Int1D, Int1D]:
    """Return which of m readings differ from the one before, and for each reading which of those it is like.

    The points of one step are measured one after the other, in one posture under one load.

    Args:
        several: Arrays whose last axis is the readings', (..., m).
    """
    new = np.ones(several[0].shape[-1], dtype=bool)
    new[1:] = False
    for values in several:
        new[1:] |= np.any(values[..., 1:] != values[..., :-1], axis=tuple(range(values.ndim - 1)))
    return np.flatnonzero(new), np.cumsum(new) - 1


def posture(chain: Chain, q: Float2D) -> Posture:
    """Return the posture at joint positions `q`, (m, n) rad, m where a joint slides.

    Source: composition of the chain's transforms (see `chain`), CWA 17384, 6.1.
    """
    if chain.mimics:
        whole, own = posture(chain.whole, chain.expanded(q)), chain.own
        frames = whole.before[own], whole.origin[own], whole.body[own], whole.body_origin[own]
        return Posture(*frames, chain.prismatic, whole.flange, whole.flange_origin, whole, chain.matrix)
    m, n = len(q), chain.n
    angles = np.where(np.array(chain.prismatic)[:, None], 0.0, q.T) + chain.offset[:, None]
    cos, sin = np.cos(angles), np.sin(angles)
    to_next = _to_next(chain)
    frame = np.zeros((4, 3, m))  # axes x, y, z and origin
    frame[:3] = np.eye(3)[:, :, None]
    before, after = np.empty((2, n, 4, 3, m))
    other = np.empty((3, m))
    for i in range(n):
        np.matmul(to_next[i], frame.reshape(4, -1), out=before[i].reshape(4, -1))
        (x, y, z, origin), frame = before[i], after[i]
        np.multiply(cos[i], x, out=frame[0])
        frame[0] += np.multiply(sin[i], y, out=other)
        np.multiply(cos[i], y, out=frame[1])
        frame[1] -= np.multiply(sin[i], x, out=other)
        frame[2] = z
        frame[3] = origin + q[:, i] * z if chain.prismatic[i] else origin
    flange = (to_next[n] @ frame.reshape(4, -1)).reshape(4, 3, m)
    frames = before[:, :3], before[:, 3], after[:, :3], after[:, 3]
    return Posture(*frames, chain.prismatic, flange[:3], flange[3])


def _to_next(chain: Chain) -> Float3D:
    """Return what makes of the axes and the origin of one frame those of the next, (n + 1, 4, 4), the flange last."""
    combined = np.zeros((chain.n + 1, 4, 4))
    combined[:-1, :3, :3], combined[-1, :3, :3] = chain.rotation.transpose(0, 2, 1), chain.flange_rotation.T
    combined[:-1, 3, :3], combined[-1, 3, :3] = chain.translation, chain.flange_translation
    combined[:, 3, 3] = 1.0
    return combined


def turn(columns: Float3D, vector: Float2D | Float1D) -> Float2D:
    """Return the (3, m) vectors R v, R by its (3, 3, m) columns, v (3,) or (3, m)."""
    if np.ndim(vector) == 1:
        return _mix(columns, vector)
    return columns[0] * vector[0] + columns[1] * vector[1] + columns[2] * vector[2]


def turned(columns: Float3D, rotation: Float2D) -> Float3D:
    """Return the (3, 3, m) columns of R S for one constant (3, 3) rotation S."""
    filled = np.empty(columns.shape)
    for k in range(3):
        _mix(columns, rotation[:, k], filled[k])
    return filled


def _mix(columns: Float3D, weights: Float1D, result: Float2D | None = None) -> Float2D:
    """Return sum_k weights[k] columns[k], leaving out what is exactly zero (most entries of DH rows are)."""
    total = np.empty(columns.shape[1:]) if result is None else result
    empty = True
    for weight, column in zip(weights.tolist(), columns, strict=True):
        if weight == 0.0:
            continue
        if empty:
            np.multiply(column, weight, out=total)
            empty = False
        else:
            total += column if weight == 1.0 else weight * column
    if empty:
        total[:] = 0.0
    return total


def cross(a: Float2D, b: Float2D) -> Float2D:
    """Return the cross products of (3, m) or (3, n, m) vectors."""
    result = np.empty(a.shape if a.shape == b.shape else np.broadcast_shapes(a.shape, b.shape))
    np.subtract(a[1] * b[2], a[2] * b[1], out=result[0])  # half the time of stacking three results
    np.subtract(a[2] * b[0], a[0] * b[2], out=result[1])
    np.subtract(a[0] * b[1], a[1] * b[0], out=result[2])
    return result


def dot(a: Float2D, b: Float2D) -> Float1D:
    """Return the (m,) scalar products of (3, m) vectors; (n, m) of (3, n, m)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def linear_jacobian(at: Posture, point: Float2D) -> Float3D:
    """Return the (n, 3, m) velocities of a point fixed to the flange per unit joint rate (1/s or m/s).

    Args:
        at: The posture.
        point: (3, m) m, base frame.

    Source: column a_i x (p - o_i) of the geometric Jacobian, CWA 17384, equation (1); a_i where the joint slides.
    """
    if at.whole is not None:
        return at.gathered(linear_jacobian(at.whole, point))
    return at.slid(by_joint(cross(by_axis(at.axes), by_axis(point - at.origin))))
