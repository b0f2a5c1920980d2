"""Fitted frames, points and geometry as values with standard deviations, in the coordinates of the cell file."""

from __future__ import annotations

import dataclasses
from typing import Literal, Protocol

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.geometry.frames import FrameFit
from calibration_core.identification.geometry.identifiability import GeometryCorrection, ParameterSelection
from calibration_core.identification.geometry.terms import AXES
from calibration_core.identification.result.estimate import ParameterEstimate
from calibration_core.model.chain import rotation_y, rotation_z, rpy_of
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float2D, Readings

POSE = ("x", "y", "z", "roll", "pitch", "yaw")
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


class Fitted(Protocol):
    """Fitted values with their covariance, the tracker pose first, as a twist."""

    @property
    def parameters(self) -> ModelParameters:
        """All values."""
        ...

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fitted parameters."""
        ...

    @property
    def covariance(self) -> Float2D:
        """(p, p), SI units."""
        ...


def uncertainty_of(result: Fitted, scale: float) -> Uncertainty:
    """Return the covariance of the fitted parameters, with the standard deviations widened by `scale`."""
    p = len(result.names)
    change, names = np.eye(p), list(result.names)
    for k, (label, pose) in enumerate(poses_of(result.parameters).items()):
        own = slice(6 * k, 6 * k + 6)
        change[own, own] = pose_by_twist(pose)
        names[own] = [f"{label} {name}" for name in POSE]
    covariance = scale**2 * change @ result.covariance @ change.T
    order = sorted(range(p), key=lambda k: not names[k].startswith("C "))
    return Uncertainty(tuple(names[k] for k in order), covariance[np.ix_(order, order)])


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
    """List tracker pose, points and geometry; what was not fitted is listed with its nominal value.

    Args:
        cell: For the nominal values.
        parameters: The kept model.
        uncertainty: Of what was fitted.
        choice: Corrections of the geometry that can be identified, and those that stay nominal.
        read: Names of the measurement points that were read.
    """
    nominal = cell.frames.tracker
    believed = [None] * 6 if nominal is None else [*nominal.xyz, *nominal.rpy]
    pose = np.concatenate([parameters.tracker[:3, 3], rpy_of(parameters.tracker[:3, :3])])
    table = []
    for i, label in enumerate(POSE):
        name, unit = f"tracker {label}", UNITS[i]
        table.append(ParameterEstimate(name, "tracker", float(pose[i]), uncertainty.std(name), unit, believed[i]))
    for point in read:
        for axis, label in enumerate(AXES):
            name, value = f"{point} {label}", float(parameters.points[point][axis])
            before = cell.frames.measurement_points[point][axis]
            fitted = name in uncertainty.names
            table.append(ParameterEstimate(name, "point", value, uncertainty.std(name), "m", before, fitted))
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
    std = np.sqrt(np.diag(frames.covariance))
    nominal = cell.frames.tracker
    values = np.concatenate([frames.tracker[:3, 3], rpy_of(frames.tracker[:3, :3])])
    believed = [None] * 6 if nominal is None else [*nominal.xyz, *nominal.rpy]
    estimates = [
        ParameterEstimate(
            f"tracker {label}", "tracker", float(values[i]), float(std[i]), "m" if i < 3 else "rad", believed[i]
        )
        for i, label in enumerate(POSE)
    ]
    for j, name in enumerate(readings.points):
        for axis, label in enumerate("xyz"):
            index = 6 + 3 * j + axis
            before = cell.frames.measurement_points[name][axis]
            value = float(frames.points[j, axis])
            estimates.append(ParameterEstimate(f"{name} {label}", "point", value, float(std[index]), "m", before))
    return tuple(estimates)
