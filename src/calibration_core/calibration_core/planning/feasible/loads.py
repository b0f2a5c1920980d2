"""Loads that a cell can apply: oblique pulls at the wrench point, and what they tell about the joints.

A pull (a cable over a pulley, a hanging weight with a guy) has a direction fixed in base axes.  It stays within the
rated load and within the range of the force/torque sensor.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import CellError
from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import by_axis, cross, linear_jacobian, posture
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.simulation.simulate import tracker_covariance
from calibration_core.timeseries import Float1D, Float2D, Float3D

STANDARD_ACCELERATION = 9.80665  # m/s^2, turns the rated load in kg into N
NINE_STEPS = (0.0, 0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0)


@dataclasses.dataclass(frozen=True)
class LoadRules:
    """How the robot is loaded.

    Attributes:
        levels: Fractions of the full pull, one per step; the first is unloaded (CWA 17384, 7.6).
        share: Full pull with the end effector's weight as a share of the rated load's weight, at most 1.
        tilt: rad, least and largest angle of a pull off the downward vertical.
        directions: Pulls considered per posture.
        largest_force: N, range of the force/torque sensor; None: not limited.
        largest_torque: N*m, likewise.
        k_csm: m, largest movement of any measurement point that the complementary stiffness K_CSM may cause under the
            full pull (CWA 17384, 6.2: negligible far from singularities); None: not limited.
    """

    levels: tuple[float, ...] = NINE_STEPS
    share: float = 1.0
    tilt: tuple[float, float] = (0.436, 1.134)
    directions: int = 6
    largest_force: float | None = None
    largest_torque: float | None = None
    k_csm: float | None = 2e-5

    @property
    def spread(self) -> float:
        """Sum of squared deviations of the levels from their mean: what one free offset per configuration leaves."""
        levels = np.array(self.levels)
        return float(((levels - levels.mean()) ** 2).sum())


def full_pulls(
    cell: Cell, parameters: ModelParameters, rules: LoadRules, count: int, rng: np.random.Generator
) -> Float3D:
    """Draw the full pulls, force only, (count, directions, 3) N in base axes.

    Azimuths are spread evenly around the vertical from a random start; tilts are uniform.  The torque that a pull
    puts on the sensor is at most force times distance from the sensor's origin to the wrench point.
    """
    gravity = cell.gravity
    size = float(np.linalg.norm(gravity))
    down = gravity / size if size > 0.0 else np.array([0.0, 0.0, -1.0])
    across = np.linalg.svd(down[None, :])[2][1:]
    azimuth = rng.uniform(0, 2 * np.pi, (count, 1)) + 2 * np.pi * np.arange(rules.directions) / rules.directions
    tilt = rng.uniform(*rules.tilt, azimuth.shape)
    level = np.cos(azimuth)[..., None] * across[0] + np.sin(azimuth)[..., None] * across[1]
    unit = np.cos(tilt)[..., None] * down + np.sin(tilt)[..., None] * level
    return np.asarray(largest_pull(cell, parameters, rules) * unit)


def largest_pull(cell: Cell, parameters: ModelParameters, rules: LoadRules) -> float:
    """Return the largest force, N, that the rated load and the sensor's range allow in any direction.

    Raises:
        CellError: The end effector alone weighs as much as the robot is to carry.
    """
    force = rules.share * cell.robot.rated_load * STANDARD_ACCELERATION - float(np.linalg.norm(cell.tool_weight))
    if force <= 0.0:
        tool = 0.0 if cell.end_effector is None else cell.end_effector.mass
        expected = f"less than {rules.share * cell.robot.rated_load:g} kg, {100 * rules.share:g} % of the rated load"
        raise CellError(cell.path, "end_effector.mass", f"{tool:g} kg", expected)
    if rules.largest_force is not None:
        force = min(force, rules.largest_force)
    if rules.largest_torque is not None and parameters.force_torque is not None and parameters.wrench_point is not None:
        lever = float(np.linalg.norm(parameters.wrench_point - parameters.force_torque[:3, 3]))
        if lever > 0.0:
            force = min(force, rules.largest_torque / lever)
    return force


def wrench_steps(force: Float1D, levels: tuple[float, ...]) -> Float2D:
    """Return the (steps, 6) wrenches of a pull, N and N*m, base axes, at the wrench point."""
    return np.hstack([np.outer(levels, force) + 0.0, np.zeros((len(levels), 3))])  # no negative zeros


def point_noise(chain: Chain, cell: Cell, parameters: ModelParameters, q: Float2D) -> Float3D:
    """Return the covariance of one reading of all points, (m, 3 p, 3 p) m^2, base axes.

    Tracker noise of each point, and the noise of the one wrench reading that they share, propagated through the nominal
    compliances (nothing where these are not known).
    """
    at = posture(chain, q)
    points = [at.point(point) for point in parameters.points.values()]
    m, p = len(q), len(points)
    noise = np.zeros((m, 3 * p, 3 * p))
    for i, point in enumerate(points):
        noise[:, 3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = _tracker_noise(cell, parameters, point)
    instrument = cell.instruments.force_torque
    if instrument is None or parameters.wrench_point is None or not np.any(parameters.compliance):
        return noise
    where = parameters.wrench_point if parameters.force_torque is None else parameters.force_torque[:3, 3]
    by_force = linear_jacobian(at, at.point(where))  # (n, 3, m), torque per unit force at the sensor
    by_torque = at.spins
    jacobian = np.concatenate([by_axis(linear_jacobian(at, point)) for point in points])  # (3 p, n, m)
    for part, sigma in ((by_force, instrument.sigma_force), (by_torque, instrument.sigma_torque)):
        root = np.einsum("anm,n,nkm->mak", jacobian, parameters.compliance, part) * sigma
        noise += root @ root.transpose(0, 2, 1)
    return noise


def _tracker_noise(cell: Cell, parameters: ModelParameters, point: Float2D) -> Float3D:
    """Return the (m, 3, 3) covariances, base axes, of the tracker's readings at (3, m) m, base frame."""
    rotation, origin = parameters.tracker[:3, :3], parameters.tracker[:3, 3]
    covariance: Float3D = rotation @ tracker_covariance(cell, (point.T - origin) @ rotation) @ rotation.T
    return covariance


def information(
    chain: Chain, cell: Cell, parameters: ModelParameters, q: Float2D, force: Float3D, rules: LoadRules
) -> Float3D:
    """Return what every posture with every pull tells about the compliances.

    Args:
        chain: The robot.
        cell: For the instruments.
        parameters: Frames, points, nominal compliances.
        q: (m, n) rad.
        force: (m, k, 3) N, full pulls at the wrench point.
        rules: For the load levels.

    Returns:
        (m, k, n, n) Fisher information of the compliances, one free offset per configuration and point eliminated.
        The columns are J_MP diag(J_WP^T W) (CWA 17384, equation (7)), so it is the product of two small matrices.
    """
    at = posture(chain, q)
    assert parameters.wrench_point is not None  # noqa: S101 - the planner has checked it
    levers = linear_jacobian(at, at.point(parameters.wrench_point))  # (n, 3, m)
    torque = np.einsum("nam,mka->mkn", levers, force) * ~np.array(chain.rigid)
    points = [by_axis(linear_jacobian(at, at.point(point))) for point in parameters.points.values()]
    jacobian = np.moveaxis(np.concatenate(points), -1, 0)  # (m, 3 p, n)
    weight = np.linalg.solve(point_noise(chain, cell, parameters, q), jacobian)
    gram = jacobian.transpose(0, 2, 1) @ weight
    return rules.spread * gram[:, None] * torque[..., :, None] * torque[..., None, :]


def complementary_share(chain: Chain, parameters: ModelParameters, q: Float2D, force: Float3D) -> Float2D:
    """Return by how much the complementary stiffness moves the measurement point that it moves most, (m, k) m.

    To first order C K_CSM C tau is added to the joint deflections C tau, with K_CSM,ij = (dJ_i/dq_j)^T f =
    (a_i x (a_j x (p - o_j))) . f for i <= j, symmetric (CWA 17384, equation (4); Alici and Shirinzadeh, 2005).

    Args:
        chain: The robot.
        parameters: Points and compliances.
        q: (m, n) rad.
        force: (m, k, 3) N, full pulls at the wrench point.
    """
    at = posture(chain, q)
    assert parameters.wrench_point is not None  # noqa: S101 - the planner has checked it
    n = chain.whole.n
    each = linear_jacobian(at.moving, at.point(parameters.wrench_point))
    stiffness = np.empty((*force.shape[:2], n, n))
    for j in range(n):
        for i in range(j + 1):
            bent = cross(at.moving.spin(i), each[j])
            stiffness[..., i, j] = stiffness[..., j, i] = np.einsum("am,mka->mk", bent, force)
    if chain.mimics:
        stiffness = chain.matrix.T @ stiffness @ chain.matrix
    levers = linear_jacobian(at, at.point(parameters.wrench_point))
    torque = np.einsum("nam,mka->mkn", levers, force)
    compliance = parameters.compliance
    extra = compliance * np.einsum("mkij,mkj->mki", stiffness, compliance * torque)
    largest = np.zeros(force.shape[:2])
    for point in parameters.points.values():
        jacobian = linear_jacobian(at, at.point(point))
        largest = np.maximum(largest, np.linalg.norm(np.einsum("nam,mkn->mka", jacobian, extra), axis=2))
    return largest
