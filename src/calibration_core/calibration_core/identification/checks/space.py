"""The investigated operating space in Cartesian representation, and how far it is from singularities."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration_core.identification.result.estimate import OperatingSpace
from calibration_core.model.chain import Chain
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.kinematics import Posture, linear_jacobian, posture
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.statics import Load, load_torque, load_torque_derivative
from calibration_core.timeseries import Float1D, Float2D, Readings


def operating_space(
    chain: Chain, parameters: ModelParameters, readings: Readings, load: Load | None = None
) -> OperatingSpace:
    """Describe where the robot was measured: one entry per configuration, at its largest load.

    Args:
        chain: The robot, geometry corrections included.
        parameters: Points and compliances.
        readings: What was measured.
        load: Load of every reading; None for a recording without external load.
    """
    force = np.zeros(len(readings)) if load is None else np.linalg.norm(load.force, axis=0)
    numbers = np.unique(readings.configuration)
    order = np.lexsort((-force, readings.configuration))
    _, first = np.unique(readings.configuration[order], return_index=True)
    rows = order[first]
    q = readings.q[rows]
    at = posture(chain, q)
    points = {name: at.point(parameters.points[name]).T for name in readings.points}
    at_load = None if load is None else load.rows(rows)
    deflection, bent, share, base_force = _loaded(chain, parameters, q, at, at_load, readings.points)
    joints = np.stack(
        [np.zeros((len(rows), 3)), *(origin.T for origin in at.moving.origin), at.flange_origin.T], axis=1
    )
    return OperatingSpace(
        configuration=numbers,
        joint_origins=joints,
        flange=at.flange_origin.T,
        points=points,
        wrench_point=None if parameters.wrench_point is None else at.point(parameters.wrench_point).T,
        force=base_force,
        deflection=deflection,
        q=q,
        singularity=singularity_distance(chain, at),
        k_csm_share=share,
        joint_deflection=bent,
    )


def _loaded(
    chain: Chain, parameters: ModelParameters, q: Float2D, at: Posture, load: Load | None, names: Sequence[str]
) -> tuple[Float2D | None, Float2D | None, Float1D | None, Float2D | None]:
    if load is None:
        return None, None, None, None
    first, *_ = points = [parameters.points[name] for name in names]
    rest = solve_equilibrium(chain, q, parameters.compliance, load)
    own = solve_equilibrium(chain, q, parameters.compliance, None)
    deflection = (rest.at.point(first) - own.at.point(first)).T
    bent = (rest.deflection - own.deflection).T
    share = complementary_share(parameters.compliance, at, load, points)
    return deflection, bent, share, load.in_base(at)[0].T


def complementary_share(compliance: Float1D, at: Posture, load: Load, points: Sequence[Float1D]) -> Float1D:
    """Return by how much the complementary stiffness moves the point that it moves most, (m,) m.

    To first order C K_CSM C tau is added to the joint deflections C tau (CWA 17384, equation (4)), for a wrench that
    keeps its direction while the robot yields.

    Args:
        compliance: (n,) rad/(N*m).
        at: The postures.
        load: Of each of them.
        points: (3,) m each, flange frame.
    """
    force, torque, _ = load.in_base(at)
    fixed = Load(force, torque, load.point, None)
    yields = compliance[:, None]
    extra = yields * np.einsum("ijm,jm->im", load_torque_derivative(at, fixed), yields * load_torque(at, fixed))
    moved = [np.einsum("nam,nm->ma", linear_jacobian(at, at.point(point)), extra) for point in points]
    return np.asarray(np.linalg.norm(moved, axis=2).max(axis=0))


def singularity_distance(chain: Chain, at: Posture) -> Float1D:
    """Return, per configuration, the smallest singular value of the Jacobian at the wrist: 0 is singular.

    Taken at the origin of the last joint, translations in units of the robot's reach; (m,), dimensionless.
    Source: clause 5.4 of CWA 17384 asks for the condition of the Jacobians.
    """
    linear = linear_jacobian(at, at.origin[-1]).transpose(2, 1, 0) / max(chain.reach, 1e-9)
    angular = at.spins.transpose(2, 1, 0)
    return np.linalg.svd(np.concatenate([linear, angular], axis=1), compute_uv=False)[:, -1]
