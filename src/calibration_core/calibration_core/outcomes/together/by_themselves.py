"""What each of several recordings shows of the robot by itself, so that it can be compared with the others."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from calibration_core.acceptance.comparison import COMPLIANCE
from calibration_core.cell import Cell
from calibration_core.identification.identify import fit_freed
from calibration_core.identification.result.together import Disagreement
from calibration_core.identification.stiffness.known_effects import without_effects
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.effects.recordings import RECORDING
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.given import GivenModel
from calibration_core.model.identified.named_values import value_of, with_values
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect, ModelParameters
from calibration_core.outcomes.together.agreement import described
from calibration_core.outcomes.together.prepare import Prepared, evaluated
from calibration_core.timeseries import Note, Readings

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
