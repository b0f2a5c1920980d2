"""The extended model: compliances and findings fitted together, at their own operating point."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.design import Design, build_design
from calibration_core.diagnosis.evidence import base_of, estimates, field, law_share
from calibration_core.diagnosis.nuisances import nuisances
from calibration_core.diagnosis.selection import Selection
from calibration_core.identification.frames import FrameFit
from calibration_core.identification.offsets import Rows, without_offsets
from calibration_core.identification.problem import LoadedProblem
from calibration_core.model.effects.applied import applied
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.state import State, state_of
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float1D, Float2D, Int1D

ROUNDS = 4
CONVERGED = 1e-5  # of the largest compliance
LEAST_STEP, MOST_STEP = 0.2, 3.0  # step control: factors on a compliance per round


@dataclasses.dataclass(frozen=True, eq=False)
class Extended:
    """The extended model at its own compliances.

    Attributes:
        problem: All readings.
        used: Indices of the readings used.
        state: Null model at the final compliances, all readings.
        rows: Grouping and noise as seen, of the readings used.
        design: Whitened there.
        accepted: Candidates in the model.
        base_compliance: (n,) rad/(N*m), about which the design is linear.
        compliance: (n,) rad/(N*m), fitted.
        compliance_covariance: (n, n).
        value: (p,) parameters of the accepted candidates.
        std: (p,) their standard deviations.
        shift: (m, 3) m, what the accepted candidates move, all readings.
        raw: (m, 3) m, measured - extended model fitted by least squares, offsets not removed, all readings.
        residual: (k, 3) m, the same without offsets, of the readings used.
    """

    problem: LoadedProblem
    used: Int1D
    state: State
    rows: Rows
    design: Design
    accepted: tuple[int, ...]
    base_compliance: Float1D
    compliance: Float1D
    compliance_covariance: Float2D
    value: Float1D
    std: Float1D
    shift: Float2D
    raw: Float2D
    residual: Float2D

    @property
    def compliance_std(self) -> Float1D:
        """(n,) rad/(N*m)."""
        return np.asarray(np.sqrt(np.clip(np.diag(self.compliance_covariance), 0.0, None)))

    def parameters_of(self, candidate: int) -> slice:
        """Return where in `value` an accepted candidate's parameters are."""
        start = 0
        for index in self.accepted:
            k = len(self.design.candidates[index].parameters)
            if index == candidate:
                return slice(start, start + k)
            start += k
        raise KeyError(candidate)


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
        rest=problem.rest(compliance),
    )


def design_at(
    problem: LoadedProblem,
    cell: Cell,
    compliance: Float1D,
    rows: Rows,
    used: Int1D,
    hypotheses: tuple[Candidate, ...],
    frames: FrameFit | None,
) -> tuple[State, Design]:
    """Return state (all readings) and whitened model (those used) at the given compliances, (n,) rad/(N*m)."""
    state = loaded_state(problem, cell, compliance)
    linear = problem.linearise(compliance)
    extra = nuisances(state, frames)
    return state, build_design(state, rows, linear.residual, linear.columns, hypotheses, extra, used)


def extend(
    problem: LoadedProblem,
    cell: Cell,
    start: Float1D,
    rows: Rows,
    used: Int1D,
    hypotheses: tuple[Candidate, ...],
    frames: FrameFit | None,
    selection: Selection,
) -> Extended:
    """Refit the compliances together with what was accepted, re-linearising until they stand still.

    Args:
        problem: All readings.
        cell: The cell file.
        start: (n,) compliances to start from, rad/(N*m).
        rows: Grouping and noise as seen, of the readings used.
        used: Indices of the readings used.
        hypotheses: The catalogue.
        frames: Refitted frames; None for displacement recordings.
        selection: What was accepted.
    """
    compliance = start
    accepted = selection.accepted
    chosen = tuple(hypotheses[index] for index in accepted)
    n = len(compliance)
    value = np.zeros(n)
    for round_number in range(ROUNDS):
        _, design = design_at(problem, cell, compliance, rows, used, chosen, frames)
        value, _ = estimates(field(base_of(design), tuple(range(len(chosen))), 0.0))
        change = np.clip(compliance + value[:n], LEAST_STEP * compliance, MOST_STEP * compliance) - compliance
        if np.abs(change).max() < CONVERGED * np.abs(compliance).max():
            break
        if round_number < ROUNDS - 1:
            compliance = compliance + change
    linear = problem.linearise(compliance)
    state, whole = design_at(problem, cell, compliance, rows, used, hypotheses, frames)
    shift = np.zeros_like(linear.residual)
    at = n
    for candidate in chosen:
        k = len(candidate.parameters)
        shift = shift + candidate.columns(state) @ value[at : at + k]
        at += k
    raw = linear.residual - shift - np.einsum("mij,j->mi", linear.columns, value[:n])
    base = base_of(whole)
    final, covariance = estimates(field(base, accepted, selection.level, law_share(base, accepted)))
    std = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    return Extended(
        problem=problem,
        used=used,
        state=state,
        rows=rows,
        design=whole,
        accepted=accepted,
        base_compliance=compliance,
        compliance=np.clip(compliance + final[:n], 0.0, None),
        compliance_covariance=covariance[:n, :n],
        value=final[n:],
        std=std[n:],
        shift=state.since_step_zero(shift),
        raw=raw,
        residual=without_offsets(linear.rows.select(used), raw[used]),
    )


def extended_model(parameters: ModelParameters, extended: Extended) -> ModelParameters:
    """Return the identified model with the compliances and effects of the extended one."""
    effects = tuple(
        applied(extended.design.candidates[index], extended.value[extended.parameters_of(index)], extended.state)
        for index in extended.accepted
    )
    return parameters.replace(compliance=extended.compliance, effects=effects)
