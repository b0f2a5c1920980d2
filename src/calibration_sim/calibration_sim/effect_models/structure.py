"""Structure: what gives way that is no joint, and joints that do not give way as a constant spring."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.timeseries import Float1D, Float2D
from calibration_sim.effect_models.effect import At, Effect
from calibration_sim.mechanics.chain import Chain
from calibration_sim.mechanics.mjcf import Spring
from calibration_sim.mechanics.statics import SideTorque

BASE, BEAM, BEARING, TOOL = range(4)  # order of the springs that carry one link
GAUSS = (0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0))  # two stations integrate a cubic exactly


@dataclasses.dataclass(frozen=True, eq=False)
class Bearing(Effect):
    """A joint's bearing tilts: two springs across the axis, in principal directions.

    Attributes:
        joint: Index in the order of q.
        compliance: rad/(N*m) about the two principal directions; one spring is left out where it is zero.
        turn: rad, of the principal directions against x and y of the frame before the joint.
    """

    joint: int
    compliance: tuple[float, float]
    turn: float = 0.0

    def springs(self, chain: Chain) -> tuple[Spring, ...]:
        """Put two hinges before the joint."""
        link = next(link for link in chain.links if link.joint == chain.joints[self.joint])
        across = np.linalg.svd(link.axis[None, :])[2][1:] if abs(link.axis[2]) < 1.0 else np.eye(3)[:2]
        first = np.cos(self.turn) * across[0] + np.sin(self.turn) * across[1]
        second = np.cross(link.axis, first)
        return tuple(
            Spring(link.name, axis, np.zeros(3), 1.0 / c, rank=BEARING)
            for axis, c in zip((first, second), self.compliance, strict=True)
            if c > 0.0
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Beam(Effect):
    """A link bends and twists as an Euler-Bernoulli beam between its joint and the next, loaded at its end.

    The beam's compliance is an integral along it of at most the second degree; hinges at the two Gauss stations, each
    with half of the beam's compliance, give it exactly: u = F L^3/3EI + M L^2/2EI, phi = F L^2/2EI + M L/EI.

    Attributes:
        link: Index, 0 for what the first joint carries.
        bending: 1/EI in the two principal planes, 1/(N*m^2).
        torsion: 1/GJ, 1/(N*m^2).
        turn: rad, of the principal planes about the beam.
    """

    link: int
    bending: tuple[float, float]
    torsion: float
    turn: float = 0.0

    def springs(self, chain: Chain) -> tuple[Spring, ...]:
        """Put three hinges at each of two stations of the beam, carrying the next link."""
        child = chain.child_of(self.link)
        span = child.origin.rotation.T @ child.origin.translation  # along the beam, in the next link's axes
        length = float(np.linalg.norm(span))
        axes = _beam_axes(span / length, child.origin.rotation.T, self.turn)
        result = []
        for station in GAUSS:
            place = -(1.0 - station) * span
            for axis, c in zip(axes, (*self.bending, self.torsion), strict=True):
                if c > 0.0:
                    result.append(Spring(child.name, axis, place, 2.0 / (length * c), rank=BEAM))
        return tuple(result)


def _beam_axes(along: Float1D, body: Float2D, turn: float) -> tuple[Float1D, Float1D, Float1D]:
    """Return two axes across the beam and the one along it; `body` has the link's own axes as columns."""
    least = body[:, int(np.argmin(np.abs(along @ body)))]
    across = np.cross(along, least)
    across = across / np.linalg.norm(across)
    other = np.cross(along, across)
    return np.cos(turn) * across + np.sin(turn) * other, np.cos(turn) * other - np.sin(turn) * across, along


@dataclasses.dataclass(frozen=True, eq=False)
class Base(Effect):
    """Pedestal and anchors give way.

    Attributes:
        rotation: rad/(N*m) about the base axes.
        translation: m/N along them.
        height: m, of the pivot above the base frame's origin.
    """

    rotation: tuple[float, float, float]
    translation: tuple[float, float, float]
    height: float = 0.0

    def springs(self, chain: Chain) -> tuple[Spring, ...]:
        """Put up to six springs under the first link."""
        first = next(link for link in chain.links if link.parent == -1)
        pivot = first.origin.inverse_apply(np.array([0.0, 0.0, self.height]))
        return _six(first.name, first.origin.rotation.T, pivot, self.rotation, self.translation, BASE)


@dataclasses.dataclass(frozen=True, eq=False)
class Tool(Effect):
    """Flange and adapter give way: everything beyond them moves.

    Attributes:
        rotation: rad/(N*m) about the flange axes.
        translation: m/N along them.
    """

    rotation: tuple[float, float, float]
    translation: tuple[float, float, float]

    def springs(self, chain: Chain) -> tuple[Spring, ...]:
        """Put up to six springs before the flange."""
        name = chain.links[chain.flange].name
        return _six(name, np.eye(3), np.zeros(3), self.rotation, self.translation, TOOL)


def _six(
    link: str,
    axes: Float2D,
    place: Float1D,
    rotation: tuple[float, float, float],
    translation: tuple[float, float, float],
    rank: int,
) -> tuple[Spring, ...]:
    slides = [
        Spring(link, axes[:, k], place, 1.0 / c, slides=True, rank=rank) for k, c in enumerate(translation) if c > 0.0
    ]
    turns = [Spring(link, axes[:, k], place, 1.0 / c, rank=rank) for k, c in enumerate(rotation) if c > 0.0]
    return (*slides, *turns)


@dataclasses.dataclass(frozen=True, eq=False)
class Coupling(Effect):
    """Two joints share a gear train: the torque of one deflects the other, symmetrically.

    Attributes:
        joints: Indices in the order of q.
        compliance: rad/(N*m).
    """

    joints: tuple[int, int]
    compliance: float

    def deflect(self, memory: None, torque: Float1D, at: At) -> Float1D:
        """Cross over."""
        i, j = self.joints
        result = np.zeros(len(torque))
        result[i], result[j] = self.compliance * torque[j], self.compliance * torque[i]
        return result


@dataclasses.dataclass(frozen=True, eq=False)
class Modulated(Effect):
    """A joint's compliance varies with its own angle, C (1 + a cos q + b sin q + ripple cos 3q).

    Attributes:
        joint: Index in the order of q.
        cosine: a.
        sine: b.
        ripple: Share that a first harmonic does not describe.
    """

    joint: int
    cosine: float
    sine: float
    ripple: float = 0.0

    def deflect(self, memory: None, torque: Float1D, at: At) -> Float1D:
        """Give way more or less."""
        result = np.zeros(len(torque))
        j = self.joint
        angle = at.q[j]
        share = self.cosine * np.cos(angle) + self.sine * np.sin(angle) + self.ripple * np.cos(3.0 * angle)
        result[j] = share * at.compliance[j] * torque[j]
        return result


@dataclasses.dataclass(frozen=True, eq=False)
class Compensator(Effect):
    """A preloaded spring between the carousel and the upper arm carries part of the arm's weight.

    A real triangle: one end at distance `anchor` from the joint on the lower link, at angle `angle`; the other end at
    distance `arm` on the upper one, at angle q; force K_c (s - s0) along the spring of length s.  Its moment about the
    joint is K_c (s - s0) anchor arm sin(angle - q)/s (law of sines).

    Attributes:
        joint: Index in the order of q.
        anchor: m.
        arm: m.
        angle: rad, of the anchor's direction against the arm's at q = 0.
        stiffness: K_c, N/m.
        free_length: s0, m.
    """

    joint: int
    anchor: float
    arm: float
    angle: float
    stiffness: float
    free_length: float

    def torque(self, q: float) -> float:
        """Return the torque (N*m) on the upper link at link angle q (rad), about the joint's axis."""
        between = self.angle - q
        length = np.sqrt(self.anchor**2 + self.arm**2 - 2.0 * self.anchor * self.arm * np.cos(between))
        pull = self.stiffness * (length - self.free_length)
        return float(pull * self.anchor * self.arm * np.sin(between) / length)

    def side_torques(self, at: At) -> tuple[SideTorque, ...]:
        """Pull at the arm."""
        return (SideTorque(self.joint, self.torque),)
