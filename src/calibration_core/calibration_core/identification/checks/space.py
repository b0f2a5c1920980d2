"""The investigated operating space in Cartesian representation, and how far it is from singularities."""

from __future__ import annotations

import numpy as np

from calibration_core.identification.result.estimate import OperatingSpace
from calibration_core.model.chain import Chain
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.kinematics import Posture, by_axis, linear_jacobian, posture
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.statics import Load, load_torque
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
    shown = parameters.points[readings.points[0]]
    deflection, bent, share, base_force = _loaded(chain, parameters, q, at, at_load, shown)
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
    chain: Chain, parameters: ModelParameters, q: Float2D, at: Posture, load: Load | None, point: Float1D
) -> tuple[Float2D | None, Float2D | None, Float1D | None, Float2D | None]:
    if load is None:
        return None, None, None, None
    rest = solve_equilibrium(chain, q, parameters.compliance, load)
    own = solve_equilibrium(chain, q, parameters.compliance, None)
    deflection = (rest.at.point(point) - own.at.point(point)).T
    jacobian = by_axis(linear_jacobian(at, at.point(point)))
    linear = np.einsum("anm,nm->ma", jacobian, parameters.compliance[:, None] * load_torque(at, load))
    bent = (rest.deflection - own.deflection).T
    return deflection, bent, np.linalg.norm(deflection - linear, axis=1), load.in_base(at)[0].T


def singularity_distance(chain: Chain, at: Posture) -> Float1D:
    """Return, per configuration, the smallest singular value of the Jacobian at the wrist: 0 is singular.

    Taken at the origin of the last joint, translations in units of the robot's reach; (m,), dimensionless.
    Source: clause 5.4 of CWA 17384 asks for the condition of the Jacobians.
    """
    linear = linear_jacobian(at, at.origin[-1]).transpose(2, 1, 0) / max(chain.reach, 1e-9)
    angular = at.spins.transpose(2, 1, 0)
    return np.linalg.svd(np.concatenate([linear, angular], axis=1), compute_uv=False)[:, -1]
