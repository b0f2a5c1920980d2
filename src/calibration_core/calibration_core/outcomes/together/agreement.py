"""Whether recordings that are evaluated together show the same robot: which of them shows a parameter otherwise.

What the recordings show by themselves is normal about parameters that all share, but for a few changes, each of one
parameter in one recording.  Changes are looked for one after the other, each beside those found before (forward
selection by generalised least squares), at one level for all recordings and parameters together: a recording that
differs is named, and does not make the others differ from what it spoils.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from calibration_core.acceptance.comparison import AS_GOOD, COMPLIANCE, COVERAGE, STIFFNESS_LEVEL, critical_size
from calibration_core.cell import Cell
from calibration_core.identification.identify import fit_freed
from calibration_core.identification.result.estimate import Anomaly, Disagreement
from calibration_core.identification.stiffness.end_effector import without_effects
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.effects.recordings import RECORDING
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.model.identified.named_values import value_of, with_values
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect, ModelParameters
from calibration_core.outcomes.together.prepare import Prepared, evaluated
from calibration_core.timeseries import Float1D, Float2D, Note, Readings

GEOMETRY = "geometry."
GROUPS = (COMPLIANCE, GEOMETRY)
ALIKE = 1e-6  # length of what is left of a column of length one: nothing
LEAST = 1e-12  # of a correlation matrix's eigenvalues: nothing is known better


def agreement(
    files: Sequence[str], estimates: Sequence[GaussianEstimate]
) -> tuple[tuple[str, ...], tuple[Disagreement, ...]]:
    """Say which recordings show a parameter otherwise than the others.

    Compliances are compared joint by joint where two recordings know them; corrections of the geometry among
    recordings that fit the same ones and the same compliances, since each depends on which others are fitted.

    Returns:
        compared: Names of the parameters that were compared.
        disagreements: What differs, the clearest first.
    """
    compared: list[str] = []
    found: list[Disagreement] = []
    for group in GROUPS:
        parts = [_known(estimate, group) for estimate in estimates]
        if group == GEOMETRY:
            sets = [{name for name in one.names if name.startswith(GROUPS)} for one in estimates]
            parts = [p if sets.count(s) > 1 else GaussianEstimate.nothing() for p, s in zip(parts, sets, strict=True)]
        whole = _stacked(parts)
        compared += dict.fromkeys(whole.names[row] for row in whole.judged)
        found += _differences(files, whole)
    return tuple(compared), tuple(found)


def as_anomalies(disagreements: Sequence[Disagreement]) -> tuple[Anomaly, ...]:
    """Return what differs between recordings as anomalies of the answer."""
    return tuple(
        Anomaly(
            "recordings_differ",
            {"joint": one.location, "recording": one.file},
            None,
            abs(one.change),
            one.unit,
            described(one),
            "evaluate the recordings apart, and find out what was done to the robot between them",
        )
        for one in disagreements
    )


def described(one: Disagreement) -> str:
    """Return a disagreement in words."""
    if one.parameter.startswith(COMPLIANCE):
        word = "softer" if one.change < 0 else "stiffer"
        low, high = sorted((abs(one.low), abs(one.high)))
        size = f"{one.location} is {100 * abs(one.change):.1f} % {word} ({100 * low:.1f} to {100 * high:.1f} %)"
    else:
        factor, unit = (1e3, "mm") if one.unit == "m" else (1e3, "mrad")
        size = (
            f"{one.parameter.removeprefix(GEOMETRY)} stands {factor * one.change:+z.3f} {unit} "
            f"({factor * one.low:+z.3f} to {factor * one.high:+z.3f} {unit}) elsewhere"
        )
    where = f"; the change may as well be at {' or '.join(one.or_else)}" if one.or_else else ""
    cause = "the robot has changed, or the model leaves something out"
    return f"in {one.file}, {size} than in the other recordings: {cause}{where}"


def _known(estimate: GaussianEstimate, group: str) -> GaussianEstimate:
    rows = [
        k
        for k, (name, std) in enumerate(zip(estimate.names, estimate.std, strict=True))
        if name.startswith(group) and np.isfinite(std) and std > 0
    ]
    return estimate.chosen(rows)


@dataclasses.dataclass(frozen=True, eq=False)
class _Stacked:
    """What all recordings show by themselves, r numbers below each other, whitened.

    Attributes:
        names: Of the parameters, (r,).
        units: Of the parameters, (r,).
        recordings: Index of the recording of each, (r,).
        value: (r,) whitened values.
        root: (r, r) whitening matrix; its columns are what a change of each number would do.
        shared: (r, p) whitened columns of the parameters that all share.
        common: (r,) which of these each number is.
        judged: Numbers that a change is looked for in: some other recording knows the parameter, too.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    recordings: tuple[int, ...]
    value: Float1D
    root: Float2D
    shared: Float2D
    common: tuple[int, ...]
    judged: tuple[int, ...]


def _stacked(parts: Sequence[GaussianEstimate]) -> _Stacked:
    names = tuple(name for part in parts for name in part.names)
    units = tuple(unit for part in parts for unit in part.units)
    recordings = tuple(k for k, part in enumerate(parts) for _ in part.names)
    root, begin = np.zeros((len(names),) * 2), 0
    for part in parts:
        rows = slice(begin, begin + len(part.names))
        own = part.std
        variances, axes = np.linalg.eigh(part.covariance / np.outer(own, own))
        root[rows, rows] = (axes / np.sqrt(np.maximum(variances, LEAST))).T / own
        begin = rows.stop
    distinct = list(dict.fromkeys(names))
    common = tuple(distinct.index(name) for name in names)
    shared = np.zeros((len(names), len(distinct)))
    for row, column in enumerate(common):
        shared[:, column] += root[:, row]
    value = np.concatenate([np.zeros(0), *(part.value for part in parts)])
    # of two recordings that alone know a parameter, the later one has changed
    judged = tuple(
        row
        for row, name in enumerate(names)
        if names.count(name) > 2 or (names.count(name) == 2 and name in names[:row])
    )
    return _Stacked(names, units, recordings, root @ value, root, shared, common, judged)


def _differences(files: Sequence[str], whole: _Stacked) -> list[Disagreement]:
    critical = critical_size(STIFFNESS_LEVEL / len(GROUPS), len(whole.judged))
    chosen: list[int] = []
    near: dict[int, tuple[str, ...]] = {}
    while len(chosen) < len(whole.judged):
        size = _sizes(whole, chosen)
        best = int(np.argmax(size))
        if size[best] <= critical:
            break
        alike = [k for k in whole.judged if k != best and size[k] > 0 and size[best] ** 2 - size[k] ** 2 < AS_GOOD]
        near[best] = tuple(_place(files, whole, k, best) for k in alike)
        chosen.append(best)
    return _stated(files, whole, chosen, near) if chosen else []


def _sizes(whole: _Stacked, chosen: Sequence[int]) -> Float1D:
    """Return (r,) how many standard deviations a further change of each number is from zero; -1: not looked for."""
    known = np.column_stack([_scaled(whole.shared), _scaled(whole.root[:, list(chosen)])])
    basis, values, _ = np.linalg.svd(known, full_matrices=False)
    basis = basis[:, values > ALIKE * values[0]]
    further = _scaled(whole.root)
    left = further - basis @ (basis.T @ further)
    length = np.linalg.norm(left, axis=0)
    score = np.abs(left.T @ whole.value) / np.maximum(length, ALIKE)
    size = np.full(len(whole.names), -1.0)
    open_ = [row for row in whole.judged if row not in chosen and length[row] > ALIKE]
    size[open_] = score[open_]
    return size


def _scaled(columns: Float2D) -> Float2D:
    """Return columns of length one: parameters have sizes of their own."""
    return columns / np.linalg.norm(columns, axis=0)


def _place(files: Sequence[str], whole: _Stacked, row: int, best: int) -> str:
    """Return where a change explains nearly as much: the joint, and the recording where it is another one."""
    joint = _joint(whole.names[row])
    return joint if whole.recordings[row] == whole.recordings[best] else f"{joint} in {files[whole.recordings[row]]}"


def _stated(
    files: Sequence[str], whole: _Stacked, chosen: Sequence[int], near: Mapping[int, tuple[str, ...]]
) -> list[Disagreement]:
    """Return changes, fitted beside each other, with their intervals."""
    columns = np.column_stack([whole.shared, whole.root[:, list(chosen)]])
    length = np.linalg.norm(columns, axis=0)
    inverse = np.linalg.pinv(columns / length) / length[:, None]
    fitted, spread = inverse @ whole.value, np.linalg.norm(inverse, axis=1)
    found = []
    for place, row in enumerate(chosen, start=whole.shared.shape[1]):
        change, unit = float(fitted[place]), whole.units[row]
        ends = [change + side * COVERAGE * float(spread[place]) for side in (-1, 1)]
        if whole.names[row].startswith(COMPLIANCE):  # K = 1/C: a compliance that grows is a stiffness that falls
            others = float(fitted[whole.common[row]])
            change, *ends = (-d / (others + d) for d in (change, *reversed(ends)))
            unit = "1"
        file, name = files[whole.recordings[row]], whole.names[row]
        found.append(Disagreement(file, name, _joint(name), change, ends[0], ends[1], unit, near[row]))
    return found


def _joint(name: str) -> str:
    return name.removeprefix(COMPLIANCE) if name.startswith(COMPLIANCE) else name.split(".")[1]


# --- what each of several recordings shows of the robot by itself, so that it can be compared with the ----------------


FOUND = "what was found"


def by_themselves(prepared: Prepared, found: ModelParameters | None = None) -> tuple[GaussianEstimate, ...]:
    """Return what each recording shows by itself, less the effects that were found in all of them together.

    What the standard's model leaves out moves the parameters of each recording otherwise, for their postures differ;
    so does a compliance that one recording at rest shows and another one does not: all start from the common ones.
    Where one recording proves that the geometry is to be corrected, the others say what they know of it, too.

    Args:
        prepared: The recordings.
        found: The model of all of them together with the effects that were found; None: none was.

    Raises:
        InputError: A recording cannot be evaluated by itself.
    """
    if found is None or not found.effects:
        return prepared.shown
    return tuple(_less(prepared, k, found) for k in range(len(prepared.members)))


def effects_in(effects: tuple[AppliedEffect, ...], prepared: Prepared, k: int) -> tuple[AppliedEffect, ...]:
    """Return the effects of all recordings together that one of them has: those of the robot, and of its set-up.

    Returns:
        Each at the place that it has in that recording by itself, whose points are counted among its own.
    """
    own = str(prepared.members[k].number)
    return tuple(_at_its_own_place(one, prepared, k) for one in effects if one.location.get(RECORDING, own) == own)


def _at_its_own_place(effect: AppliedEffect, prepared: Prepared, k: int) -> AppliedEffect:
    member = prepared.members[k]
    location = {key: value for key, value in effect.location.items() if key != RECORDING}
    point = str(location.get("point", ""))
    if point.startswith("#"):
        name = prepared.merged.readings.points[int(point[1:])]
        location["point"] = f"#{[member.point(own) for own in member.readings.points].index(name)}"
    return dataclasses.replace(effect, location=location)


def _less(prepared: Prepared, k: int, found: ModelParameters) -> GaussianEstimate:
    """Identify one recording by itself, less what was found in all of them."""
    member, start = prepared.members[k], prepared.starts[k]
    own = prepared.alone[k].model.replace(
        compliance=found.compliance, geometry=found.geometry, effects=effects_in(found.effects, prepared, k)
    )
    readings = without_effects(member.readings, member.cell, GivenModel(own, FOUND, ""))
    believed = (start or nominal_parameters(member.cell)).replace(compliance=found.compliance)
    options = Options(robust=prepared.options.robust, start=believed, corrected=prepared.corrects)
    return fit_freed(readings, member.cell, options, None).estimate


def without_changes(prepared: Prepared, changes: Sequence[Disagreement]) -> Prepared:
    """Return the recordings less what differs between them.

    A joint that is softer in one recording, or stands elsewhere, moves that one's points by what its own model with
    and without the change predicts.  The change is taken as a fixed value without uncertainty.
    What the others show by themselves stays as it was evaluated.

    Raises:
        InputError: A recording cannot be evaluated by itself without its change.
    """
    members, first = list(prepared.members), prepared.first
    unchanged = dict(enumerate(prepared.alone))
    test = None if prepared.test is None else prepared.bare
    for k, (member, alone) in enumerate(zip(prepared.members, prepared.alone, strict=True)):
        own = [one for one in changes if one.file == member.file]
        if not own:
            continue
        del unchanged[k]
        members[k] = dataclasses.replace(member, readings=_without(member.readings, member.cell, alone.model, own))
        if test is not None and k == first:
            test = _without(test, member.cell, alone.model, own)
    less = evaluated(members, prepared.known, prepared.named, prepared.asked, test, prepared.believed, unchanged)
    options = dataclasses.replace(prepared.options, start=less.options.start)
    return dataclasses.replace(less, options=options, with_changes=prepared, changes=tuple(changes))


def _without(readings: Readings, cell: Cell, model: ModelParameters, changes: Sequence[Disagreement]) -> Readings:
    values = {}
    for one in changes:
        value = value_of(model, one.parameter)
        compliance = one.parameter.startswith(COMPLIANCE)  # its change is that of the stiffness, relative
        values[one.parameter] = value * (1 + one.change) if compliance else value - one.change
    others = with_values(model, values)
    shift = predict_readings(readings, cell, model) - predict_readings(readings, cell, others)
    text = " ".join(f"What differs is taken off its readings: {described(one)}." for one in changes)
    note = Note("recordings_differ", readings.provenance.path, text, len(readings))
    return dataclasses.replace(readings, position=readings.position - shift).with_notes(note)
