"""Fitted frames, points and geometry as values with standard deviations, in the coordinates of the cell file.

What earlier phases found, with its full covariance, as the beginning of the next one.

The phases of the standard (7.1 to 7.6) build on each other.  What one of them leaves is a normal distribution over the
parameters of frames, points and geometry; the next adds its own readings to it.  With readings y, model f and knowledge
(x0, P), the next phase minimises |W (y - f(x))|^2 + (x - x0)^T P^-1 (x - x0), whose information matrix is the sum of
both: the order of the phases does not matter, nothing is counted twice, and nothing is taken as exact that is not.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.geometry.fit import (
    AbsoluteProblem,
    NormalEquations,
    fit,
    freedom_beside,
    normal_equations,
)
from calibration_core.identification.geometry.frames import FrameFit
from calibration_core.identification.geometry.identifiability import GeometryCorrection, ParameterSelection, candidates
from calibration_core.identification.geometry.terms import (
    AXES,
    CORRECTIONS,
    ElasticityTerm,
    GeometryTerm,
    Term,
    TrackerTerm,
    names_of,
)
from calibration_core.identification.result.estimate import ParameterEstimate
from calibration_core.identification.statistics import LEVEL, chi2_limit, scaled_inverse
from calibration_core.model.chain import rotation_vector, rotation_y, rotation_z, rpy_of, xyz_rpy
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.named_values import POSE, unit_of, value_of
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float1D, Float2D, Readings

UNITS: tuple[Literal["m", "rad"], ...] = ("m", "m", "m", "rad", "rad", "rad")


@dataclasses.dataclass(frozen=True, eq=False)
class Uncertainty:
    """Names and covariance of all fitted parameters, the tracker pose as x, y, z, roll, pitch, yaw.

    Attributes:
        names: (p,) names, compliances first.
        covariance: (p, p), SI units.
    """

    names: tuple[str, ...]
    covariance: Float2D

    def std(self, name: str) -> float:
        """Return one standard deviation; NaN if the parameter was not fitted."""
        if name not in self.names:
            return float("nan")
        index = self.names.index(name)
        return float(np.sqrt(self.covariance[index, index]))


def uncertainty_of(
    parameters: ModelParameters, names: Sequence[str], covariance: Float2D, scale: float = 1.0
) -> Uncertainty:
    """Return the uncertainty of fitted parameters.

    Args:
        parameters: All values.
        names: (p,) of those fitted, the tracker pose first, as a twist.
        covariance: (p, p), SI units.
        scale: By which the standard deviations are widened.
    """
    named, covariance = in_coordinates(parameters, names, covariance)
    order = sorted(range(len(named)), key=lambda k: not named[k].startswith("C "))
    return Uncertainty(tuple(named[k] for k in order), scale**2 * covariance[np.ix_(order, order)])


def in_coordinates(parameters: ModelParameters, names: Sequence[str], covariance: Float2D) -> tuple[list[str], Float2D]:
    """Return names and covariance with poses as x, y, z, roll, pitch, yaw; arguments as `uncertainty_of`."""
    change, named = np.eye(len(covariance)), list(names)
    for k, (label, pose) in enumerate(poses_of(parameters).items()):
        own = slice(6 * k, 6 * k + 6)
        change[own, own] = pose_by_twist(pose)
        named[own] = [f"{label} {name}" for name in POSE]
    return named, change @ covariance @ change.T


def poses_of(parameters: ModelParameters) -> dict[str, Float2D]:
    """Return the poses that are fitted first, (4, 4) each: of the tracker, or `tracker@NUMBER` of every recording's."""
    if parameters.setups is None:
        return {"tracker": parameters.tracker}
    return {f"tracker@{k + 1}": parameters.tracker @ setup for k, setup in enumerate(parameters.setups)}


def pose_by_twist(pose: Float2D) -> Float2D:
    """Return d (x, y, z, roll, pitch, yaw) / d (v, w), (6, 6), of T -> [exp(w), v] T at w = v = 0.

    Source: w = Rz Ry e_x roll' + Rz e_y pitch' + e_z yaw' for R = Rz(yaw) Ry(pitch) Rx(roll).
    """
    x, y, z = pose[:3, 3]
    result = np.eye(6)
    result[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    result[3:, 3:] = rpy_by_rotation(pose[:3, :3])
    return result


def rpy_by_rotation(rotation: Float2D) -> Float2D:
    """Return d (roll, pitch, yaw) / d w, (3, 3), of R -> exp(w) R at w = 0."""
    _, pitch, yaw = rpy_of(rotation)
    about_z = rotation_z(float(yaw))
    rates = np.column_stack([(about_z @ rotation_y(float(pitch)))[:, 0], about_z[:, 1], [0.0, 0.0, 1.0]])
    return np.asarray(np.linalg.inv(rates), dtype=np.float64)


def parameter_table(
    cell: Cell, parameters: ModelParameters, uncertainty: Uncertainty, choice: ParameterSelection, read: tuple[str, ...]
) -> tuple[ParameterEstimate, ...]:
    """List tracker pose, points and geometry; what was not fitted is listed with its nominal value."""
    table = _frames(cell, parameters.tracker, {point: parameters.points[point] for point in read}, uncertainty)
    ordered = sorted((*choice.chosen, *choice.nominal), key=lambda c: (c.joint, c.kind))
    return (*table, *(_geometry(candidate, parameters, uncertainty) for candidate in ordered))


def _geometry(
    candidate: GeometryCorrection, parameters: ModelParameters, uncertainty: Uncertainty
) -> ParameterEstimate:
    return ParameterEstimate(
        name=candidate.name,
        group="geometry",
        value=float(parameters.geometry[candidate.joint, candidate.kind]),
        std=uncertainty.std(candidate.name),
        unit=candidate.unit,
        nominal=candidate.nominal,
        fitted=candidate.name in uncertainty.names,
    )


def frame_table(frames: FrameFit, cell: Cell, readings: Readings) -> tuple[ParameterEstimate, ...]:
    """List tracker pose and points of a loaded recording, which fits no geometry."""
    uncertainty = frames_uncertainty(frames, readings.points)
    return _frames(cell, frames.tracker, dict(zip(readings.points, frames.points, strict=True)), uncertainty)


def frames_uncertainty(frames: FrameFit, points: Sequence[str]) -> Uncertainty:
    """Return the uncertainty of tracker pose and points.

    Args:
        frames: The fit, whose covariance is about rotations about the axes of the base.
        points: Names of the points, of which the first are fitted.
    """
    count = len(frames.covariance)
    change = np.eye(count)
    change[3:6, 3:6] = rpy_by_rotation(frames.tracker[:3, :3])
    names = (*(f"tracker {label}" for label in POSE), *(f"{point} {axis}" for point in points for axis in AXES))
    return Uncertainty(names[:count], change @ frames.covariance @ change.T)


def _frames(
    cell: Cell, tracker: Float2D, points: Mapping[str, Float1D], uncertainty: Uncertainty
) -> tuple[ParameterEstimate, ...]:
    """List tracker pose and points; coordinates without an uncertainty were not fitted."""
    nominal = cell.frames.tracker
    believed = [None] * 6 if nominal is None else [*nominal.xyz, *nominal.rpy]
    pose = xyz_rpy(tracker)
    table = []
    for i, label in enumerate(POSE):
        name, unit = f"tracker {label}", UNITS[i]
        table.append(ParameterEstimate(name, "tracker", float(pose[i]), uncertainty.std(name), unit, believed[i]))
    for point, place in points.items():
        for axis, label in enumerate(AXES):
            name, before = f"{point} {label}", cell.frames.measurement_points[point][axis]
            fitted = name in uncertainty.names
            std = uncertainty.std(name)
            table.append(ParameterEstimate(name, "point", float(place[axis]), std, "m", before, fitted))
    return tuple(table)


# --- what an identification found, with its joint covariance, under the names of the model file -----------------------


COMPLIANCE = "C "  # what the fits call the compliance of a joint, before its name


def named_estimate(names: Sequence[str], covariance: Float2D, model: ModelParameters, cell: Cell) -> GaussianEstimate:
    """Return fitted parameters under the names of the model file; what has no place there is left out.

    That are the joints that are declared rigid, and tracker poses of several recordings.

    Args:
        names: (p,) as the fits call them: `C joint_1`, `tracker roll`, `mp1 x`, `a_2`, ...
        covariance: (p, p) SI units; an infinite variance where the recording says nothing.
        model: The identified model.
        cell: The cell file.

    Raises:
        KeyError: A name is none of the model's.
    """
    kept = in_model_file(names, cell)
    paths = model_paths(cell)
    chosen = tuple(paths[names[k]] for k in kept)
    slides = dict(zip(cell.robot.joints, cell.prismatic, strict=True))
    matrix = np.array(covariance)[np.ix_(kept, kept)]
    return GaussianEstimate(
        chosen,
        tuple(unit_of(name, slides) for name in chosen),
        np.array([value_of(model, name) for name in chosen]),
        without_unknown(matrix),
    )


def in_model_file(names: Sequence[str], cell: Cell) -> list[int]:
    """Return the positions of the parameters that stand in a model file (see `named_estimate`)."""
    rigid = {
        f"{COMPLIANCE}{j}" for j, k in zip(cell.robot.joints, cell.robot.stiffness or (), strict=False) if np.isinf(k)
    }
    return [k for k, name in enumerate(names) if name not in rigid and not name.startswith("tracker@")]


def without_unknown(covariance: Float2D) -> Float2D:
    """Return a covariance in which what is not known (infinite variance) varies with nothing else."""
    unknown = ~np.isfinite(np.diag(covariance))
    matrix = np.where(unknown[:, None] | unknown[None, :], 0.0, covariance)
    matrix[unknown, unknown] = np.inf
    return np.asarray((matrix + matrix.T) / 2, dtype=np.float64)


def loaded_estimate(
    compliance: Float2D, frames: FrameFit | None, points: Sequence[str], model: ModelParameters, cell: Cell
) -> GaussianEstimate:
    """Return the compliances of a loaded recording, and beside them tracker pose and points.

    Args:
        compliance: (n, n) covariance of the compliances.
        frames: Fit of tracker pose and points; None for a recording of differences, which says nothing of them.
        points: Names of the points that were read.
        model: The identified model.
        cell: The cell file.
    """
    joints = named_estimate([f"{COMPLIANCE}{joint}" for joint in cell.robot.joints], compliance, model, cell)
    if frames is None:
        return joints
    fitted = frames_uncertainty(frames, points)
    around = named_estimate(fitted.names, fitted.covariance, model, cell)
    return GaussianEstimate.independent((joints, around))


def with_known_effects(estimate: GaussianEstimate, known: GaussianEstimate | None, count: int) -> GaussianEstimate:
    """Return the estimate of a model that begins with effects known before.

    Args:
        estimate: Of the model without them.
        known: Of the given model; only what it says of its effects is taken over.  None: it has no intervals.
        count: How many effects come before those of the estimate.
    """
    moved = estimate.renamed([_later(name, count) for name in estimate.names])
    if known is None:
        return moved
    of_effects = [k for k, name in enumerate(known.names) if name.startswith("effects.")]
    return GaussianEstimate.independent((moved, known.chosen(of_effects)))


def _later(name: str, count: int) -> str:
    group, _, rest = name.partition(".")
    if group != "effects":
        return name
    number, _, parameter = rest.partition(".")
    return f"effects.{int(number) + count}.{parameter}"


def model_paths(cell: Cell) -> dict[str, str]:
    """Return what the fits call a parameter -> its path in the model file."""
    joints = cell.robot.joints
    paths = {c.name: f"geometry.{joints[c.joint]}.{CORRECTIONS[c.kind]}" for c in candidates(cell)}
    paths |= {f"{COMPLIANCE}{joint}": f"compliance.{joint}" for joint in joints}
    paths |= {f"{point} {axis}": f"measurement_points.{point}.{axis}" for point in cell.points for axis in AXES}
    return paths | {f"tracker {part}": f"tracker.{part}" for part in POSE}


# --- what earlier phases found, with its full covariance, as the beginning of the next one ----------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class ConsiderParameters:
    """Parameters that readings cannot tell from others: they stay nominal, and their standard uncertainty still counts.

    Where such a parameter is wrong, others take up the difference, so that the readings are met all the same; what
    else depends on it, such as where the sensor sits, is then wrong.

    Attributes:
        across: (p, h) information between the parameters that are fitted and these.
        std: (h,) usual errors of nominal values, one standard deviation, m or rad.
    """

    term: GeometryTerm
    across: Float2D
    std: Float1D


@dataclasses.dataclass(frozen=True, eq=False)
class GaussianPrior:
    """Values of frames, points and geometry and how well they are known.

    Attributes:
        parameters: The values; what no term names is taken as it stands.
        terms: The parameters that have an uncertainty.
        information: (p, p) inverse covariance of the terms' parameters in their order, SI units; for the tracker pose
            of the twist (v, w) that makes T -> [exp(w), v] T.  A row of zeros: nothing is known yet.
        scale: Factor by which the residuals of the last readings exceeded the instruments' claim (1: they did not).
        freedom: Degrees of freedom of that comparison.
        held: What stays nominal; None: nothing.
    """

    parameters: ModelParameters
    terms: tuple[Term, ...]
    information: Float2D
    scale: float = 1.0
    freedom: int = 0
    held: ConsiderParameters | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of `covariance`."""
        return names_of(self.terms)

    @property
    def covariance(self) -> Float2D:
        """(p, p), SI units.

        Raises:
            numpy.linalg.LinAlgError: Something is not known at all.
        """
        return scaled_inverse(self.information)

    def normal(self, parameters: ModelParameters) -> NormalEquations:
        """Return what this knowledge adds to the normal equations at other values (no readings)."""
        step = difference(self.terms, self.parameters, parameters)
        pull = self.information @ step
        return NormalEquations(self.information, -pull, float(step @ pull), 0)

    def and_of(self, term: Term) -> GaussianPrior:
        """Return the same knowledge with one more term, of which nothing is known yet."""
        count = len(term.names)
        held = self.held
        return dataclasses.replace(
            self,
            terms=(*self.terms, term),
            information=np.pad(self.information, ((0, count), (0, count))),
            held=None if held is None else dataclasses.replace(held, across=np.pad(held.across, ((0, count), (0, 0)))),
        )

    def without_compliances(self) -> GaussianPrior:
        """Return what is known of everything but the compliances, whatever these are (the marginal)."""
        bends = [isinstance(term, ElasticityTerm) for term in self.terms]
        gone = np.repeat(bends, [len(term.names) for term in self.terms])
        kept = np.flatnonzero(~gone)
        share = np.linalg.solve(self.information[np.ix_(gone, gone)], self.information[np.ix_(gone, ~gone)]).T
        held = self.held
        if held is not None:
            held = dataclasses.replace(held, across=held.across[kept] - share @ held.across[gone])
        return dataclasses.replace(
            self,
            terms=tuple(term for term, bend in zip(self.terms, bends, strict=True) if not bend),
            information=self.information[np.ix_(kept, kept)] - share @ self.information[np.ix_(gone, kept)],
            held=held,
        )


def learn(problem: AbsoluteProblem, known: GaussianPrior) -> GaussianPrior:
    """Add readings of absolute positions to what is known.

    Where their residuals are larger than the instrument's claim explains (1 % level), the readings count less, by the
    factor of the residuals over the claim, squared.

    Raises:
        EquilibriumError: The compliances do not carry the robot's own weight.
    """
    found = fit(problem, known.parameters, known.terms, known)
    seen = normal_equations(problem, found.parameters, known.terms)
    freedom = freedom_beside(seen, seen.matrix + known.information)
    ratio = float(np.sqrt(seen.cost / freedom)) if freedom > 0 else 1.0
    scale = ratio if freedom > 0 and seen.cost > chi2_limit(LEVEL, freedom) and ratio > 1.0 else 1.0
    if scale > 1.0:
        whitening = problem.whitening / scale
        problem = dataclasses.replace(problem, whitening=whitening)
        found = fit(problem, found.parameters, known.terms, known)
        seen = normal_equations(problem, found.parameters, known.terms)
    held = known.held
    if held is not None:
        p = len(known.names)
        both = normal_equations(problem, found.parameters, (*known.terms, held.term)).matrix
        held = dataclasses.replace(held, across=held.across + both[:p, p:])
    return GaussianPrior(found.parameters, known.terms, known.information + seen.matrix, scale, freedom, held)


def difference(terms: tuple[Term, ...], first: ModelParameters, second: ModelParameters) -> Float1D:
    """Return the step of the terms, (p,), that leads from one set of values to the other.

    Source: for the pose, T2 = [exp(w), v] T1, so w is the rotation vector of R2 R1^T and v = t2 - R2 R1^T t1.
    """
    parts = []
    for term in terms:
        if isinstance(term, TrackerTerm):
            turned = second.tracker[:3, :3] @ first.tracker[:3, :3].T
            shift = second.tracker[:3, 3] - turned @ first.tracker[:3, 3]
            parts.append(np.concatenate([shift, rotation_vector(turned)]))
        else:
            parts.append(term.values(second) - term.values(first))
    return np.concatenate(parts)
