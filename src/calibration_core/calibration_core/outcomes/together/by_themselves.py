"""What each of several recordings shows of the robot by itself, so that it can be compared with the others."""

from __future__ import annotations

import dataclasses

from calibration_core.identification.identify import fit_freed
from calibration_core.identification.stiffness.known_effects import without_effects
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.model.effects.recordings import RECORDING
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.given import GivenModel
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect, ModelParameters
from calibration_core.outcomes.together.prepare import Prepared

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

    Args:
        effects: Of all; those of a set-up name its recording.
        prepared: The recordings.
        k: Index of the one.

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
