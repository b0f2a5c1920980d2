"""Frames and points that the absolute positions put elsewhere than the cell file, or a given model, does.

They are refitted before anything else, so they spoil no other finding; but the simulation has them wrong.  A cell that
is set up with care is right to a few tenths of a millimetre and of a milliradian; what is beyond is said.  A tracker
that stands elsewhere turns the measured deflections, and is a finding where they show it; what they do not show, and
where targets are, is a note for the cell file.
"""

from __future__ import annotations

import numpy as np

from calibration_core.diagnosis.findings.building import found_parameters
from calibration_core.diagnosis.result.finding import FRAMES, Finding
from calibration_core.identification.geometry.frames import FrameFit
from calibration_core.identification.result.observability import TWO_SIDED
from calibration_core.identification.statistics.sizes import rms_length
from calibration_core.identification.stiffness.loaded import PreparedLoaded
from calibration_core.model.chain import rotation_vector, xyz_rpy
from calibration_core.model.effects import effect_named
from calibration_core.model.effects.candidate import typical
from calibration_core.model.effects.state import State
from calibration_core.observations.covariance import coordinate_std
from calibration_core.timeseries import Float1D, Float2D, Note, Readings

TRACKER, TARGETS = "frames.tracker", "frames.measurement_points"  # places of notes
BEYOND = 4.5  # times how well cells are set up, their uncertainty included

Registered = tuple[tuple[Finding, ...], tuple[Note, ...]]


def registration(
    prepared: PreparedLoaded,
    state: State,
    readings: Readings,
    beside: FrameFit | None = None,
    sigma_points: float | None = None,
) -> Registered:
    """Return a tracker that stands elsewhere than stated as a finding, or as a note, and targets as a note.

    What was found in the robot moves points under its own weight, too: what only seems elsewhere because of it is none.

    Args:
        prepared: With the refitted frames, and where cell file or given model put them.
        state: The null model, for the size of the effect on the measured deflections.
        readings: The recording.
        beside: The frames as they fit best beside what was found; None: nothing was.
        sigma_points: What the cell file states of its targets, m; None: nothing.
    """
    frames = prepared.frames
    if frames is None or prepared.stated_by is None or frames.freedom < 1:
        return (), ()
    findings: list[Finding] = []
    notes: list[Note] = []
    every = [frames] if beside is None else [frames, beside]
    if all(_turned(one, prepared, state) for one in every):
        found = _tracker(every[-1], prepared, state)
        seen = found.magnitude > np.sqrt(3.0) * coordinate_std(prepared.problem.noise)
        note = Note(FRAMES, TRACKER, f"{found.explanation} For the cell file: {_pose(every[-1].tracker)}")
        findings, notes = ([found], []) if seen else ([], [note])
    odd = [_odd_point(one, prepared, readings) for one in every]
    usual = sigma_points or typical("registration_point", state.rated_load)
    if len({point for point, _, _ in odd}) == 1 and all(_beyond(*one[1:], usual) for one in odd):
        notes.append(_points(every[-1], *odd[-1], prepared, readings))
    return tuple(findings), tuple(notes)


def _turn(frames: FrameFit, prepared: PreparedLoaded) -> tuple[Float1D, Float2D]:
    turn = rotation_vector(frames.tracker[:3, :3] @ prepared.nominal.tracker[:3, :3].T)
    return turn, frames.covariance[3:6, 3:6]


def _turned(frames: FrameFit, prepared: PreparedLoaded, state: State) -> bool:
    return _beyond(*_turn(frames, prepared), typical("registration_rotation", state.rated_load))


def _odd_point(frames: FrameFit, prepared: PreparedLoaded, readings: Readings) -> tuple[int, Float1D, Float2D]:
    """Return the point that is farthest from where it is stated, against the others, its shift (3,) m and covariance.

    A shift of all is the flange's or the geometry's.
    """
    stated = np.array([prepared.nominal.points[name] for name in readings.points])
    shift = frames.points - stated
    if len(shift) > 1:
        shift = shift - (shift.sum(axis=0) - shift) / (len(shift) - 1)
    point = int(np.argmax(np.linalg.norm(shift, axis=1)))
    rows = slice(6 + 3 * point, 9 + 3 * point)
    return point, shift[point], frames.covariance[rows, rows]


def _beyond(value: Float1D, covariance: Float2D, usual: float) -> bool:
    """Return whether (3,) values lie beyond usual care and their uncertainty, as a distance of Mahalanobis."""
    return bool(value @ np.linalg.solve(covariance + usual**2 * np.eye(3), value) > BEYOND**2)


def _points(
    frames: FrameFit, point: int, shift: Float1D, covariance: Float2D, prepared: PreparedLoaded, readings: Readings
) -> Note:
    away, half = 1e3 * float(np.linalg.norm(shift)), 1e3 * TWO_SIDED * float(np.sqrt(np.trace(covariance) / 3))
    fitted = zip(readings.points, frames.points, strict=True)
    lines = ", ".join(f"{name}: [{', '.join(f'{x:.5f}' for x in at)}]" for name, at in fitted)
    text = (
        f"{readings.points[point]} is {away:.2f} mm (± {half:.2f} mm) from where {prepared.stated_by} puts it, against "
        f"the others. All were refitted, and nothing else rests on it. For the cell file, in the flange frame: {lines}"
    )
    return Note(FRAMES, TARGETS, text)


def _tracker(frames: FrameFit, prepared: PreparedLoaded, state: State) -> Finding:
    (turn, covariance), usual = _turn(frames, prepared), typical("registration_rotation", state.rated_load)
    kind = effect_named("tracker_frame_misalignment")
    candidate = next(iter(kind.candidates(state)))
    size = rms_length(state.since_step_zero(candidate.columns(state) @ turn))
    return Finding(
        effect=kind.name,
        family="point chain",
        location={"tracker": "tracker"},
        variant=candidate.variant,
        parameters=found_parameters(candidate, turn, covariance),
        log_bayes_factor=0.5 * float(turn @ np.linalg.solve(covariance + usual**2 * np.eye(3), turn)),
        held_out_gain=0.0,
        magnitude=size,
        explanation=(
            f"The tracker frame is turned by {1e3 * float(np.linalg.norm(turn)):.2f} mrad against "
            f"{prepared.stated_by}, as the absolute positions say. It was refitted before anything else; with the "
            f"stated value the deflections would be wrong by {1e6 * size:.0f} µm rms, the positions by more."
        ),
        separate_by=kind.reveal,
    )


def _pose(tracker: Float2D) -> str:
    numbers = [f"{x:.5f}" for x in xyz_rpy(tracker)]
    return f"tracker: {{xyz: [{', '.join(numbers[:3])}], rpy: [{', '.join(numbers[3:])}]}}"
