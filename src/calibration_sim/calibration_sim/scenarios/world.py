"""A cell with effects in it, played step by step in the order of time, before any instrument looks.

Each step: the springs, the weight, the load and the effects' pushes balance; joint laws shift the joints by what their
torques ask for, until both agree; then every law remembers where it came to rest.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import EquilibriumError
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D
from calibration_sim.cell.protocol import Protocol
from calibration_sim.cell.sensors import Sensors
from calibration_sim.cell.truth import Truth
from calibration_sim.effect_models.effect import At, Effect, Session
from calibration_sim.mechanics.chain import read_chain
from calibration_sim.mechanics.statics import Equilibrium, Mechanism
from calibration_sim.mechanics.transforms import Placement

STEP_SECONDS = 20.0  # from a change of load to the next
MOVE_SECONDS = 40.0  # besides, from configuration to configuration
USUAL_TEMPERATURE = 20.0
AGREED = 1e-10  # rad
MAX_ROUNDS = 40
OF_ROBOT = ("stiffness", "gravity", "joint_zero", "joint_frame_errors", "wrench_point")  # in the truth


@dataclasses.dataclass(frozen=True, eq=False)
class World:
    """A cell as it really is.

    Attributes:
        cell: As its file states it.
        truth: What it is made of, before the effects.
        effects: What else is in it.
    """

    cell: Cell
    truth: Truth
    effects: tuple[Effect, ...] = ()

    def with_effects(self, *effects: Effect) -> World:
        """Return the same world with more in it."""
        return dataclasses.replace(self, effects=(*self.effects, *effects))

    @functools.cached_property
    def actual(self) -> Truth:
        """The truth with what the effects change in it."""
        return functools.reduce(lambda truth, effect: effect.change_truth(truth), self.effects, self.truth)

    @property
    def sensors(self) -> Sensors:
        """The instruments with what the effects change in them."""
        return functools.reduce(
            lambda sensors, effect: effect.change_sensors(sensors), self.effects, self.truth.sensors
        )

    def rests_like(self, other: World) -> bool:
        """Say whether the robot rests at every step as in another world: only instruments and frames differ."""
        mine, theirs = ([effect for effect in world.effects if effect.moves_robot] for world in (self, other))
        truths = ([getattr(world.actual, name) for name in OF_ROBOT] for world in (self, other))
        return mine == theirs and all(map(np.array_equal, *truths))

    def mechanism(self) -> Mechanism:
        """Build the robot."""
        chain = functools.reduce(lambda chain, effect: effect.change_chain(chain), self.effects, read_chain(self.cell))
        truth = self.actual
        return Mechanism(
            chain,
            truth.stiffness,
            truth.gravity,
            joint_frame_errors=truth.joint_frame_errors,
            joint_zero=truth.joint_zero,
            wrench_point=truth.wrench_point,
            springs=[spring for effect in self.effects for spring in effect.springs(chain)],
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Played:
    """What perfect instruments would have shown.

    Attributes:
        configuration: (s,) numbers.
        step: (s,).
        time: (s,) s.
        temperature: (s,) degrees Celsius.
        q: (s, n) rad.
        points: (s, p, 3) m, tracker frame.
        wrench: (s, 6) N and N*m, sensor axes at the sensor.
        torque: (s, n) N*m, carried by the joints' springs.
        rests: The robot at rest at every step.
    """

    configuration: Int1D
    step: Int1D
    time: Float1D
    temperature: Float1D
    q: Float2D
    points: Float3D
    wrench: Float2D
    torque: Float2D
    rests: tuple[Equilibrium, ...]


@dataclasses.dataclass
class _Laws:
    """The effects of a world with what each remembers."""

    effects: Sequence[Effect]
    memories: list[Any]

    def arrive(self, at: At) -> None:
        self.memories = [effect.arrive(m, at) for effect, m in zip(self.effects, self.memories, strict=True)]

    def shift(self, torque: Float1D, at: At) -> Float1D | None:
        """Return the sum (n,) of all shifts, rad; None if there is none."""
        shifts = [effect.deflect(m, torque, at) for effect, m in zip(self.effects, self.memories, strict=True)]
        present = [shift for shift in shifts if shift is not None]
        return None if not present else np.asarray(np.sum(present, axis=0))

    def settle(self, torque: Float1D, at: At) -> None:
        self.memories = [effect.settle(m, torque, at) for effect, m in zip(self.effects, self.memories, strict=True)]


def play(world: World, protocol: Protocol, rests: tuple[Equilibrium, ...] | None = None) -> Played:
    """Play a protocol.

    Args:
        world: The cell.
        protocol: What is measured.
        rests: The robot at rest at every step, where it is known of a world that it rests like; None: not known.

    Raises:
        CellError: The robot cannot be read.
        EquilibriumError: A load is beyond what the springs can carry, or a law finds no rest.
    """
    time, when = _schedule(protocol)
    temperature = USUAL_TEMPERATURE + sum((e.temperature(time) for e in world.effects), np.zeros(len(time)))
    rests = _rests(world, protocol, time, temperature) if rests is None else rests
    truth = world.actual
    in_flange = np.array(list(truth.points.values()))
    loads = [load for configuration in protocol.configurations for load in configuration.wrenches]
    points = np.array([truth.tracker.inverse_apply(rest.flange.apply(in_flange)) for rest in rests])
    wrench = np.array([_at_sensor(truth, rest.flange, load) for rest, load in zip(rests, loads, strict=True)])
    axes = truth.tracker.rotation.T @ np.array([rest.flange.rotation for rest in rests])
    session = Session(when[0], when[1], time, temperature, when[2], axes, np.linalg.norm(when[3], axis=1))
    for effect in world.effects:
        points, wrench = effect.see(points, session), effect.report(wrench, session)
    torque = np.array([-rest.torque for rest in rests])
    return Played(when[0], when[1], time, temperature, when[2], points, wrench, torque, rests)


def _rests(world: World, protocol: Protocol, time: Float1D, temperature: Float1D) -> tuple[Equilibrium, ...]:
    """Let the robot come to rest at every step, s of them, of which time and temperature (s,) are known."""
    mechanism, truth = world.mechanism(), world.actual
    n = len(truth.stiffness)
    laws = _Laws(world.effects, [effect.begin(n) for effect in world.effects])
    rests: list[Equilibrium] = []
    last_q, approach = None, np.zeros(n)
    for index, configuration in enumerate(protocol.configurations):
        if last_q is not None:
            approach = np.sign(configuration.q - last_q)
        last_q = configuration.q
        places = None
        rest: Equilibrium | None = None
        for step, load in enumerate(configuration.wrenches):
            at = At(
                index,
                configuration.number,
                step,
                float(time[len(rests)]),
                float(temperature[len(rests)]),
                configuration.q,
                approach,
                1.0 / truth.stiffness,
                places,
            )
            if step == 0:
                laws.arrive(at)
            mechanism.grow(sum(effect.growth(at) for effect in world.effects))
            rest = _rest(mechanism, laws, at, load, rest)
            if step == 0:
                places = mechanism.places()
            laws.settle(-rest.torque, at)
            rests.append(rest)
    return tuple(rests)


def _schedule(protocol: Protocol) -> tuple[Float1D, tuple[Int1D, Int1D, Float2D, Float2D]]:
    """Return the time of every step, and number, step, angles and load force of every one."""
    lengths = [len(c.wrenches) for c in protocol.configurations]
    number = np.repeat([c.number for c in protocol.configurations], lengths)
    step = np.concatenate([np.arange(k) for k in lengths])
    q = np.repeat([c.q for c in protocol.configurations], lengths, axis=0)
    force = np.concatenate([c.wrenches[:, :3] for c in protocol.configurations])
    time = STEP_SECONDS * np.arange(len(step)) + MOVE_SECONDS * (np.cumsum(step == 0) - 1)
    return time, (number, step, q, force)


def _rest(mechanism: Mechanism, laws: _Laws, at: At, load: Float1D, last: Equilibrium | None) -> Equilibrium:
    """Let springs and joint laws agree."""
    pushes = [push for effect in laws.effects for push in effect.pushes(at)]
    sides = [side for effect in laws.effects for side in effect.side_torques(at)]
    shift: Float1D | None = None
    if last is not None:
        shift = laws.shift(-last.torque, at)
    start = None if last is None else last.rest
    change = np.inf
    for _ in range(MAX_ROUNDS):
        rest = mechanism.equilibrium(at.q, load, shift=shift, pushes=pushes, sides=sides, start=start)
        wanted = laws.shift(-rest.torque, at)
        if wanted is None:
            return rest
        change = float(np.max(np.abs(wanted - (0.0 if shift is None else shift))))
        if change < AGREED:
            return rest
        shift, start = wanted, rest.rest
    raise EquilibriumError(change, MAX_ROUNDS)


def _at_sensor(truth: Truth, flange: Placement, load: Float1D) -> Float1D:
    """Return the wrench (6,) that a sensor at its true place shows for a load (6,) at the wrench point, base axes."""
    x, y, z = flange.rotation @ (truth.wrench_point - truth.force_torque.translation)
    axes = flange.rotation @ truth.force_torque.rotation
    by_arm = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ load[:3]
    return np.concatenate([axes.T @ load[:3], axes.T @ (load[3:] + by_arm)])
