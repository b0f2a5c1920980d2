"""Weighted Gauss-Newton on absolute positions: frames, geometry and whatever else comes as a term.

Normal matrices are accumulated over blocks of readings, so memory stays bounded and the columns stay in the cache; they
are also what cross-validation works with (normal matrices of folds add up).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import EquilibriumError, IdentificationError
from calibration_core.identification.geometry.frames import fit_frames
from calibration_core.identification.geometry.terms import (
    ElasticityTerm,
    Term,
    TermContext,
    TrackerTerm,
    columns_of,
    names_of,
    places_of,
)
from calibration_core.identification.statistics import column_scale, scaled_inverse
from calibration_core.model.chain import Chain
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.kinematics import posture
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.statics import Load, load_of
from calibration_core.observations.kinds import references_alone
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D, Readings

BLOCK = 2_000  # readings per block
ITERATIONS = 50
CONVERGED = 1e-10  # predicted decrease of the sum of squares, relative to it (plus one: a step of one sigma)
RIDGE = 1e-13  # of the column-scaled normal matrix: keeps a fold that lacks a direction solvable


@dataclasses.dataclass(frozen=True, eq=False)
class AbsoluteProblem:
    """Absolute positions and all that a prediction needs besides the parameters.

    Attributes:
        chain: The nominal robot.
        q: (m, n) rad, encoder angles.
        position: (3, m) m, tracker frame.
        point: (m,) index into `names`; None where there is only one point.
        whitening: 1/sigma (1/m) if all coordinates have the same noise, else (3, 3, m) matrices W, tracker axes, with
            W^T W the inverse covariance of a reading.
        load: External load of every reading beside the robot's own weight; None if there is none.
        recording: (m,) which of several recordings, each with its own set-up, a reading comes from; None: one alone.
        torque: (n, m) N*m on the joints at parameters near those in question, from which equilibria are found sooner;
            None: nothing is known.
    """

    chain: Chain
    q: Float2D
    position: Float2D
    names: tuple[str, ...]
    point: Int1D | None
    whitening: float | Float3D
    load: Load | None = None
    recording: Int1D | None = None
    torque: Float2D | None = None

    def __len__(self) -> int:
        """Return the number of readings."""
        return self.position.shape[1]

    @property
    def loaded(self) -> bool:
        """Whether anything known loads the joints."""
        return self.chain.mass is not None or self.load is not None

    def select(self, rows: Int1D | slice) -> AbsoluteProblem:
        """Return the problem of some of the readings."""
        return AbsoluteProblem(
            self.chain,
            self.q[rows],
            self.position[:, rows],
            self.names,
            None if self.point is None else self.point[rows],
            self.whitening if isinstance(self.whitening, float) else self.whitening[:, :, rows],
            None if self.load is None else self.load.rows(rows),
            None if self.recording is None else self.recording[rows],
            None if self.torque is None else self.torque[:, rows],
        )

    def near(self, parameters: ModelParameters) -> AbsoluteProblem:
        """Return the same problem, whose equilibria are found sooner at parameters near these.

        Raises:
            EquilibriumError: The compliances do not carry the robot's own weight.
        """
        rests = [block.view(parameters).rest for block in self.blocks()] if self._bends(parameters) else []
        torques = [rest.torque for rest in rests if rest is not None]
        return dataclasses.replace(self, torque=np.concatenate(torques, axis=1)) if torques else self

    def _bends(self, parameters: ModelParameters) -> bool:
        return self.loaded and bool(np.any(parameters.compliance))

    def blocks(self) -> Iterator[AbsoluteProblem]:
        """Yield the readings block by block."""
        if len(self) <= BLOCK:
            yield self
            return
        for first in range(0, len(self), BLOCK):
            yield self.select(slice(first, first + BLOCK))

    def view(self, parameters: ModelParameters, *, elastic: bool = False) -> TermContext:
        """Predict every reading.

        Args:
            parameters: Current values.
            elastic: Whether the derivatives of the equilibrium are wanted even if the joints are still rigid.

        Raises:
            EquilibriumError: The compliances do not carry the robot's own weight.
        """
        chain = self.chain.corrected(parameters.geometry)
        rest = None
        if elastic or self._bends(parameters):
            rest = solve_equilibrium(chain, self.q, parameters.compliance, self.load, self.torque)
        at = posture(chain, self.q) if rest is None else rest.at
        if self.point is None:
            target = at.point(parameters.points[self.names[0]])
        else:
            target = at.point(np.stack([parameters.points[name] for name in self.names], axis=1)[:, self.point])
        placed = parameters.placed(self.position, self.recording)
        measured = parameters.tracker[:3, :3] @ placed + parameters.tracker[:3, 3:4]
        return TermContext(chain, parameters, at, target, measured, self.point, rest, self.recording)

    def residual(self, parameters: ModelParameters) -> Float2D:
        """Return measured minus predicted, (3, m) m, base axes."""
        views = (block.view(parameters) for block in self.blocks())
        return np.concatenate([view.measured - view.target for view in views], axis=1)


@dataclasses.dataclass(frozen=True, eq=False)
class NormalEquations:
    """Whitened normal equations N dx = g of a set of readings at given parameters.

    Attributes:
        matrix: (p, p) J^T J.
        gradient: (p,) J^T e.
        cost: e^T e.
    """

    matrix: Float2D
    gradient: Float1D
    cost: float
    readings: int

    def __add__(self, other: NormalEquations) -> NormalEquations:
        """Add further readings."""
        return NormalEquations(
            self.matrix + other.matrix,
            self.gradient + other.gradient,
            self.cost + other.cost,
            self.readings + other.readings,
        )

    def of(self, chosen: Int1D) -> NormalEquations:
        """Return the equations of some of the parameters, the others held."""
        return NormalEquations(self.matrix[np.ix_(chosen, chosen)], self.gradient[chosen], self.cost, self.readings)

    def __sub__(self, other: NormalEquations) -> NormalEquations:
        """Take readings out."""
        return NormalEquations(
            self.matrix - other.matrix,
            self.gradient - other.gradient,
            self.cost - other.cost,
            self.readings - other.readings,
        )


class Prior(Protocol):
    """What is known of the parameters before the readings."""

    def normal(self, parameters: ModelParameters) -> NormalEquations:
        """Return what it adds to the normal equations at these values (no readings)."""
        ...


@dataclasses.dataclass(frozen=True, eq=False)
class GeometryFit:
    """The least-squares solution for a list of terms.

    Attributes:
        terms: What was fitted.
        normal: Whitened normal equations at the solution, the prior included.
        iterations: Gauss-Newton steps.
        converged: Whether the sum of squares stopped falling.
        prior: What was known of the terms before; None: nothing.
    """

    parameters: ModelParameters
    terms: tuple[Term, ...]
    normal: NormalEquations
    iterations: int
    converged: bool
    prior: Prior | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fitted parameters."""
        return names_of(self.terms)

    @property
    def seen(self) -> NormalEquations:
        """What the readings alone say at the solution."""
        return self.normal if self.prior is None else self.normal - self.prior.normal(self.parameters)

    @property
    def freedom(self) -> int:
        """Coordinates minus the number of parameters that the readings determine."""
        if self.prior is None:
            return 3 * self.normal.readings - len(self.normal.gradient)
        return freedom_beside(self.seen, self.normal.matrix)

    def covariance(self, scale: float = 1.0) -> Float2D:
        """Return the (p, p) covariance of the parameters, SI units.

        With the information S of the readings as they were weighed and P of the prior, the solution has the covariance
        (S + P)^-1 (scale^2 S + P) (S + P)^-1: the prior is as good as it was, however large the noise is.

        Args:
            scale: Factor by which the noise exceeds the stated one.
        """
        inverse = scaled_inverse(self.normal.matrix)
        if self.prior is None:
            return scale**2 * inverse
        known = inverse @ (self.normal.matrix - self.seen.matrix) @ inverse
        return scale**2 * inverse - (scale**2 - 1) * (known + known.T) / 2


def fit(
    problem: AbsoluteProblem, start: ModelParameters, terms: Sequence[Term], prior: Prior | None = None
) -> GeometryFit:
    """Minimise the weighted sum of squares by Gauss-Newton under the terms' bounds, damped where a step fails.

    Raises:
        EquilibriumError: The start does not carry the robot's own weight.
    """
    near_start = problem.near(start)

    def linearised(at: ModelParameters) -> NormalEquations:
        seen = normal_equations(near_start, at, terms)
        return seen if prior is None else seen + prior.normal(at)

    parameters, normal, damping = start, linearised(start), 0.0
    for iteration in range(1, ITERATIONS + 1):
        step = bounded_step(normal, lower_steps(terms, parameters), damping)
        if float(normal.gradient @ step) <= CONVERGED * (normal.cost + 1.0):
            last = moved(parameters, terms, step) if not np.any(parameters.compliance) else parameters
            return GeometryFit(last, tuple(terms), normal, iteration, converged=True, prior=prior)
        trial = moved(parameters, terms, step)
        after = _attempt(linearised, trial)
        if after is not None and after.cost <= normal.cost:
            parameters, normal = trial, after
            damping = 0.0 if damping < 1e-6 else damping / 10
        elif damping > 1e6:
            break
        else:
            damping = max(10 * damping, 1e-4)
    return GeometryFit(parameters, tuple(terms), normal, ITERATIONS, converged=False, prior=prior)


def freedom_beside(seen: NormalEquations, total: Float2D) -> int:
    """Return coordinates less the number of parameters that the readings determine beside what is known already.

    Source: trace of (S + P)^-1 S, with the information S of the readings and P of the prior.

    Args:
        seen: What the readings say.
        total: (p, p) their information with that of the prior.
    """
    scale = column_scale(total)
    weighted, whole = (matrix * np.outer(scale, scale) for matrix in (seen.matrix, total))
    share = float(np.trace(np.linalg.lstsq(whole, weighted, rcond=None)[0]))
    return 3 * seen.readings - round(share)


def _attempt(
    linearised: Callable[[ModelParameters], NormalEquations], trial: ModelParameters
) -> NormalEquations | None:
    """Linearise at trial values; None where such compliances would not carry the robot."""
    try:
        return linearised(trial)
    except EquilibriumError:
        return None


def normal_equations(problem: AbsoluteProblem, parameters: ModelParameters, terms: Sequence[Term]) -> NormalEquations:
    """Accumulate the whitened normal equations over blocks of readings."""
    p = len(names_of(terms))
    matrix, gradient, cost = np.zeros((p, p)), np.zeros(p), 0.0
    for block in problem.blocks():
        columns, residual = whitened(block, parameters, terms)
        flat = columns.reshape(p, residual.size)
        matrix += flat @ flat.T
        gradient += flat @ residual.reshape(-1)
        cost += float(np.vdot(residual, residual))
    weight = problem.whitening**2 if isinstance(problem.whitening, float) else 1.0
    return NormalEquations(weight * matrix, weight * gradient, weight * cost, len(problem))


def linearised(block: AbsoluteProblem, parameters: ModelParameters, terms: Sequence[Term]) -> tuple[Float3D, Float2D]:
    """Return the columns (p, 3, m), m per unit, and residuals (3, m), m, base axes."""
    view = block.view(parameters, elastic=any(isinstance(t, ElasticityTerm) and t.gravity is None for t in terms))
    return columns_of(view, terms), view.measured - view.target


def whitened(block: AbsoluteProblem, parameters: ModelParameters, terms: Sequence[Term]) -> tuple[Float3D, Float2D]:
    """Return the columns (p, 3, m) and residuals (3, m), whitened but for a common factor 1/sigma."""
    return weighed(block, parameters, *linearised(block, parameters, terms))


def weighed(
    block: AbsoluteProblem, parameters: ModelParameters, columns: Float3D, residual: Float2D
) -> tuple[Float3D, Float2D]:
    """Whiten columns and residuals as of `linearised`, but for a common factor 1/sigma."""
    if isinstance(block.whitening, float):
        return columns, residual
    to_noise = np.einsum("abm,cb->acm", block.whitening, parameters.tracker[:3, :3])
    return np.einsum("acm,pcm->pam", to_noise, columns), np.einsum("acm,cm->am", to_noise, residual)


def moved(parameters: ModelParameters, terms: Sequence[Term], step: Float1D) -> ModelParameters:
    """Return the parameters after a step of all terms."""
    for term, place in places_of(terms):
        if term.names:
            parameters = term.moved(parameters, step[place])
    return parameters


def lower_steps(terms: Sequence[Term], parameters: ModelParameters) -> Float1D:
    """Return the lowest step, (p,), that keeps every value above its bound."""
    if not terms:
        return np.empty(0)
    return np.concatenate([term.lower - term.values(parameters) for term in terms])


def bounded_step(normal: NormalEquations, lower: Float1D, damping: float = 0.0) -> Float1D:
    """Solve N dx = g such that no step falls below `lower` (p,).

    Active set: parameters that would leave their bounds are put on them and the rest is solved again; one whose
    release would lower the sum of squares is released.  With damping, N's diagonal grows by that share.
    """
    scale = column_scale(normal.matrix)
    matrix = normal.matrix * np.outer(scale, scale)
    matrix[np.diag_indices_from(matrix)] += damping + RIDGE
    right, floor = normal.gradient * scale, np.minimum(lower, 0.0) / scale
    held = np.zeros(len(right), dtype=bool)
    step = np.linalg.solve(matrix, right)
    bounded = np.isfinite(floor)
    if not bounded.any():
        return step * scale
    for _ in range(3 * int(bounded.sum()) + 1):
        out = bounded & ~held & (step < floor - 1e-15)
        if out.any():
            held |= out
        else:
            pull = right - matrix @ step
            release = held & (pull > 1e-12 * np.abs(right).max(initial=0.0))
            if not release.any():
                break
            held[np.argmax(np.where(release, pull, -np.inf))] = False
        step = np.where(held, floor, 0.0)
        free = ~held
        step[free] = np.linalg.solve(matrix[np.ix_(free, free)], (right - matrix @ step)[free])
    return step * scale


# --- an absolute recording as a least-squares problem, and a start for it that needs no guess of the ------------------


MIN_CONFIGURATIONS = 3
MIN_SPREAD = 1e-3  # m: second singular value of the centred positions over sqrt(m); below it they lie on one line
START_READINGS = 400  # enough for a first solution of the frames


def absolute_problem(
    readings: Readings, cell: Cell, chain: Chain, nominal: ModelParameters, covariance: Float3D
) -> AbsoluteProblem:
    """Set up the problem; its points are those that were read.

    Args:
        readings: The recording.
        cell: The cell file.
        chain: The nominal robot.
        nominal: What the cell file believes.
        covariance: (m, 3, 3) m^2 of the positions, tracker axes.

    Raises:
        IdentificationError: The recording holds differences instead of positions, or too few to fix the frames.
        CellError: A wrench was recorded and the cell file does not say where the sensor is.
    """
    require_positions(readings, cell)
    return problem_of(readings, cell, chain, nominal, covariance)


def problem_of(
    readings: Readings, cell: Cell, chain: Chain, nominal: ModelParameters, covariance: Float3D
) -> AbsoluteProblem:
    """Return the same of readings that need not fix the frames, as those of a single posture."""
    present, point = np.unique(readings.point, return_inverse=True)
    names = tuple(readings.points[index] for index in present)
    loaded = readings.wrench is not None and bool(np.any(readings.wrench))
    return AbsoluteProblem(
        chain=chain,
        q=readings.q,
        position=np.ascontiguousarray(readings.position.T),
        names=names,
        point=point.reshape(-1).astype(np.int64) if len(names) > 1 else None,
        whitening=_whitening(covariance),
        load=load_of(readings, cell, nominal) if loaded else None,
        recording=readings.recording,
    )


def start_parameters(problem: AbsoluteProblem, nominal: ModelParameters) -> ModelParameters:
    """Return the nominal model with frames from a solution that is linear in them: no guess is needed.

    Several recordings were brought into one frame before; their frames and points are known to begin with.

    Args:
        problem: All readings; up to 400, evenly taken, are used.
        nominal: What the cell file believes; its tracker pose is not used.
    """
    if problem.recording is not None:
        return nominal
    rows = np.unique(np.linspace(0, len(problem) - 1, START_READINGS).astype(int))
    some = problem.select(rows)
    chain = some.chain.corrected(nominal.geometry)
    at = solve_equilibrium(chain, some.q, nominal.compliance, some.load).at
    point = np.zeros(len(some), dtype=np.int64) if some.point is None else some.point
    guess = np.stack([nominal.points[name] for name in some.names])
    frames = fit_frames(at, some.position.T, point, guess, None)
    fitted = dict(zip(some.names, frames.points, strict=True))
    return nominal.replace(tracker=frames.tracker, points={**nominal.points, **fitted})


def nominal_with_tracker(
    problem: AbsoluteProblem, nominal: ModelParameters, start: ModelParameters, *, known: bool
) -> ModelParameters:
    """Return what the cell file predicts; where it states no tracker pose, the best one for its points."""
    if known:
        return nominal
    return fit(problem, nominal.replace(tracker=start.tracker), [TrackerTerm()]).parameters


def require_positions(readings: Readings, cell: Cell) -> None:
    """Refuse readings that do not fix tracker pose and measurement points.

    Raises:
        IdentificationError: They are differences instead of positions, too few, or on one line.
    """
    path = readings.provenance.path
    if cell.measurements.points == "displacement":
        raise references_alone(readings)
    count = len(np.unique(readings.configuration))
    if count < MIN_CONFIGURATIONS:
        raise IdentificationError(
            path, "configuration", f"{count} configurations", f"at least {MIN_CONFIGURATIONS} to fix the tracker frame"
        )
    centred = readings.position - readings.position.mean(axis=0)
    width = float(np.linalg.svd(centred, compute_uv=False)[1] / np.sqrt(len(readings)))
    if width < MIN_SPREAD:
        found = f"positions on one line (to {1e3 * width:.2g} mm)"
        raise IdentificationError(path, "x y z", found, "positions that fix the tracker frame")
    parameters = 6 + 3 * len(np.unique(readings.point))
    if 3 * len(readings) <= parameters:
        raise IdentificationError(
            path,
            "",
            f"{3 * len(readings)} coordinates",
            f"more than the {parameters} parameters of the tracker pose and the measurement points",
        )


def _whitening(covariance: Float3D) -> float | Float3D:
    """Return 1/sigma where all readings have the same isotropic noise, else symmetric roots V^(-1/2), (3, 3, m).

    Symmetric, so that what several readings share keeps its direction, however the tracker is turned.
    """
    variance = float(covariance[0, 0, 0])
    if np.allclose(covariance, variance * np.eye(3), rtol=1e-9, atol=1e-9 * variance):
        return float(1.0 / np.sqrt(variance))
    values, vectors = np.linalg.eigh(covariance)
    roots = (vectors / np.sqrt(values)[:, None, :]) @ vectors.transpose(0, 2, 1)
    return np.ascontiguousarray(np.moveaxis(roots, 0, -1))
