"""Equations (6) and (7) of CWA 17384 for very many configurations: regressor, solution and covariance in blocks.

The observation matrix of configuration i is A_i = J_MP diag(J_WP^T W_i); it is never stored as a whole.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.identification.solve import Solution, solve_non_negative
from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import linear_jacobian, posture
from calibration_core.model.statics import Load, load_torque
from calibration_core.timeseries import Float1D, Float2D, Float3D

BLOCK = 2000  # configurations at a time: the arrays of one block stay in the cache


@dataclasses.dataclass(frozen=True, eq=False)
class StandardFit:
    """Least-squares compliances of equation (7).

    Attributes:
        solution: Compliances; covariance for unit variance of one coordinate.
        sigma: Standard deviation of one coordinate seen in the residual, m.
    """

    solution: Solution
    sigma: float

    @property
    def covariance(self) -> Float2D:
        """(n, n) covariance of the compliances, (rad/(N*m))^2."""
        return self.solution.covariance * self.sigma**2


def observation_matrix(chain: Chain, q: Float2D, load: Load, point: Float1D) -> Float3D:
    """Return A of equation (7), position rows only, (3, n, m) m per rad/(N*m).

    Args:
        chain: The robot.
        q: (m, n) rad.
        load: External load.
        point: (3,) or (3, m) m, measurement point in the flange frame.
    """
    at = posture(chain, q)
    return np.stack(linear_jacobian(at, at.point(point)), axis=1) * load_torque(at, load)


def fit_standard(chain: Chain, q: Float2D, load: Load, point: Float1D, deflection: Float2D) -> StandardFit:
    """Solve equation (7) by least squares, compliances not negative.

    Args:
        chain: The robot.
        q: (m, n) rad, configurations.
        load: External load, (3, m) force and torque.
        point: (3,) m, measurement point in the flange frame.
        deflection: (m, 3) m, loaded minus unloaded position, base axes.
    """
    n, m = chain.n, len(q)
    matrix, vector, squares = np.zeros((n, n)), np.zeros(n), 0.0
    for start in range(0, m, BLOCK):
        rows = slice(start, min(start + BLOCK, m))
        columns = observation_matrix(chain, q[rows], load.rows(rows), point)
        columns = columns.transpose(1, 0, 2).reshape(n, -1)
        measured = deflection[rows].T.reshape(-1)
        matrix += columns @ columns.T
        vector += columns @ measured
        squares += float(measured @ measured)
    solution = solve_non_negative(matrix, vector, np.zeros(n))
    c = solution.value
    rest = squares - 2 * float(c @ vector) + float(c @ matrix @ c)
    return StandardFit(solution, float(np.sqrt(max(rest, 0.0) / max(3 * m - n, 1))))
