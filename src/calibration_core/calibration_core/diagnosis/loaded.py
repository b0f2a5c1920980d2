"""Diagnosis of a loaded recording: null model, selection, re-linearised extended model, what remains."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.anomalies import find_anomalies
from calibration_core.diagnosis.design import Design, build_design
from calibration_core.diagnosis.evidence import estimates, field
from calibration_core.diagnosis.finding import Diagnosis, Rest, Verdict
from calibration_core.diagnosis.naming import findings_of
from calibration_core.diagnosis.selection import Selection, select
from calibration_core.identification.distributions import f_tail
from calibration_core.identification.estimate import Identification
from calibration_core.identification.loaded import Options, PreparedLoaded, identify_prepared, prepare_loaded
from calibration_core.identification.offsets import without_offsets
from calibration_core.identification.problem import LoadedProblem
from calibration_core.model.effects import candidates
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.state import State, state_of
from calibration_core.timeseries import Float1D, Float2D, Readings

ROUNDS = 3
SETTLED = 0.9  # the noise is taken as found once the rest falls by less than a tenth
SIGNIFICANT = 0.001
SMALLEST_EXCESS = 1.05  # of the noise: a smaller rest does not matter, however certain
TRUSTED_FREEDOM = 60  # degrees of freedom from which on the rigid triangle sets the noise


@dataclasses.dataclass(frozen=True, eq=False)
class Extended:
    """The extended model at its own compliances.

    Attributes:
        state: Null model at the final compliances.
        design: Whitened there.
        compliance: (n,) rad/(N*m).
        compliance_std: (n,).
        value: (p,) parameters of the accepted candidates.
        std: (p,) their standard deviations.
        shift: (m, 3) m, what the accepted candidates move.
        residual: (m, 3) m, measured - extended model, offsets removed.
    """

    state: State
    design: Design
    compliance: Float1D
    compliance_std: Float1D
    value: Float1D
    std: Float1D
    shift: Float2D
    residual: Float2D


def diagnose_loaded(readings: Readings, cell: Cell, options: Options | None = None) -> Diagnosis:
    """Say what the model of a loaded recording leaves out.

    Args:
        readings: The recording.
        cell: The cell file.
        options: As for `identify_loaded`.

    Raises:
        InputError: As `identify_loaded`.
    """
    options = options or Options()
    prepared = prepare_loaded(readings, cell, options)
    identification = identify_prepared(prepared, cell, options)
    used = prepared.problem.select(np.flatnonzero(prepared.screened.used))
    anomalies = find_anomalies(identification)
    state = loaded_state(used, cell, prepared.fit.compliance)
    hypotheses = candidates(state)
    seen = seen_noise(identification)
    noise_scale = seen or max(1.0, float(np.sqrt(prepared.fit.chi2 / max(prepared.fit.freedom, 1))))
    design, selection, extended = _attempt(used, cell, prepared, state, hypotheses, noise_scale)
    while (
        seen is None and (left := noise_scale * _whitened_rest(extended, selection)[1] ** 0.5) < SETTLED * noise_scale
    ):
        noise_scale = max(1.0, left)
        design, selection, extended = _attempt(used, cell, prepared, state, hypotheses, noise_scale)
    rest = what_remains(extended, selection, identification, noise_scale, prepared)
    findings = findings_of(extended, selection, identification, readings)
    before, after = held_out_error(design, ()), held_out_error(extended.design, selection.accepted)
    scale = identification.noise.claimed * noise_scale
    return Diagnosis(
        verdict=_verdict(bool(findings), rest),
        findings=findings,
        anomalies=anomalies,
        rest=rest,
        next_measurements=(),
        identification=identification,
        stiffness={
            joint: (1 / c, s / c**2) if c > 0 else (np.inf, np.inf)
            for joint, c, s in zip(state.chain.joints, extended.compliance, extended.compliance_std, strict=True)
        },
        rms_before=identification.fit.rms_used,
        rms_after=float(np.sqrt(np.mean(extended.residual**2))),
        held_out_before=before * scale,
        held_out_after=after * scale,
        noise=scale,
        level=selection.level,
        located=(),
        residual=extended.residual,
        shift=extended.shift,
        compliance=extended.compliance,
    )


def _attempt(
    problem: LoadedProblem,
    cell: Cell,
    prepared: PreparedLoaded,
    state: State,
    hypotheses: tuple[Candidate, ...],
    noise_scale: float,
) -> tuple[Design, Selection, Extended]:
    linear = problem.linearise(prepared.fit.compliance)
    design = build_design(state, linear.rows, linear.residual, linear.columns, hypotheses, noise_scale)
    selection = select(design)
    return design, selection, extend(problem, cell, prepared, hypotheses, selection, noise_scale)


def seen_noise(identification: Identification) -> float | None:
    """Return the factor on the claimed noise that the rigid triangle shows; None where no model-free check can.

    Without it the noise starts at what the null model leaves and shrinks with what the findings explain.
    """
    audit = identification.noise
    for check in audit.checks:
        if check.source == "rigid triangle" and check.degrees_of_freedom >= TRUSTED_FREEDOM:
            return float(np.clip(check.seen / audit.claimed, 0.3, 10.0))
    return None


def loaded_state(problem: LoadedProblem, cell: Cell, compliance: Float1D) -> State:
    """Return the null model's state at the given compliances, for the readings of the problem."""
    readings = problem.readings
    points = np.stack([problem.parameters.points[name] for name in readings.points])[readings.point].T
    return state_of(
        problem.chain,
        readings.q,
        compliance,
        problem.load,
        points,
        point_index=readings.point,
        wrench=readings.wrench,
        configuration=problem.configuration,
        step=readings.step,
        time=readings.time,
        temperature=readings.temperature,
        tracker=problem.parameters.tracker,
        rated_load=cell.robot.rated_load,
    )


def extend(
    problem: LoadedProblem,
    cell: Cell,
    prepared: PreparedLoaded,
    hypotheses: tuple[Candidate, ...],
    selection: Selection,
    noise_scale: float,
) -> Extended:
    """Refit the compliances together with what was accepted, re-linearising until they stand still."""
    compliance, rounds = prepared.fit.compliance, 0
    while True:
        rounds += 1
        state = loaded_state(problem, cell, compliance)
        linear = problem.linearise(compliance)
        design = build_design(state, linear.rows, linear.residual, linear.columns, hypotheses, noise_scale)
        value, covariance = estimates(field(design, selection.accepted, selection.level))
        change = value[: len(compliance)]
        if rounds == ROUNDS or np.abs(change).max() < 1e-6 * np.abs(compliance).max():
            break
        compliance = np.clip(compliance + change, 0.2 * compliance, 3.0 * compliance)  # step control
    n = len(compliance)
    shift = np.zeros_like(linear.residual)
    start = n
    for index in selection.accepted:
        k = len(hypotheses[index].parameters)
        shift = shift + hypotheses[index].columns(state) @ value[start : start + k]
        start += k
    rest = linear.residual - shift - np.einsum("mij,j->mi", linear.columns, value[:n])
    std = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    return Extended(
        state,
        design,
        compliance,
        std[:n],
        value[n:],
        std[n:],
        state.since_step_zero(shift),
        without_offsets(linear.rows, rest),
    )


def what_remains(
    extended: Extended,
    selection: Selection,
    identification: Identification,
    noise_scale: float,
    prepared: PreparedLoaded,
) -> Rest:
    """Test the rest of the extended model against the noise (F test), and say where it is largest."""
    design = extended.design
    rest, ratio, freedom = _whitened_rest(extended, selection)
    noise_freedom = next(
        (c.degrees_of_freedom for c in identification.noise.checks if c.source == "rigid triangle"), 10**6
    )
    beyond = f_tail(ratio, freedom, noise_freedom) < SIGNIFICANT
    significant = bool(beyond and np.sqrt(ratio) > SMALLEST_EXCESS)
    sigma = identification.noise.claimed * noise_scale
    excess = sigma * float(np.sqrt(max(ratio - 1, 0.0)))
    if not significant:
        return Rest(excess, False, {}, "The rest agrees with the noise.")
    per = {int(k): float(np.mean(rest[design.configuration == k] ** 2)) for k in np.unique(design.configuration)}
    numbers = np.unique(prepared.problem.readings.configuration)
    worst = sorted(per, key=lambda k: -per[k])[:5]
    where = {
        "configurations": [int(numbers[k]) for k in worst],
        "times_noise": [round(per[k] ** 0.5, 2) for k in worst],
    }
    text = (
        f"A rest of {1e6 * excess:.1f} µm per coordinate beyond the noise is not explained by the catalogue; largest in "
        f"configurations {', '.join(str(int(numbers[k])) for k in worst)}."
    )
    return Rest(excess, True, where, text)


def _whitened_rest(extended: Extended, selection: Selection) -> tuple[Float1D, float, int]:
    """Return what null model and findings leave, (r,), its mean square and degrees of freedom."""
    design = extended.design
    columns = np.column_stack([design.null, *(design.columns[:, design.blocks[i]] for i in selection.accepted)])
    norms = np.linalg.norm(columns, axis=0)
    columns = columns[:, norms > 0] / norms[norms > 0]
    basis, _ = np.linalg.qr(columns)
    rest = design.residual - basis @ (basis.T @ design.residual)
    freedom = max(len(rest) - columns.shape[1], 1)
    return rest, float(rest @ rest) / freedom, freedom


def held_out_error(design: Design, accepted: tuple[int, ...]) -> float:
    """Return the rms of the whitened prediction error of configurations left out (1 is the noise)."""
    columns = np.column_stack([design.null, *(design.columns[:, design.blocks[i]] for i in accepted)])
    scale = np.linalg.norm(columns, axis=0)
    columns = columns / np.where(scale > 0, scale, 1.0)
    matrix, vector = columns.T @ columns + 1e-9 * np.eye(columns.shape[1]), columns.T @ design.residual
    squares = 0.0
    for number in np.unique(design.configuration):
        rows = design.configuration == number
        own, target = columns[rows], design.residual[rows]
        without = np.linalg.solve(matrix - own.T @ own, vector - own.T @ target)
        squares += float(((target - own @ without) ** 2).sum())
    return float(np.sqrt(squares / len(design.residual)))


def _verdict(found: bool, rest: Rest) -> Verdict:
    if found:
        return "partly_explained" if rest.significant else "missing_physics"
    return "unexplained" if rest.significant else "consistent"
