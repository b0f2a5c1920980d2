"""The core: a recording goes in, the null model, what was found beside it, and one estimate of everything come out."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.estimation.alternatives import with_alternatives
from calibration_core.estimation.blocks import Blocks, posture_blocks, time_blocks
from calibration_core.estimation.controls import controls
from calibration_core.estimation.field import Accepted, Field
from calibration_core.estimation.hypotheses import (
    SAG,
    Hypothesis,
    Offered,
    high_orders,
    is_axial,
    offer,
    physics,
)
from calibration_core.estimation.noise.strata import fit_whitening, strata_of, usual_errors
from calibration_core.estimation.noise.whitening import Whitening, whiten
from calibration_core.estimation.refit import Extended, Part, refit
from calibration_core.estimation.rows import NullModel, sample, state_at, weighted
from calibration_core.estimation.search import Search, Selection
from calibration_core.estimation.shifts import FAMILY, shifts, spacing
from calibration_core.estimation.springs import (
    SPRING,
    fit_compensator_geometry,
)
from calibration_core.identification.absolute.evaluate import Evaluated
from calibration_core.identification.absolute.prediction_error import compare
from calibration_core.identification.geometry.fit import absolute_problem
from calibration_core.identification.geometry.terms import ElasticityTerm, GeometryTerm
from calibration_core.identification.statistics import FINEST, chi2_limit
from calibration_core.model.effects.absolute.joint_elasticity import AXIAL
from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Parameter, number_of, typical
from calibration_core.model.effects.state import State
from calibration_core.model.robot import chain_of
from calibration_core.observations.average import position_covariance
from calibration_core.observations.kinds import loaded_configurations
from calibration_core.policy import FALSE_EXCLUSION, MOST_EXCLUDED
from calibration_core.timeseries import Bool1D, Float2D, Float3D, Readings

ROUNDS = 3  # searches about what was found, at most
SEARCH_BLOCKS = {"time": 15, "posture": 15}
COVARIANCE_BLOCKS = 40
REMAIN = 2  # configurations under load, where others of them are left out
MORE = 0.02  # share of readings whose use must change before the search is made again
QUIETER = 0.8  # or: to which share of it the variance of what is left must fall
EXCITED = 1e-3  # of the claimed noise: what a compliance of typical size must move to be fitted


@dataclasses.dataclass(frozen=True, eq=False)
class Estimate:
    """Everything about one recording.

    Attributes:
        search: Rows, hypotheses and all that was asked of them.
        members: Hypothesis accepted -> indices of its parts in `extended`.
    """

    null: Extended
    extended: Extended
    search: Search
    selection: Selection
    members: dict[int, tuple[int, ...]]

    @property
    def field(self) -> Field:
        """Rows and hypotheses."""
        return self.search.field

    @property
    def offered(self) -> Offered:
        """The hypotheses."""
        return self.field.offered

    def parts(self, *, anomalies: bool) -> tuple[int, ...]:
        """Return the parts of the extended model that are physics, or those that are not."""
        return tuple(k for k, part in enumerate(self.extended.parts) if (part.candidate.family == FAMILY) is anomalies)


def estimate(readings: Readings, cell: Cell, evaluated: Evaluated, sound: Bool1D | None = None) -> Estimate:
    """Search a recording for what its null model leaves out, and estimate everything together.

    Args:
        readings: The recording, in the order of time.
        cell: The cell file.
        evaluated: Frames and identifiable geometry, and which readings of the postures at rest are used.
        sound: (m,) readings that may be used; None: those that the evaluation used (it saw the same readings).
    """
    model = null_model(readings, cell, evaluated, evaluated.used if sound is None else sound)
    found = _searched(model)
    identifiable = evaluated.choice.chosen and not any(isinstance(term, GeometryTerm) for term in model.terms)
    if identifiable and found.selection.accepted:  # what was missing may have hidden what the geometry explains
        model, found = _with_geometry(model, found, evaluated.choice.term)
    used = settled(found.extended)
    if np.array_equal(used, model.used):
        return _with_alternatives(found)
    again = np.mean(used != model.used) > MORE
    model = dataclasses.replace(model, used=used)
    refitted = _again(found, model)
    if not again and refitted.extended.variance >= QUIETER * found.extended.variance:
        return _with_alternatives(refitted)
    known = refitted if _sags(refitted) else None
    del found, refitted  # a search holds a hundred megabytes, and two more follow
    return _with_alternatives(_searched(model, known))


def _with_alternatives(found: Estimate) -> Estimate:
    """Return the estimate with a covariance that says what place and form of an effect leave open."""
    extended = with_alternatives(found.extended, found.search, found.selection, found.members)
    return dataclasses.replace(found, extended=extended)


def null_model(readings: Readings, cell: Cell, evaluated: Evaluated, used: Bool1D) -> NullModel:
    """Return the null model of all readings: frames, geometry, and compliances where they are stated or loads act."""
    final = evaluated.staged.final.fit
    terms = tuple(term for term in final.terms if not isinstance(term, ElasticityTerm))
    nominal = evaluated.nominal
    parameters = final.parameters.replace(compliance=nominal.compliance)
    problem = absolute_problem(readings, cell, chain_of(cell), nominal, position_covariance(readings, cell))
    state, believed = state_at(problem, parameters, readings, cell), parameters.compliance
    model = NullModel(readings, cell, problem, parameters, terms, (), state, used, believed)
    if not (np.any(nominal.compliance) or problem.load is not None):
        return model
    rows = np.flatnonzero(used)
    chain = model.state.chain
    offered = [axial(j, name, model.state) for j, name in enumerate(chain.joints) if not chain.rigid[j]]
    felt = [np.abs(model.moves([c], rows) * c.parameters[0].typical).max(initial=0.0) > EXCITED for c in offered]
    return dataclasses.replace(model, fitted_compliances=tuple(c for c, yes in zip(offered, felt, strict=True) if yes))


def axial(joint: int, name: str, state: State) -> Candidate:
    """Return the compliance of a joint about its own axis, under load and weight (CWA 17384, 6.2)."""
    slides = state.chain.prismatic[joint]
    size = typical("prismatic_elasticity" if slides else SAG, state.rated_load)
    parameter = Parameter("compliance", "m/N" if slides else "rad/(N*m)", size, positive=True)

    def columns(state: State) -> Float3D:
        return stacked(state.joint_column(joint, state.torque[joint]))

    return Candidate(SAG, "absolute", {"joint": name}, AXIAL, (parameter,), columns)


def _with_geometry(model: NullModel, found: Estimate, term: GeometryTerm) -> tuple[NullModel, Estimate]:
    """Search once more with the geometry in the null model; keep that if it predicts configurations left out better."""
    more = dataclasses.replace(model, terms=(*model.terms, term))
    other = _searched(more, found if _sags(found) else None)
    return (more, other) if _clearly_better(found, other) else (model, found)


def _searched(model: NullModel, known: Estimate | None = None) -> Estimate:
    """Search, and once more about the solution where it changes what everything else does."""
    if known is None:
        known = _search(model)
    if _sags(known):
        return _search(_about(known, model), known)
    for _ in range(ROUNDS):
        if not known.extended.model.springs:
            break
        again = _search(_about(known, model), known)
        if not (_unloads(again) and _clearly_better(known, again)):
            break
        known = again
    return known


def _about(known: Estimate, model: NullModel) -> NullModel:
    """Return a null model that is linear about what was found."""
    return dataclasses.replace(known.extended.model, terms=model.terms, used=model.used)


def _unloads(found: Estimate) -> bool:
    """Say whether a spring unloads a joint at which something else was found, which feels what is left."""
    helped = {one.location["joint"] for one, _ in found.extended.model.springs}
    others = (part.candidate for part in found.extended.parts if part.candidate.effect != SPRING)
    return any(one.location.get("joint") in helped for one in others)


def _clearly_better(found: Estimate, other: Estimate) -> bool:
    """Say whether another estimate predicts configurations left out clearly better."""
    model = found.extended.model
    configuration = model.readings.configuration
    blocks = time_blocks(configuration, COVARIANCE_BLOCKS)
    before, after = (one.extended.held_out(blocks).T[:, model.used] for one in (found, other))
    gain = compare(before, after, configuration[model.used])
    return bool(gain.clear or gain.general)


def _sags(found: Estimate) -> bool:
    """Say whether compliances were found, that the null model does not fit."""
    model = found.extended.model
    return not model.fitted_compliances and bool(np.any(model.parameters.compliance))


def _search(model: NullModel, known: Estimate | None = None) -> Estimate:
    """Search once.

    Args:
        model: What is fitted before any hypothesis.
        known: Another search of the recording, which says what chance gains; None: this is the first.
    """
    readings = model.readings
    covariance_blocks = time_blocks(readings.configuration, COVARIANCE_BLOCKS)
    everything = np.arange(len(readings))
    null = refit(_rigid(model), whiten(strata_of(model, everything), 0.0, 2.0), (), covariance_blocks)
    if not model.springs and (model.fitted_compliances or not np.any(model.parameters.compliance)):
        model = null.model
    catalogue = (*physics(null.model.state, sag=not model.fitted_compliances), *high_orders(model, sample_rows(model)))
    own = {one.key for one in catalogue}
    catalogue = (*(one for one, _ in model.springs if one.key not in own), *catalogue)
    field, whitening = _field(model, offer((*catalogue, *shifts(readings, model.state.chain))))
    control = controls(model, sample_rows(model), whitening, catalogue)
    limit = None if known is None else known.search.limit
    search = Search(field, control, limit=limit)
    selection = search.run(_these(field.offered, [one for one, _ in model.springs]))
    more = _sharper(model, search.field, selection.accepted, whitening)
    steps = [i for i in selection.accepted if field.offered.hypotheses[i].family == FAMILY]
    if steps or more:  # where exactly, between the change points tried first; which shape exactly
        reach = spacing(readings)
        near = {number_of(field.offered.hypotheses[i]) for i in steps}
        fine = np.unique(
            np.concatenate([np.zeros(0, dtype=np.int64), *(np.arange(k - reach, k + reach + 1) for k in near)])
        )
        helped = {c.location["joint"] for c in more}
        physical = {i: field.offered.hypotheses[i] for i in selection.accepted if i not in steps}
        limit = search.limit
        del search  # hundreds of megabytes beside the next one
        field = field.offering(
            offer((*more, *catalogue, *shifts(readings, model.state.chain, fine))),
            lambda new: _whitened(model, new, whitening),
        )
        kept = [one for one in physical.values() if one.location.get("joint") not in helped]
        begin = [_find(field.offered, one) for one in kept]
        sprung = {one.location["joint"] for one in physical.values() if one.effect == SPRING}
        springs = _these(field.offered, [one for one in more if one.location["joint"] in sprung])
        search = Search(field, control, limit=limit)
        selection = search.run((*begin, *springs))
    search.release()
    whole = whiten(strata_of(model, everything), whitening.shared, whitening.offset)
    if whole.parts:
        null = refit(_rigid(model), whole, (), covariance_blocks)
    parts, members = _parts(field, selection)
    extended = refit(model.begun, whole, parts, covariance_blocks)
    return Estimate(null, extended, search, selection, members)


def _rigid(model: NullModel) -> NullModel:
    """Return the null model itself, where compliances are in question."""
    if model.fitted_compliances or not np.any(model.parameters.compliance):
        return model.at(model.parameters, ()) if model.springs else model
    return model.at(model.parameters.replace(compliance=np.zeros_like(model.parameters.compliance)), ())


def _find(offered: Offered, one: Hypothesis) -> int:
    """Return the index of the same hypothesis among others."""
    return next(i for i, h in enumerate(offered.hypotheses) if (h.place, h.variant) == (one.place, one.variant))


def _these(offered: Offered, candidates: Sequence[Candidate]) -> Accepted:
    """Return the hypotheses that some candidates are by themselves."""
    keys = {one.key for one in candidates}
    several = enumerate(offered.hypotheses)
    return tuple(i for i, h in several if len(h.members) == 1 and offered.candidates[h.members[0]].key in keys)


def _sharper(model: NullModel, field: Field, accepted: Accepted, whitening: Whitening) -> tuple[Candidate, ...]:
    rows = sample_rows(model)
    part = model.problem.select(rows)

    def weigh(movement: Float3D) -> Float2D:
        white = whitening(weighted(part, model.parameters, movement[rows]))
        return np.pad(white, ((0, len(field.residual) - len(white)), (0, 0)))  # priors have rows of their own

    return fit_compensator_geometry(field, accepted, model.state, weigh)


def _again(found: Estimate, model: NullModel) -> Estimate:
    """Fit the same once more to other readings."""
    blocks = time_blocks(model.readings.configuration, COVARIANCE_BLOCKS)
    at = dataclasses.replace(found.extended.model, used=model.used)
    whitening = found.extended.whitening
    null = refit(dataclasses.replace(found.null.model, used=model.used), whitening, (), blocks)
    extended = refit(at, whitening, found.extended.parts, blocks, known=found.extended)
    return dataclasses.replace(found, null=null, extended=extended)


def sample_rows(model: NullModel) -> np.ndarray:
    """Return the readings that are searched."""
    return sample(model.readings.configuration, np.flatnonzero(model.used))


def partitions_of(model: NullModel, rows: np.ndarray, counts: dict[str, int]) -> tuple[Blocks, ...]:
    """Return blocks of some readings in time and in posture.

    Configurations under load alone tell the compliances: where a block holds nearly all of them, they stay.
    """
    configuration, q = model.readings.configuration[rows], model.readings.q[rows]
    found = time_blocks(configuration, counts["time"]), posture_blocks(q, configuration, counts["posture"])
    if not model.fitted_compliances:
        return found
    loaded = loaded_configurations(model.readings)
    under_load = np.isin(configuration, loaded)

    def remain(one: Blocks) -> int:
        out = (len(np.unique(configuration[under_load & (one.label == k)])) for k in range(one.count))
        return len(loaded) - max(out)

    return tuple(one.keeping(under_load) if remain(one) < REMAIN else one for one in found)


def _whitened(model: NullModel, candidates: Sequence[Candidate], whitening: Whitening) -> Float2D:
    """Return the columns of candidates for the readings that are searched, per typical size, as independent rows."""
    return whitening(offer(candidates).columns(model, sample_rows(model)))


def _field(model: NullModel, offered: Offered) -> tuple[Field, Whitening]:
    rows = sample_rows(model)
    flat, residual = model.flat(rows)
    usual = weighted(model.problem.select(rows), model.parameters, usual_errors(model.state)[rows])
    r, f, u = len(residual), flat.shape[1], usual.shape[1]
    wide = offered.columns(model, rows, np.column_stack([flat, usual]), u)
    columns = wide[:r, f + u :]
    if not model.fitted_compliances:  # compliances that were found already are still in question
        for candidate, block in zip(offered.candidates, offered.blocks, strict=True):
            if is_axial(candidate):
                held = model.parameters.compliance[model.parameters.joints.index(str(candidate.location["joint"]))]
                residual = residual + columns[:, block.start] * (held / candidate.parameters[0].typical)
    whitening = fit_whitening(strata_of(model, rows), residual, flat, columns, offered)
    whitening.inside(wide[:r])
    wide[r:, f : f + u] = np.eye(u)
    residual = np.concatenate([whitening(residual[:, None])[:, 0], np.zeros(u)])
    field = Field.within(residual, wide, f + u, offered, partitions_of(model, rows, SEARCH_BLOCKS))
    return field, whitening


def _parts(field: Field, selection: Selection) -> tuple[tuple[Part, ...], dict[int, tuple[int, ...]]]:
    """Return every candidate once, with the size of all hypotheses that hold it, and where each hypothesis's are."""
    variance: dict[int, float] = {}
    for index, size in zip(selection.accepted, selection.sizes.size, strict=True):
        for member in field.offered.hypotheses[index].members:
            variance[member] = variance.get(member, 0.0) + float(size) ** 2
    order = list(variance)
    parts = tuple(Part(field.offered.candidates[k], float(np.sqrt(variance[k]))) for k in order)
    return parts, {i: tuple(order.index(k) for k in field.offered.hypotheses[i].members) for i in selection.accepted}


def settled(extended: Extended) -> Bool1D:
    """Return (m,) which readings are to be used, judged by what the extended model leaves of them."""
    squares = np.sum(extended.rest.reshape(-1, 3) ** 2, axis=1)
    used = extended.model.used
    scale = float(np.median(squares[used])) / chi2_limit(0.5, 3)
    limit = max(scale, extended.variance, FINEST**2) * chi2_limit(FALSE_EXCLUSION / len(squares), 3)
    keep = squares < limit
    if np.mean(~keep) > MOST_EXCLUDED:
        return used
    return np.asarray(keep)
