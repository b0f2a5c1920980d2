"""Loads on the joints: external wrench and gravity, and how both change with the joint angles.

The change with the angles is what gives the complementary stiffness K_CSM (CWA 17384, 6.2, equation (4); Chen and
Kao's conservative congruence transformation): it has no free parameter and is in every prediction.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import Posture, by_axis, cross, dot, linear_jacobian, turn, turned
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D, Readings


@dataclasses.dataclass(frozen=True, eq=False)
class Load:
    """An external wrench on the flange, as it is recorded, for m readings.

    Attributes:
        force: (3, m) N, in the axes named by `rotation`.
        torque: (3, m) N*m, about `point`.
        point: (3,) m, flange frame: where the wrench is reduced to.
        rotation: (3, 3) orientation of the sensor in the flange frame; None where the wrench is in base axes.
    """

    force: Float2D
    torque: Float2D
    point: Float1D
    rotation: Float2D | None

    def in_base(self, at: Posture) -> tuple[Float2D, Float2D, Float2D]:
        """Return force (3, m), torque (3, m) in base axes, and the point (3, m) in the base frame."""
        where = at.point(self.point)
        if self.rotation is None:
            return self.force, self.torque, where
        axes = turned(at.flange, self.rotation)
        return turn(axes, self.force), turn(axes, self.torque), where

    def rows(self, rows: slice | Int1D) -> Load:
        """Return the load of some of the readings."""
        return dataclasses.replace(self, force=self.force[:, rows], torque=self.torque[:, rows])


def load_torque(at: Posture, load: Load) -> Float2D:
    """Return the (n, m) joint torques of the external load, N*m: tau = J_WP^T W (CWA 17384, equation (2)).

    Where a joint slides it is the force along it, N, here and below.
    """
    force, torque, point = load.in_base(at)
    return dot(by_axis(linear_jacobian(at, point)), force[:, None]) + dot(by_axis(at.spins), torque[:, None])


def gravity_torque(chain: Chain, at: Posture) -> Float2D:
    """Return the (n, m) joint torques of the links' own weight, N*m; zeros where masses are not known.

    Source: tau_i = a_i . sum_{k >= i} (c_k - o_i) x m_k g.
    """
    if chain.mass is None:
        return np.zeros((chain.n, at.flange_origin.shape[1]))
    if at.whole is not None:
        return at.gathered(gravity_torque(chain.whole, at.whole))
    gravity = chain.gravity[:, None, None]
    mass, moment = masses_beyond(chain, at)
    turning = dot(by_axis(at.spins), cross(by_axis(moment[:-1]), gravity))
    return turning + mass[:-1, None] * dot(by_axis(at.shifts), gravity)


def masses_beyond(chain: Chain, at: Posture) -> tuple[Float1D, Float3D]:
    """Return mass (n + 1,) kg and first moment about the base origin (n + 1, 3, m) kg*m of every link and all beyond.

    The last entry, beyond the last link, is zero; so are all where masses are not known.  Of a chain with mimic joints
    it is asked for the whole one.
    """
    mass, moment = np.zeros(chain.n + 1), np.zeros((chain.n + 1, 3, at.flange_origin.shape[1]))
    if chain.mass is not None and chain.com is not None:
        first = chain.mass[:, None, None] * centres_of_mass(chain, at)
        mass[:-1], moment[:-1] = np.cumsum(chain.mass[::-1])[::-1], np.cumsum(first[::-1], axis=0)[::-1]
    return mass, moment


def centres_of_mass(chain: Chain, at: Posture) -> Float3D:
    """Return the (n, 3, m) m centres of gravity of the links, whose masses are known, base frame."""
    assert chain.com is not None  # noqa: S101 - asked for only where masses are known
    return np.asarray(at.body_origin + np.einsum("ik,ikam->iam", chain.com, at.body))


def load_torque_derivative(at: Posture, load: Load) -> Float3D:
    """Return the (n, n, m) derivatives d tau_i / d q_j of the external load's torques, N*m/rad.

    A wrench recorded in sensor axes turns with the robot, one in base axes does not.
    Source: product rule on tau_i = w_i . M + v_i . f, with (w_i, v_i) the joint's twist and (M, f) the wrench about the
    base origin; both change with a twist (w, v) by (w x w_i, w x v_i + v x w_i) and by (w x M + v x f, w x f).
    """
    if at.whole is not None:
        return _gathered_twice(at, load_torque_derivative(at.whole, load))
    force, torque, point = (vector[:, None] for vector in load.in_base(at))
    moment = torque + cross(point, force)
    spin, shift = by_axis(at.spins), by_axis(at.shifts)
    beyond = np.tri(len(at.origin), k=-1)[:, :, None]  # joint i beyond joint j
    if load.rotation is not None:  # joints beyond j turn together with the wrench: their torques stay
        moved, turned_force = cross(spin, moment) + cross(shift, force), cross(spin, force)
        return (1.0 - beyond) * (_pairs(spin, moved) + _pairs(shift, turned_force))
    moved = cross(shift + cross(spin, point), force)  # the force stays, and its point of action moves
    by_spin, by_shift = cross(spin, moment) + cross(shift, force), cross(spin, force)
    return _pairs(spin, moved) + beyond * (_pairs(by_spin, spin) + _pairs(by_shift, shift))


def gravity_torque_derivative(chain: Chain, at: Posture) -> Float3D:
    """Return the (n, n, m) derivatives d tau_i / d q_j of the gravity torques, N*m/rad (symmetric)."""
    n, m = chain.n, at.flange_origin.shape[1]
    if chain.mass is None:
        return np.zeros((n, n, m))
    if at.whole is not None:
        return _gathered_twice(at, gravity_torque_derivative(chain.whole, at.whole))
    mass, moment = masses_beyond(chain, at)
    spin, shift = by_axis(at.spins), by_axis(at.shifts)
    moved = mass[:-1, None] * shift + cross(spin, by_axis(moment[:-1]))  # of the first moment beyond joint j
    slope = _pairs(spin, cross(moved, chain.gravity[:, None, None]))
    return np.where(np.tri(n, dtype=bool).T[:, :, None], slope, slope.transpose(1, 0, 2))


def _gathered_twice(at: Posture, slope: Float3D) -> Float3D:
    """Return M^T S M, (n, n, m), of the (N, N, m) slopes of all moving joints: they go linearly with the n joints."""
    return np.asarray(at.gathered(at.gathered(slope).transpose(1, 0, 2)).transpose(1, 0, 2))


def _pairs(first: Float3D, second: Float3D) -> Float3D:
    """Return the (n, n, m) scalar products of all vectors i of the first, (3, n, m), with all j of the second."""
    return np.asarray(dot(first[:, :, None], second[:, None]))


# --- the external load behind a recorded wrench -----------------------------------------------------------------------


def recorded_load(wrench: Float2D, cell: Cell, parameters: ModelParameters) -> Load:
    """Return the external load of every reading.

    Args:
        wrench: (m, 6) N and N*m, as recorded.
        cell: How wrenches are recorded.
        parameters: Where sensor and wrench point sit.

    Raises:
        CellError: The pose of the sensor or the wrench point is needed and missing.
    """
    convention = cell.measurements
    sensor = parameters.force_torque
    if sensor is None and (convention.wrench_axes == "sensor" or convention.wrench_at == "sensor"):
        raise cell.missing(
            "frames.force_torque", "a wrench recorded by the sensor (measurements.wrench_axes, wrench_at)"
        )
    if parameters.wrench_point is None and convention.wrench_at == "wrench_point":
        raise cell.missing("frames.wrench_point", "a wrench recorded at the wrench point")
    if convention.wrench_at == "sensor":
        assert sensor is not None  # noqa: S101 - checked above
        point = sensor[:3, 3]
    else:
        assert parameters.wrench_point is not None  # noqa: S101 - checked above
        point = parameters.wrench_point
    rotation = sensor[:3, :3] if sensor is not None and convention.wrench_axes == "sensor" else None
    return Load(wrench[:, :3].T, wrench[:, 3:].T, point, rotation)


def load_of(readings: Readings, cell: Cell, parameters: ModelParameters) -> Load:
    """Return the external load of every reading, as the cell file says that it was recorded.

    Raises:
        CellError: The pose of the sensor or the wrench point is needed and missing.
    """
    if readings.wrench is None:
        raise cell.missing("the recording's wrench", "joint stiffness from a loaded recording")
    return recorded_load(readings.wrench, cell, parameters)
