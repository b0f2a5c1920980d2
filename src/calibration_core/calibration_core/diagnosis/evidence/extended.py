"""The extended model: compliances and findings fitted together, at their own operating point."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Sequence

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from calibration_core.cell import Cell
from calibration_core.diagnosis.evidence.design import Choice, Design, LoadedSelection, build_design
from calibration_core.estimation.alternatives import STRUCTURE, fuller_form, instead, left_open, neglected, shares
from calibration_core.estimation.likelihood.gains import MOST_TYPICAL, shared_power
from calibration_core.estimation.noise.strata import sensor_lag, sensor_mounting
from calibration_core.identification.geometry.frames import FrameFit
from calibration_core.identification.statistics import Rows, whitened, without_offsets
from calibration_core.identification.stiffness.problem import LoadedProblem
from calibration_core.model.chain import Chain
from calibration_core.model.effects import effect_named
from calibration_core.model.effects.applied import applied
from calibration_core.model.effects.candidate import Candidate, Parameter
from calibration_core.model.effects.possible import nearest
from calibration_core.model.effects.recordings import each_recording
from calibration_core.model.effects.state import State, recorded_state
from calibration_core.model.effects.structure.gravity_compensator import carriers
from calibration_core.model.parameters import ModelParameters
from calibration_core.policy import PRIOR_WIDTH
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D

ROUNDS = 4
CONVERGED = 1e-4  # of the largest compliance: what the last step leaves is as its square
WIDE = 4.0  # times the usual size: what an effect that was found may move by chance
LEAST_STEP, MOST_STEP = 0.2, 3.0  # step control: factors on a compliance per round


@dataclasses.dataclass(frozen=True, eq=False)
class ExtendedLoadedModel:
    """The extended model at its own compliances.

    Attributes:
        used: Indices of the readings used.
        state: Null model at the final compliances, all readings.
        rows: Grouping and noise as seen, of the readings used.
        design: Whitened there; of the catalogue only what was accepted, or does as well, has columns.
        accepted: Candidates in the model.
        base_compliance: (n,) rad/(N*m), about which the design is linear.
        compliance: (n,) rad/(N*m), fitted.
        value: (p,) parameters of the accepted candidates.
        covariance: (n + p, n + p) of compliances and parameters.
        shift: (m, 3) m, what the accepted candidates move, all readings.
        raw: (m, 3) m, measured - extended model fitted by least squares, what the candidates leave to chance taken out,
            offsets not removed, all readings.
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
    value: Float1D
    covariance: Float2D
    shift: Float2D
    raw: Float2D
    residual: Float2D

    @property
    def compliance_covariance(self) -> Float2D:
        """(n, n) (rad/(N*m))^2."""
        n = len(self.compliance)
        return self.covariance[:n, :n]

    @property
    def compliance_std(self) -> Float1D:
        """(n,) rad/(N*m)."""
        return np.asarray(np.sqrt(np.clip(np.diag(self.compliance_covariance), 0.0, None)))

    def moved(self, several: Sequence[int]) -> Float2D:
        """Return the (m, 3) m that some accepted candidates move the points since their configuration's first step."""
        shift = np.zeros((self.state.m, 3))
        for index in several:
            shift += self.design.candidates[index].columns(self.state) @ self.values_of(index)[0]
        return self.state.since_step_zero(shift)

    def values_of(self, candidate: int) -> tuple[Float1D, Float2D]:
        """Return the parameters of an accepted candidate, (k,), and their covariance, (k, k)."""
        counts = [len(self.design.candidates[index].parameters) for index in self.accepted]
        place = self.accepted.index(candidate)
        start = sum(counts[:place])
        own = slice(start, start + counts[place])
        n = len(self.compliance)
        return self.value[own], self.covariance[n:, n:][own, own]


def loaded_state(problem: LoadedProblem, cell: Cell, compliance: Float1D) -> State:
    """Return the null model's state at the given compliances, for the readings of the problem."""
    parameters = problem.parameters.replace(compliance=compliance)
    return recorded_state(problem.readings, cell, problem.chain, parameters, problem.load, problem.rest(compliance))


def design_at(
    problem: LoadedProblem,
    cell: Cell,
    compliance: Float1D,
    rows: Rows,
    used: Int1D,
    hypotheses: tuple[Candidate, ...],
    frames: FrameFit | None,
    among: Collection[int] | None = None,
    discrepancy: Float3D | None = None,
) -> tuple[State, Design]:
    """Return state (all readings) and whitened model (those used) at the given compliances, (n,) rad/(N*m).

    The structured discrepancy is that of these compliances, unless it is given from others nearby.
    """
    state = loaded_state(problem, cell, compliance)
    linear = problem.linearise(compliance)
    extra = structured_discrepancy(state, frames) if discrepancy is None else discrepancy
    return state, build_design(state, rows, linear.residual, linear.columns, hypotheses, extra, used, among=among)


def extend(
    problem: LoadedProblem,
    cell: Cell,
    start: Float1D,
    rows: Rows,
    used: Int1D,
    hypotheses: tuple[Candidate, ...],
    frames: FrameFit | None,
    selection: LoadedSelection,
) -> ExtendedLoadedModel:
    """Refit the compliances together with what was accepted, re-linearising until they stand still.

    Small effects, where they were found to be there, are left to `beside_small_effects`.

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
    nearby = structured_discrepancy(loaded_state(problem, cell, start), frames)
    for round_number in range(ROUNDS):
        _, design = design_at(problem, cell, compliance, rows, used, chosen, frames, discrepancy=nearby)
        value = _allowed(compliance, chosen, *estimates(design, tuple(range(len(chosen)))))
        change = np.clip(compliance + value[:n], LEAST_STEP * compliance, MOST_STEP * compliance) - compliance
        if np.abs(change).max() < CONVERGED * np.abs(compliance).max():
            break
        if round_number < ROUNDS - 1:
            compliance = compliance + change
    linear = problem.linearise(compliance)
    state, whole = design_at(problem, cell, compliance, rows, used, hypotheses, frames, selection.named)
    shift = np.concatenate([np.zeros((state.m, 3, 0)), *(one.columns(state) for one in chosen)], axis=2) @ value[n:]
    raw = linear.residual - shift - np.einsum("mij,j->mi", linear.columns, value[:n])
    raw = raw - _by_chance(whole, accepted, value, state)
    final, covariance = estimates(whole, accepted)
    final = _allowed(compliance, chosen, final, covariance)
    return ExtendedLoadedModel(
        problem=problem,
        used=used,
        state=state,
        rows=rows,
        design=whole,
        accepted=accepted,
        base_compliance=compliance,
        compliance=compliance + final[:n],
        value=final[n:],
        covariance=covariance,
        shift=state.since_step_zero(shift),
        raw=raw,
        residual=without_offsets(linear.rows.select(used), raw[used]),
    )


def beside_small_effects(
    extended: ExtendedLoadedModel,
    cell: Cell,
    hypotheses: tuple[Candidate, ...],
    frames: FrameFit | None,
    selection: LoadedSelection,
) -> ExtendedLoadedModel:
    """Return the same model, estimated with the small effects that were found to be there in the rows' covariance.

    The law of what was accepted is known to a share only, and what is confounded with it may hold the rest: the
    covariance says so.  The values are those that explain the recording: no confounded effect stands in the model.
    """
    share, compliance, n = selection.share, extended.base_compliance, len(extended.compliance)
    if not np.any(share):
        return extended
    problem, rows, used = extended.problem, extended.rows, extended.used
    _, design = design_at(problem, cell, compliance, rows, used, hypotheses, frames, selection.with_size)
    chosen = tuple(hypotheses[index] for index in extended.accepted)
    _, covariance = estimates(design, extended.accepted, share)
    if not selection.level:
        return dataclasses.replace(extended, covariance=covariance)
    value = _allowed(compliance, chosen, *estimates(design, extended.accepted, selection.level))
    return dataclasses.replace(extended, compliance=compliance + value[:n], value=value[n:], covariance=covariance)


def _by_chance(design: Design, accepted: tuple[int, ...], value: Float1D, state: State) -> Float2D:
    """Return the (m, 3) m that accepted candidates have most probably moved by chance, all readings.

    Args:
        design: The whitened model.
        accepted: Candidates in the model.
        value: (n + p,) changes of the compliances, and parameters of the accepted candidates.
        state: The null model's state there.
    """
    several = {design.candidates[index].chances: design.chances[index] for index in accepted}
    chances = {function: columns for function, columns in several.items() if function is not None}
    if not chances:
        return np.zeros((state.m, 3))
    blocks = [design.blocks[index] for index in accepted]
    fitted = np.column_stack([design.null, *(design.columns[:, block] / design.prior[block] for block in blocks)])
    left = design.residual - fitted @ value
    columns = np.column_stack([WIDE * design.columns[:, block] for block in chances.values()])
    columns = np.column_stack([columns, design.columns[:, design.discrepancy]])
    size = np.linalg.solve(np.eye(columns.shape[1]) + columns.T @ columns, columns.T @ left)
    moved = WIDE * np.concatenate([function(state) for function in chances], axis=2)
    return np.asarray(moved @ size[: moved.shape[2]])


def _allowed(compliance: Float1D, chosen: Sequence[Candidate], change: Float1D, covariance: Float2D) -> Float1D:
    """Return the nearest to an estimate that physics allows.

    Args:
        compliance: (n,) rad/(N*m), about which the estimate is linear.
        chosen: The effects.
        change: (n + p,) of the compliances, and parameters of the effects.
        covariance: (n + p, n + p) of them.
    """
    begun = np.concatenate([compliance, np.zeros(len(change) - len(compliance))])
    joints = [[Parameter("compliance", "rad/(N*m)", 1.0, positive=True)] for _ in compliance]
    several = [*joints, *(candidate.parameters for candidate in chosen)]
    return nearest(several, begun + change, covariance).value - begun


def extended_model(parameters: ModelParameters, extended: ExtendedLoadedModel) -> ModelParameters:
    """Return the identified model with the compliances and effects of the extended one."""
    effects = tuple(
        applied(extended.design.candidates[index], extended.values_of(index)[0], extended.state)
        for index in extended.accepted
    )
    return parameters.replace(compliance=extended.compliance, effects=effects)


FAR = 2.0  # times the width of the prior: effects beyond it are none of the usual size
WIDENED = 3  # times, a prior is compared with the size that was found
RANK = 1e-10  # of the largest eigenvalue: directions below it are rounding errors


def estimates(design: Design, accepted: tuple[int, ...], share: Float1D | float = 0.0) -> tuple[Float1D, Float2D]:
    """Return values and covariance of null corrections and accepted parameters, in their units.

    Accepted parameters keep their (wide) priors; where an effect is far larger than these, its prior is as wide as it.

    Args:
        design: The whitened model.
        accepted: Candidates in the model.
        share: (c,) signal-to-noise ratio of every candidate's place in the covariance, or one of all.
    """
    n, gram = design.n, design.gram()
    weights = np.zeros(len(design.prior))
    if np.any(share):
        each = np.repeat(np.broadcast_to(share, len(design.blocks)), [b.stop - b.start for b in design.blocks])
        weights[: design.discrepancy.start] = np.minimum(each * _unit(design, gram), MOST_TYPICAL / PRIOR_WIDTH)
    own = [c for i in accepted for c in range(design.blocks[i].start, design.blocks[i].stop)]
    for i in accepted:
        weights[design.chances[i]] = 1.0
    weights[design.discrepancy] = 1.0
    weights[own] = 0.0
    active = np.flatnonzero(weights)
    scaled = gram[:, n + active] * weights[active]
    lower = cholesky(np.eye(len(active)) + scaled[n + active] * weights[active][:, None], lower=True)
    half = solve_triangular(lower, scaled.T, lower=True, check_finite=False).T
    columns = [*range(n), *(n + c for c in own)]
    metric = gram[columns] - half[columns] @ half.T
    unit = np.concatenate([np.ones(n), design.prior[own]])
    counts = [design.blocks[i].stop - design.blocks[i].start for i in accepted]
    width = np.ones(len(counts))
    value, inverse = _solved(metric, columns, np.repeat(width, counts))
    for _ in range(WIDENED):
        ends = n + np.cumsum(counts)
        sizes = [np.sqrt(np.mean(value[end - k : end] ** 2)) for k, end in zip(counts, ends, strict=True)]
        if all(size <= max(one, FAR) for size, one in zip(sizes, width, strict=True)):
            break
        width = np.maximum(width, [size if size > FAR else 1.0 for size in sizes])
        value, inverse = _solved(metric, columns, np.repeat(width, counts))
    return value * unit, np.asarray(inverse * np.outer(unit, unit), dtype=np.float64)


def _solved(metric: Float2D, columns: list[int], width: Float1D) -> tuple[Float1D, Float2D]:
    """Return values (n + k,), and their covariance, of null corrections and accepted parameters with such priors."""
    n = len(columns) - len(width)
    matrix = metric[:, columns] + np.diag(np.concatenate([np.zeros(n), width**-2.0]))
    scale = np.sqrt(np.clip(np.diag(matrix), 1e-300, None))
    inverse = np.linalg.inv(matrix / np.outer(scale, scale)) / np.outer(scale, scale)
    return inverse @ metric[:, -1], inverse


def _unit(design: Design, gram: Float2D) -> Float1D:
    """Return the sizes at which every place moves the points by as much as the noise, null model apart, (p,)."""
    n, own = design.n, design.discrepancy.start
    cross = gram[:n, n : n + own]
    scale = np.sqrt(np.clip(np.diag(gram)[:n], 1e-300, None))
    values, vectors = np.linalg.eigh(gram[:n, :n] / np.outer(scale, scale))
    kept = values > RANK * values[-1]
    taken = (vectors[:, kept] / np.sqrt(values[kept])).T @ (cross / scale[:, None])
    power = np.maximum(np.diag(gram)[n : n + own] - (taken**2).sum(axis=0), 0.0)
    return shared_power(power, design.candidates, design.blocks)


UNFITTED_ZERO = 3e-4  # rad, where absolute positions say nothing about the geometry


def structured_discrepancy(state: State, frames: FrameFit | None) -> Float3D:
    """Return (m, 3, k) movements of the points, each for one standard deviation of a small effect, m.

    Args:
        state: The null model.
        frames: The refitted frames; None where the recording holds displacements.
    """
    parts = [each_recording(sensor_lag, state), each_recording(sensor_mounting, state), _geometry(state, frames)]
    if frames is not None:
        parts.append(_frames(state, frames))
    return np.concatenate(parts, axis=2)


def _geometry(state: State, frames: FrameFit | None) -> Float3D:
    """Zeros of the joints stand for all errors of the geometry, as large as the absolute positions show them."""
    size = UNFITTED_ZERO if frames is None else frames.rms / max(state.chain.reach / 2, 0.1)
    zeros = effect_named("joint_zero_offset").candidates(state)
    return np.concatenate([candidate.columns(state) * size for candidate in zeros], axis=2)


def _frames(state: State, frames: FrameFit) -> Float3D:
    """What the refitted frames leave open; readings of one configuration share its geometric error."""
    steps = len(state.configuration) / max(len(np.unique(state.configuration)), 1) / len(frames.points)
    std = np.sqrt(np.clip(np.diag(frames.scatter), 0.0, None) * max(steps, 1.0))
    recordings = 1 if state.setups is None else state.setups.count
    turned = np.tile(std[3:6], recordings)
    frame = effect_named("tracker_frame_misalignment").candidates(state)
    points = np.zeros((len(state.configuration), 3, 3 * len(frames.points)))  # none where no reading shows one
    for candidate in effect_named("measurement_point_offset").candidates(state):
        first = 3 * int(str(candidate.location["point"])[1:])
        points[:, :, first : first + 3] = candidate.columns(state) * std[6 + first : 9 + first]
    return np.concatenate([points, *(each_recording(one.columns, state) * turned for one in frame)], axis=2)


# --- what loaded steps leave open about the structure that gives way, in the covariance of everything -----------------


@dataclasses.dataclass(frozen=True, eq=False)
class _Fit:
    """Compliances, accepted effects, and what instruments and chance do, by least squares.

    Attributes:
        columns: (r, q) whitened, of effects per standard deviation of the prior.
        normal: (q, q) their products, with the precision of the priors.
        value: (q,) the solution.
        rest: (r,) what it leaves.
        own: Candidate -> its columns.
    """

    columns: Float2D
    normal: Float2D
    value: Float1D
    rest: Float1D
    own: dict[int, slice]


def with_alternatives(extended: ExtendedLoadedModel, selection: LoadedSelection) -> ExtendedLoadedModel:
    """Return the model with a covariance that says what place and form of structural effects leave open."""
    design = extended.design
    choices = [one for one in selection.choices if design.candidates[one.candidate].family == STRUCTURE]
    if not choices:
        return extended
    fit = _fitted(design, extended.accepted)
    ways = [way for choice in choices for way in (*_elsewhere(extended, fit, choice), *_unequal(extended, fit, choice))]
    count = len(extended.covariance)
    unit = np.concatenate([np.ones(design.n), *(design.prior[design.blocks[i]] for i in extended.accepted)])
    more = np.column_stack([np.zeros((count, 0)), *(way[:count] * unit[:, None] for way in ways)])
    return dataclasses.replace(extended, covariance=extended.covariance + more @ more.T)


def _fitted(design: Design, accepted: tuple[int, ...]) -> _Fit:
    own, start = {}, design.n
    for index in accepted:
        width = design.blocks[index].stop - design.blocks[index].start
        own[index] = slice(start, start + width)
        start += width
    chances = [design.columns[:, design.chances[index]] for index in accepted]
    columns = np.column_stack([design.fitted(accepted), design.columns[:, design.discrepancy], *chances])
    normal = columns.T @ columns + np.diag(np.where(np.arange(columns.shape[1]) < design.n, 0.0, 1.0))
    unit = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    value = np.linalg.pinv(normal / np.outer(unit, unit), hermitian=True) @ (columns.T @ design.residual / unit) / unit
    return _Fit(columns, normal, value, design.residual - columns @ value, own)


def _elsewhere(extended: ExtendedLoadedModel, fit: _Fit, choice: Choice) -> Iterator[Float2D]:
    """Yield (q, c) for each place and form that does as well: what everything else may be off by, by its probability.

    Of one at another place no form is known: the fullest freedom that it may have is taken.
    """
    candidates, own = extended.design.candidates, fit.own[choice.candidate]
    moved = fit.columns[:, own] @ fit.value[own]
    as_well = (*((index, nats - choice.log_bayes_factor) for index, nats in choice.equivalents), *choice.forms)
    for (index, _), share in zip(as_well, shares([nats for _, nats in as_well]), strict=True):
        if index in fit.own:
            continue
        other = fuller_form(candidates[index], candidates) or candidates[index]
        columns = _white(extended, other) * (PRIOR_WIDTH * np.array([one.typical for one in other.parameters]))
        ways = instead(
            fit.normal,
            np.arange(own.start, own.stop),
            fit.columns.T @ moved,
            fit.columns.T @ columns,
            columns.T @ columns + np.eye(columns.shape[1]),
            columns.T @ (moved + fit.rest),
            1.0,
        )
        yield np.sqrt(share) * ways


def _unequal(extended: ExtendedLoadedModel, fit: _Fit, choice: Choice) -> Iterator[Float2D]:
    """Yield (q, c): what everything else may be off by where a form has more sizes in truth."""
    design = extended.design
    mine = design.candidates[choice.candidate]
    fuller = fuller_form(mine, design.candidates)
    if fuller is None:
        return
    value = fit.value[fit.own[choice.candidate]] * design.prior[design.blocks[choice.candidate]]
    columns = neglected(_white(extended, mine), _white(extended, fuller), mine, fuller, value)
    yield left_open(fit.normal, 1.0, fit.columns.T @ columns, columns.T @ columns, columns.T @ fit.rest)


def _white(extended: ExtendedLoadedModel, candidate: Candidate) -> Float2D:
    """Return the whitened columns of a candidate, (r, k), per unit of its parameters."""
    return whitened(extended.rows, candidate.columns(extended.state), extended.used)[0]


# --- what a recording of loads can never tell apart, in sentences that name the robot's own joints --------------------


NEARLY = 1e-4  # m, or sine of an angle: less is rounding in a file


def aliases(state: State, *, differences: bool) -> tuple[str, ...]:
    """Return which causes act alike on the readings, whatever their sizes.

    Args:
        state: The null model, all readings.
        differences: Whether differences to step 0 alone are used.  Absolute positions show the sag under the weight, on
            which sensor and tracker have no share, and the torque of a compensator itself.
    """
    joints, everywhere = state.chain.joints, "" if state.setups is None else " in all recordings"
    sentences: list[str] = []
    if differences:
        sentences = [
            f"{cause}{everywhere} acts like all joints being softer by the same share."
            for cause in ("A gain common to all axes of the force/torque sensor", "A wrong scale of the tracker")
        ]
    if not np.any(state.since_step_zero(state.q)):
        sentences.append(
            "A servo that gives way acts like its joint being softer: the joint angles are recorded alike at all steps "
            "of a configuration."
        )
    if differences:
        sentences += [
            f"A gravity compensator of {joints[k]} acts like a stiffness and a zero of {joints[k]} that follow its "
            "angle."
            for k in carriers(state)
        ]
    if _turns_about_the_base(state.chain):
        sentences.append(
            f"Rocking of the base acts like an off-axis compliance of {joints[0]} at the origin of the base frame."
        )
    return tuple(sentences)


def _turns_about_the_base(chain: Chain) -> bool:
    """Say whether the first joint turns, about the z axis of the base frame."""
    beside = np.concatenate([chain.rotation[0, :2, 2], chain.translation[0, :2]])
    return not chain.prismatic[0] and float(np.abs(beside).max()) < NEARLY
