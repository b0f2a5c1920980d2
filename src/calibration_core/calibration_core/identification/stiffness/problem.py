"""The loaded recording as a least-squares problem in the joint compliances: residuals, derivatives, noise."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Literal, TypeVar

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.statistics import Rows, without_offsets
from calibration_core.identification.stiffness.predict import from_step_zero, references
from calibration_core.model.chain import Chain
from calibration_core.model.effects.state import wrench_response
from calibration_core.model.equilibrium import Equilibrium, solve_equilibrium
from calibration_core.model.kinematics import by_axis, linear_jacobian, posture
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.statics import Load, load_of, load_torque
from calibration_core.observations.average import position_covariance, wrench_covariance
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Int1D, Readings, in_time

KEPT = 3  # equilibria and linearisations that a problem remembers: the diagnosis comes back to a few compliances
T = TypeVar("T")
Method = Literal["equilibrium", "linear"]
Weights = Literal["instrument", "plain"]


@dataclasses.dataclass(frozen=True, eq=False)
class Linearised:
    """The problem at one set of compliances, base axes.

    Attributes:
        predicted: (m, 3) m, points in the base frame.
        residual: (m, 3) m, measured - predicted.
        columns: (m, 3, n) d predicted / d compliance.
        rows: Grouping and noise.
    """

    predicted: Float2D
    residual: Float2D
    columns: Float3D
    rows: Rows


@dataclasses.dataclass(frozen=True, eq=False)
class LoadedProblem:
    """Everything that the fit of a loaded recording needs, independent of the compliances.

    Attributes:
        readings: The m readings.
        parameters: Frames and points (their compliances are not used here).
        load: External load of every reading.
        unloaded: (m, 3) m, predicted points of the undeformed robot, base frame.
        measured: (m, 3) m, base frame.
        noise: (m, 3, 3) m^2, covariance of one reading, base axes.
        wrench_root: (m, 6, w) square root of the covariance of the wrench as recorded.
        configuration: (m,) index of the configuration of each reading.
        method: `equilibrium`, or `linear` for equations (6) and (7) of the standard, which neglect K_CSM.
        torque: (n, m) N*m, of the joints at an equilibrium of these readings that was found before; None: none was.
        solved: The last equilibria, by the bytes of the compliances.
        linearised: What `linearise` has returned last, likewise.
    """

    chain: Chain
    readings: Readings
    parameters: ModelParameters
    load: Load
    unloaded: Float2D
    measured: Float2D
    noise: Float3D
    wrench_root: Float3D
    configuration: Int1D
    method: Method
    torque: Float2D | None = None
    solved: dict[bytes, Equilibrium] = dataclasses.field(default_factory=dict, init=False, repr=False)
    linearised: dict[bytes, Linearised] = dataclasses.field(default_factory=dict, init=False, repr=False)

    def select(self, rows: Int1D) -> LoadedProblem:
        """Return the problem of some of the readings (indices); configurations keep their index."""
        return dataclasses.replace(
            self,
            readings=self.readings.select(rows),
            load=self.load.rows(rows),
            torque=None if (torque := self._torque()) is None else torque[:, rows],
            **{
                name: getattr(self, name)[rows]
                for name in ("unloaded", "measured", "noise", "wrench_root", "configuration")
            },
        )

    def linearise(self, compliance: Float1D) -> Linearised:
        """Predict all readings with these compliances, (n,) rad/(N*m), and differentiate."""
        return _remembered(self.linearised, compliance, self._linearise)

    def rest(self, compliance: Float1D) -> Equilibrium:
        """Return the equilibrium of all readings at these compliances, (n,) rad/(N*m).

        Raises:
            EquilibriumError: The load is beyond what the joints can carry.
        """
        return _remembered(self.solved, compliance, self._rest)

    def residual(self, compliance: Float1D) -> Float2D:
        """Return measured minus predicted, (m, 3) m, base axes, at these compliances, (n,) rad/(N*m)."""
        if self.method == "linear":
            return self.measured - self._linear(compliance)[0]
        return self.measured - self.rest(compliance).at.point(self._points()).T

    def _rest(self, compliance: Float1D) -> Equilibrium:
        return solve_equilibrium(self.chain, self.readings.q, compliance, self.load, self._torque())

    def _torque(self) -> Float2D | None:
        """Return the torques at the equilibrium found last, which differ little from those at other compliances."""
        return next(reversed(self.solved.values())).torque if self.solved else self.torque

    def _linearise(self, compliance: Float1D) -> Linearised:
        if self.method == "linear":
            predicted, columns, by_wrench = self._linear(compliance)
        else:
            predicted, columns, by_wrench = self._equilibrium(compliance)
        columns = columns * ~np.array(self.chain.rigid)  # what is declared rigid is not asked for
        shared = np.einsum("mij,mjk->mik", by_wrench, self.wrench_root)
        rows = Rows(self.configuration, self.readings.point, self._loads, self.noise, shared)
        return Linearised(predicted, self.measured - predicted, columns, rows)

    @functools.cached_property
    def _loads(self) -> Int1D:
        return _shared_loads(self.readings)

    def _points(self) -> Float2D:
        names = self.readings.points
        return np.stack([self.parameters.points[name] for name in names])[self.readings.point].T

    def _linear(self, compliance: Float1D) -> tuple[Float2D, Float3D, Float3D]:
        """Equation (6): J_MP K^-1 J_WP^T W on the undeformed geometry, K_CSM and gravity left out."""
        at = posture(self.chain, self.readings.q)
        jacobian = by_axis(linear_jacobian(at, at.point(self._points())))
        torque = load_torque(at, self.load)
        columns = np.moveaxis(jacobian * torque, -1, 0)
        by_wrench = wrench_response(jacobian * compliance[:, None], at, self.load)
        return self.unloaded + columns @ compliance, columns, by_wrench

    def _equilibrium(self, compliance: Float1D) -> tuple[Float2D, Float3D, Float3D]:
        rest = self.rest(compliance)
        points = self._points()
        answer = rest.loaded_point_jacobian(points)
        columns = np.moveaxis(answer * rest.torque, -1, 0)
        return rest.at.point(points).T, columns, wrench_response(answer * compliance[:, None], rest.at, self.load)


def _remembered(known: dict[bytes, T], compliance: Float1D, solve: Callable[[Float1D], T]) -> T:
    """Return what was found at these compliances before, or find it now and forget the oldest."""
    key = compliance.tobytes()
    if key not in known:
        found = solve(compliance)
        while len(known) >= KEPT:
            del known[next(iter(known))]
        known[key] = found
    return known[key]


def build_problem(
    readings: Readings,
    cell: Cell,
    chain: Chain,
    parameters: ModelParameters,
    *,
    method: Method = "equilibrium",
    weights: Weights = "instrument",
) -> LoadedProblem:
    """Set up the problem; the frames and points of `parameters` are taken as they are.

    Raises:
        CellError: A frame that the wrench needs is missing in the cell file.
    """
    at = posture(chain, readings.q)
    points = np.stack([parameters.points[name] for name in readings.points])[readings.point].T
    unloaded = at.point(points).T
    rotation = parameters.tracker[:3, :3]
    measured = parameters.placed(readings.position.T, readings.recording).T @ rotation.T
    measured = measured + (unloaded if cell.measurements.points == "displacement" else parameters.tracker[:3, 3])
    m = len(readings)
    if weights == "plain":
        noise = np.tile(np.eye(3) * _mean_variance(readings, cell), (m, 1, 1))
        root = np.zeros((m, 6, 0))
    else:
        noise = rotation @ position_covariance(readings, cell) @ rotation.T
        root = _root(wrench_covariance(readings, cell))
    return LoadedProblem(
        chain,
        readings,
        parameters,
        load_of(readings, cell, parameters),
        unloaded,
        measured,
        noise,
        root,
        in_time(readings.configuration),
        method,
    )


def _root(covariance: Float3D) -> Float3D:
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.clip(values, 0.0, None))[:, None, :]


def _mean_variance(readings: Readings, cell: Cell) -> float:
    return float(np.mean(np.einsum("mii->m", position_covariance(readings, cell))) / 3)


def _shared_loads(readings: Readings) -> Int1D:
    """Number the wrench readings: rows of one configuration and step with identical values share one."""
    if readings.wrench is None:
        return np.arange(len(readings))
    keys = np.column_stack([readings.configuration, readings.step, readings.wrench])
    _, index = np.unique(keys, axis=0, return_inverse=True)
    return index.reshape(-1).astype(np.int64)


def relative(problem: LoadedProblem, linear: Linearised, cell: Cell, used: Int1D | Bool1D | None = None) -> Float2D:
    """Return the (m, 3) m residuals after the best offsets; for displacement recordings, relative to step 0.

    Args:
        problem: All readings.
        linear: The problem at some compliances, with the residuals.
        cell: The cell file.
        used: Readings that the offsets rest on, as indices or mask; None: all.
    """
    if cell.measurements.points == "displacement":
        return from_step_zero(problem.readings, linear.residual)
    return without_offsets(linear.rows if used is None else linear.rows.counting(used), linear.residual)


def counted(readings: Readings, cell: Cell) -> Bool1D:
    """Say which readings count in the figures, (m,): all but step 0 of a displacement recording, zero by definition."""
    if cell.measurements.points == "absolute":
        return np.ones(len(readings), dtype=bool)
    return ~references(readings)
