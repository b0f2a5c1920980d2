"""Readings of a simulated cell, as in a measurement table.

`solve` finds every rest position once; `measure` looks at them through the instruments, as often as there are seeds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D, Provenance, Readings, read_only
from calibration_sim.cell.protocol import Protocol
from calibration_sim.cell.sensors import read_tracker, read_wrench
from calibration_sim.cell.truth import NOISE_STREAM, Truth, generator
from calibration_sim.mechanics.chain import Chain, read_chain
from calibration_sim.mechanics.mjcf import Spring
from calibration_sim.mechanics.statics import Mechanism

STEP_SECONDS = 5.0
MOVE_SECONDS = 20.0


@dataclasses.dataclass(frozen=True, eq=False)
class States:
    """Rest positions, one row each.

    Attributes:
        q: (s, n) rad, encoder angles.
        points: (s, p, 3) m, measurement points in the true tracker frame.
        wrench: (s, 6) N and N*m, as a perfect instrument reports it (axes and place as the cell file says).
        deflection: (s, n) rad.
    """

    q: Float2D
    points: Float3D
    wrench: Float2D
    deflection: Float2D

    def __post_init__(self) -> None:
        """Copy to read-only arrays."""
        for field in dataclasses.fields(self):
            object.__setattr__(self, field.name, read_only(getattr(self, field.name)))


@dataclasses.dataclass(frozen=True, eq=False)
class Solved:
    """A protocol played on a truth, before any instrument looks.

    Attributes:
        truth: What was played.
        states: One row per configuration and step, in the order of time.
        configuration: (s,) int64.
        step: (s,) int64.
        time: (s,) s, from the start of the protocol.
    """

    truth: Truth
    states: States
    configuration: Int1D
    step: Int1D
    time: Float1D

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for array in (self.configuration, self.step, self.time):
            array.setflags(write=False)


def build_mechanism(cell: Cell, truth: Truth, chain: Chain | None = None, springs: Sequence[Spring] = ()) -> Mechanism:
    """Build the true robot of a cell.

    Args:
        cell: As its file states it.
        truth: What it is made of.
        chain: The robot; None: the cell's.
        springs: What gives way besides the joints.

    Raises:
        CellError: The robot cannot be read.
    """
    return Mechanism(
        chain or read_chain(cell),
        truth.stiffness,
        truth.gravity,
        joint_frame_errors=truth.joint_frame_errors,
        joint_zero=truth.joint_zero,
        wrench_point=truth.wrench_point,
        springs=springs,
    )


def solve_states(mechanism: Mechanism, cell: Cell, truth: Truth, q: Float2D, wrench: Float2D) -> States:
    """Find the rest positions for commanded angles (s, n) rad and wrenches (s, 6), base axes at the wrench point.

    Raises:
        EquilibriumError: A load is beyond what the springs can carry.
        CellError: The wrench is to be reported at the sensor, and the cell file does not say where that is.
    """
    if np.any(wrench != 0.0) and cell.frames.wrench_point is None:
        raise cell.missing("frames.wrench_point", "an external load")
    in_flange = np.array(list(truth.points.values()))
    points, reported, deflections = [], [], []
    for angles, load in zip(q, wrench, strict=True):
        rest = mechanism.equilibrium(angles, load)
        points.append(truth.tracker.inverse_apply(rest.flange.apply(in_flange)))
        deflections.append(rest.deflection)
        reported.append(_report(cell, truth, rest.flange.rotation, load))
    return States(q, np.array(points), np.array(reported), np.array(deflections))


def _report(cell: Cell, truth: Truth, flange_axes: Float2D, load: Float1D) -> Float1D:
    """Carry a wrench (6,), base axes at the wrench point, to where and in which axes the instrument reports it.

    The sensor is tared and shows the external load alone; its place and axes are those of the deformed robot.
    """
    force, torque = load[:3], load[3:]
    settings = cell.measurements
    sensor_needed = "sensor" in {settings.wrench_axes, settings.wrench_at} and cell.frames.wrench_point is not None
    if sensor_needed and cell.frames.force_torque is None:
        raise cell.missing("frames.force_torque", "a wrench as the sensor reports it")
    if settings.wrench_at == "sensor":
        arm = flange_axes @ (truth.wrench_point - truth.force_torque.translation)
        torque = torque + np.cross(arm, force)
    if settings.wrench_axes == "sensor":
        axes = flange_axes @ truth.force_torque.rotation
        force, torque = axes.T @ force, axes.T @ torque
    return np.concatenate([force, torque])


def solve(cell: Cell, truth: Truth, protocol: Protocol) -> Solved:
    """Play a protocol: every rest position of every step.

    Raises:
        CellError: The robot cannot be read, or the cell lacks a frame that the load needs.
        EquilibriumError: A load is beyond what the springs can carry.
    """
    q = np.concatenate([np.tile(c.q, (len(c.wrenches), 1)) for c in protocol.configurations])
    wrench = np.concatenate([c.wrenches for c in protocol.configurations])
    states = solve_states(build_mechanism(cell, truth), cell, truth, q, wrench)
    configuration = np.concatenate([np.full(len(c.wrenches), c.number) for c in protocol.configurations])
    step = np.concatenate([np.arange(len(c.wrenches)) for c in protocol.configurations])
    time = STEP_SECONDS * np.arange(len(step)) + MOVE_SECONDS * (np.cumsum(step == 0) - 1)
    return Solved(truth, states, configuration, step, time)


def measure(solved: Solved, cell: Cell, seed: int) -> Readings:
    """Look at a played protocol through the instruments; cheap, so that many seeds can share one solution."""
    rng = generator(seed, NOISE_STREAM)
    sensors, states = solved.truth.sensors, solved.states
    steps, points = states.points.shape[:2]
    names = tuple(solved.truth.points)
    rows = steps * points
    step_of = np.repeat(np.arange(steps), points)
    position = read_tracker(
        states.points.reshape(rows, 3), cell.instruments.tracker, sensors.tracker, rng.standard_normal((rows, 3)), rng
    )
    if cell.measurements.points == "displacement":
        position = _displacement(position.reshape(steps, points, 3), solved).reshape(rows, 3)
    looks = rows if sensors.one_after_another else steps
    look_of = np.arange(rows) if sensors.one_after_another else step_of
    noise = rng.standard_normal((looks, 7))
    wrench = None
    if cell.frames.wrench_point is not None:
        true_wrench = states.wrench[step_of] if sensors.one_after_another else states.wrench
        wrench = read_wrench(true_wrench, wrench_sigma(cell), sensors.force_torque, noise[:, :6])[look_of]
    thermometer = cell.instruments.temperature
    temperature = np.full(rows, np.nan)
    if thermometer is not None:
        temperature = sensors.temperature + thermometer.sigma * noise[look_of, 6]
    later = np.tile(np.arange(points), steps) if sensors.one_after_another else np.zeros(rows)
    return Readings(
        points=names,
        configuration=solved.configuration[step_of],
        step=solved.step[step_of],
        point=np.tile(np.arange(points), steps),
        q=states.q[step_of],
        position=position,
        wrench=wrench,
        time=solved.time[step_of] + later,
        temperature=temperature,
        provenance=Provenance("simulation", "csv", {}, {"measurements": rows}),
    )


def simulate_readings(cell: Cell, truth: Truth, protocol: Protocol, seed: int) -> Readings:
    """Play and look once; see `solve` and `measure`."""
    return measure(solve(cell, truth, protocol), cell, seed)


def wrench_sigma(cell: Cell) -> Float1D:
    """Return the claimed standard deviations (6,) of one averaged wrench, N and N*m; zeros without a claim."""
    claim = cell.instruments.force_torque
    return np.zeros(6) if claim is None else np.repeat([claim.sigma_force, claim.sigma_torque], 3)


def _displacement(position: Float3D, solved: Solved) -> Float3D:
    """Subtract each configuration's first reading (s, p, 3) from all of its readings."""
    first = np.flatnonzero(solved.step == 0)
    return np.asarray(position - position[first[np.cumsum(solved.step == 0) - 1]])
