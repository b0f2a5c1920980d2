"""Joint stiffness from a loaded recording: frames, compliances, exclusions, uncertainty, held-out proof."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import EquilibriumError, IdentificationError
from calibration_core.identification.checks.conditions import check_preconditions
from calibration_core.identification.checks.noise_audit import (
    anomalies_of,
    audit,
    rigid_triangle,
    window_scatter,
    zero_return,
)
from calibration_core.identification.checks.space import operating_space
from calibration_core.identification.geometry.frames import FrameFit, fit_frames
from calibration_core.identification.geometry.identifiability import fit_each
from calibration_core.identification.geometry.parameter_table import frame_table, loaded_estimate
from calibration_core.identification.result.estimate import (
    Fit,
    Identification,
    NoiseAudit,
    Residuals,
)
from calibration_core.identification.result.observability import stiffness_table, weak_directions
from calibration_core.identification.statistics import rms
from calibration_core.identification.stiffness.fit import (
    CONVERGED,
    NEARLY,
    Deflections,
    Key,
    LoadedFit,
    OutlierRejection,
    fit_compliance,
    held_out_compliance,
    reject_outliers,
)
from calibration_core.identification.stiffness.predict import from_step_zero
from calibration_core.identification.stiffness.problem import (
    LoadedProblem,
    Method,
    Weights,
    build_problem,
    counted,
    relative,
)
from calibration_core.identification.stiffness.tested import tested_on
from calibration_core.model.chain import Chain
from calibration_core.model.effects.candidate import typical
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import load_of
from calibration_core.observations.average import coordinate_std, position_covariance
from calibration_core.observations.kinds import loaded_configurations
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Int1D, Readings

MIN_CONFIGURATIONS = 2  # one posture cannot tell joints from frames
UNLOADED = 0.02  # share of the largest force below which a step counts as unloaded


@dataclasses.dataclass(frozen=True)
class Options:
    """How a recording is to be evaluated.

    Attributes:
        method: `equilibrium`: deformed geometry, K_CSM and gravity included; `linear`: the standard's equations (6)
            and (7), which neglect it, with these weights and one free offset per configuration and point.
        weights: `instrument`: tracker and wrench covariance; `plain`: every coordinate alike, scaled by the residual.
        deflections: `points`, or `pose` for the rigid displacement of three or more points.
        robust: Set gross errors aside.
        readmit: Readings that must be used: (configuration, step, point).
        start: Model to start from; None: what the cell file believes.
        corrected: Correct the geometry even where configurations left out do not prove that it helps.
    """

    method: Method = "equilibrium"
    weights: Weights = "instrument"
    deflections: Deflections = "points"
    robust: bool = True
    readmit: frozenset[Key] = frozenset()
    start: ModelParameters | None = None
    corrected: bool = False

    def in_words(self) -> str:
        """Describe the method for the report."""
        return ", ".join(
            (
                {
                    "equilibrium": "static equilibrium on the deformed geometry (K_CSM and gravity included)",
                    "linear": "linear least squares, equations (6) and (7) of CWA 17384 (K_CSM neglected)",
                }[self.method],
                {"points": "position deflections", "pose": "full-pose deflections"}[self.deflections],
                {"instrument": "weights from the instruments' uncertainties", "plain": "equal weights"}[self.weights],
                "one free offset per configuration and point",
                "gross errors excluded by name" if self.robust else "every reading used",
            )
        )


def identify_prepared(
    prepared: PreparedLoaded, cell: Cell, options: Options, test: Readings | None = None
) -> Identification:
    """Make the answer from what was fitted."""
    readings = prepared.problem.readings
    problem, rejection, fit, nominal = prepared.problem, prepared.rejection, prepared.fit, prepared.nominal
    chain, parameters, frames = problem.chain, prepared.parameters, prepared.frames

    noise = _audit(problem, rejection, fit, cell)
    plain = options.weights == "plain"
    scale = float(np.sqrt(fit.chi2 / max(fit.freedom, 1))) if plain else noise.scale
    estimated = plain or noise.scale > 1.0
    load = load_of(readings, cell, parameters)
    torque_rms = np.sqrt(np.mean(_load_torques(problem, parameters) ** 2, axis=1))
    joints = tuple(f"C {joint}" for joint in chain.joints)
    residuals, figures = _figures(problem, rejection, fit, nominal.compliance, scale, cell)
    space = operating_space(chain, parameters, readings, load)
    before = parameters.replace(compliance=nominal.compliance)
    return Identification(
        kind="loaded",
        method=options.in_words(),
        readings=readings,
        stiffness=stiffness_table(
            chain.joints,
            fit.solution,
            scale,
            fit.freedom if estimated else None,
            torque_rms,
            chain.prismatic,
            chain.rigid,
        ),
        parameters=() if frames is None else frame_table(frames, cell, readings),
        names=joints,
        covariance=fit.solution.covariance * scale**2,
        condition_number=fit.solution.condition_number,
        fit=figures if frames is None else dataclasses.replace(figures, positions=frames.rms),
        noise=noise,
        stages=(),
        unidentified=weak_directions(joints, fit.solution, chain.rigid),
        exclusions=rejection.exclusions,
        anomalies=anomalies_of(noise, rejection.exclusions, readings),
        preconditions=check_preconditions(readings, cell, space, figures.noise, k_csm=options.method != "linear"),
        residuals=residuals,
        space=space,
        model=parameters,
        test=None if test is None else tested_on(test, cell, parameters, before, with_frames=False),
        notes=readings.notes,
        estimate=loaded_estimate(fit.solution.covariance * scale**2, frames, readings.points, parameters, cell),
        basis=prepared,
    )


@dataclasses.dataclass(frozen=True, eq=False)
class PreparedLoaded:
    """A loaded recording with frames refitted, gross errors set aside and compliances fitted.

    Attributes:
        problem: All readings, frames refitted.
        rejection: The readings used.
        fit: The fit that counts (points or pose).
        nominal: What the cell file believes, or the model to start from.
        parameters: Identified model.
        frames: Refitted frames; None for displacement recordings.
        stated_by: Who says where the tracker is: `the cell file`, `the given model`, `earlier phases`; None: nobody.
    """

    problem: LoadedProblem
    rejection: OutlierRejection
    fit: LoadedFit
    nominal: ModelParameters
    parameters: ModelParameters
    frames: FrameFit | None
    stated_by: str | None

    def select(self, rows: Int1D) -> PreparedLoaded:
        """Return the same fit of some of the readings (indices)."""
        rejection = dataclasses.replace(self.rejection, used=self.rejection.used[rows])
        return dataclasses.replace(self, problem=self.problem.select(rows), rejection=rejection)


def prepare_loaded(readings: Readings, cell: Cell, options: Options) -> PreparedLoaded:
    """Refit the frames, set gross errors aside and fit the compliances.

    Raises:
        CellError: A frame is needed and missing.
        IdentificationError: Fewer than two steps everywhere, or no load.
        EquilibriumError: The load is beyond what the joints can carry.
    """
    nominal = nominal_parameters(cell) if options.start is None else options.start
    chain = chain_of(cell).corrected(nominal.geometry)
    stated_by = _who_states(nominal, options, cell) if readings.recording is None else None  # set-ups are fitted before
    guess = None if stated_by is None else nominal.tracker
    require_load(readings)
    parameters, frames = _with_frames(readings, cell, chain, nominal, guess)
    problem = build_problem(readings, cell, chain, parameters, method=options.method, weights=options.weights)
    converged = CONVERGED if frames is None else NEARLY
    rejection = reject_outliers(
        problem, nominal.compliance, robust=options.robust, readmit=options.readmit, converged=converged
    )
    if frames is not None:
        near, guess = rejection.fit.compliance, None if stated_by is None else parameters.tracker
        believed = parameters.replace(compliance=near)
        parameters, frames = _with_frames(readings, cell, chain, believed, guess, rejection.used)
        problem = build_problem(readings, cell, chain, parameters, method=options.method, weights=options.weights)
        rejection = reject_outliers(
            problem, nominal.compliance, robust=options.robust, readmit=options.readmit, near=near
        )
    fit = rejection.fit
    if options.deflections == "pose":
        fit = fit_compliance(problem.select(np.flatnonzero(rejection.used)), fit.compliance, "pose")
    identified = parameters.replace(compliance=fit.compliance)
    return PreparedLoaded(problem, rejection, fit, nominal, identified, frames, stated_by)


def require_load(readings: Readings) -> None:
    """Raise IdentificationError unless several configurations have several steps, and the load changes."""
    path = readings.provenance.path
    if readings.wrench is None:
        raise IdentificationError(path, "fx ... tz", "no wrench", "the measured load (a loaded recording)")
    several = loaded_configurations(readings)
    if not several:
        raise IdentificationError(path, "step", "one step in every configuration", "unloaded and loaded steps")
    if len(several) < MIN_CONFIGURATIONS:
        found, expected = f"{len(several)} with unloaded and loaded steps", f"at least {MIN_CONFIGURATIONS}"
        raise IdentificationError(path, "configuration", found, f"{expected} (CWA 17384, 5.1, asks for 12)")
    if not np.any(np.ptp(readings.wrench, axis=0) > 0):
        raise IdentificationError(path, "fx ... tz", "the same wrench everywhere", "a load that changes between steps")


def _who_states(nominal: ModelParameters, options: Options, cell: Cell) -> str | None:
    """Say who states where the tracker is; a given model may have the frames of the cell file."""
    if cell.frames.tracker is not None and np.array_equal(nominal.tracker, nominal_parameters(cell).tracker):
        return "the cell file"
    return None if options.start is None else "the given model"


def _with_frames(
    readings: Readings,
    cell: Cell,
    chain: Chain,
    believed: ModelParameters,
    guess: Float2D | None,
    used: Bool1D | None = None,
) -> tuple[ModelParameters, FrameFit | None]:
    """Refit tracker pose and points where the recording holds absolute positions.

    Unloaded readings alone, where every configuration has some: a stiffness that is still wrong then moves no frame.
    """
    if cell.measurements.points == "displacement":
        return believed, None
    kept = readings if used is None else readings.select(used)
    if readings.recording is not None:
        return fit_each(kept, believed, lambda part, at: _fitted_frames(part, cell, chain, at, at.tracker))
    fit = _fitted_frames(kept, cell, chain, believed, guess)
    fitted = dict(zip(readings.points, fit.points, strict=True))
    return believed.replace(tracker=fit.tracker, points={**believed.points, **fitted}), fit


def refitted_frames(
    prepared: PreparedLoaded, cell: Cell, compliance: Float1D, moved: Float2D, used: Int1D
) -> FrameFit | None:
    """Return the frames that fit best beside other compliances and effects; those that were fitted where none can.

    Args:
        prepared: With frames.
        cell: The cell file.
        compliance: (n,) rad/(N*m).
        moved: (m, 3) m, base axes, what the effects move the points.
        used: Indices of the readings to use.
    """
    believed, readings = prepared.parameters.replace(compliance=compliance), prepared.problem.readings
    without = dataclasses.replace(readings, position=readings.position - moved @ believed.tracker[:3, :3])
    try:
        return _fitted_frames(without.select(used), cell, prepared.problem.chain, believed, believed.tracker)
    except (EquilibriumError, IdentificationError):
        return prepared.frames


def _fitted_frames(
    readings: Readings, cell: Cell, chain: Chain, believed: ModelParameters, guess: Float2D | None
) -> FrameFit:
    some = readings.select(_unloaded(readings))
    rest = solve_equilibrium(chain, some.q, believed.compliance, load_of(some, cell, believed))
    points = np.stack([believed.points[name] for name in readings.points])
    claimed = coordinate_std(position_covariance(some, cell))
    usual = (0.0, 0.0)
    if not np.any(believed.geometry):  # one that was calibrated is no longer so far off
        load = cell.robot.rated_load
        usual = typical("registration_geometry_length", load), typical("registration_geometry_angle", load)
    fit = fit_frames(rest.at, some.position, some.point, points, guess, claimed, usual)
    if guess is None and fit.rank < 6:
        raise IdentificationError(
            readings.provenance.path,
            "",
            "configurations that do not fix the tracker pose",
            "frames.tracker in the cell file",
        )
    return fit


def _unloaded(readings: Readings) -> Bool1D:
    assert readings.wrench is not None  # noqa: S101 - a loaded recording has a wrench
    force = np.linalg.norm(readings.wrench[:, :3], axis=1)
    light = force <= UNLOADED * force.max()
    everywhere = set(readings.configuration) == set(readings.configuration[light])
    return light if everywhere else np.ones(len(readings), dtype=bool)


def _audit(problem: LoadedProblem, rejection: OutlierRejection, fit: LoadedFit, cell: Cell) -> NoiseAudit:
    linear = problem.linearise(fit.compliance)
    absolute = cell.measurements.points == "absolute"
    checks = (
        rigid_triangle(problem.readings.position, problem.readings, rejection.used) if absolute else None,
        zero_return(linear.residual, problem.readings, rejection.used) if absolute else None,
        window_scatter(problem.readings, rejection.used),
    )
    return audit(problem.noise[rejection.used], checks, fit.chi2, fit.freedom)


def without_load(problem: LoadedProblem) -> LoadedProblem:
    """Return the same problem with the robot under its own weight alone."""
    load = problem.load
    return dataclasses.replace(
        problem, load=dataclasses.replace(load, force=np.zeros_like(load.force), torque=np.zeros_like(load.torque))
    )


def _load_torques(problem: LoadedProblem, parameters: ModelParameters) -> Float2D:
    """Return the (n, m) joint torques of the external load alone, N*m."""
    loaded = solve_equilibrium(problem.chain, problem.readings.q, parameters.compliance, problem.load)
    own = solve_equilibrium(problem.chain, problem.readings.q, parameters.compliance, None)
    return loaded.torque - own.torque


def _figures(
    problem: LoadedProblem, rejection: OutlierRejection, fit: LoadedFit, before: Float1D, scale: float, cell: Cell
) -> tuple[Residuals, Fit]:
    linear = problem.linearise(fit.compliance)
    own = without_load(problem).linearise(fit.compliance)
    after = relative(problem, linear, cell, rejection.used)
    nominal = relative(problem, problem.linearise(before), cell, rejection.used)
    compliances = held_out_compliance(fit, problem.configuration)
    moved = np.einsum("mij,mj->mi", linear.columns, compliances[problem.configuration] - fit.compliance)
    left_out = dataclasses.replace(linear, residual=linear.residual - moved)
    held_out = relative(problem, left_out, cell, rejection.used)
    shown = counted(problem.readings, cell)
    lengths = np.linalg.norm(held_out[shown], axis=1)
    differences = cell.measurements.points == "displacement"
    deflection = linear.predicted - own.predicted
    predicted = from_step_zero(problem.readings, deflection) if differences else deflection
    doubled = 2.0 if differences else 1.0
    variance = np.einsum("mii->mi", problem.noise) + np.einsum("mij,mij->mi", linear.rows.shared, linear.rows.shared)
    assert problem.readings.wrench is not None  # noqa: S101 - a loaded recording has a wrench
    residuals = Residuals(
        measured=predicted + after,
        predicted=predicted,
        residual=after,
        held_out=held_out,
        sigma=scale * np.sqrt(doubled * variance),
        load=np.linalg.norm(problem.readings.wrench[:, :3], axis=1),
        excluded=~rejection.used,
    )
    figures = Fit(
        rms_before=rms(nominal[shown]),
        rms_after=rms(after[shown]),
        held_out_rms_before=rms(nominal[shown]),
        held_out_rms_after=rms(held_out[shown]),
        noise=float(np.sqrt(doubled * variance[shown].mean())),
        held_out_mean_after=float(lengths.mean()),
        held_out_max_after=float(lengths.max()),
        rms_used=rms(after[shown & rejection.used]),
        chi2=fit.chi2,
        degrees_of_freedom=fit.freedom,
    )
    return residuals, figures
