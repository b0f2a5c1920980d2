"""Forward kinematics and Jacobians of many configurations at once.

Arrays have the configurations last ((3, m) and so on), so that every operation runs over contiguous memory; a Python
loop runs over joints only.  pinocchio does one configuration per call, which costs more than twice as much at
100,000 configurations (`make bench` measures both); the tests compare the two.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.model.chain import Chain
from calibration_core.timeseries import Float1D, Float2D, Float3D


@dataclasses.dataclass(frozen=True, eq=False)
class Posture:
    """Where everything is, in the base frame, for m configurations.

    Attributes:
        before: Per joint the (3, 3, m) columns x, y, z of the frame before it; [2] is the joint's axis.
        origin: Per joint the (3, m) position of that frame, m.
        body: Per joint the (3, 3, m) columns of the link's body frame after the joint's motion.
        body_origin: Per joint the (3, m) position of that frame, m: that of the frame before unless the joint slides.
        prismatic: Per joint, whether it slides.
        flange: (3, 3, m) columns of the flange frame.
        flange_origin: (3, m), m.
    """

    before: tuple[Float3D, ...]
    origin: tuple[Float2D, ...]
    body: tuple[Float3D, ...]
    body_origin: tuple[Float2D, ...]
    prismatic: tuple[bool, ...]
    flange: Float3D
    flange_origin: Float2D

    def axis(self, joint: int) -> Float2D:
        """Return the (3, m) unit vectors along a joint's axis, base axes."""
        return self.before[joint][2]

    def spin(self, joint: int) -> Float2D:
        """Return the (3, m) angular velocity per unit joint rate, base axes; zero where the joint slides."""
        return np.zeros_like(self.axis(joint)) if self.prismatic[joint] else self.axis(joint)

    def screw(self, joint: int) -> tuple[Float2D, Float2D]:
        """Return a joint's unit twist: angular (3, m) and linear velocity (3, m) of the base origin."""
        if self.prismatic[joint]:
            return self.spin(joint), self.axis(joint)
        return self.axis(joint), cross(self.origin[joint], self.axis(joint))

    def point(self, point: Float1D) -> Float2D:
        """Return the (3, m) positions of a point given in the flange frame ((3,) or (3, m)), m, base frame."""
        return self.flange_origin + turn(self.flange, point)


def posture(chain: Chain, q: Float2D) -> Posture:
    """Return the posture at joint positions `q`, (m, n) rad, m where a joint slides.

    Source: composition of the chain's transforms (see `chain`), CWA 17384, 6.1.
    """
    m = len(q)
    slides = np.array(chain.prismatic)
    angles = np.where(slides[:, None], 0.0, q.T) + chain.offset[:, None]
    cos, sin = np.cos(angles), np.sin(angles)
    columns = np.empty((3, 3, m))
    columns[:] = np.eye(3)[:, :, None]
    at = np.zeros((3, m))
    before, origin, body, body_origin = [], [], [], []
    for i in range(chain.n):
        at = at + _mix(columns, chain.translation[i])
        columns = turned(columns, chain.rotation[i])
        before.append(columns)
        origin.append(at)
        x, y, z = columns
        columns = np.empty((3, 3, m))
        columns[0], columns[1], columns[2] = cos[i] * x + sin[i] * y, cos[i] * y - sin[i] * x, z
        if slides[i]:
            at = at + q[:, i] * z
        body.append(columns)
        body_origin.append(at)
    at = at + _mix(columns, chain.flange_translation)
    flange = turned(columns, chain.flange_rotation)
    return Posture(tuple(before), tuple(origin), tuple(body), tuple(body_origin), chain.prismatic, flange, at)


def turn(columns: Float3D, vector: Float2D | Float1D) -> Float2D:
    """Return the (3, m) vectors R v, R by its (3, 3, m) columns, v (3,) or (3, m)."""
    if np.ndim(vector) == 1:
        return _mix(columns, vector)
    return columns[0] * vector[0] + columns[1] * vector[1] + columns[2] * vector[2]


def turned(columns: Float3D, rotation: Float2D) -> Float3D:
    """Return the (3, 3, m) columns of R S for one constant (3, 3) rotation S."""
    if np.array_equal(rotation, np.eye(3)):
        return columns
    return np.stack([_mix(columns, rotation[:, k]) for k in range(3)])


def _mix(columns: Float3D, weights: Float1D) -> Float2D:
    """Return sum_k weights[k] columns[k], leaving out what is exactly zero (most entries of DH rows are)."""
    total: Float2D | None = None
    for weight, column in zip(weights, columns, strict=True):
        if weight == 0.0:
            continue
        term = column if weight == 1.0 else weight * column
        total = term if total is None else total + term
    return np.zeros_like(columns[0]) if total is None else total


def cross(a: Float2D, b: Float2D) -> Float2D:
    """Return the cross products of (3, m) vectors."""
    result = np.empty(a.shape if a.shape == b.shape else np.broadcast_shapes(a.shape, b.shape))
    np.subtract(a[1] * b[2], a[2] * b[1], out=result[0])  # half the time of stacking three results
    np.subtract(a[2] * b[0], a[0] * b[2], out=result[1])
    np.subtract(a[0] * b[1], a[1] * b[0], out=result[2])
    return result


def dot(a: Float2D, b: Float2D) -> Float1D:
    """Return the (m,) scalar products of (3, m) vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def linear_jacobian(at: Posture, point: Float2D) -> list[Float2D]:
    """Return, per joint, the (3, m) velocity of a point fixed to the flange per unit joint rate (1/s or m/s).

    Args:
        at: The posture.
        point: (3, m) m, base frame.

    Source: column a_i x (p - o_i) of the geometric Jacobian, CWA 17384, equation (1); a_i where the joint slides.
    """
    return [velocity(at, i, point) for i in range(len(at.origin))]


def velocity(at: Posture, joint: int, point: Float2D) -> Float2D:
    """Return the (3, m) velocity of points (3, m) m beyond a joint per unit joint rate, base frame."""
    return at.axis(joint) if at.prismatic[joint] else cross(at.axis(joint), point - at.origin[joint])
