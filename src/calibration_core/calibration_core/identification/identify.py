"""The one entry: a recording goes in, an identification comes out, whatever kind of recording it is."""

from __future__ import annotations

import dataclasses

from calibration_core.cell import Cell
from calibration_core.identification.absolute.evaluate import identify_absolute
from calibration_core.identification.geometry.parameter_table import with_known_effects
from calibration_core.identification.result.estimate import Identification
from calibration_core.identification.several.mixed import identify_mixed
from calibration_core.identification.standard.decoupled import identify_loaded
from calibration_core.identification.standard.kinematic_phases import standard_geometry
from calibration_core.identification.standard.phases import holds_phases, identify_phases
from calibration_core.identification.stiffness.end_effector import accounted, in_own_set_up, without_effects
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.observations.kinds import holds_both, is_loaded
from calibration_core.timeseries import Note, Readings


def identify(
    readings: Readings,
    cell: Cell,
    options: Options | None = None,
    test: Readings | None = None,
    given: GivenModel | None = None,
) -> Identification:
    """Identify stiffness from a loaded recording, frames, geometry and elasticity from an absolute one.

    Args:
        readings: The recording.
        cell: The cell file.
        options: How to evaluate.
        test: A second recording of the same kind that is predicted, not fitted.
        given: A model to start from; its effects are taken off both recordings and stand in the identified model, and
            so does the compliance of the end effector where the cell file states one.

    Raises:
        InputError: The input cannot be used; the message names file, place, what was found and what was expected.
    """
    options = options or Options()
    given = accounted(cell, given) if is_loaded(readings) else given
    if given is None:
        return fit_freed(readings, cell, options, test)
    given = in_own_set_up(given, readings, cell)
    freed, test = (None if one is None else without_effects(one, cell, given) for one in (readings, test))
    assert freed is not None  # noqa: S101 - readings are
    return with_given(fit_freed(freed, cell, dataclasses.replace(options, start=given.start), test), given)


def with_given(found: Identification, given: GivenModel) -> Identification:
    """Return the answer with the effects of the given model in the identified one."""
    effects = (*given.parameters.effects, *found.model.effects)
    stages = tuple(
        dataclasses.replace(stage, reason="what the given model predicts") if stage.name == "nominal" else stage
        for stage in found.stages
    )
    estimate = with_known_effects(found.estimate, given.estimate, len(given.parameters.effects))
    model = found.model.replace(effects=effects)
    return dataclasses.replace(found, model=model, stages=stages, given=given, estimate=estimate)


def fit_freed(readings: Readings, cell: Cell, options: Options, test: Readings | None) -> Identification:
    """Identify from readings of which everything known was taken off; arguments as for `identify`."""
    if readings.recording is None and is_loaded(readings) and holds_phases(readings):
        return identify_phases(readings, cell, options, test)
    if holds_both(readings, cell):
        return identify_mixed(readings, cell, options, test)
    if is_loaded(readings):
        return identify_loaded(readings, cell, options, test)
    readings = readings.with_notes(*_without_effect(options))
    found = identify_absolute(readings, cell, options, test)
    if readings.recording is not None:
        return found
    names, covariance = found.names, found.covariance
    return dataclasses.replace(found, standard=standard_geometry(readings, cell, found.model, names, covariance))


def _without_effect(options: Options) -> tuple[Note, ...]:
    """Name the options that were asked for and mean nothing to an absolute recording."""
    usual = Options()
    asked = [name for name in ("method", "weights", "deflections") if getattr(options, name) != getattr(usual, name)]
    text = "this option is for loaded recordings and has no effect on this one"
    return tuple(Note("option", name, text) for name in asked)
