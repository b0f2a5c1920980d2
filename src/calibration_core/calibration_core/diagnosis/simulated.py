"""A recording beside a simulation that may have faults of its own: these are the simulation's and are not compared."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison.recordings import compare, put_right, with_loads
from calibration_core.diagnosis.comparison.result import Comparison, Difference, OwnFaults
from calibration_core.diagnosis.data_checks.loaded_anomalies import (
    find_shifts,
    noise_understated,
    outlier_readings,
)
from calibration_core.diagnosis.data_checks.noise import Scatter
from calibration_core.diagnosis.evidence.extended import loaded_state
from calibration_core.errors import EquilibriumError, IdentificationError
from calibration_core.estimation.rows import state_at
from calibration_core.identification.absolute.evaluate import evaluate_absolute, identification_of
from calibration_core.identification.checks.noise_audit import out_of_shape
from calibration_core.identification.geometry.fit import absolute_problem, start_parameters
from calibration_core.identification.result.estimate import MODEL_FREE, Anomaly, Identification, NoiseAudit
from calibration_core.identification.stiffness.loaded import (
    MIN_CONFIGURATIONS,
    Options,
    identify_prepared,
    prepare_loaded,
)
from calibration_core.model.effects.state import State
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.observations.average import coordinate_std, position_covariance
from calibration_core.observations.kinds import is_loaded, loaded_configurations
from calibration_core.policy import OTHERS
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Readings

NOT_COMPARED = {
    "target_moved": " The readings of this target are not compared.",
    "tracker_moved": " The configurations before or after it, whichever are fewer, are not compared.",
}
AS_RIGHT = "It is read as if this were put right"
WILD, NEARLY_ALL = 6.0, 0.95  # times what nearly all readings have: no physics does that to single ones


def compare_checked(recorded: Readings, simulated: Readings, cell: Cell) -> Comparison:
    """Compare a recording with a simulation; what is wrong with the simulation by itself is named and set aside.

    Where units, signs, axes or orders differ, the simulation is not looked at further: nothing is compared then.
    """
    simulated, described = with_loads(recorded, simulated, cell)
    found = compare(recorded, simulated, cell, described=described)
    wrong = [one for one in found.differences if one.spoils]
    if wrong and all(one.side == "simulation" for one in wrong):
        right = put_right(recorded, simulated, cell, wrong)
        if right is not None:
            described += tuple(
                dataclasses.replace(d, text=f"{d.sentence} {AS_RIGHT}: {d.remedy}.", spoils=False) for d in wrong
            )
            again = compare(recorded, right, cell, described=described)
            if not any(one.spoils for one in again.differences):
                simulated, found = right, again
    mixed_up = any(d.spoils and (d.kind != "wrong_robot_file" or "joint" in d.location) for d in found.differences)
    if mixed_up or not found.readings:
        return found
    own = own_faults(simulated, cell)
    return found if own.nothing else compare(recorded, simulated, cell, own, described)


def own_faults(simulated: Readings, cell: Cell) -> OwnFaults:
    """Look for moved targets and trackers, gross errors and understated noise in a simulation.

    They are found as those of a recording are, before any physics.
    """
    look = _loaded if _stiffness_shows(simulated) else _at_rest
    try:
        return look(simulated, cell)
    except (IdentificationError, EquilibriumError) as error:
        text = f"The simulation cannot be searched for faults of its own: {error}."
        return OwnFaults((), np.ones(len(simulated), dtype=bool), None, text)


def _stiffness_shows(simulated: Readings) -> bool:
    if not is_loaded(simulated) or simulated.wrench is None:
        return False
    several = len(loaded_configurations(simulated)) >= MIN_CONFIGURATIONS
    return several and bool(np.any(np.ptp(simulated.wrench, axis=0) > 0))


def _loaded(simulated: Readings, cell: Cell) -> OwnFaults:
    options = Options()
    prepared = prepare_loaded(simulated, cell, options)
    moved: Sequence[Anomaly] = ()
    sound = np.ones(len(simulated), dtype=bool)
    if prepared.frames is not None:  # displacements show no targets or trackers that moved
        compliance = prepared.fit.compliance
        residual = prepared.problem.linearise(compliance).residual
        moved, sound = _shifts(simulated, cell, residual, loaded_state(prepared.problem, cell, compliance))
    if not sound.all():
        prepared = prepare_loaded(simulated.select(sound), cell, options)
    return _own(simulated, cell, moved, sound, prepared.rejection.used, identify_prepared(prepared, cell, options))


def _at_rest(simulated: Readings, cell: Cell) -> OwnFaults:
    nominal, covariance = nominal_parameters(cell), position_covariance(simulated, cell)
    problem = absolute_problem(simulated, cell, chain_of(cell), nominal, covariance)
    start = start_parameters(problem, nominal)
    moved, sound = _shifts(simulated, cell, problem.residual(start).T, state_at(problem, start, simulated, cell))
    kept = simulated.select(sound)
    evaluated = evaluate_absolute(kept, cell)
    return _own(simulated, cell, moved, sound, evaluated.used, identification_of(evaluated, kept, cell))


def _shifts(simulated: Readings, cell: Cell, residual: Float2D, state: State) -> tuple[Sequence[Anomaly], Bool1D]:
    """Return targets and a tracker that moved, and the (m,) readings that stand where most do.

    No reading of a target that moved does: it is not known where it stood as in the recording.
    """
    shifts = find_shifts(simulated, residual, state, coordinate_std(position_covariance(simulated, cell)))
    names = {str(one.location["point"]) for one in shifts.anomalies if one.kind == "target_moved"}
    moved = np.isin(simulated.point, [k for k, name in enumerate(simulated.points) if name in names])
    return shifts.anomalies, ~(shifts.tracker | moved)


def _own(
    simulated: Readings, cell: Cell, moved: Sequence[Anomaly], sound: Bool1D, used: Bool1D, identified: Identification
) -> OwnFaults:
    """Put together what was found.

    Args:
        simulated: All m readings.
        cell: The cell file.
        moved: Targets and trackers that moved, and what else was seen before.
        sound: (m,) readings that stand where most do.
        used: Which of the sound ones are no gross errors.
        identified: From the sound ones.
    """
    kept = simulated.select(sound)
    length = np.linalg.norm(identified.residuals.residual, axis=1)
    aside = np.zeros(len(simulated), dtype=bool)
    aside[np.flatnonzero(sound)[~used & _gross(kept, cell, length)]] = True
    size = float(length[aside[sound]].max(initial=0.0))
    unsettled = (one for one in identified.anomalies if one.kind == "unsettled")
    noise = _noise(identified.noise)
    anomalies = (*moved, *outlier_readings(aside, size, simulated), *noise, *unsettled)
    seen = max((one.magnitude for one in noise), default=None)
    return OwnFaults(tuple(_difference(one) for one in anomalies), sound & ~aside, seen)


def _gross(kept: Readings, cell: Cell, length: Float1D) -> Bool1D:
    """Return the (k,) readings that no physics puts where they are: a simulation may hold more than the core's model.

    Args:
        kept: k readings.
        cell: The cell file.
        length: (k,) m, what the model leaves of them.
    """
    wild = length > WILD * float(np.quantile(length, NEARLY_ALL))
    keys = np.column_stack([kept.configuration, kept.step])
    _, step, points = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    shapeless = points[step.reshape(-1)] <= OTHERS
    if cell.measurements.points == "displacement" or shapeless.all():
        return np.asarray(wild)
    return np.where(shapeless, wild, out_of_shape(kept, coordinate_std(position_covariance(kept, cell))))


def _noise(audit: NoiseAudit) -> tuple[Anomaly, ...]:
    """Say whether what shows noise without a model, the clearest of it, shows more than is claimed."""
    free = [check for check in audit.checks if check.source in MODEL_FREE]
    clearest = max(free, key=lambda check: check.degrees_of_freedom, default=None)
    if clearest is None:
        return ()
    own = clearest.seen / audit.claimed
    return noise_understated(Scatter((own, own, own), 0.0, 0.0, clearest.degrees_of_freedom), audit.claimed)


def _difference(anomaly: Anomaly) -> Difference:
    where = {key: str(value) for key, value in anomaly.location.items()}
    seen = anomaly.text.partition(". ")[0].rstrip(".")  # what follows says what the search for physics makes of it
    text = f"In the simulation, {seen}.{NOT_COMPARED.get(anomaly.kind, '')}"
    return Difference(anomaly.kind, where, "simulation", anomaly.magnitude, anomaly.unit, text, False)
