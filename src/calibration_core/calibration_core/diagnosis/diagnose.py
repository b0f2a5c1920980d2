"""The one entry: a recording goes in, a diagnosis comes out, whatever kind of recording it is."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.bias import with_bias
from calibration_core.diagnosis.comparison.result import Comparison
from calibration_core.diagnosis.location import locate
from calibration_core.diagnosis.proposals.candidates import Offers
from calibration_core.diagnosis.result.finding import Diagnosis, Rest
from calibration_core.errors import EquilibriumError, IdentificationError
from calibration_core.identification.geometry.named_estimate import with_known_effects
from calibration_core.identification.identify import with_given
from calibration_core.identification.result.estimate import Identification
from calibration_core.identification.stiffness.end_effector import accounted
from calibration_core.identification.stiffness.known_effects import in_own_set_up, without_effects
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.model.effects.recordings import RECORDING
from calibration_core.model.identified.given import GivenModel
from calibration_core.observations.kinds import holds_single_steps, is_loaded
from calibration_core.timeseries import Bool1D, Readings

NO_PHYSICS = Rest(
    0.0,
    False,
    {},
    "Recording and simulation differ by what is no physics, and it may be the recording that is mixed up: no physics "
    "is claimed before this is put right.",
)
NOT_NOISE = 1.25  # times the noise: a residual of this size in the middle of the readings is none
MEDIAN = 1.4826  # standard deviation over median size, normal distribution


def diagnose(
    readings: Readings,
    cell: Cell,
    options: Options | None = None,
    test: Readings | None = None,
    simulation: Readings | None = None,
    offers: Offers | None = None,
    given: GivenModel | None = None,
    identified: Identification | None = None,
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
        identified: What `identify` says of the same recording and test, without a given model; None: it is found where
            it is needed.

    Raises:
        InputError: The input cannot be used; the message names file, place, what was found and what was expected.
    """
    options = options or Options()
    given = accounted(cell, given) if is_loaded(readings) else given
    given = None if given is None else in_own_set_up(given, readings, cell)
    if simulation is None:
        return _judged(_with_location(readings, cell, options, test, offers, given, identified))
    from calibration_core.diagnosis.simulated import compare_checked  # slow to load, and seldom needed

    compared = [compare_checked(readings, simulation, cell)]
    with mixed_up(compared):
        found = _with_location(readings, cell, options, test, offers, given, identified)
    return beside(_judged(found), compared)


def _judged(found: Diagnosis) -> Diagnosis:
    """Call no model consistent whose residual is not noise, and give Table 2 the bias of what is left out."""
    found = _not_noise(found)
    return dataclasses.replace(found, identification=with_bias(found.identification, found))


def _not_noise(found: Diagnosis) -> Diagnosis:
    """Call a residual that is more than noise unexplained; compliances are then as much more uncertain."""
    residual = found.residual[_of_firm_targets(found)]
    seen = MEDIAN * float(np.median(np.abs(residual))) if len(residual) else 0.0
    known = max((a.magnitude for a in found.anomalies if a.kind == "noise_understated"), default=found.noise)
    noise = max(found.noise, known)
    if found.verdict != "consistent" or seen <= NOT_NOISE * noise:
        return found
    excess = float(np.sqrt(seen**2 - noise**2))
    text = (
        f"The residual is {1e6 * seen:.1f} µm per coordinate (from the median), the noise {1e6 * noise:.1f} µm, and "
        "nothing in the catalogue explains the difference."
    )
    covariance = found.compliance_covariance
    return dataclasses.replace(
        found,
        verdict="unexplained",
        rest=Rest(excess, True, {}, text),
        compliance_covariance=None if covariance is None else covariance * (seen / noise) ** 2,
    )


def _of_firm_targets(found: Diagnosis) -> Bool1D:
    """Return the (m,) residuals of targets that do not sit loose: the others show no misfit of the model."""
    readings = found.identification.readings
    if len(found.residual) != len(readings):
        return np.ones(len(found.residual), dtype=bool)
    loose = [anomaly.location["point"] for anomaly in found.anomalies if anomaly.kind == "loose_target"]
    return np.array([readings.points[point] not in loose for point in readings.point], dtype=bool)


def _with_location(
    readings: Readings,
    cell: Cell,
    options: Options,
    test: Readings | None,
    offers: Offers | None,
    given: GivenModel | None,
    identified: Identification | None,
) -> Diagnosis:
    """Diagnose the recording less what is known, and say where the rest lies."""
    if given is None:
        return with_location(_diagnose(readings, cell, options, test, offers, identified), cell)
    freed = without_effects(readings, cell, given)
    test = None if test is None else without_effects(test, cell, given)
    started = dataclasses.replace(options, start=given.start)
    return with_given_effects(with_location(_diagnose(freed, cell, started, test, offers), cell), given)


def with_given_effects(found: Diagnosis, given: GivenModel) -> Diagnosis:
    """Return the answer with the effects of the given model in the identified and in the extended one."""
    model = found.model
    if model is not None:
        model = model.replace(effects=(*given.parameters.effects, *model.effects))
    estimate = with_known_effects(found.estimate, given.estimate, len(given.parameters.effects))
    return dataclasses.replace(
        found, identification=with_given(found.identification, given), model=model, estimate=estimate
    )


def with_location(found: Diagnosis, cell: Cell) -> Diagnosis:
    """Add where recording and null model differ, without a hypothesis."""
    null = found.identification
    if null.readings.recording is not None:  # the place is looked for in the frame of one set-up
        return found
    if found.residual_before is None or len(found.residual_before) != len(null.readings):
        return found
    where = locate(null.readings, found.residual_before, cell, null.model)
    if where is None:
        return found
    return dataclasses.replace(found, where=where, located=(*where.sentences, *found.located))


@contextlib.contextmanager
def mixed_up(compared: Sequence[Comparison]) -> Iterator[None]:
    """Say of loads beyond what the joints can carry that their recording is mixed up, where a simulation shows it.

    Args:
        compared: Recordings beside their simulations.

    Raises:
        IdentificationError: There were such loads.
    """
    try:
        yield
    except EquilibriumError as error:
        named = next(((one, d) for one in compared for d in one.differences if d.of_recording), None)
        if named is None:
            raise
        one, difference = named
        found, expected = f"{difference.sentence} There is {error}", "a recording as the cell file says"
        raise IdentificationError(one.recording, difference.kind, found, expected) from None


def beside(found: Diagnosis, compared: Sequence[Comparison]) -> Diagnosis:
    """Add comparisons with simulations; a recording that is mixed up lets no physics be claimed.

    Anomalies are those of the recording.  What is wrong with a simulation, or differs and is no fault, stands in the
    comparison alone.
    """
    together = found.identification.together is not None
    named = [
        dataclasses.replace(anomaly, location={**anomaly.location, RECORDING: one.recording}) if together else anomaly
        for one in compared
        for anomaly in (difference.as_anomaly() for difference in one.differences if difference.of_recording)
    ]
    found = dataclasses.replace(found, comparisons=tuple(compared), anomalies=(*named, *found.anomalies))
    if not found.recording_spoiled:
        return found
    return dataclasses.replace(found, verdict="unexplained", findings=(), rest=NO_PHYSICS, model=None)


def _diagnose(
    readings: Readings,
    cell: Cell,
    options: Options,
    test: Readings | None,
    offers: Offers | None,
    identified: Identification | None = None,
) -> Diagnosis:
    # a recording needs one of the two, and each is slow to load
    if is_loaded(readings) and not (cell.measurements.points == "absolute" and holds_single_steps(readings)):
        from calibration_core.diagnosis.loaded import diagnose_loaded

        return diagnose_loaded(readings, cell, options, test, offers)
    from calibration_core.diagnosis.positions import diagnose_mixed, diagnose_still

    if not is_loaded(readings):
        return diagnose_still(readings, cell, test=test, believed=options.start, offers=offers)
    return diagnose_mixed(readings, cell, options, test, offers, identified)
