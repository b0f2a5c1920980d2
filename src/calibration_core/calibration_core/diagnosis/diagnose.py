"""The one entry: a recording goes in, a diagnosis comes out, whatever kind of recording it is."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.absolute import diagnose_absolute
from calibration_core.diagnosis.compare import compare
from calibration_core.diagnosis.comparison import Comparison
from calibration_core.diagnosis.finding import Diagnosis, Rest, Verdict
from calibration_core.diagnosis.known_stiffness import known_compliance
from calibration_core.diagnosis.loaded import diagnose_loaded
from calibration_core.diagnosis.locate import locate
from calibration_core.diagnosis.next_offers import Offer
from calibration_core.errors import EquilibriumError, IdentificationError
from calibration_core.identification.identify import is_loaded, with_given
from calibration_core.identification.known import without_effects
from calibration_core.identification.loaded import Options
from calibration_core.model.given import GivenModel
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Bool1D, Readings

NO_PHYSICS = Rest(
    0.0,
    False,
    {},
    "Recording and simulation differ by what is no physics, and it may be the recording that is mixed up: no physics "
    "is claimed before this is put right.",
)
SLACK = 0.02  # of the largest force: less is none
ENOUGH = 20  # single-step configurations beside loaded ones from which on their absolute positions are searched too


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

    A recording may hold configurations with several steps and others with one: the first are searched as loaded data;
    the second, with the first steps of the others where nothing pulls, as absolute positions, with the compliances that
    the loaded steps tell.  The findings stand together.

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
        return diagnose_absolute(readings, cell, test=test, believed=options.start, offers=offers)
    single = _single(readings)
    if len(np.unique(readings.configuration[single])) < ENOUGH or cell.measurements.points == "displacement":
        return diagnose_loaded(readings, cell, options, test, offers)
    loaded = diagnose_loaded(readings.select(~single), cell, options, test, offers)
    still = dataclasses.replace(readings.select(single | _unloaded_start(readings)), wrench=None)
    if loaded.model is not None:  # what gives way under load gives way under the weight, too
        still = without_effects(still, cell, GivenModel(loaded.model, "the loaded steps", ""))
    known = known_compliance(loaded, cell.robot.rated_load)
    return together(loaded, diagnose_absolute(still, cell, believed=options.start, known=known), tied=known is not None)


def together(loaded: Diagnosis, absolute: Diagnosis, *, tied: bool) -> Diagnosis:
    """Join the diagnosis of loaded steps and that of single steps of one recording; figures are the loaded one's.

    Args:
        loaded: Of the loaded steps.
        absolute: Of the single ones.
        tied: Whether the second knew the first one's compliances: the extended model then is the second one's, which
            tells frames and geometry better, with the effects of both; else it is the first one's.
    """
    known = {(finding.effect, tuple(sorted(finding.location.items()))) for finding in loaded.findings}
    more = tuple(f for f in absolute.findings if (f.effect, tuple(sorted(f.location.items()))) not in known)
    findings = tuple(sorted((*loaded.findings, *more), key=lambda finding: -finding.magnitude))
    seen = {(anomaly.kind, tuple(sorted(anomaly.location.items()))) for anomaly in loaded.anomalies}
    others = tuple(a for a in absolute.anomalies if (a.kind, tuple(sorted(a.location.items()))) not in seen)
    rest = loaded.rest if loaded.rest.significant or not absolute.rest.significant else absolute.rest
    left = rest.significant
    physics = bool(loaded.physics or absolute.physics)
    verdict: Verdict = "partly_explained" if physics and left else "missing_physics" if physics else "consistent"
    if left and not physics:
        verdict = "unexplained"
    return dataclasses.replace(
        loaded,
        verdict=verdict,
        findings=findings,
        anomalies=(*loaded.anomalies, *others),
        rest=rest,
        model=_both(loaded.model, absolute.model) if tied else loaded.model,
        located=(*loaded.located, *absolute.located),
    )


def _both(loaded: ModelParameters | None, absolute: ModelParameters | None) -> ModelParameters | None:
    """Return one model of the two; where both hold an effect at a place, it is the loaded one's."""
    if loaded is None or absolute is None:
        return loaded
    held = {(effect.effect, tuple(sorted(effect.location.items()))) for effect in loaded.effects}
    more = (e for e in absolute.effects if (e.effect, tuple(sorted(e.location.items()))) not in held)
    return absolute.replace(effects=(*loaded.effects, *more))


def _unloaded_start(readings: Readings) -> Bool1D:
    """Return the rows of first steps at which next to nothing pulls, (m,)."""
    if readings.wrench is None:
        return np.zeros(len(readings), dtype=bool)
    force = np.linalg.norm(readings.wrench[:, :3], axis=1)
    return np.asarray((readings.step == 0) & (force < SLACK * force.max()))


def _single(readings: Readings) -> Bool1D:
    """Return the rows of configurations with one step, (m,)."""
    pairs = np.unique(np.column_stack([readings.configuration, readings.step]), axis=0)
    numbers, counts = np.unique(pairs[:, 0], return_counts=True)
    return np.isin(readings.configuration, numbers[counts == 1])
