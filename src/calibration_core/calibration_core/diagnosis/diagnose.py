"""The one entry: a recording goes in, a diagnosis comes out, whatever kind of recording it is."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.compare import compare
from calibration_core.diagnosis.comparison import Comparison
from calibration_core.diagnosis.finding import Diagnosis, Rest
from calibration_core.diagnosis.loaded import diagnose_loaded
from calibration_core.diagnosis.locate import locate
from calibration_core.diagnosis.next_offers import Offer
from calibration_core.diagnosis.positions import diagnose_mixed, diagnose_still
from calibration_core.errors import EquilibriumError, IdentificationError
from calibration_core.identification.identify import is_loaded, with_given
from calibration_core.identification.known import without_effects
from calibration_core.identification.loaded import Options
from calibration_core.model.given import GivenModel
from calibration_core.timeseries import Readings

NO_PHYSICS = Rest(
    0.0,
    False,
    {},
    "Recording and simulation differ by what is no physics, and it may be the recording that is mixed up: no physics "
    "is claimed before this is put right.",
)


def diagnose(
    readings: Readings,
    cell: Cell,
    options: Options | None = None,
    test: Readings | None = None,
    simulation: Readings | None = None,
    offers: Sequence[Offer] | None = None,
    given: GivenModel | None = None,
) -> Diagnosis:
    """Say what the model of a recording leaves out.

    A recording may hold configurations with several steps and others with one, any number of either: all are positions
    of one model.  Loaded steps alone are searched as differences to their configuration's first.

    Args:
        readings: The recording.
        cell: The cell file.
        options: How to evaluate the loaded part.
        test: A second recording of the same kind, predicted but not fitted.
        simulation: What a simulation says of the same measurement; compared before any physics.
        offers: What could be measured next; None: nothing is proposed.
        given: A model to start from.  Its effects are known: they are taken off both recordings (not off the
            simulation, nor where it is compared with), and stand in the extended model before what is found.

    Raises:
        InputError: The input cannot be used; the message names file, place, what was found and what was expected.
    """
    options = options or Options()
    if simulation is None:
        return _with_location(readings, cell, options, test, offers, given)
    compared = compare(readings, simulation, cell)
    try:
        found = _with_location(readings, cell, options, test, offers, given)
    except EquilibriumError as error:
        if not compared.recording_spoiled:
            raise
        named = next(d for d in compared.differences if d.spoils and d.side != "simulation")
        raise IdentificationError(
            readings.provenance.path, named.kind, f"{named.text} There is {error}", "a recording as the cell file says"
        ) from None
    return beside(found, compared)


def _with_location(
    readings: Readings,
    cell: Cell,
    options: Options,
    test: Readings | None,
    offers: Sequence[Offer] | None,
    given: GivenModel | None,
) -> Diagnosis:
    """Diagnose the recording less what is known, and say where the rest lies."""
    if given is None:
        return with_location(_diagnose(readings, cell, options, test, offers), cell)
    freed = without_effects(readings, cell, given)
    test = None if test is None else without_effects(test, cell, given)
    started = dataclasses.replace(options, start=given.start)
    found = with_location(_diagnose(freed, cell, started, test, offers), cell)
    model = found.model
    if model is not None:
        model = model.replace(effects=(*given.parameters.effects, *model.effects))
    return dataclasses.replace(found, identification=with_given(found.identification, given), model=model)


def with_location(found: Diagnosis, cell: Cell) -> Diagnosis:
    """Add where recording and null model differ, without a hypothesis."""
    null = found.identification
    if found.residual_before is None or len(found.residual_before) != len(null.readings):
        return found
    where = locate(null.readings, found.residual_before, cell, null.model)
    if where is None:
        return found
    return dataclasses.replace(found, where=where, located=(*where.sentences, *found.located))


def beside(found: Diagnosis, compared: Comparison) -> Diagnosis:
    """Add the comparison with a simulation; a recording that is mixed up itself lets no physics be claimed."""
    named = tuple(difference.as_anomaly() for difference in compared.differences)
    kinds = {anomaly.kind for anomaly in named}
    anomalies = (*named, *(a for a in found.anomalies if a.kind != "wrong_robot_file" or a.kind not in kinds))
    found = dataclasses.replace(found, comparison=compared, anomalies=anomalies)
    if not compared.recording_spoiled:
        return found
    return dataclasses.replace(found, verdict="consistent", findings=(), rest=NO_PHYSICS, model=None)


def _diagnose(
    readings: Readings,
    cell: Cell,
    options: Options,
    test: Readings | None,
    offers: Sequence[Offer] | None,
) -> Diagnosis:
    if not is_loaded(readings):
        return diagnose_still(readings, cell, test=test, believed=options.start, offers=offers)
    if cell.measurements.points == "absolute" and holds_single_steps(readings):
        return diagnose_mixed(readings, cell, options, test, offers)
    return diagnose_loaded(readings, cell, options, test, offers)


def holds_single_steps(readings: Readings) -> bool:
    """Say whether any configuration has one step alone."""
    pairs = np.unique(np.column_stack([readings.configuration, readings.step]), axis=0)
    return bool(np.any(np.unique(pairs[:, 0], return_counts=True)[1] == 1))
