"""What identification asks about missing physics of a recording that holds loaded configurations and postures at rest.

The stiffness comes from both parts, each with a set-up of its own; its bias is that of the same two parts.
"""

from __future__ import annotations

import dataclasses

from calibration_core.cell import Cell
from calibration_core.diagnosis.diagnose import diagnose, with_given_effects
from calibration_core.diagnosis.result.finding import Alternative, Diagnosis, Finding
from calibration_core.identification.several.mixed import Parts, set_ups
from calibration_core.identification.stiffness.end_effector import accounted
from calibration_core.identification.stiffness.known_effects import without_effects
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.model.identified.given import GivenModel
from calibration_core.observations.kinds import is_loaded
from calibration_core.timeseries import Readings


def search_missing(readings: Readings, cell: Cell, options: Options, given: GivenModel | None = None) -> Diagnosis:
    """Look for missing physics in a recording as `identify` has evaluated it.

    Args:
        readings: The recording.
        cell: The cell file.
        options: How it was evaluated.
        given: A model to start from; its effects are taken off.

    Raises:
        InputError: The recording cannot be searched.
    """
    usual = Options(robust=options.robust, readmit=options.readmit)
    known = accounted(cell, given) if is_loaded(readings) else given
    freed = readings if known is None else without_effects(readings, cell, known)
    asked = options if known is None else dataclasses.replace(options, start=known.start)
    parts = set_ups(freed, cell, asked)
    if not isinstance(parts, Parts):
        return diagnose(readings, cell, usual, given=given)
    merged, start = parts.merged, parts.options.start
    together = dataclasses.replace(usual, readmit=parts.options.readmit, start=start)
    found = diagnose(merged.readings, merged.cell, together)
    found = dataclasses.replace(
        found,
        findings=tuple(_finding(one, parts) for one in found.findings),
        anomalies=tuple(parts.anomaly(one) for one in found.anomalies),
        rest=dataclasses.replace(found.rest, text=parts.text(found.rest.text)),
    )
    return found if known is None else with_given_effects(found, known)


def _finding(one: Finding, parts: Parts) -> Finding:
    return dataclasses.replace(
        one,
        location=parts.location(one.location),
        explanation=parts.text(one.explanation),
        separate_by=parts.text(one.separate_by),
        cannot_be_told_from=tuple(_beside(other, parts) for other in one.cannot_be_told_from),
    )


def _beside(one: Alternative, parts: Parts) -> Alternative:
    return dataclasses.replace(one, location=parts.location(one.location))
