"""The model's prediction of a plan as a recording: sampled streams with step markers, to be written as a bag.

Between configurations the joints move along a straight line, between steps the load changes along a ramp.  In every
measuring window the samples scatter about the reading, and their mean is the reading: looking at the recording gives
the same numbers as `simulate_plan` with the same seed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import CellError
from calibration_core.model.kinematics import posture
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.model.simulation.simulate import (
    LOADING,
    MEASURING,
    MOVING,
    SETTLING,
    TEMPERATURE,
    Loading,
    Noise,
    Predicted,
    Schedule,
    draw_noise,
    predict_schedule,
    tracker_covariance,
    wrench_sigma,
)
from calibration_core.timeseries import (
    NANOSECONDS,
    Float1D,
    Float2D,
    Int1D,
    Phase,
    Provenance,
    StepMarkers,
    Streams,
    TimeSeries,
)

START = 1_767_600_000 * NANOSECONDS  # 2026-01-05 08:00:00 UTC, an arbitrary morning
JOINTS, TRACKER, WRENCH, THERMOMETER = 25.0, 10.0, 50.0, 2.0  # Hz


@dataclasses.dataclass(frozen=True, eq=False)
class _Segments:
    """Stretches of time in one phase; each goes from the state of one step to that of another.

    Attributes:
        start: (g,) s; `end` likewise.
        phase: (g,) values of Phase.
        before: (g,) step (row of the schedule) whose state holds at the start; `after` at the end.
    """

    start: Float1D
    end: Float1D
    phase: Int1D
    before: Int1D
    after: Int1D

    def at(self, time: Float1D) -> tuple[Int1D, Float1D]:
        """Return the segment of every instant, and how far it has gone, 0 ... 1."""
        which = np.clip(np.searchsorted(self.start, time, side="right") - 1, 0, len(self.start) - 1)
        return which, (time - self.start[which]) / (self.end - self.start)[which]


def as_recording(
    configurations: Sequence[Loading], cell: Cell, parameters: ModelParameters, seed: int | None = None
) -> Streams:
    """Predict a plan as streams of all sensors.

    Args:
        configurations: To be measured, in order.
        cell: How readings are recorded, and how noisy they are.
        parameters: The model that answers.
        seed: Of the instrument noise; None: none.

    Raises:
        CellError: The robot cannot be read, a frame that the load needs is missing, or the cell's points are
            displacements, which streams are not.
        EquilibriumError: A load is beyond what the springs can carry.
    """
    if cell.measurements.points != "absolute":
        raise CellError(cell.path, "measurements.points", repr(cell.measurements.points), "absolute, for a bag")
    schedule = Schedule.of(configurations)
    predicted = predict_schedule(schedule, cell, parameters)
    noise = draw_noise(predicted, cell, seed)
    segments = _segments(schedule)
    scatter = None if seed is None else np.random.default_rng([seed, 1])

    joints = _stream(segments, JOINTS, schedule.q)
    points = _points(segments, schedule, predicted, noise, cell, parameters, scatter)
    wrench = temperature = None
    if predicted.wrench is not None:
        wrench = _stream(segments, WRENCH, predicted.wrench, noise.wrench, scatter, wrench_sigma(cell), "force_torque")
    thermometer = cell.instruments.temperature
    if thermometer is not None:
        mean, sigma = np.full((len(schedule.step), 1), TEMPERATURE), np.array([thermometer.sigma])
        temperature = _stream(segments, THERMOMETER, mean, noise.temperature[:, None], scatter, sigma)
    markers = StepMarkers(
        time=_stamps(np.append(segments.start, segments.end[-1])),
        configuration=schedule.configuration[np.append(segments.after, segments.after[-1])],
        step=schedule.step[np.append(segments.after, segments.after[-1])],
        phase=np.append(segments.phase, int(Phase.DONE)),
    )
    streams = {cell.topics.joint_states: joints, cell.topics.wrench: wrench, cell.topics.temperature: temperature}
    streams |= {cell.topics.point(name): series for name, series in points.items()}
    messages = {topic: len(series) for topic, series in streams.items() if series is not None}
    path = cell.urdf_path
    return Streams(
        joints=joints,
        points=points,
        wrench=wrench,
        temperature=temperature,
        steps=markers,
        robot_description="" if path is None else path.read_text(encoding="utf-8"),
        provenance=Provenance("simulation", "mcap", {}, {**messages, cell.topics.step: len(markers.time)}),
    )


def _segments(schedule: Schedule) -> _Segments:
    rows: list[tuple[float, float, int, int, int]] = []
    clock = 0.0

    def add(seconds: float, phase: Phase, before: int, after: int) -> None:
        nonlocal clock
        rows.append((clock, clock + seconds, int(phase), before, after))
        clock += seconds

    size = np.linalg.norm(schedule.wrench, axis=1)
    for i in range(len(schedule.step)):
        if i == 0 or schedule.step[i] == 0:
            add(MOVING, Phase.MOVING, max(i - 1, 0), i)
        else:
            add(LOADING, Phase.LOADING if size[i] >= size[i - 1] else Phase.UNLOADING, i - 1, i)
        add(SETTLING, Phase.SETTLING, i, i)
        add(MEASURING, Phase.MEASURING, i, i)
    start, end, phase, before, after = (np.array(column) for column in zip(*rows, strict=True))
    return _Segments(start, end, phase.astype(np.int64), before.astype(np.int64), after.astype(np.int64))


def _times(segments: _Segments, rate: float) -> Float1D:
    """Return sampling times, s, half a period off the round figures, so that none falls on a border of segments."""
    return np.asarray(np.arange(0.5 / rate, float(segments.end[-1]), 1.0 / rate))


def _between(segments: _Segments, time: Float1D, values: Float2D) -> Float2D:
    which, share = segments.at(time)
    before, after = values[segments.before[which]], values[segments.after[which]]
    return np.where(
        (segments.before == segments.after)[which][:, None], before, before + share[:, None] * (after - before)
    )


def _stream(
    segments: _Segments,
    rate: float,
    values: Float2D,
    error: Float2D | None = None,
    rng: np.random.Generator | None = None,
    sigma: Float1D | None = None,
    frame: str = "",
) -> TimeSeries:
    time = _times(segments, rate)
    sampled = _between(segments, time, values)
    if error is not None and rng is not None and sigma is not None:
        sampled = sampled + _errors(segments, time, error) + _scatter(segments, time, rng, len(sigma)) * sigma
    return TimeSeries(_stamps(time), sampled, _stamps(time), frame)


def _points(
    segments: _Segments,
    schedule: Schedule,
    predicted: Predicted,
    noise: Noise,
    cell: Cell,
    parameters: ModelParameters,
    rng: np.random.Generator | None,
) -> dict[str, TimeSeries]:
    """Follow the points along motions and ramps; in the windows they stand where the prediction has them."""
    chain = chain_of(cell).corrected(parameters.geometry)
    time = _times(segments, TRACKER)
    which, _ = segments.at(time)
    still = segments.before[which] == segments.after[which]
    at = posture(chain, _between(segments, time, schedule.q + predicted.deflection))
    rotation, origin = parameters.tracker[:3, :3], parameters.tracker[:3, 3]
    streams = {}
    for i, (name, point) in enumerate(parameters.points.items()):
        moving = (at.point(point).T + _between(segments, time, predicted.shift[:, i]) - origin) @ rotation
        position = np.where(still[:, None], predicted.position[segments.after[which], i], moving)
        if rng is not None:
            root = np.asarray(np.linalg.cholesky(tracker_covariance(cell, position)), dtype=np.float64)
            scatter: Float2D = np.einsum("mij,mj->mi", root, _scatter(segments, time, rng, 3))
            position = position + _errors(segments, time, noise.position[:, i]) + scatter
        streams[name] = TimeSeries(_stamps(time), position, _stamps(time), "tracker")
    return streams


def _errors(segments: _Segments, time: Float1D, error: Float2D) -> Float2D:
    """Return the error of the step's reading in its measuring window, and none elsewhere."""
    which, _ = segments.at(time)
    measuring = segments.phase[which] == Phase.MEASURING
    return np.where(measuring[:, None], error[segments.after[which]], 0.0)


def _scatter(segments: _Segments, time: Float1D, rng: np.random.Generator, columns: int) -> Float2D:
    """Return white noise (m, columns) with mean zero over each measuring window; a free mean would err by one."""
    which, _ = segments.at(time)
    white = rng.standard_normal((len(time), columns))
    count = np.bincount(which, minlength=len(segments.start)).astype(float)
    for column in white.T:
        mean = np.bincount(which, weights=column, minlength=len(count)) / np.maximum(count, 1.0)
        column -= np.where(segments.phase == Phase.MEASURING, mean, 0.0)[which]
    return white * np.sqrt(np.maximum(count, 1.0))[which][:, None]


def _stamps(time: Float1D) -> Int1D:
    return np.asarray(START + np.round(time * NANOSECONDS).astype(np.int64))
