"""Recordings as they would be if none of them showed the robot otherwise than the others do."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from calibration_core.acceptance.comparison import COMPLIANCE
from calibration_core.cell import Cell
from calibration_core.identification.result.together import Disagreement
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.identified.named_values import value_of, with_values
from calibration_core.model.parameters import ModelParameters
from calibration_core.outcomes.together.agreement import described
from calibration_core.outcomes.together.prepare import Prepared, evaluated
from calibration_core.timeseries import Note, Readings


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
        members[k] = dataclasses.replace(member, readings=_less(member.readings, member.cell, alone.model, own))
        if test is not None and k == first:
            test = _less(test, member.cell, alone.model, own)
    less = evaluated(members, prepared.known, prepared.named, prepared.asked, test, prepared.believed, unchanged)
    options = dataclasses.replace(prepared.options, start=less.options.start)
    return dataclasses.replace(less, options=options, with_changes=prepared, changes=tuple(changes))


def _less(readings: Readings, cell: Cell, model: ModelParameters, changes: Sequence[Disagreement]) -> Readings:
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
