"""What the standard's own methods make of a recording: base frame, joint axes, wrist centre (CWA 17384, 7.1 to 7.3)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.circle_point.joint_axes import identify_axes
from calibration_core.identification.geometry.problem import absolute_problem
from calibration_core.identification.geometry.terms import AXES
from calibration_core.identification.result.phase import StandardGeometry
from calibration_core.identification.wrist.centre import identify_wrist_centre
from calibration_core.model.chain import rotation_vector
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.observations.covariance import position_covariance
from calibration_core.timeseries import Float1D, Float2D, Readings

BASE_FRAME, JOINT_AXES, WRIST_CENTRE = "base_frame", "joint_axes", "wrist_centre"
LEAST_AXES = 3  # joints 1 and 2 make the base frame; geometry begins with the next

Found = TypeVar("Found")


def standard_geometry(
    readings: Readings, cell: Cell, model: ModelParameters, names: tuple[str, ...], covariance: Float2D
) -> StandardGeometry:
    """Apply the standard's methods to an absolute recording.

    Circles and spheres are those of a rigid robot: what the model says of the bending is taken off the positions first.

    Args:
        readings: The recording.
        cell: The cell file.
        model: What was identified, and believed of the rest.
        names: Names of the rows of `covariance`, `mp1 x` among them where that was fitted.
        covariance: (p, p) of everything that was fitted.
    """
    reasons: dict[str, str] = {}

    def attempt(name: str, method: Callable[[], Found]) -> Found | None:
        try:
            return method()
        except IdentificationError as error:
            reasons[name] = str(error)
            return None

    readings = unbent(readings, cell, model)
    rows = [names.index(name) if name in names else -1 for point in readings.points for name in _coordinates(point)]
    fitted = np.array(rows) >= 0
    of_points = np.where(np.outer(fitted, fitted), covariance[np.ix_(rows, rows)], 0.0) if fitted.any() else None
    axes = attempt(BASE_FRAME, lambda: identify_axes(readings, cell))
    base = None if axes is None else axes.base
    if axes is None:
        reasons[JOINT_AXES] = reasons[BASE_FRAME]
    elif len(axes.axes) < LEAST_AXES:
        place, found = ", ".join(axes.not_observed), "no sweep"
        expected = "five or more poses in which only one of them moves"
        reasons[JOINT_AXES] = str(IdentificationError(readings.provenance.path, place, found, expected))
        axes = None
    return StandardGeometry(
        base=base,
        axes=axes,
        wrist=attempt(WRIST_CENTRE, lambda: identify_wrist_centre(readings, cell, model.points, of_points)),
        points_fitted=bool(fitted.all()),
        reasons=reasons,
    )


def unbent(readings: Readings, cell: Cell, model: ModelParameters) -> Readings:
    """Return the readings as a rigid robot would have given them: bending by its own weight and by loads taken off."""
    problem = absolute_problem(readings, cell, chain_of(cell), model, position_covariance(readings, cell))
    rigid = model.replace(compliance=np.zeros_like(model.compliance))
    bending = problem.view(model).target - problem.view(rigid).target
    return dataclasses.replace(readings, position=readings.position - (model.tracker[:3, :3].T @ bending).T)


def _coordinates(point: str) -> tuple[str, ...]:
    return tuple(f"{point} {axis}" for axis in AXES)


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
