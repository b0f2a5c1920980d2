"""The one entry: a recording goes in, a diagnosis comes out, whatever kind of recording it is."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison.result import Comparison
from calibration_core.diagnosis.location import locate
from calibration_core.diagnosis.model_estimate import with_bias
from calibration_core.diagnosis.proposals.choose import Offers
from calibration_core.diagnosis.result.finding import HANDED_OUT, Diagnosis, Rest
from calibration_core.errors import EquilibriumError, IdentificationError
from calibration_core.identification.geometry.parameter_table import with_known_effects
from calibration_core.identification.identify import fit_freed, with_given
from calibration_core.identification.result.estimate import Identification
from calibration_core.identification.result.tested import PARTS, PartKind
from calibration_core.identification.statistics import beyond_noise
from calibration_core.identification.stiffness.end_effector import accounted, in_own_set_up, without_effects
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.model.effects.recordings import RECORDING
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.observations.kinds import (
    holds_both,
    holds_single_steps,
    is_loaded,
    loaded_configurations,
    postures_at_rest,
)
from calibration_core.policy import MAD
from calibration_core.timeseries import Bool1D, Float2D, Note, Readings

NO_PHYSICS = Rest(
    0.0,
    False,
    {},
    "Recording and simulation differ by what is no physics, and it may be the recording that is mixed up: no physics "
    "is claimed before this is put right.",
)
NOT_NOISE = 1.25  # times the noise: a residual of this size in the middle of the readings is none
EFFICIENCY = 0.37  # of that estimate: as sure as one from so large a share of the numbers (Rousseeuw and Croux 1993)


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
        return _judged(_with_location(readings, cell, options, test, offers, given, identified), readings)
    # slow to load, and seldom needed
    from calibration_core.diagnosis.simulated import compare_checked
    from calibration_core.diagnosis.waterfall import beside_wrong_angles, with_sound_angles, with_waterfall

    compared = [compare_checked(readings, simulation, cell)]
    with mixed_up(compared):
        found = _with_location(readings, cell, options, test, offers, given, identified)
    found = with_waterfall(beside(_judged(found, readings), compared), readings, cell, test)
    sound = with_sound_angles(found, readings)
    if sound is readings:
        return found
    return beside_wrong_angles(diagnose(sound, cell, options, test, simulation, offers, given), found)


def _judged(found: Diagnosis, readings: Readings) -> Diagnosis:
    """Call no model consistent whose residual is not noise, and give Table 2 the bias of what is left out."""
    found = _best_predicting(_tested(_not_noise(found), readings))
    if found.compliance_covariance is not None:
        variance = np.clip(np.diag(found.compliance_covariance), 0.0, None)
        joints = found.identification.model.joints
        known = {f"compliance.{joint}": float(v) ** 0.5 for joint, v in zip(joints, variance, strict=True)}
        known = {name: std for name, std in known.items() if 0 < std < np.inf}
        found = dataclasses.replace(found, estimate=found.estimate.with_std(known))
    return dataclasses.replace(found, identification=with_bias(found.identification, found))


def _best_predicting(found: Diagnosis) -> Diagnosis:
    """Hand out the standard's model where nothing was found, unless the extended one predicts blocks left out better.

    Under load the two differ by what is fitted together; at rest the extended one has every stiffness that is stated.
    """
    if found.physics:
        return found
    better = found.held_out_after < found.identification.fit.held_out_rms_after
    if found.identification.kind == "absolute" and (better or found.verdict == "consistent"):
        return found
    if found.verdict == "consistent":
        return dataclasses.replace(found, model=None)
    return _with_standard(found, "nothing was found that predicts configurations left out better")


def _with_standard(found: Diagnosis, why: str) -> Diagnosis:
    """Return the answer with the standard's model as the one that is written for use."""
    note = Note(HANDED_OUT, "model.yaml", f"it holds the standard's model, not the extended one: {why}")
    noted = dataclasses.replace(found.identification, notes=(*found.identification.notes, note))
    return dataclasses.replace(found, identification=noted, model=None)


def _tested(found: Diagnosis, readings: Readings) -> Diagnosis:
    """Let a recording that was not fitted have the last word on verdict and extended model.

    Where any part of it is predicted worse than by the standard's model, that is the one that is handed out; where more
    than noise is left of what the fitted recording speaks of, the extended model does not explain the robot.
    """
    standard = found.identification.test
    if found.test is None or standard is None:
        return found
    loaded, single = is_loaded(readings), holds_single_steps(readings)
    spoken: Mapping[PartKind, bool] = {"loaded": loaded, "at_rest": single or not loaded}
    kinds = [kind for kind, there in spoken.items() if there]
    noise = min(found.noise_known, found.held_out_after)  # an instrument that is better than its claim
    worse, left = found.test.worse(standard, noise), found.test.beyond(noise, kinds)
    if worse is None and left is None:
        return found
    excess, texts = 0.0, []
    if worse is not None:
        one, other = worse
        figures = f"{1e6 * one.rms:.1f} against {1e6 * other.rms:.1f} µm per coordinate"
        why = f"the extended model predicts the second recording ({PARTS[one.kind]}) worse, {figures}"
        found, excess = _with_standard(found, why), float(np.sqrt(one.rms**2 - other.rms**2))
        texts.append(f"T{why[1:]}.")
    if left is not None:
        texts.append(
            f"Of the second recording, which was not fitted, the model leaves {1e6 * left.rms:.1f} µm per coordinate "
            f"({PARTS[left.kind]}), the noise is {1e6 * noise:.1f} µm."
        )
        excess = float(np.sqrt(left.rms**2 - noise**2))
    rest = found.rest.also(" ".join(texts), found.rest.where, excess)
    return dataclasses.replace(found, verdict=rest.verdict(found=bool(found.findings)), rest=rest)


def _not_noise(found: Diagnosis) -> Diagnosis:
    """Call a residual that is more than noise unexplained; compliances are then as much more uncertain."""
    residual, freedom = _beside_offsets(found)
    residual = residual[_of_firm_targets(found)]
    seen = MAD * float(np.median(np.abs(residual))) if len(residual) else 0.0
    noise = max(found.noise, found.noise_known)
    chance = not beyond_noise(seen, EFFICIENCY * freedom, noise)[1]
    if found.verdict != "consistent" or seen <= NOT_NOISE * noise or chance:
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


def _beside_offsets(found: Diagnosis) -> tuple[Float2D, int]:
    """Return residuals as large as the noise in them, (m, 3) m, and their number less that of the offsets taken out.

    Differences under load have an offset of their own for every configuration and point; positions have none.
    """
    readings, residual = found.identification.readings, found.residual
    if found.blocks or len(residual) != len(readings):
        return residual, residual.size
    keys = np.column_stack([readings.configuration, readings.point])
    _, group, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    left = 1 - 1 / np.maximum(count, 2)[group.reshape(-1)]
    return residual / np.sqrt(left)[:, None], 3 * (len(residual) - len(count))


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
    few = postures_at_rest(readings) < len(loaded_configurations(readings))
    if is_loaded(readings) and (few or cell.measurements.points != "absolute"):
        from calibration_core.diagnosis.loaded import diagnose_loaded

        if identified is None and holds_both(readings, cell):
            identified = fit_freed(readings, cell, options, test)
        return diagnose_loaded(readings, cell, options, test, offers, identified)
    from calibration_core.diagnosis.positions import diagnose_mixed, diagnose_still

    if not is_loaded(readings):
        return diagnose_still(readings, cell, options, test, offers, identified)
    return diagnose_mixed(readings, cell, options, test, offers, identified)
