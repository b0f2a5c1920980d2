"""Base frame, geometry, wrist centre and points from the kinematic part of a recording, phase by phase (7.1 to 7.5).

Single-joint sweeps give circles, and these the first guess of base frame and joint axes.  All sweeps and the known
configurations are then fitted together; what the readings cannot tell stays nominal and is named.  The wrist motion,
and points that were measured in known configurations only, follow with what is known by then as prior.

Bending by the robot's own weight is part of every prediction.  The compliances behind it are no result here: they are
nuisances with a broad prior, so that neither a wrong stiffness nor wrong masses bend the geometry.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.absolute.gross_errors import GrossErrorRejection, reject_gross_errors
from calibration_core.identification.checks.noise_audit import exclusion
from calibration_core.identification.circle_point.joint_axes import (
    first_guess,
    identify_axes,
    single_joint_sweeps,
    wrist_sweep,
)
from calibration_core.identification.geometry.fit import AbsoluteProblem, absolute_problem, start_parameters
from calibration_core.identification.geometry.identifiability import (
    ParameterSelection,
    candidates,
    select_frames,
    select_identifiable,
)
from calibration_core.identification.geometry.parameter_table import ConsiderParameters, GaussianPrior, learn
from calibration_core.identification.geometry.terms import AXES, ElasticityTerm, GeometryTerm, PointTerm, Term, names_of
from calibration_core.identification.result.estimate import Exclusion, StandardGeometry, Unidentified
from calibration_core.identification.stiffness.loaded import UNLOADED
from calibration_core.identification.wrist import WRIST, identify_wrist_centre
from calibration_core.model.chain import rotation_vector
from calibration_core.model.effects.candidate import typical
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.observations.average import position_covariance, wrench_covariance
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Readings

BASE_FRAME, JOINT_AXES, WRIST_CENTRE = "base_frame", "joint_axes", "wrist_centre"
LEAST_AXES = 3  # joints 1 and 2 make the base frame; geometry begins with the next

Found = TypeVar("Found")


def standard_geometry(
    readings: Readings, cell: Cell, model: ModelParameters, names: tuple[str, ...], covariance: Float2D
) -> StandardGeometry:
    """Apply the standard's methods to an absolute recording.

    Circles and spheres are those of a rigid robot: what the model says of the bending is taken off the positions first.

    Args:
        readings: The recording.
        cell: The cell file.
        model: What was identified, and believed of the rest.
        names: Names of the rows of `covariance`, `mp1 x` among them where that was fitted.
        covariance: (p, p) of everything that was fitted.
    """
    reasons: dict[str, str] = {}

    def attempt(name: str, method: Callable[[], Found]) -> Found | None:
        try:
            return method()
        except IdentificationError as error:
            reasons[name] = str(error)
            return None

    readings = unbent(readings, cell, model)
    rows = [names.index(name) if name in names else -1 for point in readings.points for name in _coordinates(point)]
    fitted = np.array(rows) >= 0
    of_points = np.where(np.outer(fitted, fitted), covariance[np.ix_(rows, rows)], 0.0) if fitted.any() else None
    axes = attempt(BASE_FRAME, lambda: identify_axes(readings, cell))
    base = None if axes is None else axes.base
    if axes is None:
        reasons[JOINT_AXES] = reasons[BASE_FRAME]
    elif len(axes.axes) < LEAST_AXES:
        place, found = ", ".join(axes.not_observed), "no sweep"
        expected = "five or more poses in which only one of them moves"
        reasons[JOINT_AXES] = str(IdentificationError(readings.provenance.path, place, found, expected))
        axes = None
    return StandardGeometry(
        base=base,
        axes=axes,
        wrist=attempt(WRIST_CENTRE, lambda: identify_wrist_centre(readings, cell, model.points, of_points)),
        points_fitted=bool(fitted.all()),
        reasons=reasons,
    )


def unbent(readings: Readings, cell: Cell, model: ModelParameters) -> Readings:
    """Return the readings as a rigid robot would have given them: bending by its own weight and by loads taken off."""
    problem = absolute_problem(readings, cell, chain_of(cell), model, position_covariance(readings, cell))
    rigid = model.replace(compliance=np.zeros_like(model.compliance))
    bending = problem.view(model).target - problem.view(rigid).target
    return dataclasses.replace(readings, position=readings.position - (model.tracker[:3, :3].T @ bending).T)


def _coordinates(point: str) -> tuple[str, ...]:
    return tuple(f"{point} {axis}" for axis in AXES)


STEP = 1e-7  # m, of the differences by which uncertainties are propagated
LEAST_HEIGHT = 1e-3  # m: distance of the third point from the line of the others


@dataclasses.dataclass(frozen=True, eq=False)
class PointFrame:
    """A frame in three points: origin in the first, x towards the second, the third in the half plane of positive y.

    Attributes:
        pose: (4, 4) of this frame in the flange frame.
        covariance: (6, 6) of its origin (m) and of a rotation vector (rad), both in flange axes.
    """

    pose: Float2D
    covariance: Float2D

    @property
    def std(self) -> Float1D:
        """(6,) m and rad."""
        return np.sqrt(np.diag(self.covariance))


def frame_of(points: Float2D, covariance: Float2D) -> PointFrame:
    """Return the frame of three points.

    Args:
        points: (3, 3) m, flange frame, one per row.
        covariance: (9, 9) m^2, of the points one after another.

    Raises:
        ValueError: The points lie on one line.
    """
    pose = _pose(points)

    def change(moved: Float1D) -> Float1D:
        there = _pose(moved.reshape(3, 3))
        return np.concatenate([there[:3, 3], rotation_vector(there[:3, :3] @ pose[:3, :3].T)])

    flat = points.ravel()
    slope = np.column_stack([(change(flat + h) - change(flat - h)) / (2 * STEP) for h in STEP * np.eye(9)])
    return PointFrame(pose, slope @ covariance @ slope.T)


def _pose(points: Float2D) -> Float2D:
    first, second, third = points
    length = float(np.linalg.norm(second - first))
    x = (second - first) / max(length, 1e-300)
    across = third - first - x * (x @ (third - first))
    height = float(np.linalg.norm(across))
    if min(length, height) < LEAST_HEIGHT:
        msg = f"three points on one line (to {1e3 * min(length, height):.2g} mm)"
        raise ValueError(msg)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([x, across / height, np.cross(x, across / height)])
    pose[:3, 3] = first
    return pose


# --- base frame, geometry, wrist centre and points from the kinematic part of a recording, phase by -------------------


NO_LOAD = 5.0  # standard deviations of the sensor below which a wrench is its noise
UNLOADED_TORQUE = 1e-3  # N*m
BROAD = 3.0  # times the typical compliance: standard deviation of the prior of what bends under its own weight


@dataclasses.dataclass(frozen=True, eq=False)
class PhaseRows:
    """Which readings belong to which phase.

    Attributes:
        loaded: (m,) configurations with unloaded and loaded steps: stiffness.
        sweeps: (m,) one joint alone turns: base frame and joint axes.
        wrist: (m,) the arm stands and the wrist joints move together: wrist centre.
        poses: (m,) all others: known configurations.
    """

    loaded: Bool1D
    sweeps: Bool1D
    wrist: Bool1D
    poses: Bool1D

    @property
    def kinematic(self) -> Bool1D:
        """(m,) everything but the loaded configurations."""
        return ~self.loaded


@dataclasses.dataclass(frozen=True, eq=False)
class Kinematics:
    """What the kinematic phases leave for the next one.

    Attributes:
        readings: The kinematic readings, without wrenches that are the sensor's noise.
        rows: Their phases.
        geometry: Knowledge after sweeps and known configurations.
        final: Knowledge after all kinematic readings.
        choice: Which geometry was fitted, and what stays nominal.
        hidden: Coordinates of points that stay nominal, and why.
        exclusions: Readings not used.
    """

    readings: Readings
    rows: PhaseRows
    geometry: GaussianPrior
    final: GaussianPrior
    choice: ParameterSelection
    hidden: tuple[Unidentified, ...]
    exclusions: tuple[Exclusion, ...]


def split(readings: Readings) -> PhaseRows:
    """Tell the phases of a recording apart, by what moves and what is loaded."""
    m, n = readings.q.shape
    loaded = np.zeros(m, dtype=bool)
    if readings.wrench is not None:
        force = np.linalg.norm(readings.wrench[:, :3], axis=1)
        _, index = np.unique(readings.configuration, return_inverse=True)
        low, high = np.full(m, np.inf), np.full(m, -np.inf)
        np.minimum.at(low, index, force)
        np.maximum.at(high, index, force)
        loaded = (high - low)[index] > UNLOADED * force.max(initial=0.0)
    kinematic = np.flatnonzero(~loaded)
    q, point = readings.q[kinematic], readings.point[kinematic]
    sweeps, wrist = np.zeros(m, dtype=bool), np.zeros(m, dtype=bool)
    for sweep in single_joint_sweeps(q, point):
        sweeps[kinematic[sweep.rows]] = True
    if n > WRIST:
        for sweep in wrist_sweep(q, point, tuple(range(n - WRIST, n))):
            wrist[kinematic[sweep.rows]] = True
    wrist &= ~sweeps
    return PhaseRows(loaded, sweeps, wrist, ~loaded & ~sweeps & ~wrist)


def identify_kinematics(
    readings: Readings, cell: Cell, believed: ModelParameters, *, robust: bool = True
) -> Kinematics:
    """Find frames, geometry and points with covariance.

    Raises:
        IdentificationError: Too few configurations, positions on one line, or differences instead of positions.
        CellError: A load was recorded and a frame for it is missing.
    """
    readings = without_sensor_noise(readings, cell)
    rows = split(readings)
    problem = absolute_problem(readings, cell, chain_of(cell), believed, position_covariance(readings, cell))
    start = start_parameters(problem, believed)
    frames, hidden = select_frames(problem, start)
    choice = select_identifiable(problem, start, frames, candidates(cell))
    start = _circles_first(readings, cell, start, choice)
    used = np.ones(len(readings), dtype=bool)
    exclusions: tuple[Exclusion, ...] = ()
    if robust:
        everything = [*frames, choice.term, *_bending(problem, start)]
        rejection = reject_gross_errors(problem, start, everything, used, np.zeros_like(used))
        used = rejection.used
        off = np.linalg.norm(problem.residual(rejection.fit.parameters), axis=0)
        exclusions = tuple(_exclusion(readings, int(row), rejection, float(off[row])) for row in np.flatnonzero(~used))
    later = _later(frames, readings, rows)
    known = _beginning(start, [*(term for term in frames if term not in later), choice.term], cell, problem)
    known = dataclasses.replace(known, held=_held(choice, cell, len(known.names)))
    of_later = np.isin(readings.point, [readings.points.index(term.point) for term in later])
    together = (rows.sweeps | rows.poses) & used & ~of_later
    known = geometry = learn(problem.select(np.flatnonzero(together)), known)
    if np.any(rows.wrist & used & ~of_later):
        known = learn(problem.select(np.flatnonzero(rows.wrist & used & ~of_later)), known)
    for term in later:
        known = known.and_of(term)
    if np.any(of_later & used):
        known = learn(problem.select(np.flatnonzero(of_later & used)), known)
    return Kinematics(readings, rows, geometry, known, choice, hidden, exclusions)


def without_sensor_noise(readings: Readings, cell: Cell) -> Readings:
    """Return the readings without wrenches that do not stand out from the sensor's noise: a free robot."""
    if readings.wrench is None:
        return readings
    sigma = np.sqrt(np.einsum("mii->mi", wrench_covariance(readings, cell)))
    noise = np.all(np.abs(readings.wrench) <= NO_LOAD * sigma, axis=1)
    return dataclasses.replace(readings, wrench=np.where(noise[:, None], 0.0, readings.wrench))


def _circles_first(
    readings: Readings, cell: Cell, start: ModelParameters, choice: ParameterSelection
) -> ModelParameters:
    """Return the start with base frame and joint axes of the circles, where joints were swept alone."""
    try:
        tracker, found = first_guess(unbent(readings, cell, start), cell)
    except IdentificationError:  # no such sweeps: the linear start is enough
        return start
    geometry = start.geometry.copy()
    for one in choice.chosen:
        if found[one.joint].any():
            geometry[one.joint, one.kind] = found[one.joint, one.kind]
    return start.replace(tracker=tracker, geometry=geometry)


def _later(frames: list[Term], readings: Readings, rows: PhaseRows) -> list[PointTerm]:
    """Return the points that no sweep has seen: they follow when the kinematics is known."""
    if not rows.sweeps.any():
        return []
    swept = {readings.points[index] for index in np.unique(readings.point[rows.sweeps])}
    return [term for term in frames if isinstance(term, PointTerm) and term.point not in swept]


def _beginning(start: ModelParameters, terms: list[Term], cell: Cell, problem: AbsoluteProblem) -> GaussianPrior:
    """Return what is known before any reading: nothing, but the order of magnitude of what bends."""
    free = len(names_of(terms))
    if not problem.loaded:
        return GaussianPrior(start, tuple(terms), np.zeros((free, free)))
    n = problem.chain.n
    usual = typical("joint_elasticity", cell.robot.rated_load)
    if not start.compliance.any():
        start = start.replace(compliance=np.full(n, usual))
    bending = ElasticityTerm(tuple(range(n)), tuple(f"C {joint}" for joint in problem.chain.joints))
    information = np.concatenate([np.zeros(free), np.full(n, 1 / (BROAD * usual) ** 2)])
    return GaussianPrior(start, (*terms, bending), np.diag(information))


def _bending(problem: AbsoluteProblem, start: ModelParameters) -> list[Term]:
    """Return the compliances of the joints that weight or load turn at all: a wrong stiffness is no gross error."""
    if not problem.loaded:
        return []
    torque = solve_equilibrium(problem.chain, problem.q, start.compliance, problem.load).torque
    joints = tuple(int(j) for j in np.flatnonzero(np.abs(torque).max(axis=1) > UNLOADED_TORQUE))
    return [ElasticityTerm(joints, tuple(f"C {problem.chain.joints[j]}" for j in joints))] if joints else []


def _held(choice: ParameterSelection, cell: Cell, fitted: int) -> ConsiderParameters | None:
    """Return what stays nominal beyond joint 1 (whose frame is the base frame), with its usual error."""
    hidden = [one for one in choice.nominal if one.joint > 0]
    if not hidden:
        return None
    usual = {
        "m": typical("geometry_length", cell.robot.rated_load),
        "rad": typical("geometry_angle", cell.robot.rated_load),
    }
    term = GeometryTerm(tuple((one.joint, one.kind) for one in hidden), tuple(one.name for one in hidden))
    return ConsiderParameters(term, np.zeros((fitted, len(hidden))), np.array([usual[one.unit] for one in hidden]))


def _exclusion(readings: Readings, row: int, rejection: GrossErrorRejection, off: float) -> Exclusion:
    reason = (
        f"{off * 1e3:.3f} mm from where all other readings of the kinematic phases put it "
        f"({np.sqrt(rejection.squared[row]):.1f} claimed standard deviations, limit {np.sqrt(rejection.threshold):.1f})"
    )
    return exclusion(readings, row, reason, off, rejection.squared[row])
