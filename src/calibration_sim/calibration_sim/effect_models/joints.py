"""Joint laws: how a joint's deflection follows its torque when it is no constant spring.

Each law gives the deflection besides C tau.  Torques are those that the joint's spring carries: weight and load.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calibration_core.timeseries import Float1D
from calibration_sim.effect_models.effect import At, Effect

ELEMENTS = (0.25, 0.5, 1.0, 2.0)  # stroke of each Maxwell element over the half width


@dataclasses.dataclass(frozen=True, eq=False)
class JointLaw(Effect):
    """A law of one joint.

    Attributes:
        joint: Index in the order of q.
    """

    joint: int

    def deflect(self, memory: Any, torque: Float1D, at: At) -> Float1D:
        """Put the joint's own value in its place."""
        result = np.zeros(len(torque))
        result[self.joint] = self.extra(memory, float(torque[self.joint]), at)
        return result

    def extra(self, memory: Any, torque: float, at: At) -> float:
        """Return the deflection (rad) besides C tau under a torque (N*m)."""
        return 0.0


@dataclasses.dataclass(frozen=True, eq=False)
class Hardening(JointLaw):
    """A cubic spring, tau = K theta (1 + k (theta/theta_r)^2); softening, where that would fold over, the inverse.

    Attributes:
        k: Relative change of the secant stiffness at the reference torque; where it is negative, the law is
            theta = C tau (1 - k (tau/tau_r)^2).
        reference: Reference torque tau_r, N*m; theta_r = C times it.
    """

    k: float
    reference: float

    def extra(self, memory: None, torque: float, at: At) -> float:
        """Solve the cubic for the angle by Newton's method."""
        linear = torque / self.reference
        x = linear
        if self.k < 0.0:
            return float(-self.k * linear**3 * self.reference * at.compliance[self.joint])
        for _ in range(30):
            x -= (x * (1.0 + self.k * x * x) - linear) / (1.0 + 3.0 * self.k * x * x)
        return float((x - linear) * self.reference * at.compliance[self.joint])


@dataclasses.dataclass(frozen=True, eq=False)
class SoftZone(JointLaw):
    """Three stiffnesses one after another, as makers of strain-wave gears state them: K1 up to T1, K2 up to T2, K3.

    Attributes:
        first: 1/K1 over 1/K3, minus one.
        second: 1/K2 over 1/K3, minus one.
        torques: T1 and T2, N*m.
    """

    first: float
    second: float
    torques: tuple[float, float]

    def extra(self, memory: None, torque: float, at: At) -> float:
        """Add what the softer ranges give."""
        low, high = (float(np.clip(torque, -t, t)) for t in self.torques)
        return float(at.compliance[self.joint]) * (self.first * low + self.second * (high - low))


@dataclasses.dataclass(frozen=True, eq=False)
class DeadZone(JointLaw):
    """Clearance: the joint lies at one flank or the other, and crosses within a small torque.

    Attributes:
        clearance: rad, from flank to flank.
        within: N*m, torque at which a flank carries.
    """

    clearance: float
    within: float

    def extra(self, memory: None, torque: float, at: At) -> float:
        """Lie at a flank."""
        return 0.5 * self.clearance * float(np.clip(torque / self.within, -1.0, 1.0))


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

    def begin(self, joints: int) -> Any:
        """Remember nothing yet; the first arrival sets the elements."""
        return np.zeros(len(ELEMENTS))

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


@dataclasses.dataclass(frozen=True, eq=False)
class LogCreep(JointLaw):
    """Logarithmic creep: every change of torque goes on deflecting by eps C dtau log10(1 + t/T).

    Attributes:
        share: eps, per decade of time.
        constant: T, s.
    """

    share: float
    constant: float

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

    @property
    def lead(self) -> float:
        """Time (s) from a change of load to its reading."""
        return 10.0

    def _grown(self, since: ArrayLike) -> Float1D:
        return np.log10(1.0 + np.asarray(since) / self.constant)
