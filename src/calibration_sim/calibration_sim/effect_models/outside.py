"""Effects that no catalogue holds: the diagnosis shall say that something is left which it cannot name."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from calibration_core.timeseries import Float1D, Float3D
from calibration_sim.effect_models.effect import At, Effect, Session
from calibration_sim.mechanics.statics import Push


@dataclasses.dataclass(frozen=True, eq=False)
class PoseModulation(Effect):
    """A joint's compliance varies with two joint angles together, C (1 + a sin(2 q_j + 3 q_k + phase)).

    Attributes:
        joint: Index of the joint that gives way.
        other: Index of the other one.
        share: a.
        phase: rad.
    """

    joint: int
    other: int
    share: float
    phase: float

    def deflect(self, memory: None, torque: Float1D, at: At) -> Float1D:
        """Give way more or less."""
        result = np.zeros(len(torque))
        wave = np.sin(2.0 * at.q[self.joint] + 3.0 * at.q[self.other] + self.phase)
        result[self.joint] = self.share * wave * at.compliance[self.joint] * torque[self.joint]
        return result


@dataclasses.dataclass(frozen=True, eq=False)
class NestSlip(Effect):
    """In a few configurations a target slips in its nest at one step, and sits right again in the next configuration.

    Attributes:
        point: Index of the point.
        slips: Index of the configuration, first step after the slip, (3,) m in the flange frame.
    """

    point: int
    slips: tuple[tuple[int, int, Float1D], ...]

    def see(self, points: Float3D, session: Session) -> Float3D:
        """Slip."""
        result = points.copy()
        numbers = session.numbers
        for index, step, shift in self.slips:
            moved = (session.configuration == numbers[index]) & (session.step >= step)
            result[moved, self.point] += session.axes[moved] @ shift
        return result


@dataclasses.dataclass(frozen=True, eq=False)
class RigContact(Effect):
    """In a few configurations the arm runs against a stop of the rig as it gives way: a one-sided spring.

    Attributes:
        link: Index of the link that is touched, at its origin.
        name: Its name.
        stops: Index of the configuration, (3,) unit direction from the link at step 0 towards the stop, base axes.
        gap: m, free way.
        stiffness: N/m.
    """

    link: int
    name: str
    stops: tuple[tuple[int, Float1D], ...]
    gap: float
    stiffness: float

    def pushes(self, at: At) -> tuple[Push, ...]:
        """Push back beyond the gap."""
        if at.places is None:
            return ()
        free = at.places[self.link]
        return tuple(
            Push(self.name, np.zeros(3), self._stop(free, towards))
            for index, towards in self.stops
            if index == at.index
        )

    def _stop(self, free: Float1D, towards: Float1D) -> Callable[[Float1D], Float1D]:
        def force(place: Float1D) -> Float1D:
            beyond = max(0.0, float((place - free) @ towards) - self.gap)
            return np.asarray(-self.stiffness * beyond * towards)

        return force


@dataclasses.dataclass(frozen=True, eq=False)
class ThermalJump(Effect):
    """A door opens: within a few configurations, all that is seen shifts and turns from one step on.

    Attributes:
        jumps: Index of the configuration, first step after the jump, (3,) m and (3,) rad in tracker axes.
    """

    jumps: tuple[tuple[int, int, Float1D, Float1D], ...]

    def see(self, points: Float3D, session: Session) -> Float3D:
        """Jump, and stay until the next configuration is set up."""
        result = points.copy()
        numbers = session.numbers
        for index, step, shift, turn in self.jumps:
            moved = (session.configuration == numbers[index]) & (session.step >= step)
            middle = points[moved].mean(axis=(0, 1)) if moved.any() else np.zeros(3)
            result[moved] += shift + np.cross(turn, points[moved] - middle)
        return result


@dataclasses.dataclass(frozen=True, eq=False)
class RigStickSlip(Effect):
    """Part of the pull goes past the sensor, through a guide that sticks and slips: another share at every step.

    Attributes:
        share: Largest share of the rated force.
        force: Rated force, N.
        seed: Of sticking and slipping.
    """

    share: float
    force: float
    seed: int

    def pushes(self, at: At) -> tuple[Push, ...]:
        """Pull at the flange, from the second step on."""
        if at.step == 0:
            return ()
        rng = np.random.default_rng((self.seed, at.index))
        direction = rng.standard_normal(3)
        direction /= np.linalg.norm(direction)
        levels = rng.uniform(-1.0, 1.0, 64)
        held = levels[at.step - 1] if levels[32 + at.step] > 0.0 else levels[at.step - at.step % 3]
        pull = self.share * self.force * float(held) * direction
        return (Push("flange", np.zeros(3), lambda place: np.asarray(pull + 0.0 * place)),)


@dataclasses.dataclass(frozen=True, eq=False)
class TurningTool(Effect):
    """The adapter's bolts give way unevenly: the wrist tilts in a direction and by an amount that follow joint 6.

    Attributes:
        joint: Index of the joint that tilts along (the fifth).
        last: Index of the joint that the tilt follows (the sixth).
        compliance: rad/(N*m).
        phase: rad.
    """

    joint: int
    last: int
    compliance: float
    phase: float

    def deflect(self, memory: None, torque: Float1D, at: At) -> Float1D:
        """Tilt by a third harmonic of joint 6, and drag the fourth joint along by another."""
        result = np.zeros(len(torque))
        wave = 3.0 * at.q[self.last] + self.phase
        result[self.joint] = self.compliance * np.sin(wave) * torque[self.joint]
        result[self.joint - 1] = self.compliance * np.cos(wave) * torque[self.joint - 1]
        return result
