"""Which corrections of the geometry a recording can identify, and in whose effect the others are hidden.

The frame before every joint could be moved in six ways, many of which do the same to the measured points.  Candidates
are taken in an order of preference; one that is, to a small rest, a combination of those taken before stays nominal.

Frames of several recordings of one robot: each has a tracker pose and measurement points of its own.

The positions of every recording stand in one common frame nearly; what is left of each recording's own pose is a small
motion (`ModelParameters.setups`), fitted beside everything that the recordings share.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.geometry.fit import AbsoluteProblem, normal_equations, whitened
from calibration_core.identification.geometry.frames import FrameFit
from calibration_core.identification.geometry.terms import (
    CORRECTIONS,
    GeometryTerm,
    PointTerm,
    PoseSteps,
    Term,
    TermContext,
    TrackerTerm,
    names_of,
)
from calibration_core.identification.result.estimate import Unidentified
from calibration_core.identification.statistics import column_scale
from calibration_core.model.chain import Chain, rotation_about
from calibration_core.model.kinematics import posture
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.simulation.simulate import tracker_covariance
from calibration_core.timeseries import Float1D, Float2D, Float3D, Readings


def fit_each(
    readings: Readings, believed: ModelParameters, fit: Callable[[Readings, ModelParameters], FrameFit]
) -> tuple[ModelParameters, FrameFit]:
    """Fit the frames of every recording by itself.

    Args:
        readings: Of several recordings, whose points differ in their names.
        believed: Points, and the common frame.
        fit: Fits the frames of one recording; its points are all those of `readings`, in their order.

    Returns:
        parameters: With points and set-ups.
        frames: Of all together: what the points are, and the covariance of all of them; of the tracker pose the mean
            covariance.
    """
    points = {name: believed.points[name] for name in readings.points}
    at_tracker = np.linalg.inv(believed.tracker)
    setups, squares, freedom = [], [], 0
    covariance, scatter = np.zeros((2, *(6 + 3 * len(points),) * 2))
    for rows in readings.each():
        part = readings.select(rows)
        found = fit(part, believed)
        own = np.unique(part.point)
        setups.append(at_tracker @ found.tracker)
        points |= {readings.points[k]: found.points[k] for k in own}
        index = np.concatenate([6 + 3 * k + np.arange(3) for k in own])
        for whole, part_of in ((covariance, found.covariance), (scatter, found.scatter)):
            whole[np.ix_(index, index)] = part_of[np.ix_(index, index)]
            whole[:6, :6] += part_of[:6, :6] / len(readings.each())
        squares.append(found.rms**2 * len(part))
        freedom += found.freedom
    frames = FrameFit(
        tracker=np.array(believed.tracker),
        points=np.stack(list(points.values())),
        covariance=covariance,
        rms=float(np.sqrt(np.sum(squares) / len(readings))),
        rank=6 + 3 * len(points),
        scatter=scatter,
        freedom=freedom,
    )
    return believed.replace(points={**believed.points, **points}, setups=np.stack(setups)), frames


def pose_terms(recordings: int | None) -> list[Term]:
    """Return the terms of the tracker pose; with several recordings, one term each."""
    return [TrackerTerm()] if recordings is None else [SetupTerm(number) for number in range(recordings)]


@dataclasses.dataclass(frozen=True)
class SetupTerm(PoseSteps):
    """Pose of one recording's positions in the base frame: translations, then rotations about the base axes.

    A step (v, w) makes T -> [exp(w), v] T, as of `TrackerTerm`, for the readings of this recording.

    Attributes:
        recording: Its number, from 0.
    """

    recording: int

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the six parameters."""
        return tuple(f"tracker@{self.recording + 1} {name}" for name in CORRECTIONS)

    def write(self, view: TermContext, out: Float3D) -> None:
        """Write -v and -(w x measured) for the readings of the recording, zero for the others."""
        TrackerTerm().write(view, out)
        assert view.recording is not None  # noqa: S101 - the term is for several recordings
        out[:6, :, view.recording != self.recording] = 0.0

    def moved(self, parameters: ModelParameters, step: Float1D) -> ModelParameters:
        """Apply a twist from the left, in the base frame."""
        assert parameters.setups is not None  # noqa: S101 - the term is for several recordings
        twist = np.eye(4)
        twist[:3, :3], twist[:3, 3] = rotation_about(step[3:]), step[:3]
        setups = np.array(parameters.setups)
        base = parameters.tracker
        setups[self.recording] = np.linalg.inv(base) @ twist @ base @ setups[self.recording]
        return parameters.replace(setups=setups)


# --- which corrections of the geometry a recording can identify, and in whose effect the others are -------------------


DH_KINDS = (0, 3, 2, 5)  # a, alpha, d, theta
OTHER_KINDS = (1, 4)  # y and the rotation about it: needed where neighbouring axes are parallel
LEAST_REST = 0.02  # share of a column that the others do not explain: condition numbers stay near 100 (Schröer's rule)
NAMED = 0.1  # parts of a combination below this share of the largest are not named


@dataclasses.dataclass(frozen=True)
class GeometryCorrection:
    """A correction of the frame before a joint.

    Attributes:
        joint: Counted from 0.
        kind: Index into `terms.CORRECTIONS`.
        name: For DH robots the name of the DH parameter (`a_2`, `alpha_2`, `d_3`, `theta_3`; rows counted from 1).
        nominal: The value in the cell file; None where it states none.
    """

    joint: int
    kind: int
    name: str
    nominal: float | None

    @property
    def unit(self) -> Literal["m", "rad"]:
        """`m` or `rad`."""
        return "m" if self.kind < 3 else "rad"


@dataclasses.dataclass(frozen=True)
class ParameterSelection:
    """What is fitted and what stays nominal.

    Attributes:
        chosen: Corrections to fit.
        nominal: DH-like corrections that stay nominal.
        unidentified: For each of those, what hides it.
    """

    chosen: tuple[GeometryCorrection, ...]
    nominal: tuple[GeometryCorrection, ...]
    unidentified: tuple[Unidentified, ...]

    @property
    def term(self) -> GeometryTerm:
        """The term that fits the chosen corrections, ordered by joint."""
        ordered = sorted(self.chosen, key=lambda c: (c.joint, c.kind))
        return GeometryTerm(tuple((c.joint, c.kind) for c in ordered), tuple(c.name for c in ordered))


def candidates(cell: Cell) -> tuple[GeometryCorrection, ...]:
    """Return the corrections in the order of preference: DH-like ones of all joints, then the others.

    Moving the frame before the first joint is moving the tracker; only what the cell file states of it is listed.
    """
    offered = [
        _candidate(cell, joint, kind)
        for kinds in (DH_KINDS, OTHER_KINDS)
        for joint in range(len(cell.robot.joints))
        for kind in kinds
    ]
    return tuple(candidate for candidate in offered if candidate.joint > 0 or candidate.nominal is not None)


def _candidate(cell: Cell, joint: int, kind: int) -> GeometryCorrection:
    rows = cell.robot.dh
    if rows is None or kind in OTHER_KINDS:
        symbol = "beta" if kind == 4 and rows is not None else CORRECTIONS[kind]
        return GeometryCorrection(joint, kind, f"{symbol}_{joint + 1}", None)
    field = {0: "a", 3: "alpha", 2: "d", 5: "theta"}[kind]
    row = joint - 1 if kind in (0, 3) and not cell.robot.modified_dh else joint
    if row < 0:
        return GeometryCorrection(joint, kind, f"{CORRECTIONS[kind]}_{joint + 1}", None)
    return GeometryCorrection(joint, kind, f"{field}_{row + 1}", float(getattr(rows[row], field)))


def select_identifiable(
    problem: AbsoluteProblem,
    parameters: ModelParameters,
    fixed: Sequence[Term],
    offered: Sequence[GeometryCorrection],
) -> ParameterSelection:
    """Select the corrections that the readings identify beside the `fixed` terms, at the nominal geometry.

    The candidates are taken in order; what a column keeps after the best combination of all columns taken before must
    be at least `LEAST_REST` of its length.  A combination with a smaller rest would make the errors of the result
    more than 1/`LEAST_REST` times those of a well-conditioned fit.
    """
    everything = GeometryTerm(tuple((c.joint, c.kind) for c in offered), tuple(c.name for c in offered))
    terms = [*fixed, everything]
    names = names_of(terms)
    matrix = normal_equations(_without_residual(problem, parameters), parameters, terms).matrix
    scale = column_scale(matrix)
    gram = matrix * np.outer(scale, scale)
    first = len(names) - len(offered)
    taken = list(range(first))
    limit = 3 * len(problem) - 1
    chosen, nominal, unidentified = [], [], []
    for index, candidate in enumerate(offered, start=first):
        weights, rest = _explained(gram, taken, index)
        if matrix[index, index] > 0 and rest >= LEAST_REST and len(taken) < limit:
            taken.append(index)
            chosen.append(candidate)
        elif candidate.kind in DH_KINDS:
            nominal.append(candidate)
            unidentified.append(_hidden(names, taken, index, weights, moves=bool(matrix[index, index] > 0)))
    return ParameterSelection(tuple(chosen), tuple(nominal), tuple(unidentified))


def select_frames(problem: AbsoluteProblem, parameters: ModelParameters) -> tuple[list[Term], tuple[Unidentified, ...]]:
    """Return the terms of the tracker pose and of those point coordinates that the readings tell from it.

    If the flange never turns about some axes, moving the point along one is the same as moving the tracker; such a
    coordinate keeps its nominal value, and the tracker pose takes up the difference.
    """
    poses = pose_terms(None if parameters.setups is None else len(parameters.setups))
    everything: list[Term] = [*poses, *(PointTerm(name, k) for k, name in enumerate(problem.names))]
    names, first = names_of(everything), 6 * len(poses)
    matrix = normal_equations(_without_residual(problem, parameters), parameters, everything).matrix
    scale = column_scale(matrix)
    gram = matrix * np.outer(scale, scale)
    taken, unidentified = list(range(first)), []
    for index in range(first, len(names)):
        weights, rest = _explained(gram, taken, index)
        if matrix[index, index] > 0 and rest >= LEAST_REST:
            taken.append(index)
        else:
            unidentified.append(_hidden(names, taken, index, weights, moves=bool(matrix[index, index] > 0)))
    terms: list[Term] = [*poses]
    for k, name in enumerate(problem.names):
        axes = tuple(axis for axis in range(3) if first + 3 * k + axis in taken)
        if axes:
            terms.append(PointTerm(name, k, axes))
    return terms, tuple(unidentified)


def _without_residual(problem: AbsoluteProblem, parameters: ModelParameters) -> AbsoluteProblem:
    """Return the problem with the predicted positions as readings, so that exact aliases are exactly that."""
    shift = parameters.tracker[:3, :3].T @ -problem.residual(parameters)
    if parameters.setups is not None and problem.recording is not None:
        shift = np.einsum("mji,jm->im", parameters.setups[problem.recording, :3, :3], shift)
    return dataclasses.replace(problem, position=problem.position + shift)


def columns_rest(matrix: Float2D, index: int) -> float:
    """Return the share of a column's length that the other columns do not explain, given J^T J."""
    scale = column_scale(matrix)
    others = [k for k in range(len(matrix)) if k != index]
    return _explained(matrix * np.outer(scale, scale), others, index)[1]


def _explained(gram: Float2D, taken: list[int], index: int) -> tuple[Float1D, float]:
    """Return how the columns taken explain one column, and the length of the rest (all columns of length one)."""
    if not taken:
        return np.empty(0), 1.0
    values, vectors = np.linalg.eigh(gram[np.ix_(taken, taken)])
    kept = values > 1e-12 * max(float(values[-1]), 1e-300)
    projected = vectors[:, kept].T @ gram[taken, index]
    weights = vectors[:, kept] @ (projected / values[kept])
    return weights, float(np.sqrt(max(gram[index, index] - projected @ (projected / values[kept]), 0.0)))


def _hidden(names: tuple[str, ...], taken: list[int], index: int, weights: Float1D, *, moves: bool) -> Unidentified:
    name = names[index]
    if not moves:
        return Unidentified({name: 1.0}, f"{name} does not move the measured point; it stays nominal")
    parts = {name: 1.0, **{names[k]: -float(w) for k, w in zip(taken, weights, strict=True)}}
    largest = max(abs(weight) for weight in parts.values())
    named = {key: weight for key, weight in parts.items() if key == name or abs(weight) >= NAMED * largest}
    combination = {key: weight / largest for key, weight in named.items()}
    others = ", ".join(key for key in combination if key != name) or "the parameters before it"
    return Unidentified(combination, f"{name} cannot be distinguished from {others}; it stays nominal")


JUDGED = 600  # postures by which it is judged what can be told


def pose_problem(chain: Chain, cell: Cell, parameters: ModelParameters, q: Float2D) -> AbsoluteProblem:
    """Return the absolute problem of every measurement point at postures (m, n) rad, point after point.

    The positions are those that the nominal model predicts.
    """
    names, m = tuple(parameters.points), len(q)
    at = posture(chain, q)
    base = np.concatenate([at.point(point) for point in parameters.points.values()], axis=1)
    rotation, origin = parameters.tracker[:3, :3], parameters.tracker[:3, 3:]
    position = rotation.T @ (base - origin)
    root = np.linalg.cholesky(tracker_covariance(cell, position.T))
    whitening = np.moveaxis(np.linalg.inv(root), 0, -1)
    return AbsoluteProblem(
        chain, np.tile(q, (len(names), 1)), position, names, np.repeat(np.arange(len(names)), m), whitening
    )


def geometry_terms(
    chain: Chain, cell: Cell, parameters: ModelParameters, q: Float2D
) -> tuple[tuple[Term, ...], tuple[Unidentified, ...]]:
    """Return the terms of frames, points and geometry that postures (m, n) rad can tell, and what they cannot.

    Args:
        chain: The nominal robot.
        cell: The cell.
        parameters: Frames and points.
        q: Postures that can be measured; some of them are judged.
    """
    problem = pose_problem(chain, cell, parameters, q[:: max(len(q) // JUDGED, 1)])
    frames, hidden = select_frames(problem, parameters)
    choice = select_identifiable(problem, parameters, frames, candidates(cell))
    return (*frames, choice.term), (*hidden, *choice.unidentified)


def pose_information(
    chain: Chain, cell: Cell, parameters: ModelParameters, q: Float2D, terms: Sequence[Term]
) -> Float3D:
    """Return the Fisher information of the terms' parameters in one reading of all points at each posture, (m, n, n).

    Args:
        chain: The nominal robot.
        cell: The cell, for the tracker's noise.
        parameters: Where the derivatives are taken.
        q: (m, n) rad.
        terms: See `geometry_terms`.
    """
    problem = pose_problem(chain, cell, parameters, q)
    columns, _ = whitened(problem, parameters, terms)  # (n, 3, p m)
    parts = columns.reshape(len(columns), 3, len(problem.names), len(q))
    rows = np.ascontiguousarray(np.moveaxis(parts, 3, 0)).reshape(len(q), len(columns), -1)
    information: Float3D = rows @ rows.transpose(0, 2, 1)
    return information
