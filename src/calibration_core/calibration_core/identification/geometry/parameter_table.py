"""Fitted frames, points and geometry as values with standard deviations, in the coordinates of the cell file."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.geometry.frames import FrameFit
from calibration_core.identification.geometry.identifiability import GeometryCorrection, ParameterSelection
from calibration_core.identification.geometry.terms import AXES
from calibration_core.identification.result.estimate import ParameterEstimate
from calibration_core.model.chain import rotation_y, rotation_z, rpy_of, xyz_rpy
from calibration_core.model.identified.named_values import POSE
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float1D, Float2D, Readings

UNITS: tuple[Literal["m", "rad"], ...] = ("m", "m", "m", "rad", "rad", "rad")


@dataclasses.dataclass(frozen=True, eq=False)
class Uncertainty:
    """Names and covariance of all fitted parameters, the tracker pose as x, y, z, roll, pitch, yaw.

    Attributes:
        names: (p,) names, compliances first.
        covariance: (p, p), SI units.
    """

    names: tuple[str, ...]
    covariance: Float2D

    def std(self, name: str) -> float:
        """Return one standard deviation; NaN if the parameter was not fitted."""
        if name not in self.names:
            return float("nan")
        index = self.names.index(name)
        return float(np.sqrt(self.covariance[index, index]))


def uncertainty_of(
    parameters: ModelParameters, names: Sequence[str], covariance: Float2D, scale: float = 1.0
) -> Uncertainty:
    """Return the uncertainty of fitted parameters.

    Args:
        parameters: All values.
        names: (p,) of those fitted, the tracker pose first, as a twist.
        covariance: (p, p), SI units.
        scale: By which the standard deviations are widened.
    """
    named, covariance = in_coordinates(parameters, names, covariance)
    order = sorted(range(len(named)), key=lambda k: not named[k].startswith("C "))
    return Uncertainty(tuple(named[k] for k in order), scale**2 * covariance[np.ix_(order, order)])


def in_coordinates(parameters: ModelParameters, names: Sequence[str], covariance: Float2D) -> tuple[list[str], Float2D]:
    """Return names and covariance with poses as x, y, z, roll, pitch, yaw; arguments as `uncertainty_of`."""
    change, named = np.eye(len(covariance)), list(names)
    for k, (label, pose) in enumerate(poses_of(parameters).items()):
        own = slice(6 * k, 6 * k + 6)
        change[own, own] = pose_by_twist(pose)
        named[own] = [f"{label} {name}" for name in POSE]
    return named, change @ covariance @ change.T


def poses_of(parameters: ModelParameters) -> dict[str, Float2D]:
    """Return the poses that are fitted first, (4, 4) each: of the tracker, or `tracker@NUMBER` of every recording's."""
    if parameters.setups is None:
        return {"tracker": parameters.tracker}
    return {f"tracker@{k + 1}": parameters.tracker @ setup for k, setup in enumerate(parameters.setups)}


def pose_by_twist(pose: Float2D) -> Float2D:
    """Return d (x, y, z, roll, pitch, yaw) / d (v, w), (6, 6), of T -> [exp(w), v] T at w = v = 0.

    Source: w = Rz Ry e_x roll' + Rz e_y pitch' + e_z yaw' for R = Rz(yaw) Ry(pitch) Rx(roll).
    """
    x, y, z = pose[:3, 3]
    result = np.eye(6)
    result[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    result[3:, 3:] = rpy_by_rotation(pose[:3, :3])
    return result


def rpy_by_rotation(rotation: Float2D) -> Float2D:
    """Return d (roll, pitch, yaw) / d w, (3, 3), of R -> exp(w) R at w = 0."""
    _, pitch, yaw = rpy_of(rotation)
    about_z = rotation_z(float(yaw))
    rates = np.column_stack([(about_z @ rotation_y(float(pitch)))[:, 0], about_z[:, 1], [0.0, 0.0, 1.0]])
    return np.asarray(np.linalg.inv(rates), dtype=np.float64)


def parameter_table(
    cell: Cell, parameters: ModelParameters, uncertainty: Uncertainty, choice: ParameterSelection, read: tuple[str, ...]
) -> tuple[ParameterEstimate, ...]:
    """List tracker pose, points and geometry; what was not fitted is listed with its nominal value."""
    table = _frames(cell, parameters.tracker, {point: parameters.points[point] for point in read}, uncertainty)
    ordered = sorted((*choice.chosen, *choice.nominal), key=lambda c: (c.joint, c.kind))
    return (*table, *(_geometry(candidate, parameters, uncertainty) for candidate in ordered))


def _geometry(
    candidate: GeometryCorrection, parameters: ModelParameters, uncertainty: Uncertainty
) -> ParameterEstimate:
    return ParameterEstimate(
        name=candidate.name,
        group="geometry",
        value=float(parameters.geometry[candidate.joint, candidate.kind]),
        std=uncertainty.std(candidate.name),
        unit=candidate.unit,
        nominal=candidate.nominal,
        fitted=candidate.name in uncertainty.names,
    )


def frame_table(frames: FrameFit, cell: Cell, readings: Readings) -> tuple[ParameterEstimate, ...]:
    """List tracker pose and points of a loaded recording, which fits no geometry."""
    uncertainty = frames_uncertainty(frames, readings.points)
    return _frames(cell, frames.tracker, dict(zip(readings.points, frames.points, strict=True)), uncertainty)


def frames_uncertainty(frames: FrameFit, points: Sequence[str]) -> Uncertainty:
    """Return the uncertainty of tracker pose and points.

    Args:
        frames: The fit, whose covariance is about rotations about the axes of the base.
        points: Names of the points, of which the first are fitted.
    """
    count = len(frames.covariance)
    change = np.eye(count)
    change[3:6, 3:6] = rpy_by_rotation(frames.tracker[:3, :3])
    names = (*(f"tracker {label}" for label in POSE), *(f"{point} {axis}" for point in points for axis in AXES))
    return Uncertainty(names[:count], change @ frames.covariance @ change.T)


def _frames(
    cell: Cell, tracker: Float2D, points: Mapping[str, Float1D], uncertainty: Uncertainty
) -> tuple[ParameterEstimate, ...]:
    """List tracker pose and points; coordinates without an uncertainty were not fitted."""
    nominal = cell.frames.tracker
    believed = [None] * 6 if nominal is None else [*nominal.xyz, *nominal.rpy]
    pose = xyz_rpy(tracker)
    table = []
    for i, label in enumerate(POSE):
        name, unit = f"tracker {label}", UNITS[i]
        table.append(ParameterEstimate(name, "tracker", float(pose[i]), uncertainty.std(name), unit, believed[i]))
    for point, place in points.items():
        for axis, label in enumerate(AXES):
            name, before = f"{point} {label}", cell.frames.measurement_points[point][axis]
            fitted = name in uncertainty.names
            std = uncertainty.std(name)
            table.append(ParameterEstimate(name, "point", float(place[axis]), std, "m", before, fitted))
    return tuple(table)
