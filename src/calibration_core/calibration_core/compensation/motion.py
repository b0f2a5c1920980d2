"""How the tool moves with everything that was identified, and how well its place is therefore known."""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from calibration_core.compensation.robot import CalibratedRobot, LocalEffects
from calibration_core.identification.geometry.parameter_table import rpy_by_rotation
from calibration_core.identification.geometry.terms import CORRECTIONS, correction_axis
from calibration_core.model.equilibrium import Equilibrium
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.named_values import AXES, POSE
from calibration_core.model.kinematics import cross, linear_jacobian, turn
from calibration_core.timeseries import Float1D, Float2D, Float3D

COVERAGE = 0.95


def tool_movement(robot: CalibratedRobot, parts: tuple[LocalEffects, ...], m: int, *, turns: bool = True) -> Float2D:
    """Return what the model's effects move (m) and turn (rad) the tool by, (m, 6), base axes; (m, 3) without turns."""
    moved = np.zeros((m, 6 if turns else 3))
    for part in parts:
        for k, (index, candidate, _) in enumerate(part.effects):
            values = robot.parameters.effects[index].parameters
            moved[part.rows] += part.columns(k) @ np.array([values[p.name] for p in candidate.parameters])
    return moved


def tool_columns(
    robot: CalibratedRobot,
    rest: Equilibrium,
    parts: tuple[LocalEffects, ...],
    estimate: GaussianEstimate,
    point: Float1D | None = None,
) -> Float3D:
    """Return how the tool moves (m) and turns (rad) with every parameter, per its unit, (m, 6, p), base axes.

    Exact for compliances (K_CSM and gravity answer) and effects; for geometry the change of the load's torques by it is
    left out, about a thousandth.  The place is meant as the tracker of the calibration sees it: what its pose is wrong
    by moves the base frame, in which targets are stated.

    Args:
        robot: The robot.
        rest: Its equilibrium at m places.
        parts: Its effects there, with the tool's turning.
        estimate: What was identified.
        point: Another point than the tool's origin, flange frame; effects are then not asked for.
    """
    at = rest.at
    origin = at.point(robot.tool[:3, 3] if point is None else point)
    m = origin.shape[1]
    joints = np.concatenate([linear_jacobian(at, origin), at.spins], axis=1)  # (n, 6, m)
    answer = np.einsum("iam,ijm->jam", joints, rest.amplification)
    columns = np.zeros((m, 6, len(estimate.names)))
    placed = {
        (part_number, index): k
        for part_number, part in enumerate(parts)
        for k, (index, _, _) in enumerate(part.effects)
    }
    tracker = robot.parameters.tracker
    about = np.linalg.inv(rpy_by_rotation(tracker[:3, :3]))  # columns: rotation vectors per roll, pitch, yaw
    made: dict[tuple[int, int], Float3D] = {}
    for p, name in enumerate(estimate.names):
        group, _, inside = name.partition(".")
        if group == "compliance":
            j = robot.chain.joints.index(inside)
            columns[:, :, p] = (answer[j] * rest.torque[j]).T
        elif group == "geometry":
            joint, _, kind = inside.rpartition(".")
            columns[:, :, p] = _of_geometry(
                robot, rest, origin, robot.chain.joints.index(joint), CORRECTIONS.index(kind)
            )
        elif group == "tracker" and inside in AXES:
            columns[:, AXES.index(inside), p] = -1.0
        elif group == "tracker":
            turning = about[:, POSE.index(inside) - 3]
            columns[:, :3, p] = -np.cross(turning, (origin - tracker[:3, 3:]).T)
            columns[:, 3:, p] = -turning
        elif group == "measurement_points" and robot.point is not None and inside[:-2] == robot.point:
            columns[:, :3, p] = at.flange[AXES.index(inside[-1])].T
        elif group == "effects" and point is None:
            number, _, parameter = inside.partition(".")
            for part_number, part in enumerate(parts):
                key = part_number, int(number)
                if key not in placed:
                    continue
                if key not in made:
                    made[key] = part.columns(placed[key])
                names = [one.name for one in part.effects[placed[key]][1].parameters]
                columns[part.rows, : made[key].shape[1], p] = made[key][:, :, names.index(parameter)]
    return columns


def _of_geometry(robot: CalibratedRobot, rest: Equilibrium, origin: Float2D, joint: int, kind: int) -> Float2D:
    axis = turn(rest.at.before[joint], correction_axis(robot.parameters.geometry[joint], kind))
    if kind < 3:
        return np.concatenate([axis, np.zeros_like(axis)]).T
    return np.concatenate([cross(axis, origin - rest.at.origin[joint]), axis]).T


def covariance_of(columns: Float3D, estimate: GaussianEstimate) -> Float3D:
    """Return the covariance (m, k, k) of what has the columns (m, k, p); infinite where an unknown parameter acts."""
    spread = columns @ estimate.root()
    covariance = spread @ np.swapaxes(spread, 1, 2)
    unknown = np.isinf(estimate.std)
    if unknown.any():
        touched = np.abs(columns[:, :, unknown]).max(axis=2) > 0
        rows, coordinates = np.nonzero(touched)
        covariance[rows, coordinates, coordinates] = np.inf
    return np.asarray(covariance)


def length_bound(covariance: Float3D) -> Float1D:
    """Return the length (m,) that a normal error with covariance (m, 3, 3) exceeds in one of twenty cases.

    The squared length, a sum of weighted chi squares, is taken as a gamma variable of the same mean and variance.
    Source: Satterthwaite 1946; Box 1954.
    """
    diagonal = np.einsum("mii->m", covariance)
    known = np.isfinite(diagonal) & (diagonal > 0)
    some = covariance[known]
    mean = np.einsum("mii->m", some)
    variance = 2 * np.einsum("mij,mji->m", some, some)
    shape = mean**2 / variance
    bound = np.where(np.isfinite(diagonal), 0.0, np.inf)
    bound[known] = np.sqrt(gammaincinv(shape, COVERAGE) * variance / mean)
    return np.asarray(bound)
