"""Joint laws: how a joint's deflection follows its torque when it is no constant spring.

Each law gives the deflection besides C tau.  Torques are those that the joint's spring carries: weight and load.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calibration_core.timeseries import Float1D
from calibration_sim.effects.draw import Draw
from calibration_sim.effects.effect import At, Effect, Label, moving

ELEMENTS = (0.25, 0.5, 1.0, 2.0)  # stroke of each Maxwell element over the half width

Law = Callable[[float, float], float]  # torque (N*m) and compliance (rad/(N*m)) -> deflection besides C tau, rad


def spring(label: Label, joint: int, law: Law) -> Effect:
    """Return a joint (index) with a law that remembers nothing."""
    return moving(label, lambda torque, at: {joint: law(float(torque[joint]), float(at.compliance[joint]))})


def nonlinear_stiffness(draw: Draw) -> Effect:
    """A spring that hardens or softens."""
    j = draw.among(0, 1, 2, 3, 4)
    k = draw.sign() * draw.amplitude * draw.size.hardening
    reference = draw.size.rated_torque[j]
    parameters = {"stiffness_change": k, "reference_torque": reference}
    label = draw.label("joint law", "nonlinear_stiffness", draw.at(j), parameters)
    return spring(label, draw.first + j, hardening(k, reference))


def hardening(k: float, reference: float) -> Law:
    """Return a cubic spring, tau = K theta (1 + k (theta/theta_r)^2), theta_r = C tau_r, tau_r `reference` (N*m).

    Where k is negative and that would fold over, it is theta = C tau (1 - k (tau/tau_r)^2).
    """

    def law(torque: float, compliance: float) -> float:
        linear = torque / reference
        x = linear
        if k < 0.0:
            return -k * linear**3 * reference * compliance
        for _ in range(30):  # Newton's method
            x -= (x * (1.0 + k * x * x) - linear) / (1.0 + 3.0 * k * x * x)
        return (x - linear) * reference * compliance

    return law


def soft_zone(draw: Draw) -> Effect:
    """Three stiffnesses of a strain-wave gear."""
    j = draw.among(0, 1, 2, 3, 4)
    first = draw.amplitude * draw.size.soft
    low = draw.size.soft_torque * draw.size.rated_torque[j] * float(draw.rng.uniform(0.8, 1.25))
    high = low * float(draw.rng.uniform(1.8, 2.6))
    parameters = {"extra_compliance": first, "first_torque": low, "second_torque": high}
    label = draw.label("joint law", "soft_zone", draw.at(j), parameters)
    return spring(label, draw.first + j, three_stiffnesses(first, 0.3 * first, (low, high)))


def three_stiffnesses(first: float, second: float, torques: tuple[float, float]) -> Law:
    """Return K1 up to T1, K2 up to T2 (`torques`, N*m) and K3, as makers of strain-wave gears state them.

    `first` and `second` are 1/K1 and 1/K2 over 1/K3, minus one.
    """

    def law(torque: float, compliance: float) -> float:
        low, high = (float(np.clip(torque, -t, t)) for t in torques)
        return compliance * (first * low + second * (high - low))

    return law


def backlash(draw: Draw) -> Effect:
    """A clearance."""
    j = draw.among(0, 1, 2, 3, 4, 5)
    clearance = draw.amplitude * draw.size.clearance[j // 3]
    within = draw.size.clearance_torque * draw.size.rated_torque[j] * float(draw.rng.uniform(0.5, 2.0))
    label = draw.label("joint law", "backlash", draw.at(j), {"clearance": clearance})
    return spring(label, draw.first + j, dead_zone(clearance, within))


def dead_zone(clearance: float, within: float) -> Law:
    """Return a joint that lies at one flank or the other (rad apart), and crosses within a small torque (N*m)."""
    return lambda torque, _: 0.5 * clearance * float(np.clip(torque / within, -1.0, 1.0))


@dataclasses.dataclass(frozen=True, eq=False)
class JointLaw(Effect):
    """A law of one joint (index in the order of q) that remembers."""

    joint: int

    def deflect(self, memory: Any, torque: Float1D, at: At) -> Float1D:
        """Put the joint's own value in its place."""
        result = np.zeros(len(torque))
        result[self.joint] = self.extra(memory, float(torque[self.joint]), at)
        return result

    def extra(self, memory: Any, torque: float, at: At) -> float:
        """Return the deflection (rad) besides C tau under a torque (N*m)."""
        raise NotImplementedError


def hysteresis(draw: Draw) -> Effect:
    """Friction."""
    j = draw.among(0, 1, 2, 3, 4, 5)
    width = draw.amplitude * draw.size.friction[j // 3]
    label = draw.label("joint law", "hysteresis", draw.at(j), {"half_width": width})
    return MaxwellSlip(label, draw.first + j, width, draw.seed())


@dataclasses.dataclass(frozen=True, eq=False)
class MaxwellSlip(JointLaw):
    """Friction beside the gear's spring: four elements that stick, and slip beyond their stroke.

    tau = theta/C + sum_e k_e clip(theta - z_e, -stroke_e, stroke_e), z_e dragged along.  On arrival in a configuration
    the elements stand anywhere within their strokes, leaning to where the joint came from.

    Attributes:
        half_width: rad, deflection lost to friction while all elements slip.
        seed: Of the unknown start.
    """

    half_width: float
    seed: int

    def arrive(self, memory: Any, at: At) -> Any:
        """Draw how the elements stand, relative to the joint's deflection: a pair of (offsets, not yet placed)."""
        rng = np.random.default_rng((self.seed, at.index))
        strokes = self.half_width * np.array(ELEMENTS)
        lean = 0.5 * at.approach[self.joint]
        return (np.clip(lean + rng.uniform(-1.0, 1.0, len(strokes)), -1.0, 1.0) * strokes, None)

    def extra(self, memory: Any, torque: float, at: At) -> float:
        """Find the angle that carries the torque."""
        compliance = float(at.compliance[self.joint])
        return self._angle(memory, torque, compliance) - compliance * torque

    def settle(self, memory: Any, torque: Float1D, at: At) -> Any:
        """Drag the elements along."""
        theta = self._angle(memory, float(torque[self.joint]), float(at.compliance[self.joint]))
        offsets, anchors = memory
        strokes = self.half_width * np.array(ELEMENTS)
        stretch = offsets if anchors is None else np.clip(theta - anchors, -strokes, strokes)
        return (offsets, theta - stretch)

    def _angle(self, memory: Any, torque: float, compliance: float) -> float:
        offsets, anchors = memory
        strokes = self.half_width * np.array(ELEMENTS)
        stiffness = self.half_width / (len(strokes) * compliance) / strokes
        if anchors is None:  # nothing is known of what came before: the elements stand as drawn
            return compliance * (torque - float(stiffness @ offsets))
        # The law grows with the angle and is straight between the angles at which an element begins to slip.
        bends = np.sort(np.concatenate([anchors - strokes, anchors + strokes]))
        borne = bends / compliance + np.clip(bends[:, None] - anchors, -strokes, strokes) @ stiffness
        if torque <= borne[0]:
            return float(bends[0] - compliance * (borne[0] - torque))
        if torque >= borne[-1]:
            return float(bends[-1] + compliance * (torque - borne[-1]))
        return float(np.interp(torque, borne, bends))


def creep(draw: Draw) -> Effect:
    """Logarithmic creep."""
    j = draw.among(0, 1, 2, 3, 4)
    share = draw.amplitude * draw.size.creep
    label = draw.label("joint law", "creep", draw.at(j), {"share_per_decade": share})
    return LogCreep(label, draw.first + j, share, draw.size.creep_time)


@dataclasses.dataclass(frozen=True, eq=False)
class LogCreep(JointLaw):
    """Logarithmic creep: every change of torque goes on deflecting by eps C dtau log10(1 + t/T).

    Attributes:
        share: eps, per decade of time.
        constant: T, s.
        lead: s, from a change of load to its reading.
    """

    share: float
    constant: float
    lead: float = 10.0

    def begin(self, joints: int) -> Any:
        """Remember when the torque changed (k,), by how much (k,), and the last torque."""
        return np.zeros(0), np.zeros(0), 0.0

    def extra(self, memory: Any, torque: float, at: At) -> float:
        """Add up what all changes have crept by now; the change of this step begins half a step before."""
        when, changes, last = memory
        crept = float(changes @ self._grown(at.time - when)) + (torque - last) * float(self._grown(self.lead))
        return float(self.share * at.compliance[self.joint] * crept)

    def settle(self, memory: Any, torque: Float1D, at: At) -> Any:
        """Remember this step's change."""
        when, changes, last = memory
        now = float(torque[self.joint])
        return np.append(when, at.time - self.lead), np.append(changes, now - last), now

    def _grown(self, since: ArrayLike) -> Float1D:
        return np.log10(1.0 + np.asarray(since) / self.constant)
