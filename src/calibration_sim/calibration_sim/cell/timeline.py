"""A protocol as it runs in time: motions, load ramps, settling and measuring, one after another.

Between configurations the robot moves unloaded, along a straight line in joint space, timed so that every point of
interest stays below the speed bound.  Loads change along linear ramps.  After a motion or a ramp the points ring down.
Rest positions are solved at nodes along each motion and ramp; in between, a cubic spline runs through them.
Collisions are not considered.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.timeseries import Float1D, Float2D, Float3D, Phase
from calibration_sim.cell.protocol import Protocol
from calibration_sim.cell.table import States, build_mechanism, solve_states
from calibration_sim.cell.truth import Truth
from calibration_sim.mechanics.statics import Mechanism

QUINTIC_PEAK = 1.875  # largest slope of 10 t^3 - 15 t^4 + 6 t^5
NODE_SPACING = 0.05  # rad, between the nodes of a motion
RAMP_NODES = 5
RINGING_AFTER_RAMP = 0.03  # of the displacement
RINGING_AFTER_MOTION = 1e-4  # m
RINGING_FREQUENCY = 7.0  # Hz
RINGING_TIME = 0.25  # s, to 1/e


@dataclasses.dataclass(frozen=True)
class Pace:
    """How fast the protocol runs.

    Attributes:
        lead_in: s, standing at the first configuration before anything happens.
        ramp: s, every change of load.
        settle: s, after every motion and ramp.
        measure: s, the averaging window.
        speed: m/s, Cartesian bound while moving; the standard's is 0.25.
    """

    lead_in: float = 1.0
    ramp: float = 2.0
    settle: float = 1.5
    measure: float = 2.0
    speed: float = 0.2


USUAL_PACE = Pace()


@dataclasses.dataclass(frozen=True, eq=False)
class Segment:
    """A stretch of time in one phase.

    Attributes:
        phase: What happens.
        configuration: Number of the configuration (while moving: the one moved to).
        step: Step (while loading: the one loaded to).
        start: s.
        duration: s.
        states: Rest positions at nodes evenly spaced along the way; a single one where nothing moves.
        ringing: (p, 3) m, amplitude of the oscillation that dies out from the segment's start on.
    """

    phase: Phase
    configuration: int
    step: int
    start: float
    duration: float
    states: States
    ringing: Float2D


@dataclasses.dataclass(frozen=True, eq=False)
class Timeline:
    """A protocol played on a truth: segments without gaps, the first starting at zero."""

    truth: Truth
    segments: tuple[Segment, ...]
    pace: Pace

    @property
    def duration(self) -> float:
        """Length, s."""
        return self.segments[-1].start + self.segments[-1].duration


@dataclasses.dataclass(frozen=True, eq=False)
class Samples:
    """What a perfect instrument would see at given times.

    Attributes:
        q: (m, n) rad, encoder.
        points: (m, p, 3) m, true tracker frame.
        wrench: (m, 6) N and N*m, as reported.
    """

    q: Float2D
    points: Float3D
    wrench: Float2D


class _Player:
    """Strings segments together; knows where the robot stands and what pulls at it."""

    def __init__(self, cell: Cell, truth: Truth, pace: Pace) -> None:
        self.cell, self.truth, self.pace = cell, truth, pace
        self.mechanism: Mechanism = build_mechanism(cell, truth)
        self.segments: list[Segment] = []
        self.clock = 0.0
        self.still = np.zeros((len(truth.points), 3))

    def solve(self, q: Float2D, wrench: Float2D) -> States:
        return solve_states(self.mechanism, self.cell, self.truth, q, wrench)

    def add(
        self,
        phase: Phase,
        configuration: int,
        step: int,
        duration: float,
        states: States,
        ringing: Float2D | None = None,
    ) -> None:
        ringing = self.still if ringing is None else ringing
        self.segments.append(Segment(phase, configuration, step, self.clock, duration, states, ringing))
        self.clock += duration

    def move(self, configuration: int, start: Float1D, end: Float1D) -> Float2D:
        """Move unloaded; return the amplitude of the ringing afterwards."""
        count = max(9, int(np.ceil(np.max(np.abs(end - start)) / NODE_SPACING)) + 1)
        q = start + np.linspace(0.0, 1.0, count)[:, None] * (end - start)
        watched = np.array([self._watched(angles) for angles in q])
        steepest = float(np.max(np.linalg.norm(np.diff(watched, axis=0), axis=2))) * (count - 1)
        duration = max(1.0, QUINTIC_PEAK * steepest / self.pace.speed)
        states = self.solve(q, np.zeros((count, 6)))
        self.add(Phase.MOVING, configuration, 0, duration, states)
        last = states.points[-1] - states.points[-2]
        return np.asarray(RINGING_AFTER_MOTION * last / max(float(np.max(np.linalg.norm(last, axis=1))), 1e-12))

    def _watched(self, angles: Float1D) -> Float2D:
        flange = self.mechanism.forward(angles)
        at_flange = np.array([np.zeros(3), self.truth.wrench_point, *self.truth.points.values()])
        return np.vstack([self.mechanism.origins(angles), flange.apply(at_flange)])

    def ramp(self, configuration: int, step: int, q: Float1D, before: Float1D, after: Float1D) -> Float2D:
        """Change the load; return the amplitude of the ringing afterwards."""
        states = self.solve(np.tile(q, (RAMP_NODES, 1)), np.linspace(before, after, RAMP_NODES))
        rising = np.linalg.norm(after) > np.linalg.norm(before)
        self.add(Phase.LOADING if rising else Phase.UNLOADING, configuration, step, self.pace.ramp, states)
        return np.asarray(RINGING_AFTER_RAMP * (states.points[-1] - states.points[0]))


def play(cell: Cell, truth: Truth, protocol: Protocol, pace: Pace = USUAL_PACE) -> Timeline:
    """Play a protocol in time.

    Raises:
        CellError: The robot cannot be read, or the cell lacks a frame that the load needs.
        EquilibriumError: A load is beyond what the springs can carry.
    """
    player = _Player(cell, truth, pace)
    first = protocol.configurations[0]
    none = np.zeros(6)
    player.add(Phase.MOVING, first.number, 0, pace.lead_in, player.solve(first.q[None], none[None]))
    q = first.q
    for configuration in protocol.configurations:
        number = configuration.number
        ringing = None if configuration is first else player.move(number, q, configuration.q)
        q, load = configuration.q, none
        for step, wrench in enumerate(configuration.wrenches):
            if not np.array_equal(wrench, load):
                ringing = player.ramp(number, step, q, load, wrench)
            load = wrench
            states = player.solve(q[None], load[None])
            player.add(Phase.SETTLING, number, step, pace.settle, states, ringing)
            player.add(Phase.MEASURING, number, step, pace.measure, states)
            ringing = None
        if np.any(load != 0.0):
            player.ramp(number, len(configuration.wrenches) - 1, q, load, none)
    return Timeline(truth, tuple(player.segments), pace)


def sample(timeline: Timeline, time: Float1D) -> Samples:
    """Return what a perfect instrument sees at times (m,) s, increasing, from zero to the timeline's duration."""
    starts = np.array([segment.start for segment in timeline.segments])
    first = np.searchsorted(time, starts, side="left")
    last = np.append(first[1:], len(time))
    parts = [_along(segment, time[a:b]) for segment, a, b in zip(timeline.segments, first, last, strict=True) if a < b]
    return Samples(
        *(np.concatenate([getattr(part, field.name) for part in parts]) for field in dataclasses.fields(Samples))
    )


def _along(segment: Segment, time: Float1D) -> Samples:
    states, elapsed = segment.states, time - segment.start
    if len(states.q) == 1:
        rows = np.zeros(len(time), dtype=np.int64)
        q, points, wrench = states.q[rows], states.points[rows], states.wrench[rows]
    else:
        from scipy.interpolate import CubicSpline  # slow to load, and a cell that lives has no use for it

        fraction = np.clip(elapsed / segment.duration, 0.0, 1.0)
        if segment.phase is Phase.MOVING:
            fraction = fraction**3 * (10.0 - 15.0 * fraction + 6.0 * fraction**2)
        nodes = np.linspace(0.0, 1.0, len(states.q))
        q = states.q[0] + fraction[:, None] * (states.q[-1] - states.q[0])
        points = CubicSpline(nodes, states.points)(fraction)
        wrench = CubicSpline(nodes, states.wrench)(fraction)
    swing = np.exp(-elapsed / RINGING_TIME) * np.sin(2.0 * np.pi * RINGING_FREQUENCY * elapsed)
    return Samples(q, points + swing[:, None, None] * segment.ringing, wrench)
