"""Laws of a kind that the catalogue has, in a shape that it has not: other friction, other knees, other waves."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from calibration_core.timeseries import Float1D
from calibration_sim.effect_models.effect import At, Effect
from calibration_sim.effect_models.joints import JointLaw

Friction = tuple[float, float]  # state within -1 ... 1, torque (N*m) at which it stood


@dataclasses.dataclass(frozen=True, eq=False)
class _Sliding(JointLaw):
    """Friction with one state, which every change of torque drags towards its own side.

    Attributes:
        reversal: N*m, change of torque that turns the state over.
        seed: Of the unknown state on arrival.
    """

    reversal: float
    seed: int

    def begin(self, joints: int) -> Friction:
        """Stand in the middle; the first arrival says more."""
        return (0.0, 0.0)

    def arrive(self, memory: Friction, at: At) -> Friction | tuple[float, None]:
        """Stand anywhere, leaning to where the joint came from; the torque is that of the first step."""
        rng = np.random.default_rng((self.seed, at.index))
        return (float(np.clip(0.5 * at.approach[self.joint] + rng.uniform(-1.0, 1.0), -1.0, 1.0)), None)

    def settle(self, memory: Any, torque: Float1D, at: At) -> Friction:
        """Be dragged along."""
        now = float(torque[self.joint])
        return (self._dragged(memory, now), now)

    def _dragged(self, memory: Any, torque: float) -> float:
        state, last = memory
        return float(state) if last is None else self.drag(float(state), torque - float(last))

    def drag(self, state: float, change: float) -> float:
        """Return the state after a change of torque (N*m)."""
        return float(np.clip(state + change / self.reversal, -1.0, 1.0))


@dataclasses.dataclass(frozen=True, eq=False)
class WedgeFriction(_Sliding):
    """Friction of toothed gears: the loop opens with the load, half width w |tau|/tau_r.

    Attributes:
        half_width: rad, at the reference torque.
        reference: tau_r, N*m.
    """

    half_width: float
    reference: float

    def extra(self, memory: Any, torque: float, at: At) -> float:
        """Lag by as much as the teeth press."""
        return -self.half_width * abs(torque) / self.reference * self._dragged(memory, torque)


@dataclasses.dataclass(frozen=True, eq=False)
class DahlFriction(_Sliding):
    """Friction after Dahl (1968): the state approaches its own side exponentially with the change of torque.

    Attributes:
        half_width: rad.
    """

    half_width: float

    def drag(self, state: float, change: float) -> float:
        """Approach one or minus one."""
        return float(np.sign(change) + (state - np.sign(change)) * np.exp(-abs(change) / self.reversal))

    def extra(self, memory: Any, torque: float, at: At) -> float:
        """Lag."""
        return -self.half_width * self._dragged(memory, torque)


@dataclasses.dataclass(frozen=True, eq=False)
class UnevenFriction(_Sliding):
    """Friction that holds back more in one direction than in the other, as worm gears and worn seals do.

    Attributes:
        half_widths: rad, of a state above zero and of one below.
    """

    half_widths: tuple[float, float]

    def extra(self, memory: Any, torque: float, at: At) -> float:
        """Lag by as much as the direction holds back."""
        state = self._dragged(memory, torque)
        return -self.half_widths[state < 0.0] * state


@dataclasses.dataclass(frozen=True, eq=False)
class PowerLaw(JointLaw):
    """Contacts that flatten: C tau_r share sign(tau) |tau/tau_r|^p (Hertz: p = 2/3).

    Attributes:
        share: Of the linear deflection at the reference torque.
        reference: tau_r, N*m.
        power: p.
    """

    share: float
    reference: float
    power: float

    def extra(self, memory: None, torque: float, at: At) -> float:
        """Follow the power of the torque."""
        size = self.share * self.reference * float(at.compliance[self.joint])
        return size * float(np.sign(torque)) * abs(torque / self.reference) ** self.power


@dataclasses.dataclass(frozen=True, eq=False)
class LostPreload(JointLaw):
    """A bearing whose preload is lost beyond a torque: more compliance from there on.

    Attributes:
        share: Additional compliance over C.
        beyond: N*m.
    """

    share: float
    beyond: float

    def extra(self, memory: None, torque: float, at: At) -> float:
        """Add what lies beyond."""
        over = float(np.sign(torque)) * max(0.0, abs(torque) - self.beyond)
        return self.share * float(at.compliance[self.joint]) * over


@dataclasses.dataclass(frozen=True, eq=False)
class OneSided(JointLaw):
    """A gear that is softer on one flank: more compliance for torques of one sign.

    Attributes:
        share: Additional compliance over C.
        side: The sign, 1 or -1.
    """

    share: float
    side: float

    def extra(self, memory: None, torque: float, at: At) -> float:
        """Add what the soft flank gives."""
        return self.share * float(at.compliance[self.joint]) * self.side * max(0.0, self.side * torque)


@dataclasses.dataclass(frozen=True, eq=False)
class OtherWave(Effect):
    """A joint's compliance varies with its angle by another wave than one cycle per revolution.

    Attributes:
        joint: Index in the order of q.
        share: Of the joint's compliance.
        cycles: Per revolution; 0: one soft place instead.
        phase: rad, or where the soft place is.
        width: rad, of the soft place.
    """

    joint: int
    share: float
    cycles: int
    phase: float
    width: float = 0.6

    def deflect(self, memory: None, torque: Float1D, at: At) -> Float1D:
        """Give way more or less."""
        result = np.zeros(len(torque))
        j, angle = self.joint, float(at.q[self.joint])
        if self.cycles:
            wave = np.sin(self.cycles * angle + self.phase)
        else:
            off = np.angle(np.exp(1j * (angle - self.phase)))
            wave = np.exp(-((off / self.width) ** 2))
        result[j] = self.share * wave * at.compliance[j] * torque[j]
        return result
