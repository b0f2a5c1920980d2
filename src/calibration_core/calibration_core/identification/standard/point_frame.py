"""The frame that three measurement points make on the end effector (CWA 17384, 7.4 and 7.5)."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.model.chain import rotation_vector
from calibration_core.timeseries import Float1D, Float2D

STEP = 1e-7  # m, of the differences by which uncertainties are carried on
LEAST_HEIGHT = 1e-3  # m: distance of the third point from the line of the others


@dataclasses.dataclass(frozen=True, eq=False)
class PointFrame:
    """A frame in three points: origin in the first, x towards the second, the third in the half plane of positive y.

    Attributes:
        pose: (4, 4) of this frame in the flange frame.
        covariance: (6, 6) of its origin (m) and of a rotation vector (rad), both in flange axes.
    """

    pose: Float2D
    covariance: Float2D

    @property
    def std(self) -> Float1D:
        """(6,) m and rad."""
        return np.sqrt(np.diag(self.covariance))


def frame_of(points: Float2D, covariance: Float2D) -> PointFrame:
    """Return the frame of three points.

    Args:
        points: (3, 3) m, flange frame, one per row.
        covariance: (9, 9) m^2, of the points one after another.

    Raises:
        ValueError: The points lie on one line.
    """
    pose = _pose(points)

    def change(moved: Float1D) -> Float1D:
        there = _pose(moved.reshape(3, 3))
        return np.concatenate([there[:3, 3], rotation_vector(there[:3, :3] @ pose[:3, :3].T)])

    flat = points.ravel()
    slope = np.column_stack([(change(flat + h) - change(flat - h)) / (2 * STEP) for h in STEP * np.eye(9)])
    return PointFrame(pose, slope @ covariance @ slope.T)


def _pose(points: Float2D) -> Float2D:
    first, second, third = points
    length = float(np.linalg.norm(second - first))
    x = (second - first) / max(length, 1e-300)
    across = third - first - x * (x @ (third - first))
    height = float(np.linalg.norm(across))
    if min(length, height) < LEAST_HEIGHT:
        msg = f"three points on one line (to {1e3 * min(length, height):.2g} mm)"
        raise ValueError(msg)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([x, across / height, np.cross(x, across / height)])
    pose[:3, 3] = first
    return pose
