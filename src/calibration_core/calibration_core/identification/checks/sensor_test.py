"""Test of a force/torque sensor with a known mass: sign, frame, bias.

A mass m beyond the sensor weighs m g whatever the posture.  With R the rotation from the base to the sensor axes, the
sensor reads f = S R m g + b, with a constant bias b and S = 1 if sign and frame are as declared.  S is taken as s Q: a
signed factor and a rotation, fitted by least squares over the orientations (Umeyama 1991, "Least-squares estimation of
transformation parameters between two point patterns", for each sign).  The torque is t = c x (f - b) + b_t with the
centre of mass c, linear in both unknowns.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.model.chain import nearest_rotation, rotation_rpy
from calibration_core.model.kinematics import posture
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Float1D, Float2D

MIN_ORIENTATIONS = 3
MIN_SPREAD = 0.2  # singular value ratio of the weight directions: three orientations in a plane still determine it


@dataclasses.dataclass(frozen=True, eq=False)
class SensorTest:
    """What the test found.

    Attributes:
        sign: +1 or -1.
        mass: kg, as fitted.
        bias: (6,) N and N*m, reading without any load.
        centre_of_mass: (3,) m, sensor frame, of the mass.
        residual_force: N, root mean square per component of what the fit leaves.
        residual_torque: N*m, the same.
        frame_error: rad, rotation by which the declared sensor axes are off.
    """

    sign: int
    mass: float
    bias: Float1D
    centre_of_mass: Float1D
    residual_force: float
    residual_torque: float
    frame_error: float

    def faults(self, mass: float, *, mass_share: float = 0.05, angle: float = 0.05, force: float = 5.0) -> list[str]:
        """Say what is wrong, one sentence each; nothing if the sensor is as declared.

        Args:
            mass: kg, the known mass.
            mass_share: Share by which the fitted mass may be off.
            angle: rad by which the axes may be off.
            force: N that the fit may leave.
        """
        found = []
        if self.sign < 0:
            found.append("the sign is reversed: the sensor reads the wrench that the robot applies")
        if abs(self.mass - mass) > mass_share * mass:
            found.append(f"the sensor weighs {self.mass:.3f} kg where {mass:.3f} kg hang")
        if self.frame_error > angle:
            found.append(f"the sensor axes are off by {np.degrees(self.frame_error):.1f} degrees")
        if self.residual_force > force:
            found.append(f"the fit leaves {self.residual_force:.1f} N")
        return found


def evaluate_sensor_test(wrenches: Float2D, weights: Float2D) -> SensorTest:
    """Fit sign, frame, mass, bias and centre of mass.

    Args:
        wrenches: (n, 6) N and N*m, mean reading at each orientation, as recordings declare it.
        weights: (n, 3) m/s^2, gravity at each orientation in the declared sensor axes.

    Raises:
        IdentificationError: Fewer than three orientations, or orientations that are too much alike.
    """
    n = len(wrenches)
    if n < MIN_ORIENTATIONS:
        raise IdentificationError("sensor test", "", f"{n} orientations", f"at least {MIN_ORIENTATIONS}")
    force, torque = wrenches[:, :3], wrenches[:, 3:]
    spread = weights - weights.mean(axis=0)
    singular = np.linalg.svd(spread, compute_uv=False)
    if singular[1] < MIN_SPREAD * np.linalg.norm(weights[0]):
        found = "orientations in which the weight pulls in nearly the same direction"
        raise IdentificationError("sensor test", "", found, "orientations that differ by 30 degrees and more")
    fits = [_fit(force, weights, sign) for sign in (1, -1)]
    sign, mass, rotation, bias = min(fits, key=lambda fit: _rest(force, weights, fit))
    rest = force - (sign * mass * weights @ rotation.T + bias)
    lever, torque_bias, torque_rest = _lever(force - bias, torque)
    error = float(np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0)))
    return SensorTest(
        sign=sign,
        mass=mass,
        bias=np.concatenate([bias, torque_bias]),
        centre_of_mass=lever,
        residual_force=float(np.sqrt((rest**2).mean())),
        residual_torque=torque_rest,
        frame_error=error,
    )


_Fit = tuple[int, float, Float2D, Float1D]


def _fit(force: Float2D, weights: Float2D, sign: int) -> _Fit:
    a = sign * (weights - weights.mean(axis=0))
    b = force - force.mean(axis=0)
    rotation = nearest_rotation(b.T @ a)
    mass = float(np.sum(b * (a @ rotation.T)) / (a**2).sum())
    bias = force.mean(axis=0) - sign * mass * rotation @ weights.mean(axis=0)
    return sign, mass, rotation, bias


def _rest(force: Float2D, weights: Float2D, fit: _Fit) -> float:
    """Misfit of a fit; of two that fit alike (orientations in a plane), the one with the smaller rotation wins."""
    sign, mass, rotation, bias = fit
    rest = force - (sign * mass * weights @ rotation.T + bias)
    scale = float((force - force.mean(axis=0)).std())
    return float(np.sqrt((rest**2).mean())) + 1e-3 * scale * (3.0 - float(np.trace(rotation)))


def _lever(force: Float2D, torque: Float2D) -> tuple[Float1D, Float1D, float]:
    """Centre of mass (3,), bias of the torque (3,), and the root mean square that is left."""
    rows = []
    for fx, fy, fz in force:  # c x f = -[f]x c
        rows.append(np.hstack([[[0.0, fz, -fy], [-fz, 0.0, fx], [fy, -fx, 0.0]], np.eye(3)]))
    design = np.vstack(rows)
    solution, *_ = np.linalg.lstsq(design, torque.ravel(), rcond=None)
    rest = torque.ravel() - design @ solution
    return solution[:3], solution[3:], float(np.sqrt((rest**2).mean()))


def gravity_in_sensor(cell: Cell, q: Float1D) -> Float1D:
    """Return gravity in the declared sensor axes, (3,) m/s^2, at joint angles q, (n,) rad.

    Raises:
        CellError: The cell file does not say how the sensor is mounted.
    """
    mounted = cell.frames.force_torque
    if mounted is None:
        raise cell.missing("frames.force_torque", "the test of the sensor")
    columns = posture(chain_of(cell), np.asarray(q)[None, :]).flange[:, :, 0]  # rows: axes of the flange in the base
    return np.asarray(rotation_rpy(*mounted.rpy).T @ columns @ cell.gravity)
