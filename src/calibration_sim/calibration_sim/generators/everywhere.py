"""Draws causes that every joint has a little of, each joint by its own share; the location is all joints."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from calibration_sim.cell.truth import Truth
from calibration_sim.effect_models.absolute import ElasticJoints, TransmissionError
from calibration_sim.effect_models.effect import Effect, Label
from calibration_sim.effect_models.together import Together
from calibration_sim.generators import joint_law
from calibration_sim.generators.draw import Draw

ALL = {"joints": "all"}
JOINTS = 6


def _shares(draw: Draw) -> list[float]:
    """Return how much each joint has of it: gamma distributed about one, no joint without."""
    return [float(0.2 + 0.8 * value) for value in draw.rng.gamma(2.0, 0.5, JOINTS)]


def _each(draw: Draw, maker: Callable[[Draw], Effect]) -> tuple[Effect, ...]:
    scaled = [
        dataclasses.replace(draw, place=j, amplitude=draw.amplitude * share) for j, share in enumerate(_shares(draw))
    ]
    return tuple(maker(one) for one in scaled)


def every_gear(draw: Draw) -> Effect:
    """Gears with many small orders, at every joint."""
    parts = []
    for j, share in enumerate(_shares(draw)):
        orders = draw.rng.choice(np.arange(2, 14), 4, replace=False)
        size = draw.amplitude * share * draw.size.transmission / np.sqrt(2.0)
        terms = tuple((int(k), size * float(draw.rng.rayleigh(0.7)), float(draw.rng.uniform(0, 6.28))) for k in orders)
        parts.append(TransmissionError(Label("absolute", "transmission_error", ALL), j, terms))
    return Together(Label("absolute", "transmission_error", ALL, draw.amplitude), tuple(parts))


def every_friction(draw: Draw) -> Effect:
    """Friction at every joint."""
    return Together(Label("joint law", "hysteresis", ALL, draw.amplitude), _each(draw, joint_law.hysteresis))


def every_soft_zone(draw: Draw) -> Effect:
    """Strain-wave gears at every joint but the last, which carries next to nothing."""
    return Together(Label("joint law", "soft_zone", ALL, draw.amplitude), _each(draw, joint_law.soft_zone)[:-1])


@dataclasses.dataclass(frozen=True, eq=False)
class _Unevenly(ElasticJoints):
    """Joints that are softer than typical, each by its own share, of which the cell file knows nothing.

    Attributes:
        shares: One per joint.
    """

    shares: tuple[float, ...]

    def change_truth(self, truth: Truth) -> Truth:
        """Soften each joint."""
        return dataclasses.replace(truth, stiffness=truth.stiffness / (self.share * np.array(self.shares)))


def every_spring(draw: Draw) -> Effect:
    """Joints that sag, of which the file says nothing."""
    label = Label("absolute", "joint_elasticity", ALL, draw.amplitude)
    return _Unevenly(label, draw.amplitude, tuple(_shares(draw)))
