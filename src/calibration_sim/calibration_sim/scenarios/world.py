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
from calibration_sim.cell.table import build_mechanism
from calibration_sim.cell.truth import Truth
from calibration_sim.effects.effect import At, Effect, Session
from calibration_sim.mechanics.chain import read_chain
from calibration_sim.mechanics.statics import Equilibrium, Mechanism

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
        springs = [spring for effect in self.effects for spring in effect.springs(chain)]
        return build_mechanism(self.cell, self.actual, chain, springs)


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


class _Laws:
    """The effects of a world that act on the robot as it comes to rest, with what each law of a joint remembers."""

    def __init__(self, effects: Sequence[Effect], joints: int) -> None:
        self.growing, self.pushing, self.beside = (
            [effect for effect in effects if effect.acts_through(hook)] for hook in ("growth", "pushes", "side_torques")
        )
        self.laws = [effect for effect in effects if any(map(effect.acts_through, ("arrive", "deflect", "settle")))]
        self.memories: list[Any] = [law.begin(joints) for law in self.laws]

    def arrive(self, at: At) -> None:
        self.memories = [law.arrive(m, at) for law, m in zip(self.laws, self.memories, strict=True)]

    def shift(self, torque: Float1D, at: At) -> Float1D | None:
        """Return the sum (n,) of all shifts, rad; None if there is none."""
        shifts = [law.deflect(m, torque, at) for law, m in zip(self.laws, self.memories, strict=True)]
        present = [shift for shift in shifts if shift is not None]
        return None if not present else functools.reduce(np.add, present)

    def settle(self, torque: Float1D, at: At) -> None:
        self.memories = [law.settle(m, torque, at) for law, m in zip(self.laws, self.memories, strict=True)]


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
    turned, at = (np.array([getattr(rest.flange, part) for rest in rests]) for part in ("rotation", "translation"))
    points = truth.tracker.inverse_apply(in_flange @ turned.transpose(0, 2, 1) + at[:, None])
    wrench, axes = _at_sensor(truth, turned, np.array(loads)), truth.tracker.rotation.T @ turned
    session = Session(when[0], when[1], time, temperature, when[2], axes, np.linalg.norm(when[3], axis=1))
    for effect in world.effects:
        points, wrench = effect.see(points, session), effect.report(wrench, session)
    torque = np.array([-rest.torque for rest in rests])
    return Played(when[0], when[1], time, temperature, when[2], points, wrench, torque, rests)


def _rests(world: World, protocol: Protocol, time: Float1D, temperature: Float1D) -> tuple[Equilibrium, ...]:
    """Let the robot come to rest at every step, s of them, of which time and temperature (s,) are known."""
    mechanism, truth = world.mechanism(), world.actual
    n = len(truth.stiffness)
    laws = _Laws(world.effects, n)
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
            mechanism.grow(sum(effect.growth(at) for effect in laws.growing))
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
    pushes = [push for effect in laws.pushing for push in effect.pushes(at)]
    sides = [side for effect in laws.beside for side in effect.side_torques(at)]
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


def _at_sensor(truth: Truth, flange: Float3D, load: Float2D) -> Float2D:
    """Return the wrenches (s, 6) that a sensor at its true place shows.

    Args:
        truth: The cell as it is.
        flange: (s, 3, 3) flange axes in the base frame, columns.
        load: (s, 6) at the wrench point, base axes.
    """
    arm, axes = flange @ (truth.wrench_point - truth.force_torque.translation), flange @ truth.force_torque.rotation
    force, torque = load[:, :3], load[:, 3:] + np.cross(arm, load[:, :3])
    return np.concatenate([np.einsum("sji,sj->si", axes, part) for part in (force, torque)], axis=1)
