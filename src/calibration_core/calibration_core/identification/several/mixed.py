"""A recording that holds loaded configurations and postures at rest: two parts of one robot, as in two recordings.

Each part shows tracker and points by itself, and is put together with the other as recordings of several set-ups are:
the same data give the same answer, in one file or in two.  Where one part is too small to show them well, there is one
set-up, which all unloaded positions show: that is known of one file, and of two it is not.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.absolute.evaluate import (
    Evaluated,
    evaluate_absolute,
    identification_of,
    identify_absolute,
)
from calibration_core.identification.checks.conditions import check_preconditions
from calibration_core.identification.checks.noise_audit import OUTLIERS, outliers_of
from calibration_core.identification.checks.space import operating_space
from calibration_core.identification.geometry.fit import normal_equations
from calibration_core.identification.geometry.parameter_table import model_paths
from calibration_core.identification.geometry.terms import ElasticityTerm
from calibration_core.identification.result.estimate import (
    Anomaly,
    Exclusion,
    Fit,
    Identification,
    ParameterEstimate,
    Residuals,
    Unidentified,
)
from calibration_core.identification.several.merge import Member, Merged, merge, placed, start_of, with_readmitted
from calibration_core.identification.standard.decoupled import identify_loaded
from calibration_core.identification.standard.phases import holds_phases
from calibration_core.identification.statistics import rms
from calibration_core.identification.stiffness.loaded import MIN_CONFIGURATIONS, Options, identify_steps
from calibration_core.identification.stiffness.tested import tested_on
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import load_of
from calibration_core.observations.kinds import (
    FEWEST,
    at_rest,
    holds_both,
    loaded_configurations,
    single_steps,
    standing,
)
from calibration_core.timeseries import Bool1D, Float2D, Int1D, Note, Readings, numbers_in_time

COMPLIANCE = "compliance."
GEOMETRY = "geometry."


@dataclasses.dataclass(frozen=True, eq=False)
class Standing:
    """What the positions at rest show.

    Attributes:
        rows: (m,) which readings of the recording they are.
        found: The same in values and figures.
    """

    rows: Bool1D
    case: Evaluated
    found: Identification


def identify_mixture(readings: Readings, cell: Cell, options: Options, test: Readings | None = None) -> Identification:
    """Identify stiffness from the loaded steps, on the geometry that the positions at rest show.

    Raises:
        InputError: As `prepare_loaded` and `evaluate_absolute`.
    """
    start = nominal_parameters(cell) if options.start is None else options.start
    loaded = identify_steps(readings, cell, options)
    if readings.recording is None:  # frames of merged set-ups were known before; a single one shows its own
        start = loaded.model.replace(geometry=start.geometry, compliance=start.compliance)
    rows = standing(readings)
    some = readings.select(rows)
    believed = start.replace(compliance=loaded.model.compliance)
    case = evaluate_absolute(
        some,
        cell,
        robust=options.robust,
        readmit=options.readmit,
        believed=believed,
        corrected=options.corrected,
    )
    still = Standing(rows, case, identification_of(case, some, cell))
    started = dataclasses.replace(options, start=start.replace(geometry=still.found.model.geometry))
    found = _with_geometry(identify_loaded(readings, cell, started), still, cell)
    if test is None:
        return found
    before = case.nominal.replace(compliance=start.compliance)
    return dataclasses.replace(found, test=tested_on(test, cell, found.model, before, with_frames=True))


def _with_geometry(found: Identification, still: Standing, cell: Cell) -> Identification:
    """Return the answer of the loaded steps with geometry, residuals and exclusions of the positions at rest."""
    estimate = _beside(found.estimate, still, cell)
    seen = {(one.configuration, one.step, one.point) for one in found.exclusions}
    further = [one for one in still.found.exclusions if (one.configuration, one.step, one.point) not in seen]
    exclusions = (*found.exclusions, *further)
    kinds = {OUTLIERS, *(one.kind for one in found.anomalies)}
    anomalies = [one for one in found.anomalies if one.kind != OUTLIERS]
    anomalies += [one for one in still.found.anomalies if one.kind not in kinds]
    residuals, fit = _figures(found, still)
    return dataclasses.replace(
        found,
        method=f"{found.method}; geometry from all postures at rest ({still.found.method})",
        parameters=(*found.parameters, *_geometry_parameters(still, estimate, cell)),
        unidentified=(*found.unidentified, *still.found.unidentified),
        exclusions=exclusions,
        anomalies=(*outliers_of(exclusions), *anomalies),
        residuals=residuals,
        fit=fit,
        estimate=estimate,
    )


def _geometry_parameters(still: Standing, estimate: GaussianEstimate, cell: Cell) -> list[ParameterEstimate]:
    """Return the corrections of the geometry with the standard deviations of an estimate."""
    std, paths = dict(zip(estimate.names, estimate.std, strict=True)), model_paths(cell)
    return [
        dataclasses.replace(one, std=float(std.get(paths[one.name], one.std)))
        for one in still.found.parameters
        if one.group == "geometry"
    ]


def _beside(found: GaussianEstimate, still: Standing, cell: Cell) -> GaussianEstimate:
    """Return what loads and postures at rest show as one: the geometry is as uncertain as the compliances make it.

    At rest the robot sags by its compliances, which the loads have shown: an error of them is taken for geometry, with
    the sensitivity J = -(A^T A)^-1 A^T B of whitened columns A of what is fitted at rest and B of the compliances.
    """
    known = still.found.estimate
    geometry = known.chosen([k for k, name in enumerate(known.names) if name.startswith(GEOMETRY)])
    whole = GaussianEstimate.independent((found, geometry))
    case, joints = still.case, cell.robot.joints
    places = {name: row for row, name in enumerate(found.names)}
    held = [j for j, name in enumerate(joints) if _known(found, places.get(f"{COMPLIANCE}{name}"))]
    if case.staged.elastic or not held or not geometry.names:
        return whole
    fit, paths = case.staged.final.fit, model_paths(cell)
    terms = [*fit.terms, ElasticityTerm(tuple(held), tuple(joints[j] for j in held))]
    used = case.problem.select(np.flatnonzero(case.used))
    matrix, p = normal_equations(used, fit.parameters, terms).matrix, len(fit.names)
    answer = -np.linalg.solve(fit.normal.matrix, matrix[:p, p:])
    fitted = [paths.get(name) for name in fit.names]
    sensitivity = answer[[fitted.index(name) for name in geometry.names]]
    rows = [places[f"{COMPLIANCE}{joints[j]}"] for j in held]
    n = len(found.names)
    covariance = np.array(whole.covariance)
    shared = found.covariance[:, rows] @ sensitivity.T
    covariance[:n, n:], covariance[n:, :n] = shared, shared.T
    covariance[n:, n:] += sensitivity @ found.covariance[np.ix_(rows, rows)] @ sensitivity.T
    return dataclasses.replace(whole, covariance=covariance)


def _known(found: GaussianEstimate, row: int | None) -> bool:
    return row is not None and bool(np.isfinite(found.covariance[row, row]))


def _figures(found: Identification, still: Standing) -> tuple[Residuals, Fit]:
    """Return residuals and figures over all readings: loaded steps say nothing of postures at rest, positions do."""
    posture = at_rest(found.readings) & still.rows
    some = posture[still.rows]
    loaded, own, figures = found.residuals, still.found.residuals, found.fit
    residual, held_out = loaded.residual.copy(), loaded.held_out.copy()
    sigma, excluded = loaded.sigma.copy(), loaded.excluded.copy()
    residual[posture], held_out[posture], sigma[posture] = own.residual[some], own.held_out[some], own.sigma[some]
    excluded[posture] = own.excluded[some]
    before = still.case.staged.frames
    lengths = np.linalg.norm(held_out, axis=1)
    together = dataclasses.replace(
        loaded,
        measured=loaded.predicted + residual,
        residual=residual,
        held_out=held_out,
        sigma=sigma,
        excluded=excluded,
    )
    return together, dataclasses.replace(
        figures,
        rms_before=_with_further(figures.rms_before, before.residual.T[some], len(residual)),
        rms_after=rms(residual),
        held_out_rms_before=_with_further(figures.held_out_rms_before, before.held_out.T[some], len(residual)),
        held_out_rms_after=rms(held_out),
        held_out_mean_after=float(lengths.mean()),
        held_out_max_after=float(lengths.max()),
        rms_used=rms(residual[~excluded]),
    )


def _with_further(figure: float, further: Float2D, count: int) -> float:
    """Return the root mean square of `count` readings, m, in which further ones, (k, 3) m, counted as zero."""
    return float(np.sqrt(figure**2 + np.sum(further**2) / (3 * count)))


# --- A recording that holds loaded configurations and postures at rest ------------------------------------------------


DIGITS = 9  # of the number from which on postures at rest are numbered beside loaded configurations
LONG = re.compile(rf"\b\d{{{DIGITS + 1},}}\b")
FEWEST_OF_A_FILE = 3  # postures at rest, with which a file of their own has frames of its own
IN_TWO_FILES = "two files would have frames of their own each, share less, and give a slightly different answer"
PARTS = ("the loaded configurations", "the postures at rest")


@dataclasses.dataclass(frozen=True, eq=False)
class Parts:
    """A recording as two: its loaded configurations, and its postures at rest.

    Attributes:
        members: The parts.
        alone: What each shows by itself.
        merged: Both together, the loaded configurations first.
        order: (m,) row of `merged` for every row of the recording.
    """

    readings: Readings
    cell: Cell
    members: tuple[Member, Member]
    alone: tuple[Identification, Identification]
    merged: Merged
    order: Int1D
    options: Options

    def placed(self, readings: Readings) -> Readings:
        """Return further readings of the loaded part's set-up, as they stand beside both parts."""
        like = dataclasses.replace(self.members[0], readings=readings)
        reference = self.members[0], self.alone[0]
        return placed(like, self.alone[0], reference, self.merged.readings.points, differences=False)

    def text(self, text: str) -> str:
        """Return a text about both parts together in words of the recording."""
        for member, part in zip(self.members, PARTS, strict=True):
            for name in ("tracker", *member.readings.points):
                text = text.replace(member.point(name), name)
            text = text.replace(f"in recording {member.number}", f"in {part}")
        return re.sub(LONG, lambda found: str(self.number(int(found[0]))), text)

    def number(self, configuration: int) -> int:
        """Return the number that a configuration of both parts together has in the recording."""
        apart = self.members[1].first_number
        return configuration - apart if configuration >= apart else configuration

    def parameters(self, text: str) -> str:
        """Return a text that names parameters of both set-ups, those of the postures at rest marked as such."""
        still = self.members[1]
        for name in ("tracker", *still.readings.points):
            text = re.sub(rf"{re.escape(still.point(name))} (\w+)", rf"{name} \1 (at rest)", text)
        return self.text(text)

    def location(self, location: Mapping[str, Any]) -> dict[str, Any]:
        """Return a location without the part that it is in, for that is no place of its own."""
        return {
            key: self.text(value) if isinstance(value, str) else self.number(value)
            for key, value in location.items()
            if key != "recording"
        }

    def anomaly(self, one: Anomaly) -> Anomaly:
        """Return an anomaly in words of the recording."""
        known = numbers_in_time(self.readings.configuration).tolist()
        first_last = (
            None if one.configurations is None else sorted(map(self.number, one.configurations), key=known.index)
        )
        return dataclasses.replace(
            one,
            location=self.location(one.location),
            configurations=None if first_last is None else (first_last[0], first_last[1]),
            text=self.text(one.text),
        )


def parts_of(readings: Readings, cell: Cell, options: Options) -> Parts:
    """Take a recording for two, its loaded configurations and its postures at rest.

    Raises:
        InputError: A part cannot be evaluated by itself.
    """
    rest = single_steps(readings)
    apart = 10 ** max(DIGITS, len(str(int(readings.configuration.max()))))
    loaded, still = Member(_part(readings, ~rest), cell, 1, 0), Member(_part(readings, rest), cell, 2, apart)
    start = options.start
    alone = (
        with_readmitted(identify_steps(loaded.readings, cell, options), options.readmit),
        identify_absolute(
            still.readings,
            cell,
            robust=options.robust,
            readmit=options.readmit,
            believed=start,
            corrected=options.corrected,
        ),
    )
    merged = merge((loaded, still), alone, 0)
    merged = dataclasses.replace(
        merged, readings=dataclasses.replace(merged.readings, provenance=readings.provenance, notes=readings.notes)
    )
    order = np.argsort(np.concatenate([np.flatnonzero(~rest), np.flatnonzero(rest)]))
    each = (loaded, still)
    together = dataclasses.replace(
        options,
        readmit=frozenset((c + one.first_number, s, one.point(p)) for c, s, p in options.readmit for one in each),
        start=start_of(nominal_parameters(merged.cell) if start is None else start, merged),
    )
    return Parts(readings, cell, each, alone, merged, order, together)


def set_ups(readings: Readings, cell: Cell, options: Options) -> Parts | str:
    """Return the parts of a recording, each with a set-up of its own; why there is one set-up alone, otherwise.

    Arguments as for `parts_of`.

    Raises:
        CellError: A frame is needed and missing.
        EquilibriumError: The load is beyond what the joints can carry.
    """
    if readings.recording is not None or not holds_both(readings, cell) or holds_phases(readings):
        return "the recording is of one kind"
    count = len(np.unique(readings.configuration[single_steps(readings)]))
    if count < FEWEST:
        few = f"frames of their own need {FEWEST} postures at rest, and there are {count}"
        return few if count < FEWEST_OF_A_FILE else f"{few}; {IN_TWO_FILES}"
    try:
        return parts_of(readings, cell, options)
    except IdentificationError as error:
        return str(error)


def identify_mixed(readings: Readings, cell: Cell, options: Options, test: Readings | None = None) -> Identification:
    """Identify stiffness and geometry from a recording that holds both kinds, any number of either.

    Returns:
        The answer of a loaded recording; where fewer than two configurations were loaded, that of postures at rest.

    Raises:
        InputError: The recording cannot be evaluated.
    """
    if readings.recording is not None:
        return identify_mixture(readings, cell, options, test)
    if len(loaded_configurations(readings)) < MIN_CONFIGURATIONS:
        return _at_rest_alone(readings, cell, options, test)
    parts = set_ups(readings, cell, options)
    if not isinstance(parts, Parts):
        return _of_one_set_up(readings, cell, options, test, parts)
    placed_test = None if test is None else parts.placed(test)
    return _as_one(identify_mixture(parts.merged.readings, parts.merged.cell, parts.options, placed_test), parts)


def _at_rest_alone(readings: Readings, cell: Cell, options: Options, test: Readings | None) -> Identification:
    """Identify from positions at rest, where too few configurations were loaded for a stiffness."""
    count = len(loaded_configurations(readings))
    text = f"{count} with loaded steps is too few for a stiffness (at least {MIN_CONFIGURATIONS}): first steps are used"
    some = readings.select(standing(readings)).with_notes(Note("few_loaded", "configuration", text, count))
    case = evaluate_absolute(
        some,
        cell,
        robust=options.robust,
        readmit=options.readmit,
        believed=options.start,
        corrected=options.corrected,
    )
    return identification_of(case, some, cell, test=test)


def _of_one_set_up(
    readings: Readings, cell: Cell, options: Options, test: Readings | None, reason: str
) -> Identification:
    """Identify where one part alone does not show tracker and points: all unloaded positions together may."""
    text = f"loaded configurations and postures at rest share tracker and points: {reason}"
    noted = readings.with_notes(Note("one_set_up", "configuration", text))
    try:
        return identify_mixture(noted, cell, options, test)
    except IdentificationError as error:
        text = f"the postures at rest are not used: {error}"
        return identify_loaded(readings.with_notes(Note("loaded_alone", "configuration", text)), cell, options, test)


def _as_one(found: Identification, parts: Parts) -> Identification:
    """Return the answer of both parts as that of the recording, with tracker and points of the loaded part."""
    readings, cell = parts.readings, parts.cell
    member, alone = parts.members[0], parts.alone[0]
    model = _with_all_points(of_set_up(found.model, member, alone), found.model, parts)
    chain = chain_of(cell).corrected(model.geometry)
    space = operating_space(chain, model, readings, load_of(readings, cell, model))
    frames = [one for one in alone.parameters if one.group in SET_UP]
    return dataclasses.replace(
        found,
        readings=readings,
        parameters=(*frames, *(one for one in found.parameters if one.group not in SET_UP)),
        unidentified=tuple(_unidentified(one, parts) for one in found.unidentified),
        residuals=Residuals(**{name: values[parts.order] for name, values in vars(found.residuals).items()}),
        exclusions=tuple(_exclusion(one, parts) for one in found.exclusions),
        anomalies=tuple(parts.anomaly(one) for one in found.anomalies),
        preconditions=check_preconditions(
            readings, cell, space, found.fit.noise, k_csm=parts.options.method != "linear"
        ),
        space=space,
        model=model,
        estimate=estimate_of_set_up(found.estimate, member, alone),
    )


def _with_all_points(model: ModelParameters, whole: ModelParameters, parts: Parts) -> ModelParameters:
    """Return the model with points that were measured at rest alone, as that part shows them."""
    loaded, still = parts.members
    further = [name for name in still.readings.points if name not in loaded.readings.points]
    return model.replace(points={**model.points, **{name: whole.points[still.point(name)] for name in further}})


def _unidentified(one: Unidentified, parts: Parts) -> Unidentified:
    combination = {parts.parameters(name): weight for name, weight in one.combination.items()}
    return Unidentified(combination, parts.parameters(one.reason))


def _exclusion(one: Exclusion, parts: Parts) -> Exclusion:
    configuration, point = parts.number(one.configuration), parts.text(one.point)
    return dataclasses.replace(one, configuration=configuration, point=point, reason=parts.text(one.reason))


def _part(readings: Readings, rows: Bool1D) -> Readings:
    """Return some rows of a recording as one of its own, with the points that they hold."""
    some = readings.select(rows)
    own = np.unique(some.point)
    points = tuple(some.points[k] for k in own)
    return dataclasses.replace(some, points=points, point=np.searchsorted(own, some.point))


POINTS, TRACKER = "measurement_points.", "tracker."
SET_UP = ("tracker", "point")  # groups of parameters that belong to no robot


def of_set_up(model: ModelParameters, member: Member, alone: Identification) -> ModelParameters:
    """Return a model of several set-ups with tracker pose and points of one of them."""
    tracker = alone.model.tracker
    if model.setups is not None:
        tracker = model.tracker @ model.setups[member.number - 1] @ tracker
    points = {name: np.array(point) for name, point in member.cell.frames.measurement_points.items()}
    points |= {name: model.points[member.point(name)] for name in member.readings.points}
    return model.replace(tracker=tracker, points=points, setups=None)


def estimate_of_set_up(estimate: GaussianEstimate, member: Member, alone: Identification) -> GaussianEstimate:
    """Return what is known of the numbers of `of_set_up`: what is shared, and the set-up's own points and tracker.

    The tracker pose, and points that displacements do not show, are known as the set-up shows them by itself.
    """
    mark = f"@{member.number}."
    others = (POINTS, TRACKER)
    kept = [k for k, name in enumerate(estimate.names) if mark in name or not name.startswith(others)]
    shared = estimate.chosen(kept)
    shared = shared.renamed([name.replace(mark, ".") for name in shared.names])
    own = [k for k, name in enumerate(alone.estimate.names) if name.startswith(others) and name not in shared.names]
    return GaussianEstimate.independent((shared, alone.estimate.chosen(own)))
