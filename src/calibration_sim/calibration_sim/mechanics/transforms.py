"""Small rigid-body arithmetic of the simulated cell: rotations, poses, nothing more."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from calibration_core.cell import Pose
from calibration_core.timeseries import Float1D, Float2D


@dataclasses.dataclass(frozen=True, eq=False)
class Placement:
    """Where one frame stands in another.

    Attributes:
        rotation: (3, 3), columns are the frame's axes.
        translation: (3,) m, the frame's origin.
    """

    rotation: Float2D
    translation: Float1D

    def __matmul__(self, other: Placement) -> Placement:
        """Chain two placements: the frame of `other`, seen from where `self` is seen."""
        return Placement(self.rotation @ other.rotation, self.rotation @ other.translation + self.translation)

    def apply(self, points: ArrayLike) -> Float2D:
        """Map points (..., 3) of the frame into the one it stands in."""
        return np.asarray(np.asarray(points) @ self.rotation.T + self.translation)

    def inverse_apply(self, points: ArrayLike) -> Float2D:
        """Map points (..., 3) the other way: into the frame."""
        return np.asarray((np.asarray(points) - self.translation) @ self.rotation)


def axis_rotation(axis: int, angle: float) -> Float2D:
    """Return the rotation (3, 3) by `angle` (rad) about coordinate axis 0, 1 or 2."""
    cosine, sine = np.cos(angle), np.sin(angle)
    second, third = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.eye(3)
    rotation[second, second] = rotation[third, third] = cosine
    rotation[third, second] = sine
    rotation[second, third] = -sine
    return rotation


def fixed_axes(roll: float, pitch: float, yaw: float) -> Float2D:
    """Return R = Rz(yaw) Ry(pitch) Rx(roll), angles in rad."""
    return axis_rotation(2, yaw) @ axis_rotation(1, pitch) @ axis_rotation(0, roll)


def rotation_vector(vector: ArrayLike) -> Float2D:
    """Return the rotation (3, 3) by |vector| rad about its direction (Rodrigues)."""
    vector = np.asarray(vector, dtype=np.float64)
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * skew @ skew)


def placement(pose: Pose | None) -> Placement:
    """Turn a pose of the cell file into a placement; None is the identity."""
    if pose is None:
        return Placement(np.eye(3), np.zeros(3))
    return Placement(fixed_axes(*pose.rpy), np.array(pose.xyz))


def translation(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Placement:
    """Return a placement that only moves the origin, m."""
    return Placement(np.eye(3), np.array([x, y, z]))


def turn(rotation: Float2D) -> Placement:
    """Return a placement that only turns."""
    return Placement(rotation, np.zeros(3))


def quaternion(rotation: Float2D) -> Float1D:
    """Return the unit quaternion (4,) w, x, y, z of a rotation (3, 3).

    The largest of the four components is computed first, so that the result is exact to rounding everywhere.
    """
    r = rotation
    squares = np.array(
        [
            1.0 + r[0, 0] + r[1, 1] + r[2, 2],
            1.0 + r[0, 0] - r[1, 1] - r[2, 2],
            1.0 - r[0, 0] + r[1, 1] - r[2, 2],
            1.0 - r[0, 0] - r[1, 1] + r[2, 2],
        ]
    )
    products = np.array(
        [
            [0.0, r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], 0.0, r[0, 1] + r[1, 0], r[2, 0] + r[0, 2]],
            [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], 0.0, r[2, 1] + r[1, 2]],
            [r[1, 0] - r[0, 1], r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], 0.0],
        ]
    )
    largest = int(np.argmax(squares))
    result = products[largest]
    result[largest] = squares[largest]
    return np.asarray(result / np.linalg.norm(result))
