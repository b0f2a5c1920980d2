"""A cell and a played session: configurations, load steps, ramps, noise, clocks."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.timeseries import NANOSECONDS, Phase, Provenance, StepMarkers, Streams, TimeSeries

START = 1_700_000_000 * NANOSECONDS
CELL = """
name: small
robot:
  name: three joints
  dh: [{a: 0.1, alpha: 1.5, d: 0.4}, {a: 0.5, alpha: 0, d: 0}, {a: 0.4, alpha: 0, d: 0}]
  joints: [shoulder, elbow, wrist]
  joint_limits: [[-3, 3], [-3, 3], [-3, 3]]
  rated_load: 50
frames:
  measurement_points: {left: [0.1, 0, 0], right: [0, 0.1, 0]}
instruments:
  tracker: {sigma: 2.0e-5}
  force_torque: {sigma_force: 1.0, sigma_torque: 0.5}
  temperature: {sigma: 0.1}
"""
LOADS = np.array([0.0, 150.0, 400.0, 150.0, 0.0])  # N
MOVE, RAMP, HOLD = 2.0, 1.5, 4.0  # s
MEASURE = 2.0  # s, the last part of a hold
COMPLIANCE = np.array([2.0e-6, -1.0e-6, 1.5e-6])  # m/N
DIRECTION = np.array([0.6, 0.0, -0.8])


@pytest.fixture
def cell(tmp_path: Path) -> Cell:
    path = tmp_path / "cell.yaml"
    path.write_text(CELL)
    return load_cell(path)


@dataclasses.dataclass(frozen=True)
class Session:
    """What was really so: per configuration the joint angles, the point without load, and the loads."""

    configurations: int = 3
    loaded: bool = True
    noise: float = 1.0
    tracker_ahead: float = 0.0
    seed: int = 0
    rate: float = 100.0
    elastic: float = 2e-6  # rad/N, how much the encoders move under load

    @property
    def loads(self) -> np.ndarray:
        return LOADS if self.loaded else LOADS[:1]

    def angles(self, configuration: int) -> np.ndarray:
        return np.array([0.3, -0.5, 0.8]) * np.cos(configuration + np.arange(3))

    def place(self, configuration: int, point: int) -> np.ndarray:
        return np.array([2.0, 0.1 * point, 1.0]) + 0.2 * np.sin(configuration + np.arange(3))

    def nodes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[tuple[float, int, int, int]]]:
        """Times, fractional configurations and loads at which anything changes, and the markers."""
        time, place, load, markers = [0.0], [0.0], [0.0], []
        clock = 0.0
        for configuration in range(self.configurations):
            if configuration:
                markers.append((clock, configuration + 1, 0, Phase.MOVING))
                clock += MOVE
                time, place, load = [*time, clock], [*place, configuration], [*load, 0.0]
            for step, force in enumerate(self.loads):
                if step:
                    markers.append((clock, configuration + 1, step, Phase.LOADING))
                    clock += RAMP
                    time, place, load = [*time, clock], [*place, configuration], [*load, force]
                markers.append((clock, configuration + 1, step, Phase.SETTLING))
                markers.append((clock + HOLD - MEASURE, configuration + 1, step, Phase.MEASURING))
                clock += HOLD
                time, place, load = [*time, clock], [*place, configuration], [*load, force]
        markers.append((clock, self.configurations, len(self.loads) - 1, Phase.DONE))
        return np.array(time), np.array(place), np.array(load), markers

    def record(self, *, markers: bool = True) -> Streams:
        rng = np.random.default_rng(self.seed)
        node_time, node_place, node_load, marks = self.nodes()
        duration = node_time[-1]

        def at(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return np.interp(time, node_time, node_place), np.interp(time, node_time, node_load)

        def mixed(place: np.ndarray, state: list[np.ndarray]) -> np.ndarray:
            low = np.minimum(place.astype(int), len(state) - 1)
            high = np.minimum(low + 1, len(state) - 1)
            share = (place - low)[:, None]
            return np.array(state)[low] * (1 - share) + np.array(state)[high] * share

        def series(time: np.ndarray, values: np.ndarray, ahead: float = 0.0) -> TimeSeries:
            stamp = START + np.round((time + ahead) * NANOSECONDS).astype(np.int64)
            received = START + np.round(time * NANOSECONDS).astype(np.int64) + 1_000_000
            return TimeSeries(stamp, values, received, "f")

        time = np.arange(0.0, duration, 1 / 50.0)
        place, load = at(time)
        angles = [self.angles(i) for i in range(self.configurations)]
        q = mixed(place, angles) + self.elastic * load[:, None]
        joints = series(time, q + self.noise * 1e-6 * rng.normal(size=q.shape))
        points = {}
        for i, name in enumerate(("left", "right")):
            time = np.arange(i * 0.3 / self.rate, duration, 1 / self.rate)
            place, load = at(time)
            places = [self.place(k, i) for k in range(self.configurations)]
            values = mixed(place, places) + load[:, None] * COMPLIANCE
            values = values + self.noise * 2e-5 * rng.normal(size=values.shape)
            points[name] = series(time, values, self.tracker_ahead)
        time = np.arange(0.0, duration, 1 / 200.0)
        wrench = np.hstack([at(time)[1][:, None] * DIRECTION, np.zeros((len(time), 3))])
        wrench += self.noise * np.repeat([2.0, 0.5], 3) * rng.normal(size=wrench.shape)
        warm = np.arange(0.0, duration, 2.0)
        steps = None
        if markers:
            clock, configuration, step, phase = zip(*marks, strict=True)
            stamps = START + np.round(np.array(clock) * NANOSECONDS).astype(np.int64)
            steps = StepMarkers(stamps, np.array(configuration), np.array(step), np.array(phase, np.int64))
        return Streams(
            joints=joints,
            points=points,
            wrench=series(time, wrench) if self.loaded else None,
            temperature=series(warm, np.full((len(warm), 1), 20.5)),
            steps=steps,
            robot_description="",
            provenance=Provenance("session", "mcap", {}, {}),
        )


@pytest.fixture
def session() -> type[Session]:
    """Return the class of sessions: tests set what matters to them."""
    return Session
