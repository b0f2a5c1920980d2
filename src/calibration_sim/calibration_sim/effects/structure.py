"""Structure: what gives way that is no joint, and joints that do not give way as a constant spring."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.timeseries import Float1D, Float2D
from calibration_sim.effects.draw import Draw
from calibration_sim.effects.effect import At, Effect, Label, modulated, moving
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


def coupling(label: Label, pair: tuple[int, int], compliance: float) -> Effect:
    """Return two joints that share a gear train: the torque of one deflects the other, rad/(N*m), symmetrically."""
    i, j = pair
    return moving(label, lambda torque, at: {i: compliance * torque[j], j: compliance * torque[i]})


def waving(label: Label, joint: int, cosine: float, sine: float, ripple: float = 0.0) -> Effect:
    """Return a compliance that varies with its joint's angle, C (1 + cosine cos q + sine sin q + ripple cos 3q)."""

    def wave(q: Float1D) -> float:
        angle = q[joint]
        return cosine * np.cos(angle) + sine * np.sin(angle) + ripple * np.cos(3.0 * angle)

    return modulated(label, joint, wave)


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


def off_axis_compliance(draw: Draw) -> Effect:
    """Bearings that tilt, anisotropic."""
    j = draw.among(0, 1, 2, 3, 4, 5)
    pair = draw.pair(draw.amplitude * (draw.size.bearing if j < 3 else draw.size.wrist_bearing))
    turn = draw.twist()
    alike: tuple[tuple[str, dict[str, str]], ...] = ()
    if j == 0:
        alike = (("base_compliance", {"base": "base"}),)
    elif pair[0] == pair[1] and j >= 2:
        alike = (("off_axis_compliance", draw.at({2: 3, 3: 2, 4: 5, 5: 4}[j])),)
    parameters = {"compliance_x": pair[0], "compliance_y": pair[1]}
    label = draw.label("structure", "off_axis_compliance", draw.at(j), parameters, alike, same_law=turn == 0.0)
    return Bearing(label, draw.first + j, pair, turn)


def link_bending(draw: Draw) -> Effect:
    """A beam, with unequal sides and torsion."""
    link = draw.among(*draw.size.beams)
    size = draw.amplitude * draw.size.bending
    pair = draw.pair(size)
    torsion = 0.0 if draw.plain else float(size * draw.rng.uniform(0.5, 1.5))
    parameters = {"bending_1": pair[0], "bending_2": pair[1], "torsion": torsion}
    label = draw.label("structure", "link_bending", draw.link(link), parameters)
    return Beam(label, draw.first + link, pair, torsion, draw.twist())


def base_compliance(draw: Draw) -> Effect:
    """A pedestal that rocks, and gives way a little sideways."""
    size = draw.amplitude * draw.size.base_rotation
    about = (*draw.pair(size), 0.0 if draw.plain else 0.3 * size)
    along = (0.0, 0.0, 0.0) if draw.plain else (draw.amplitude * draw.size.base_translation,) * 3
    parameters = {f"rotation_{axis}": value for axis, value in zip("xyz", about, strict=True)}
    alike = (("off_axis_compliance", draw.at(0)),)
    label = draw.label("structure", "base_compliance", {"base": "base"}, parameters, alike, same_law=True)
    return Base(label, about, along)


def tool_compliance(draw: Draw) -> Effect:
    """An adapter that tilts."""
    size = draw.amplitude * draw.size.tool_rotation
    about = (*draw.pair(size), 0.5 * size)
    along = (draw.amplitude * draw.size.tool_translation,) * 3
    parameters = {f"rotation_{axis}": value for axis, value in zip("xy", about[:2], strict=True)}
    return Tool(draw.label("structure", "tool_compliance", {"tool": "tool"}, parameters, same_law=True), about, along)


def joint_coupling(draw: Draw) -> Effect:
    """Wrist gear train or parallelogram."""
    i = draw.among(1, 3, 4)
    mean = 1.0 / np.sqrt(draw.stiffness[i] * draw.stiffness[i + 1])
    value = draw.sign() * draw.amplitude * draw.size.coupling * float(mean)
    location = {"joints": [draw.at(i)["joint"], draw.at(i + 1)["joint"]]}
    label = draw.label("structure", "joint_coupling", location, {"compliance": value}, same_law=True)
    return coupling(label, (draw.first + i, draw.first + i + 1), value)


def pose_dependent_stiffness(draw: Draw) -> Effect:
    """A gear that is stiffer at some angles."""
    j = draw.among(0, 1, 2, 3, 4)
    phase = draw.rng.uniform(0.0, 2.0 * np.pi)
    size = draw.amplitude * draw.size.modulation
    a, b = size * float(np.cos(phase)), size * float(np.sin(phase))
    ripple = 0.0 if draw.plain or draw.rng.random() < 0.5 else 0.3 * size
    alike = (("gravity_compensator", draw.at(1)),) if j == 1 else ()
    location, parameters = draw.at(j), {"cosine": a, "sine": b}
    same = ripple == 0.0
    label = draw.label("structure", "pose_dependent_stiffness", location, parameters, alike, same_law=same)
    return waving(label, draw.first + j, a, b, ripple)


def gravity_compensator(draw: Draw) -> Effect:
    """A spring of real geometry beside joint 2."""
    anchor, arm, stiffness, free = draw.size.compensator
    angle = float(draw.rng.uniform(-0.15, 0.15))
    stiffness *= draw.amplitude
    parameters = {"anchor": anchor, "arm": arm, "spring": stiffness, "angle": angle}
    label = draw.label("structure", "gravity_compensator", draw.at(1), parameters)
    return Compensator(label, draw.first + 1, anchor, arm, angle, stiffness, free)
