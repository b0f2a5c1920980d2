"""Laws of a kind that the catalogue has, in a shape that it has not: other friction, other knees, other waves.

The label says of which kind they are.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from calibration_core.timeseries import Float1D
from calibration_sim.effects.draw import Draw
from calibration_sim.effects.effect import At, Effect, Label, modulated
from calibration_sim.effects.joints import JointLaw, Law, spring

KNEES = ("nonlinear_stiffness", "soft_zone", "backlash")
WAVES = ("pose_dependent_stiffness", "gravity_compensator")


@dataclasses.dataclass(frozen=True, eq=False)
class Sliding(JointLaw):
    """Friction with one state within -1 ... 1, which every change of torque drags towards its own side.

    Attributes:
        reversal: N*m, change of torque that turns the state over.
        seed: Of the unknown state on arrival.
        width: Torque (N*m) and state -> half width, rad.
        gradual: Whether the state approaches its side exponentially, after Dahl (1968).
    """

    reversal: float
    seed: int
    width: Callable[[float, float], float]
    gradual: bool = False

    def arrive(self, memory: Any, at: At) -> tuple[float, None]:
        """Stand anywhere, leaning to where the joint came from; the torque is that of the first step."""
        rng = np.random.default_rng((self.seed, at.index))
        return (float(np.clip(0.5 * at.approach[self.joint] + rng.uniform(-1.0, 1.0), -1.0, 1.0)), None)

    def settle(self, memory: Any, torque: Float1D, at: At) -> tuple[float, float]:
        """Be dragged along."""
        now = float(torque[self.joint])
        return (self._dragged(memory, now), now)

    def extra(self, memory: Any, torque: float, at: At) -> float:
        """Lag."""
        state = self._dragged(memory, torque)
        return -self.width(torque, state) * state

    def _dragged(self, memory: Any, torque: float) -> float:
        state, last = memory
        if last is None:
            return float(state)
        change = torque - float(last)
        if self.gradual:
            return float(np.sign(change) + (state - np.sign(change)) * np.exp(-abs(change) / self.reversal))
        return float(np.clip(state + change / self.reversal, -1.0, 1.0))


def _friction(draw: Draw, joint: int, width: float) -> Label:
    return draw.label("joint law", "hysteresis", draw.at(joint), {"half_width": width}, kinds=("hysteresis",))


def wedge_friction(draw: Draw) -> Effect:
    """Friction of toothed gears, of which the loop opens with the load."""
    j = draw.among(0, 1, 2, 3, 4)
    width = 1.5 * draw.amplitude * draw.size.friction[j // 3]
    reference = draw.size.rated_torque[j]
    reversal = reference * float(draw.rng.uniform(0.1, 0.3))
    return Sliding(_friction(draw, j, width), draw.first + j, reversal, draw.seed(), opening(width, reference))


def opening(width: float, reference: float) -> Callable[[float, float], float]:
    """Return a half width that grows with the load to `width` (rad) at a torque (N*m): w |tau|/tau_r."""
    return lambda torque, _: width * abs(torque) / reference


def dahl_friction(draw: Draw) -> Effect:
    """Friction whose state approaches its side exponentially."""
    j = draw.among(0, 1, 2, 3, 4)
    width = draw.amplitude * draw.size.friction[j // 3]
    reversal = draw.size.rated_torque[j] * float(draw.rng.uniform(0.08, 0.4))
    label = _friction(draw, j, width)
    return Sliding(label, draw.first + j, reversal, draw.seed(), lambda torque, state: width, gradual=True)


def uneven_friction(draw: Draw) -> Effect:
    """Friction that holds back more in one direction than in the other, as worm gears and worn seals do."""
    j = draw.among(0, 1, 2, 3, 4)
    width = draw.amplitude * draw.size.friction[j // 3]
    reversal = draw.size.rated_torque[j] * float(draw.rng.uniform(0.08, 0.4))
    weaker = width * float(draw.rng.uniform(0.2, 0.7))
    widths = (width, weaker) if draw.sign() > 0 else (weaker, width)
    label = _friction(draw, j, width)
    return Sliding(label, draw.first + j, reversal, draw.seed(), lambda torque, state: widths[state < 0.0])


def _knee(draw: Draw, joint: int, law: Law, **parameters: float) -> Effect:
    label = draw.label("joint law", KNEES[0], draw.at(joint), parameters, kinds=KNEES)
    return spring(label, draw.first + joint, law)


def power_law(draw: Draw) -> Effect:
    """Contacts that flatten (Hertz: power 2/3), or a mount that gives way ever more."""
    j = draw.among(0, 1, 2, 3, 4)
    power = float(draw.rng.choice([0.55, 2.0 / 3.0, 1.7, 2.5]))
    share = draw.amplitude * draw.size.hardening
    return _knee(draw, j, to_the_power(share, draw.size.rated_torque[j], power), power=power, share=share)


def to_the_power(share: float, reference: float, power: float) -> Law:
    """Return C tau_r share sign(tau) |tau/tau_r|^p, tau_r `reference` (N*m)."""
    return lambda torque, c: share * reference * c * float(np.sign(torque)) * abs(torque / reference) ** power


def lost_preload(draw: Draw) -> Effect:
    """A bearing whose preload is lost beyond a high torque."""
    j = draw.among(0, 1, 2, 3, 4)
    share = 0.4 * draw.amplitude
    beyond = draw.size.rated_torque[j] * float(draw.rng.uniform(0.35, 0.6))
    return _knee(draw, j, softer_beyond(share, beyond), share=share, beyond=beyond)


def softer_beyond(share: float, beyond: float) -> Law:
    """Return a joint that has more compliance, by a share, from a torque (N*m) on."""
    return lambda torque, c: share * c * (float(np.sign(torque)) * max(0.0, abs(torque) - beyond))


def one_sided(draw: Draw) -> Effect:
    """A gear that is softer on one flank."""
    j = draw.among(0, 1, 2, 3, 4)
    share, side = 0.2 * draw.amplitude, draw.sign()
    return _knee(draw, j, soft_flank(share, side), share=share, side=side)


def soft_flank(share: float, side: float) -> Law:
    """Return a joint that has more compliance, by a share, for torques of one sign (1 or -1)."""
    return lambda torque, c: share * c * side * max(0.0, side * torque)


def other_wave(draw: Draw) -> Effect:
    """Compliance that follows twice or three times the angle, or has one soft place."""
    j = draw.among(0, 1, 2, 3, 4)
    cycles = int(draw.rng.choice([0, 2, 3]))
    phase = float(draw.rng.uniform(-np.pi, np.pi)) if cycles else float(draw.rng.uniform(-0.8, 0.8))
    share = (1.0 if cycles else 3.0) * draw.amplitude * draw.size.modulation
    parameters = {"share": share, "cycles": float(cycles)}
    label = draw.label("structure", WAVES[0], draw.at(j), parameters, kinds=WAVES if j == 1 else WAVES[:1])
    return wave(label, draw.first + j, share, cycles, phase)


def wave(label: Label, joint: int, share: float, cycles: int, phase: float, width: float = 0.6) -> Effect:
    """Return a compliance that varies by a share, so often per turn; or one soft place at `phase`, `width` (rad)."""

    def varies(q: Float1D) -> float:
        angle = float(q[joint])
        if cycles:
            return share * np.sin(cycles * angle + phase)
        off = np.angle(np.exp(1j * (angle - phase)))
        return share * np.exp(-((off / width) ** 2))

    return modulated(label, joint, varies)
