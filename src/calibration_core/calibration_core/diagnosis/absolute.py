"""Diagnosis of an absolute recording: what the geometric model leaves out, found, named, fitted and proven."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.absolute_changes import FAMILY, Steps, anomaly_of, select_changes
from calibration_core.diagnosis.absolute_controls import GravityControl
from calibration_core.diagnosis.absolute_design import (
    AbsoluteDesign,
    absolute_state,
    build_absolute_design,
    sample,
    weighted,
)
from calibration_core.diagnosis.absolute_drift import DriftControl, slow_blocks
from calibration_core.diagnosis.absolute_fit import AbsoluteExtended, extend_absolute
from calibration_core.diagnosis.absolute_geometry import geometry_findings
from calibration_core.diagnosis.absolute_naming import absolute_findings, equivalents
from calibration_core.diagnosis.absolute_next import Known, propose_postures
from calibration_core.diagnosis.absolute_rest import what_remains_absolute
from calibration_core.diagnosis.absolute_selection import (
    MOST_PARAMETERS,
    AbsoluteSelection,
    Control,
    held_out_squares,
    parameter_count,
    select_absolute,
)
from calibration_core.diagnosis.absolute_shape import by_kind, is_spring, sharpened, spring_is_better
from calibration_core.diagnosis.blocks import Blocks, posture_blocks, time_blocks
from calibration_core.diagnosis.finding import Diagnosis, Finding, Rest, Verdict, by_size
from calibration_core.diagnosis.known_stiffness import Considered, KnownCompliance, divided
from calibration_core.diagnosis.next_measurements import NONE_ASKED, Proposals
from calibration_core.diagnosis.next_offers import Offer
from calibration_core.identification.absolute import Evaluated, evaluate_absolute, identification_of
from calibration_core.identification.absolute_problem import absolute_problem
from calibration_core.identification.distributions import chi2_limit
from calibration_core.identification.estimate import Anomaly, TestResult
from calibration_core.identification.geometry import fit
from calibration_core.identification.robust import Key
from calibration_core.identification.terms import ElasticityTerm, Term
from calibration_core.model.effects import candidates
from calibration_core.model.effects.applied import applied
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.joint_elasticity import AXIAL, turned_columns
from calibration_core.model.effects.state import State
from calibration_core.model.effects.transmission_error import order_of
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.observations.covariance import position_covariance
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D, Readings

GROSS = 0.01  # probability that a clean recording has any reading beyond the limit
LOW_ORDERS = 64  # of transmission errors, searched first; higher ones if there is room left
DWARFS = 10.0  # times what remains unexplained, that a geometry error beside it must move the points
REPORTED = {"time": 10, "posture": 20}  # blocks left out in the figures that are reported
Found = tuple[AbsoluteDesign, AbsoluteSelection]


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """The null model of a recording and what a search needs.

    Attributes:
        readings: The recording.
        cell: The cell file.
        evaluated: Decisions of the identification.
        terms: Frames and, where identifiable, geometry.
        parameters: The null model, fitted.
        state: All readings' state there.
        nuisances: Joint compliances of the null model that are refitted.
        considered: Joint compliances of the null model that are held, and what is known of the refitted ones.
        rows: Readings of the search.
        partitions: Of those, into blocks.
        control: Controls of elasticity and drift.
    """

    readings: Readings
    cell: Cell
    evaluated: Evaluated
    terms: tuple[Term, ...]
    parameters: ModelParameters
    state: State
    nuisances: tuple[Candidate, ...]
    considered: Considered
    rows: Int1D
    partitions: tuple[Blocks, ...]
    control: Control

    def design(self, hypotheses: tuple[Candidate, ...]) -> AbsoluteDesign:
        """Return the linear model with the given hypotheses."""
        problem = self.evaluated.problem
        return build_absolute_design(
            problem, self.parameters, self.terms, self.state, hypotheses, self.rows, self.nuisances
        )

    def weigh(self, movement: Float3D) -> Float2D:
        """Return movements of all readings, (m, 3, k) m, base axes, as columns of the search, (3 s, k)."""
        part = self.evaluated.problem.select(self.rows)
        return weighted(part, self.parameters, movement[self.rows])

    def extend(self, chosen: tuple[Candidate, ...]) -> AbsoluteExtended:
        """Fit the given effects together with frames and geometry to all readings used."""
        return extend_absolute(
            self.evaluated.problem, self.evaluated.used, self.parameters, self.terms, chosen, self.readings, self.cell,
            time_blocks(self.readings.configuration), self.nuisances, self.considered,
        )  # fmt: skip


def diagnose_absolute(
    readings: Readings,
    cell: Cell,
    *,
    test: Readings | None = None,
    believed: ModelParameters | None = None,
    known: KnownCompliance | None = None,
    offers: Sequence[Offer] | None = None,
) -> Diagnosis:
    """Say what the model of an absolute recording leaves out.

    Args:
        readings: The recording; rows in the order of time.
        cell: The cell file.
        test: A second recording, predicted but not fitted.
        believed: Model to start from; None: what the cell file believes.
        known: Compliances that are known from elsewhere; None: those of the model are refitted.
        offers: Postures that could be measured next; None: nothing is proposed.

    Raises:
        InputError: As `identify_absolute`.
    """
    if known is not None:
        believed = (nominal_parameters(cell) if believed is None else believed).replace(compliance=known.value)
    case = prepare(readings, cell, evaluate_absolute(readings, cell, believed=believed), known)
    stepped = select_changes(case.design, readings, case.partitions, (), dwarfing=True)
    moved = _anomalies(case.extend(stepped.found), readings, stepped)
    if stepped.found:  # everything else is judged on readings freed of what moved
        readings = _freed(case.extend(stepped.found), readings)
        case = prepare(readings, cell, evaluate_absolute(readings, cell, believed=believed), known)
    searched = case
    design, selection, steps = search(searched)
    hypotheses = tuple(design.candidates[i] for i in selection.accepted)
    extended = case.extend(hypotheses)
    readmit = fitting_after_all(extended, readings)
    if readmit:
        case = prepare(readings, cell, evaluate_absolute(readings, cell, readmit=readmit, believed=believed), known)
        extended = case.extend(hypotheses)
    null = case.extend(())
    identification = identification_of(case.evaluated, readings, cell, test=test)
    findings = absolute_findings(extended, design, selection, searched.partitions, searched.control)
    rest = what_remains_absolute(
        extended, design, selection.accepted, searched.partitions[0], readings, identification.noise
    )
    findings = by_size((*findings, *_geometry(case, extended, rest)))
    rest = _with_refusals(rest, selection)
    proposals = NONE_ASKED if offers is None else _proposals(searched, design, selection, readings, offers)
    kinds = {"time": time_blocks(readings.configuration, REPORTED["time"]),
             "posture": posture_blocks(readings.q, readings.configuration, REPORTED["posture"])}  # fmt: skip
    left = {kind: (null.held_out(partition), extended.held_out(partition)) for kind, partition in kinds.items()}
    physics = tuple(k for k, h in enumerate(hypotheses) if h.family != FAMILY)
    model = extended.parameters.replace(
        effects=tuple(applied(hypotheses[k], extended.values_of(k)[0], extended.state) for k in physics)
    )
    return Diagnosis(
        verdict=_verdict(bool(findings), rest),
        findings=findings,
        anomalies=(*identification.anomalies, *moved, *_anomalies(extended, readings, steps)),
        rest=rest,
        next_measurements=proposals.measurements,
        next_text=proposals.text,
        identification=identification,
        stiffness=_stiffness(extended),
        rms_before=_rms(null.residual),
        rms_after=_rms(extended.residual),
        held_out_before=_rms(left["time"][0]),
        held_out_after=_rms(left["time"][1]),
        noise=identification.noise.claimed,
        level=0.0,
        located=(*selection.refused, *(f"{words}: too small to be named" for words in selection.small)),
        residual=extended.residual,
        residual_before=null.residual,
        shift=extended.shift(extended.state, physics),
        compliance=extended.parameters.compliance,
        blocks={kind: (_rms3(before), _rms3(after)) for kind, (before, after) in left.items()},
        test=None if test is None else predict_extended(test, cell, case, extended, physics),
        model=model,
    )


def prepare(readings: Readings, cell: Cell, evaluated: Evaluated, known: KnownCompliance | None = None) -> Case:
    """Fit the null model: frames, identifiable geometry, and refitted stiffnesses where the cell file states them.

    Args:
        readings: The recording.
        cell: The cell file.
        evaluated: Decisions of the identification.
        known: Compliances of the evaluated model that are known; None: they are refitted.
    """
    problem, used = evaluated.problem, np.flatnonzero(evaluated.used)
    final = evaluated.ladder.final.fit
    terms = tuple(term for term in final.terms if not isinstance(term, ElasticityTerm))
    start = final.parameters.replace(compliance=evaluated.nominal.compliance)
    parameters = fit(problem.select(used), start, terms).parameters
    state = absolute_state(problem, parameters, readings, cell)
    rows = sample(readings.configuration, used)
    part = problem.select(rows)
    stated = bool(np.any(evaluated.nominal.compliance))
    nuisances = tuple(c for c in candidates(state) if stated and c.effect == "joint_elasticity" and c.variant == AXIAL)
    considered = Considered()
    if known is not None:
        size = [_rms(weighted(part, parameters, c.columns(state)[rows])) for c in nuisances]
        nuisances, considered = divided(known, nuisances, size)
    partitions = (
        time_blocks(readings.configuration[rows]),
        posture_blocks(readings.q[rows], readings.configuration[rows]),
    )
    turned = {
        name: weighted(part, parameters, turned_columns(state, joint)[rows])
        for joint, name in enumerate(state.chain.joints)
    }
    control = DriftControl(slow_blocks(readings.configuration[rows]), GravityControl(partitions, turned))
    return Case(readings, cell, evaluated, terms, parameters, state, nuisances, considered, rows, partitions, control)


def search(case: Case) -> tuple[AbsoluteDesign, AbsoluteSelection, Steps]:
    """Look for physics, then for steps beside the physics; where there are any, for physics beside the steps.

    Returns:
        The design of the last search, what was accepted in it, and the steps.
    """
    stated = {str(c.location["joint"]) for c in (*case.nuisances, *case.considered.candidates)}
    offered = tuple(c for c in candidates(case.state) if _searched(c, stated))
    low = tuple(c for c in offered if _order(c) <= LOW_ORDERS)
    high = len(low) < len(offered)
    design, selection = _select(case, (), low)
    if high and parameter_count(design, selection.accepted) < MOST_PARAMETERS:
        design, selection = _select(case, _accepted(design, selection), offered)
    design, selection = _spring_or_waves(case, offered, (design, selection))
    physics = _accepted(design, selection)
    steps = select_changes(case.design, case.readings, case.partitions, physics, dwarfing=False)
    if steps.found:
        shaped = any(map(is_spring, physics))
        more = tuple(c for c in low if not (shaped and is_spring(c)))
        design, selection = _select(case, (*steps.found, *physics), more)
    return design, selection, steps


def _searched(candidate: Candidate, stated: set[str]) -> bool:
    """Say whether a hypothesis is searched: not what is refitted, nor what postures at rest hardly tell from sag."""
    if candidate.effect == "joint_elasticity":
        return candidate.location["joint"] not in stated
    return candidate.effect == "gravity_compensator" or candidate.family not in {"structure", "joint law"}


def _spring_or_waves(case: Case, offered: tuple[Candidate, ...], found: Found) -> Found:
    """Search anew where joint 2 was given a spring or waves, from either alone; return the better result."""
    accepted = _accepted(*found)
    springs, waves, others = by_kind(accepted, case.state)
    if not any(map(is_spring, offered)) or not (springs or waves):
        return found
    rest = tuple(c for c in offered if not is_spring(c))
    waved = found if not springs else _select(case, (*others, *waves), rest)
    sprung = _select(case, (*others, sharpened(case.design, case.weigh, case.state, others)), rest)
    if not any(map(is_spring, _accepted(*sprung))):
        return waved
    squares = [held_out_squares(*one, case.partitions[0]) for one in (sprung, waved)]
    counts = [parameter_count(design, selection.accepted) for design, selection in (sprung, waved)]
    return sprung if spring_is_better(squares, counts, first=bool(springs)) else waved


def fitting_after_all(extended: AbsoluteExtended, readings: Readings) -> frozenset[Key]:
    """Return the readings that the null model called gross errors and the extended model explains."""
    squares = np.sum(extended.rest.reshape(-1, 3) ** 2, axis=1)
    scale = max(float(np.median(squares[extended.used])) / chi2_limit(0.5, 3), 1.0)
    limit = scale * chi2_limit(GROSS / len(squares), 3)
    rows = np.flatnonzero(~extended.used & (squares < limit))
    names = readings.points
    return frozenset((int(readings.configuration[k]), int(readings.step[k]), names[readings.point[k]]) for k in rows)


def _proposals(
    case: Case,
    design: AbsoluteDesign,
    selection: AbsoluteSelection,
    readings: Readings,
    offers: Sequence[Offer],
) -> Proposals:
    physics = [i for i in selection.accepted if design.candidates[i].family != FAMILY]
    places = [design.candidates[i].place for i in physics]
    single = [i for i in physics if places.count(design.candidates[i].place) == 1]
    equal = {i: equivalents(design, selection.accepted, [i], case.partitions, case.control) for i in single}
    noise = max(float(np.sqrt(np.mean(_left(design, selection.accepted) ** 2))), 1.0)
    known = Known(design, selection.accepted, equal, case.parameters, case.terms, case.nuisances, noise)
    return propose_postures(known, readings, case.cell, offers)


def _left(design: AbsoluteDesign, accepted: tuple[int, ...]) -> Float1D:
    """Return what a fit of the accepted candidates leaves, (3 s,), in units of the claimed noise."""
    columns = design.of(accepted)
    return design.residual - columns @ np.linalg.lstsq(columns, design.residual, rcond=1e-9)[0]


def _geometry(case: Case, extended: AbsoluteExtended, rest: Rest) -> tuple[Finding, ...]:
    """Return the joints whose geometry is far from where the cell file, or the given model, puts it.

    Geometry is fitted to whatever else is missing, too: beside a significant rest only what dwarfs it is believed.
    """
    ladder = case.evaluated.ladder
    gain = 1 - (ladder.final.held_out_rms / ladder.frames.held_out_rms) ** 2
    blocks = time_blocks(case.readings.configuration)
    found = geometry_findings(extended, case.terms, case.evaluated.nominal, blocks, gain)
    least = DWARFS * rest.rms if rest.significant else 0.0
    return tuple(finding for finding in found if finding.magnitude > least)


def _freed(extended: AbsoluteExtended, readings: Readings) -> Readings:
    """Return the readings with the steps taken out, in the tracker frame."""
    shift = extended.shift(extended.state) @ extended.parameters.tracker[:3, :3]
    return dataclasses.replace(readings, position=readings.position - shift)


def _anomalies(extended: AbsoluteExtended, readings: Readings, steps: Steps) -> tuple[Anomaly, ...]:
    """Return the steps of an extended model in words."""
    return tuple(
        anomaly_of(candidate, extended, k, readings, steps.beside.get(candidate.key, ()))
        for k, candidate in enumerate(extended.candidates)
        if candidate.family == FAMILY
    )


def predict_extended(
    readings: Readings, cell: Cell, case: Case, extended: AbsoluteExtended, physics: tuple[int, ...]
) -> TestResult:
    """Predict a recording that was not fitted with frames, geometry and findings; steps are not carried over.

    Args:
        readings: The other recording, in the order of time.
        cell: The cell file.
        case: The null model.
        extended: The extended model.
        physics: Positions of the findings' effects in it.
    """
    before = case.evaluated.nominal
    problem = absolute_problem(
        readings, cell, case.evaluated.problem.chain, before, position_covariance(readings, cell)
    )
    state = absolute_state(problem, extended.parameters, readings, cell)
    after = problem.residual(extended.parameters).T - extended.shift(state, physics)
    return TestResult.of(readings, after, problem.residual(before).T)


def _select(
    case: Case, first: tuple[Candidate, ...], offered: tuple[Candidate, ...]
) -> tuple[AbsoluteDesign, AbsoluteSelection]:
    """Search among the offered candidates, beginning with the first ones."""
    keys = {candidate.key for candidate in first}
    design = case.design((*first, *(c for c in offered if c.key not in keys)))
    return design, select_absolute(design, case.partitions, case.control, tuple(range(len(first))))


def _accepted(design: AbsoluteDesign, selection: AbsoluteSelection) -> tuple[Candidate, ...]:
    return tuple(design.candidates[i] for i in selection.accepted)


def _order(candidate: Candidate) -> int:
    return order_of(candidate.variant) if candidate.effect == "transmission_error" else 0


def _stiffness(extended: AbsoluteExtended) -> dict[str, tuple[float, float]]:
    """Return joint -> (stiffness, standard deviation) of compliances that were found, N*m/rad."""
    found = {}
    for k, candidate in enumerate(extended.candidates):
        if candidate.effect == "joint_elasticity" and candidate.variant == AXIAL:
            value, covariance = extended.values_of(k)
            compliance, std = float(value[0]), float(np.sqrt(covariance[0, 0]))
            found[str(candidate.location["joint"])] = (1 / compliance, std / compliance**2)
    return found


def _with_refusals(rest: Rest, selection: AbsoluteSelection) -> Rest:
    return dataclasses.replace(rest, text=f"{rest.text} The search stopped: {selection.stopped}.")


def _verdict(found: bool, rest: Rest) -> Verdict:
    if found:
        return "partly_explained" if rest.significant else "missing_physics"
    return "unexplained" if rest.significant else "consistent"


def _rms(residual: Float2D) -> float:
    return float(np.sqrt(np.mean(residual**2)))


def _rms3(residual: Float2D) -> float:
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))
