"""What is known already is taken off the readings, so that only the rest is left to be explained.

The effects of a given model move the points by so much at its own compliances, geometry and frames; readings less this
movement are those of a robot without the effects.  Their parameters are taken as they stand: fixed, without doubt.
"""

from __future__ import annotations

import dataclasses

from calibration_core.cell import Cell
from calibration_core.errors import ModelFileError
from calibration_core.identification.stiffness.predict import from_step_zero, require_points, shift_by_effects
from calibration_core.model.identified.given import GivenModel
from calibration_core.timeseries import Note, Readings


def without_effects(readings: Readings, cell: Cell, given: GivenModel) -> Readings:
    """Return the readings less what the effects of a given model move the points, with a note that says so.

    Args:
        readings: The recording.
        cell: The cell file.
        given: The model.

    Raises:
        RecordingError: The recording has a point that the model does not know.
        ModelFileError: The model contains an effect that this recording has no data for.
        EquilibriumError: The load is beyond what the joints of the model can carry.
    """
    model = given.parameters
    require_points(readings, model)
    if not model.effects:
        return readings
    try:
        shift = shift_by_effects(readings, cell, model) @ model.tracker[:3, :3]
    except ModelFileError as error:
        raise ModelFileError(given.file, error.place, error.found, error.expected) from None
    if cell.measurements.points == "displacement":
        shift = from_step_zero(readings, shift)
    text = f"the effects of this model were taken off the readings as known: {given.known_effects()}"
    note = Note("known_effects", given.file, text, len(readings))
    return dataclasses.replace(readings, position=readings.position - shift).with_notes(note)
