"""A recording of a simulated cell: the timeline as sampled, noisy, stamped streams with step markers."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import CellError
from calibration_core.timeseries import (
    NANOSECONDS,
    Float1D,
    Float2D,
    Phase,
    Provenance,
    StepMarkers,
    Streams,
    TimeSeries,
)
from calibration_sim.cell.protocol import Protocol
from calibration_sim.cell.sensors import quantise, read_tracker, read_wrench, stream_noise
from calibration_sim.cell.table import wrench_sigma
from calibration_sim.cell.timeline import USUAL_PACE, Pace, Timeline, play, sample
from calibration_sim.cell.truth import NOISE_STREAM, Truth, generator

START = 1_767_600_000 * NANOSECONDS  # 2026-01-05 08:00:00 UTC
TRANSPORT = (0.0005, 0.0025)  # s, from a reading to its receipt
THERMOMETER_RESOLUTION = 0.01  # degrees Celsius


@dataclasses.dataclass(frozen=True)
class Rates:
    """Sampling rates, Hz."""

    joints: float = 25.0
    tracker: float = 10.0
    wrench: float = 50.0
    temperature: float = 0.5


USUAL_RATES = Rates()


def simulate_recording(
    cell: Cell,
    truth: Truth,
    protocol: Protocol,
    seed: int,
    *,
    rates: Rates = USUAL_RATES,
    pace: Pace = USUAL_PACE,
    markers: bool = True,
) -> Streams:
    """Play a protocol and record it.

    Args:
        cell: The cell; its instruments' claims scale the noise: the mean over one measuring window has the claimed
            standard deviation (times the truth's noise factor).
        truth: What is played.
        protocol: What is measured.
        seed: Of the noise alone.
        rates: Sampling rates.
        pace: Durations and speed.
        markers: Whether step markers are recorded.

    Raises:
        CellError: The robot cannot be read, the cell lacks a frame that the load needs, or its points are to be
            recorded as displacements, which streams are not.
        EquilibriumError: A load is beyond what the springs can carry.
    """
    if cell.measurements.points != "absolute":
        raise CellError(cell.path, "measurements.points", repr(cell.measurements.points), "absolute, for a bag")
    return observe(play(cell, truth, protocol, pace), cell, seed, rates=rates, markers=markers)


def observe(timeline: Timeline, cell: Cell, seed: int, *, rates: Rates = USUAL_RATES, markers: bool = True) -> Streams:
    """Look at a played timeline through the instruments; cheap, so that many seeds can share one timeline."""
    rng = generator(seed, NOISE_STREAM)
    sensors, window = timeline.truth.sensors, timeline.pace.measure

    time = _times(timeline, rates.joints)
    joints = _series(rng, time, sample(timeline, time).q)

    points: dict[str, TimeSeries] = {}
    for i, name in enumerate(timeline.truth.points):
        time = _times(timeline, rates.tracker, late=i / len(timeline.truth.points))
        noise = stream_noise(rng, len(time), 3, rate=rates.tracker, window=window)
        true = sample(timeline, time).points[:, i]
        shown = read_tracker(true, cell.instruments.tracker, sensors.tracker, noise, rng)
        points[name] = _series(rng, time, shown, frame="tracker")

    wrench = None
    if cell.frames.wrench_point is not None:
        time = _times(timeline, rates.wrench)
        noise = stream_noise(rng, len(time), 6, rate=rates.wrench, window=window)
        shown = read_wrench(sample(timeline, time).wrench, wrench_sigma(cell), sensors.force_torque, noise)
        wrench = _series(rng, time, shown, frame="force_torque", ahead=sensors.force_torque.clock_offset)

    temperature = None
    thermometer = cell.instruments.temperature
    if thermometer is not None:
        time = _times(timeline, rates.temperature)
        shown = sensors.temperature + thermometer.sigma * rng.standard_normal((len(time), 1))
        temperature = _series(rng, time, quantise(shown, THERMOMETER_RESOLUTION))

    steps = _markers(timeline) if markers else None
    streams = {cell.topics.joint_states: joints, cell.topics.wrench: wrench, cell.topics.temperature: temperature}
    streams |= {cell.topics.point(name): series for name, series in points.items()}
    messages = {topic: len(series) for topic, series in streams.items() if series is not None}
    if steps is not None:
        messages[cell.topics.step] = len(steps.time)
    path = cell.urdf_path
    return Streams(
        joints=joints,
        points=points,
        wrench=wrench,
        temperature=temperature,
        steps=steps,
        robot_description="" if path is None else path.read_text(encoding="utf-8"),
        provenance=Provenance("simulation", "mcap", {}, messages),
    )


def _times(timeline: Timeline, rate: float, late: float = 0.0) -> Float1D:
    """Return sampling times, s; `late` shifts them by a share of the sampling period."""
    return np.asarray(np.arange(late / rate, timeline.duration, 1.0 / rate))


def _nanoseconds(time: Float1D) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return np.asarray(START + np.round(time * NANOSECONDS).astype(np.int64))


def _series(
    rng: np.random.Generator, time: Float1D, values: Float2D, *, frame: str = "", ahead: float = 0.0
) -> TimeSeries:
    """Stamp values with a clock that is `ahead` s, and receive them a little later by the recorder's clock."""
    received = np.maximum.accumulate(time + rng.uniform(*TRANSPORT, len(time)))
    return TimeSeries(_nanoseconds(time + ahead), values, _nanoseconds(received), frame)


def _markers(timeline: Timeline) -> StepMarkers:
    """Announce every segment at its start, and the end."""
    segments = timeline.segments
    rows = [(s.start, s.configuration, s.step, int(s.phase)) for s in segments]
    rows.append((timeline.duration, segments[-1].configuration, segments[-1].step, int(Phase.DONE)))
    time, *columns = zip(*rows, strict=True)
    return StepMarkers(_nanoseconds(np.array(time)), *(np.array(column, dtype=np.int64) for column in columns))
