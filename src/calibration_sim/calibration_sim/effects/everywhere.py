"""Causes that every joint has a little of, each joint by its own share; the location is all joints."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from calibration_core.timeseries import Float1D
from calibration_sim.effects import joints
from calibration_sim.effects.absolute import elastic_joints, uneven_gear
from calibration_sim.effects.draw import Draw
from calibration_sim.effects.effect import At, Effect

ALL = {"joints": "all"}
JOINTS = 6


@dataclasses.dataclass(frozen=True, eq=False)
class Together(Effect):
    """Laws of joints that act together under one label.

    Attributes:
        parts: The laws; their own labels say nothing.
    """

    parts: tuple[Effect, ...]

    def begin(self, joints: int) -> Any:
        """Return what each part remembers."""
        return tuple(part.begin(joints) for part in self.parts)

    def arrive(self, memory: Any, at: At) -> Any:
        """Let each part arrive."""
        return tuple(part.arrive(own, at) for part, own in zip(self.parts, memory, strict=True))

    def deflect(self, memory: Any, torque: Float1D, at: At) -> Float1D:
        """Add up."""
        shifts = [part.deflect(own, torque, at) for part, own in zip(self.parts, memory, strict=True)]
        return np.asarray(np.sum([shift for shift in shifts if shift is not None], axis=0))

    def settle(self, memory: Any, torque: Float1D, at: At) -> Any:
        """Let each part remember."""
        return tuple(part.settle(own, torque, at) for part, own in zip(self.parts, memory, strict=True))


def _shares(draw: Draw) -> list[float]:
    """Return how much each joint has of it: gamma distributed about one, no joint without."""
    return [float(0.2 + 0.8 * value) for value in draw.rng.gamma(2.0, 0.5, JOINTS)]


def _each(draw: Draw, effect: str, maker: Callable[[Draw], Effect], last: int) -> Effect:
    scaled = [
        dataclasses.replace(draw, place=j, amplitude=draw.amplitude * share) for j, share in enumerate(_shares(draw))
    ]
    return Together(draw.label("joint law", effect, ALL), tuple(maker(one) for one in scaled)[:last])


def every_gear(draw: Draw) -> Effect:
    """Gears with many small orders, at every joint."""
    label, parts = draw.label("absolute", "transmission_error", ALL), []
    for j, share in enumerate(_shares(draw)):
        orders = draw.rng.choice(np.arange(2, 14), 4, replace=False)
        size = draw.amplitude * share * draw.size.transmission / np.sqrt(2.0)
        terms = tuple((int(k), size * float(draw.rng.rayleigh(0.7)), float(draw.rng.uniform(0, 6.28))) for k in orders)
        parts.append(uneven_gear(label, draw.first + j, terms))
    return Together(label, tuple(parts))


def every_friction(draw: Draw) -> Effect:
    """Friction at every joint."""
    return _each(draw, "hysteresis", joints.hysteresis, JOINTS)


def every_soft_zone(draw: Draw) -> Effect:
    """Strain-wave gears at every joint but the last, which carries next to nothing."""
    return _each(draw, "soft_zone", joints.soft_zone, JOINTS - 1)


def every_spring(draw: Draw) -> Effect:
    """Joints that are softer than typical, each by its own share, of which the file says nothing."""
    label = draw.label("absolute", "joint_elasticity", ALL)
    return elastic_joints(label, draw.amplitude * np.array([1.0] * draw.first + _shares(draw)))
