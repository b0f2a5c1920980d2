"""Loads on the joints: external wrench and gravity, and how both change with the joint angles.

The change with the angles is what gives the complementary stiffness K_CSM (CWA 17384, 6.2, equation (4); Chen and
Kao's conservative congruence transformation): it has no free parameter and is in every prediction.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import Posture, cross, dot, linear_jacobian, turn, turned
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D


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
    columns = linear_jacobian(at, point)
    return np.stack([dot(column, force) + dot(at.spin(i), torque) for i, column in enumerate(columns)])


def gravity_torque(chain: Chain, at: Posture) -> Float2D:
    """Return the (n, m) joint torques of the links' own weight, N*m; zeros where masses are not known.

    Source: tau_i = a_i . sum_{k >= i} (c_k - o_i) x m_k g.
    """
    m = at.flange_origin.shape[1]
    torque = np.zeros((chain.n, m))
    if chain.mass is None:
        return torque
    gravity = np.broadcast_to(chain.gravity[:, None], (3, m))
    mass, moment = masses_beyond(chain, at)
    for i in range(chain.n):
        angular, linear = at.screw(i)
        torque[i] = dot(angular, cross(moment[i], gravity)) + mass[i] * dot(linear, gravity)
    return torque


def masses_beyond(chain: Chain, at: Posture) -> tuple[Float1D, Float3D]:
    """Return mass (n + 1,) kg and first moment about the base origin (n + 1, 3, m) kg*m of every link and all beyond.

    The last entry, beyond the last link, is zero; so are all where masses are not known.
    """
    mass, moment = np.zeros(chain.n + 1), np.zeros((chain.n + 1, 3, at.flange_origin.shape[1]))
    if chain.mass is not None and chain.com is not None:
        for i in reversed(range(chain.n)):
            mass[i] = mass[i + 1] + chain.mass[i]
            moment[i] = moment[i + 1] + chain.mass[i] * centre_of_mass(chain, at, i)
    return mass, moment


def centre_of_mass(chain: Chain, at: Posture, link: int) -> Float2D:
    """Return the (3, m) m centre of gravity of a link whose mass is known, base frame."""
    assert chain.com is not None  # noqa: S101 - asked for only where masses are known
    return at.body_origin[link] + turn(at.body[link], chain.com[link])


def load_torque_derivative(at: Posture, load: Load) -> Float3D:
    """Return the (n, n, m) derivatives d tau_i / d q_j of the external load's torques, N*m/rad.

    A wrench recorded in sensor axes turns with the robot, one in base axes does not.
    Source: product rule on tau_i = w_i . M + v_i . f, with (w_i, v_i) the joint's twist and (M, f) the wrench about the
    base origin; both change with a twist (w, v) by (w x w_i, w x v_i + v x w_i) and by (w x M + v x f, w x f).
    """
    force, torque, point = load.in_base(at)
    n, m = len(at.origin), point.shape[1]
    moment = torque + cross(point, force)
    derivative = np.zeros((n, n, m))
    screws = [at.screw(i) for i in range(n)]
    for j, (angular, linear) in enumerate(screws):
        if load.rotation is None:  # the force stays, and its point of action moves
            moved, turned_force = cross(linear + cross(angular, point), force), None
        else:
            moved, turned_force = cross(angular, moment) + cross(linear, force), cross(angular, force)
        for i in range(j + 1):
            derivative[i, j] = dot(screws[i][0], moved)
            if turned_force is not None:
                derivative[i, j] += dot(screws[i][1], turned_force)
        if turned_force is not None:
            continue  # joints beyond j turn together with the wrench: their torques stay
        for i in range(j + 1, n):
            spin, shift = screws[i]
            derivative[i, j] = (
                dot(spin, moved)
                + dot(cross(angular, spin), moment)
                + dot(cross(angular, shift) + cross(linear, spin), force)
            )
    return derivative


def gravity_torque_derivative(chain: Chain, at: Posture) -> Float3D:
    """Return the (n, n, m) derivatives d tau_i / d q_j of the gravity torques, N*m/rad (symmetric)."""
    m = at.flange_origin.shape[1]
    derivative = np.zeros((chain.n, chain.n, m))
    if chain.mass is None:
        return derivative
    gravity = np.broadcast_to(chain.gravity[:, None], (3, m))
    mass, moment = masses_beyond(chain, at)
    for j in range(chain.n):
        angular, linear = at.screw(j)
        shift = mass[j] * linear + cross(angular, moment[j])  # how the first moment of what is beyond joint j moves
        pull = cross(shift, gravity)
        for i in range(j + 1):
            derivative[i, j] = derivative[j, i] = dot(at.spin(i), pull)
    return derivative
