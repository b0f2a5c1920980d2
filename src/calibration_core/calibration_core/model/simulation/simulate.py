"""Readings as the cell's model predicts them, with or without instrument noise.

This is the model answering for itself: what `calibration simulate` writes.  It is no test of the model.

The model's prediction of a plan as a recording: sampled streams with step markers, to be written as a bag.

Between configurations the joints move along a straight line, between steps the load changes along a ramp.  In every
measuring window the samples scatter about the reading, and their mean is the reading: looking at the recording gives
the same numbers as `simulate_plan` with the same seed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import CellError, ModelFileError
from calibration_core.model.chain import Chain
from calibration_core.model.effects.applied import applied_shift
from calibration_core.model.effects.state import state_of
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.kinematics import posture
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import Load, recorded_load
from calibration_core.observations.average import spherical_covariance
from calibration_core.timeseries import (
    NANOSECONDS,
    Float1D,
    Float2D,
    Float3D,
    Int1D,
    Phase,
    Provenance,
    Readings,
    StepMarkers,
    Streams,
    TimeSeries,
    read_only,
)

TEMPERATURE = 20.0  # degrees Celsius, as the standard wants it
MOVING, LOADING, SETTLING, MEASURING = 4.0, 2.0, 1.5, 2.0  # s, phases of a configuration and of a step


class Loading(Protocol):
    """One configuration with the wrenches of its steps."""

    @property
    def number(self) -> int:
        """As it is counted in recordings."""

    @property
    def q(self) -> Float1D:
        """(n,) rad."""

    @property
    def steps(self) -> Float2D:
        """(k, 6) N and N*m, base axes, at the wrench point."""


@dataclasses.dataclass(frozen=True, eq=False)
class Schedule:
    """All steps of all configurations, in the order in which they are measured.

    Attributes:
        configuration: (s,) its number.
        step: (s,) counted from 0 within the configuration.
        q: (s, n) rad, encoder angles.
        wrench: (s, 6) N and N*m, base axes, at the wrench point.
    """

    configuration: Int1D
    step: Int1D
    q: Float2D
    wrench: Float2D

    def __post_init__(self) -> None:
        """Copy to read-only arrays; raise ValueError on unequal lengths."""
        lengths = {len(getattr(self, field.name)) for field in dataclasses.fields(self)}
        if len(lengths) != 1:
            msg = f"unequal lengths {sorted(lengths)}"
            raise ValueError(msg)
        object.__setattr__(self, "configuration", read_only(self.configuration, np.int64))
        object.__setattr__(self, "step", read_only(self.step, np.int64))
        object.__setattr__(self, "q", read_only(self.q))
        object.__setattr__(self, "wrench", read_only(self.wrench))

    @staticmethod
    def of(configurations: Sequence[Loading]) -> Schedule:
        """Return the schedule of planned configurations."""
        counts = [len(c.steps) for c in configurations]
        return Schedule(
            configuration=np.repeat([c.number for c in configurations], counts),
            step=np.concatenate([np.arange(count) for count in counts]),
            q=np.repeat([c.q for c in configurations], counts, axis=0),
            wrench=np.concatenate([c.steps for c in configurations]),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Predicted:
    """What the model predicts for every step.

    Attributes:
        deflection: (s, n) rad, behind the encoders.
        position: (s, p, 3) m, tracker frame, effects included.
        shift: (s, p, 3) m, base axes, what the model's effects add to it.
        wrench: (s, 6) N and N*m, as the cell records it; None without a wrench point.
    """

    deflection: Float2D
    position: Float3D
    shift: Float3D
    wrench: Float2D | None


def predict_schedule(schedule: Schedule, cell: Cell, parameters: ModelParameters) -> Predicted:
    """Find the equilibrium of every step, and where the model's effects move the points there.

    Raises:
        CellError: The robot cannot be read, or a frame that the load needs is missing.
        EquilibriumError: A load is beyond what the springs can carry.
        ModelFileError: The model contains an effect that a simulation has no data for.
    """
    chain = chain_of(cell).corrected(parameters.geometry)
    load = None
    if parameters.wrench_point is not None:
        load = Load(schedule.wrench[:, :3].T, schedule.wrench[:, 3:].T, parameters.wrench_point, None)
    elif np.any(schedule.wrench):
        raise cell.missing("frames.wrench_point", "an external load")
    rest = solve_equilibrium(chain, schedule.q, parameters.compliance, load)
    in_base = np.stack([rest.at.point(point).T for point in parameters.points.values()], axis=1)
    rotation, origin = parameters.tracker[:3, :3], parameters.tracker[:3, 3]
    wrench = None if load is None else _as_recorded(schedule, cell, parameters, np.moveaxis(rest.at.flange, -1, 0))
    shift = _by_effects(schedule, cell, parameters, chain, wrench)
    return Predicted(rest.deflection.T, (in_base + shift - origin) @ rotation, shift, wrench)


def _by_effects(
    schedule: Schedule, cell: Cell, parameters: ModelParameters, chain: Chain, wrench: Float2D | None
) -> Float3D:
    """Return the (s, p, 3) m, base axes, that the effects of the model move the points; times as in `measured_at`."""
    steps, count = len(schedule.step), len(parameters.points)
    if not parameters.effects:
        return np.zeros((steps, count, 3))
    of_step = np.repeat(np.arange(steps), count)
    point = np.tile(np.arange(count), steps)
    applied = None if wrench is None else wrench[of_step]
    state = state_of(
        chain,
        schedule.q[of_step],
        parameters.compliance,
        None if applied is None else recorded_load(applied, cell, parameters),
        np.stack(list(parameters.points.values()))[point].T,
        point_index=point,
        wrench=applied,
        configuration=np.unique(schedule.configuration, return_inverse=True)[1].reshape(-1).astype(np.int64)[of_step],
        step=schedule.step[of_step],
        time=measured_at(schedule)[of_step],
        temperature=np.full(len(of_step), TEMPERATURE),
        tracker=parameters.tracker,
        rated_load=cell.robot.rated_load,
    )
    try:
        return applied_shift(parameters.effects, state).reshape(steps, count, 3)
    except ValueError as error:
        raise ModelFileError("model", "effects", str(error), "effects that a simulation has data for") from None


def measured_at(schedule: Schedule) -> Float1D:
    """Return the (s,) s from the beginning to the middle of every step's measuring window."""
    before = np.where(schedule.step == 0, MOVING, LOADING) + SETTLING
    before[0] = MOVING + SETTLING
    return np.asarray(np.cumsum(before + MEASURING) - MEASURING / 2)


def _as_recorded(schedule: Schedule, cell: Cell, parameters: ModelParameters, flange: Float3D) -> Float2D:
    """Carry the wrenches to where and in which axes the cell records them; `flange` is (s, 3, 3), columns as rows."""
    force, torque = schedule.wrench[:, :3], schedule.wrench[:, 3:]
    convention = cell.measurements
    sensor = parameters.force_torque
    if sensor is None:
        if "sensor" in {convention.wrench_axes, convention.wrench_at}:
            raise cell.missing("frames.force_torque", "a wrench recorded by the sensor")
        return np.hstack([force, torque])
    if convention.wrench_at == "sensor":
        assert parameters.wrench_point is not None  # noqa: S101 - only called with one
        arm = np.einsum("skj,k->sj", flange, parameters.wrench_point - sensor[:3, 3])
        torque = torque + np.cross(arm, force)
    if convention.wrench_axes == "sensor":
        axes = np.einsum("skj,ki->sij", flange, sensor[:3, :3])  # rows: sensor axes in base
        force, torque = np.einsum("sij,sj->si", axes, force), np.einsum("sij,sj->si", axes, torque)
    return np.hstack([force, torque])


@dataclasses.dataclass(frozen=True, eq=False)
class Noise:
    """Errors of the averaged readings of every step: (s, p, 3) m, (s, 6) N and N*m, (s,) K."""

    position: Float3D
    wrench: Float2D
    temperature: Float1D


def draw_noise(predicted: Predicted, cell: Cell, seed: int | None) -> Noise:
    """Draw the errors that the cell's instruments claim; all points of a step share one wrench reading.

    Args:
        predicted: Where the points are.
        cell: Whose instruments.
        seed: None: no noise.
    """
    steps, points = predicted.position.shape[:2]
    if seed is None:
        return Noise(np.zeros((steps, points, 3)), np.zeros((steps, 6)), np.zeros(steps))
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(tracker_covariance(cell, predicted.position.reshape(-1, 3)))
    position = np.einsum("mij,mj->mi", root, rng.standard_normal((steps * points, 3)))
    wrench = wrench_sigma(cell) * rng.standard_normal((steps, 6))
    thermometer = cell.instruments.temperature
    sigma = 0.0 if thermometer is None else thermometer.sigma
    temperature = np.asarray(sigma * rng.standard_normal(steps))
    return Noise(position.reshape(steps, points, 3), wrench, temperature)


def simulate_plan(
    configurations: Sequence[Loading], cell: Cell, parameters: ModelParameters, seed: int | None = None
) -> Readings:
    """Predict the readings of a plan.

    Args:
        configurations: To be measured, in order.
        cell: How readings are recorded, and how noisy they are.
        parameters: The model that answers.
        seed: Of the instrument noise; None: none.

    Raises:
        CellError: The robot cannot be read, or a frame that the load needs is missing.
        EquilibriumError: A load is beyond what the springs can carry.
    """
    schedule = Schedule.of(configurations)
    predicted = predict_schedule(schedule, cell, parameters)
    noise = draw_noise(predicted, cell, seed)
    position = predicted.position + noise.position
    steps, points = position.shape[:2]
    if cell.measurements.points == "displacement":
        begins = np.flatnonzero(schedule.step == 0)
        position = position - position[begins[np.cumsum(schedule.step == 0) - 1]]
    of_step = np.repeat(np.arange(steps), points)
    wrench = None if predicted.wrench is None else (predicted.wrench + noise.wrench)[of_step]
    known = cell.instruments.temperature is not None
    return Readings(
        points=tuple(parameters.points),
        configuration=schedule.configuration[of_step],
        step=schedule.step[of_step],
        point=np.tile(np.arange(points), steps),
        q=schedule.q[of_step],
        position=position.reshape(-1, 3),
        wrench=wrench,
        time=measured_at(schedule)[of_step],
        temperature=(TEMPERATURE + noise.temperature)[of_step] if known else np.full(len(of_step), np.nan),
        provenance=Provenance("simulation", "csv", {}, {"measurements": len(of_step)}),
    )


def tracker_covariance(cell: Cell, position: Float2D) -> Float3D:
    """Return the covariance of tracker readings at positions (m, 3) m, tracker frame: (m, 3, 3) m^2, tracker axes."""
    tracker = cell.instruments.tracker
    if tracker.sigma is not None:
        return np.tile(np.eye(3) * tracker.sigma**2, (len(position), 1, 1))
    return spherical_covariance(position, tracker)


def wrench_sigma(cell: Cell) -> Float1D:
    """Return the standard deviations (6,) of one wrench reading, N and N*m; zeros without a claim."""
    claim = cell.instruments.force_torque
    return np.zeros(6) if claim is None else np.repeat([claim.sigma_force, claim.sigma_torque], 3)


# --- the model's prediction of a plan as a recording ------------------------------------------------------------------


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
