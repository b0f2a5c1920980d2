"""Frames and points that the absolute positions put elsewhere than the cell file, or a given model, does.

They are refitted before anything else, so they spoil no other finding; but the simulation has them wrong.  A cell that
is set up with care is right to a few tenths of a millimetre and of a milliradian; what is beyond is said.
"""

from __future__ import annotations

import numpy as np

from calibration_core.diagnosis.findings.building import found_parameters
from calibration_core.diagnosis.result.finding import Finding
from calibration_core.identification.geometry.frames import FrameFit
from calibration_core.identification.statistics.sizes import rms_length
from calibration_core.identification.stiffness.loaded import PreparedLoaded
from calibration_core.model.chain import rotation_vector
from calibration_core.model.effects import effect_named
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.priors import typical
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float1D, Float2D, Readings

BEYOND = 4.5  # times how well cells are set up, their uncertainty included


def registration_findings(
    prepared: PreparedLoaded, state: State, readings: Readings, beside: FrameFit | None = None
) -> tuple[Finding, ...]:
    """Return tracker and points that stand elsewhere than stated, beyond usual care and uncertainty.

    What was found in the robot moves points under its own weight, too: what only seems elsewhere because of it is none.

    Args:
        prepared: With the refitted frames, and where cell file or given model put them.
        state: The null model, for the size of the effect on the measured deflections.
        readings: The recording.
        beside: The frames as they fit best beside what was found; None: nothing was.
    """
    if prepared.frames is None or prepared.stated_by is None:
        return ()
    found = _elsewhere(prepared.frames, prepared, state, readings)
    if beside is None or not found:
        return found
    places = {one.effect: one.location for one in found}
    still = _elsewhere(beside, prepared, state, readings)
    return tuple(one for one in still if places.get(one.effect) == one.location)


def _elsewhere(frames: FrameFit, prepared: PreparedLoaded, state: State, readings: Readings) -> tuple[Finding, ...]:
    """Return tracker and points that these frames put elsewhere than stated, beyond usual care and uncertainty."""
    steps = len(readings) / max(len(np.unique(readings.configuration)), 1) / len(readings.points)
    covariance = frames.covariance * max(steps, 1.0)  # steps of one configuration share its geometric error
    nominal, by = prepared.nominal.tracker, str(prepared.stated_by)
    found = []
    turn = rotation_vector(frames.tracker[:3, :3] @ nominal[:3, :3].T)
    usual = typical("registration_rotation", state.rated_load)
    if _beyond(turn, usual, covariance[3:6, 3:6]):
        found.append(
            _finding("tracker_frame_misalignment", turn, usual, covariance[3:6, 3:6], state, readings, None, by)
        )
    point, shift = _odd_point(frames, prepared, readings)
    usual = typical("registration_point", state.rated_load)
    rows = slice(6 + 3 * point, 9 + 3 * point)
    if _beyond(shift, usual, covariance[rows, rows]):
        others = usual**2 / max(len(frames.points) - 1, 1) * np.eye(3)  # it is seen against them
        against_others = covariance[rows, rows] + others
        found.append(_finding("measurement_point_offset", shift, usual, against_others, state, readings, point, by))
    return tuple(found)


def _odd_point(frames: FrameFit, prepared: PreparedLoaded, readings: Readings) -> tuple[int, Float1D]:
    """Return the point that is farthest from where it is stated, against the others, and its shift (3,) m."""
    stated = np.array([prepared.nominal.points[name] for name in readings.points])
    shift = frames.points - stated
    if len(shift) > 1:  # a shift of all is the flange's or the geometry's
        shift = shift - (shift.sum(axis=0) - shift) / (len(shift) - 1)
    point = int(np.argmax(np.linalg.norm(shift, axis=1)))
    return point, shift[point]


def _beyond(value: Float1D, usual: float, covariance: Float2D) -> bool:
    """Return whether (3,) values lie beyond usual care and their uncertainty, as a distance of Mahalanobis."""
    return bool(value @ np.linalg.solve(covariance + usual**2 * np.eye(3), value) > BEYOND**2)


def _finding(
    effect: str,
    value: Float1D,
    usual: float,
    covariance: Float2D,
    state: State,
    readings: Readings,
    point: int | None,
    stated_by: str,
) -> Finding:
    kind = effect_named(effect)
    candidate = _candidate(list(kind.candidates(state)), point)
    shift = state.since_step_zero(candidate.columns(state) @ value)
    size = rms_length(shift)
    score = 0.5 * float(np.sum(value**2)) / float(usual**2 + np.trace(covariance) / 3)
    name = "tracker" if point is None else readings.points[point]
    length = float(np.linalg.norm(value))
    amount = f"{1e3 * length:.2f} {'mrad' if point is None else 'mm'}"
    what = "The tracker frame is turned" if point is None else f"The measurement point {name} is off"
    return Finding(
        effect=effect,
        family="point chain",
        location={"tracker": "tracker"} if point is None else {"point": name},
        variant=candidate.variant,
        parameters=found_parameters(candidate, value, covariance),
        log_bayes_factor=score,
        held_out_gain=0.0,
        magnitude=size,
        explanation=(
            f"{what} by {amount} against {stated_by}, as the absolute positions say. It was refitted before anything "
            f"else; with the stated value the deflections would be wrong by {1e6 * size:.0f} µm rms, the positions by "
            "more."
        ),
        separate_by=kind.reveal,
    )


def _candidate(several: list[Candidate], point: int | None) -> Candidate:
    if point is None:
        return several[0]
    return next(candidate for candidate in several if candidate.location["point"] == f"#{point}")
