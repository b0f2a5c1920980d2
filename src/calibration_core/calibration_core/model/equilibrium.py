"""Static equilibrium on the deformed geometry, and its derivatives.

The encoders read q; behind each joint a spring gives way by theta = C tau(q + theta), with the torques taken at the
deformed posture.  Complementary stiffness and gravity are therefore always part of the answer.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.errors import EquilibriumError
from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import Posture, by_axis, differing, linear_jacobian, posture
from calibration_core.model.statics import (
    Load,
    gravity_torque,
    gravity_torque_derivative,
    load_torque,
    load_torque_derivative,
)
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D

TOLERANCE = 1e-13  # rad: below the last bit of an encoder by five orders of magnitude
MAX_ITERATIONS = 60
NEAR = 1e-5  # rad: that near to the equilibrium its amplification is known to seven digits


@dataclasses.dataclass(frozen=True, eq=False)
class Equilibrium:
    """The loaded robot at rest, for m readings.

    Attributes:
        deflection: (n, m) rad, joint deflections theta.
        torque: (n, m) N*m, joint torques at the deformed posture (load and gravity).
        at: The deformed posture.
        amplification: (n, n, m) (I - C dtau/dq)^-1: what a first deflection becomes once K_CSM and gravity answer.
    """

    deflection: Float2D
    torque: Float2D
    at: Posture
    amplification: Float3D

    def of_readings(self, rows: Int1D) -> Equilibrium:
        """Return the equilibrium of other readings, each that of one of these (indices)."""
        deflection, torque, amplification = (
            part.take(rows, axis=-1) for part in (self.deflection, self.torque, self.amplification)
        )
        return Equilibrium(deflection, torque, self.at.of_readings(rows), amplification)

    def point_jacobian(self, point: Float1D) -> Float3D:
        """Return d p / d theta of a point in the flange frame, (3,) or (3, m) m, here deformed, (3, n, m) m/rad."""
        return by_axis(linear_jacobian(self.at, self.at.point(point)))

    def loaded_point_jacobian(self, point: Float1D) -> Float3D:
        """Return what a first deflection does to a point once K_CSM and gravity answer, (3, n, m) m/rad.

        Times `torque` it is d p / d C, exact at this equilibrium.
        """
        return np.asarray(np.einsum("anm,njm->ajm", self.point_jacobian(point), self.amplification))


def solve_equilibrium(
    chain: Chain, q: Float2D, compliance: Float1D, load: Load | None, near: Float2D | None = None
) -> Equilibrium:
    """Find the equilibrium by fixed-point iteration (contraction: load times lever over stiffness, about 0.3 %).

    Near the equilibrium the steps are Newton's, with the amplification there.

    Args:
        chain: The robot.
        q: (m, n) rad, encoder angles.
        compliance: (n,) rad/(N*m).
        load: External load; None for the robot under its own weight.
        near: (n, m) N*m, torques at nearly the same equilibrium, to begin with; None: nothing is known.

    Raises:
        EquilibriumError: It does not converge: the load is beyond what these springs carry.
    """
    first, place = differing(q.T, *(() if load is None else (load.force, load.torque)))
    if len(first) == len(q):
        return _solved(chain, q, compliance, load, near)
    some = None if load is None else load.rows(first)
    found = _solved(chain, q[first], compliance, some, None if near is None else near[:, first])
    return found.of_readings(place)


def _solved(chain: Chain, q: Float2D, compliance: Float1D, load: Load | None, near: Float2D | None) -> Equilibrium:
    """Solve as `solve_equilibrium` for readings that all differ."""
    deflection = np.zeros((chain.n, len(q))) if near is None else compliance[:, None] * near
    amplification: Float3D | None = None
    change = np.inf
    for iteration in range(1, MAX_ITERATIONS + 1):
        at = posture(chain, q + deflection.T)
        torque = joint_torque(chain, at, load)
        step = compliance[:, None] * torque - deflection
        change = float(np.max(np.abs(step), initial=0.0))
        if amplification is None and change < NEAR:
            amplification = _amplification(chain, at, compliance, load)
        deflection = deflection + (step if amplification is None else np.einsum("ijm,jm->im", amplification, step))
        if change < TOLERANCE:
            break
        if not np.isfinite(change) or change > np.pi:
            raise EquilibriumError(change, iteration)
    else:
        raise EquilibriumError(change, MAX_ITERATIONS)
    assert amplification is not None  # noqa: S101 - the last change was below NEAR
    return Equilibrium(deflection, torque, at, amplification)


def joint_torque(chain: Chain, at: Posture, load: Load | None) -> Float2D:
    """Return the (n, m) torques of load and gravity on the joints, N*m."""
    gravity = gravity_torque(chain, at)
    return gravity if load is None else gravity + load_torque(at, load)


def _amplification(chain: Chain, at: Posture, compliance: Float1D, load: Load | None) -> Float3D:
    slope = gravity_torque_derivative(chain, at)
    if load is not None:
        slope = slope + load_torque_derivative(at, load)
    system = np.eye(chain.n)[:, :, None] - compliance[:, None, None] * slope
    inverse = np.linalg.inv(system.transpose(2, 0, 1))
    return np.ascontiguousarray(inverse.transpose(1, 2, 0), dtype=np.float64)  # for the products to come
