"""Draws laws of other shapes than the catalogue's; the label says of which kind they are."""

from __future__ import annotations

import numpy as np

from calibration_sim.effect_models import other_shapes
from calibration_sim.effect_models.effect import Effect, Label
from calibration_sim.generators.draw import Draw, at_joint

KNEES = ("nonlinear_stiffness", "soft_zone", "backlash")
WAVES = ("pose_dependent_stiffness", "gravity_compensator")


def _knee(draw: Draw, joint: int, **parameters: float) -> Label:
    return Label("joint law", KNEES[0], at_joint(joint), draw.amplitude, parameters, kinds=KNEES)


def _friction(draw: Draw, joint: int, width: float) -> Label:
    kinds = ("hysteresis",)
    return Label("joint law", kinds[0], at_joint(joint), draw.amplitude, {"half_width": width}, kinds=kinds)


def wedge_friction(draw: Draw) -> Effect:
    """Friction that grows with the load."""
    j = draw.among(0, 1, 2, 3, 4)
    width = 1.5 * draw.amplitude * draw.size.friction[j // 3]
    reference = draw.size.rated_torque[j]
    reversal = reference * float(draw.rng.uniform(0.1, 0.3))
    return other_shapes.WedgeFriction(_friction(draw, j, width), j, reversal, draw.seed(), width, reference)


def dahl_friction(draw: Draw) -> Effect:
    """Friction whose state approaches its side exponentially."""
    j = draw.among(0, 1, 2, 3, 4)
    width = draw.amplitude * draw.size.friction[j // 3]
    reversal = draw.size.rated_torque[j] * float(draw.rng.uniform(0.08, 0.4))
    return other_shapes.DahlFriction(_friction(draw, j, width), j, reversal, draw.seed(), width)


def uneven_friction(draw: Draw) -> Effect:
    """Friction that differs between the directions."""
    j = draw.among(0, 1, 2, 3, 4)
    width = draw.amplitude * draw.size.friction[j // 3]
    reversal = draw.size.rated_torque[j] * float(draw.rng.uniform(0.08, 0.4))
    weaker = width * float(draw.rng.uniform(0.2, 0.7))
    widths = (width, weaker) if draw.sign() > 0 else (weaker, width)
    return other_shapes.UnevenFriction(_friction(draw, j, width), j, reversal, draw.seed(), widths)


def power_law(draw: Draw) -> Effect:
    """Contacts that flatten, or a mount that gives way ever more."""
    j = draw.among(0, 1, 2, 3, 4)
    power = float(draw.rng.choice([0.55, 2.0 / 3.0, 1.7, 2.5]))
    share = draw.amplitude * draw.size.hardening
    label = _knee(draw, j, power=power, share=share)
    return other_shapes.PowerLaw(label, j, share, draw.size.rated_torque[j], power)


def lost_preload(draw: Draw) -> Effect:
    """A knee at a high torque."""
    j = draw.among(0, 1, 2, 3, 4)
    share = 0.4 * draw.amplitude
    beyond = draw.size.rated_torque[j] * float(draw.rng.uniform(0.35, 0.6))
    return other_shapes.LostPreload(_knee(draw, j, share=share, beyond=beyond), j, share, beyond)


def one_sided(draw: Draw) -> Effect:
    """A soft flank."""
    j = draw.among(0, 1, 2, 3, 4)
    share, side = 0.2 * draw.amplitude, draw.sign()
    return other_shapes.OneSided(_knee(draw, j, share=share, side=side), j, share, side)


def other_wave(draw: Draw) -> Effect:
    """Compliance that follows twice or three times the angle, or has one soft place."""
    j = draw.among(0, 1, 2, 3, 4)
    cycles = int(draw.rng.choice([0, 2, 3]))
    phase = float(draw.rng.uniform(-np.pi, np.pi)) if cycles else float(draw.rng.uniform(-0.8, 0.8))
    share = (1.0 if cycles else 3.0) * draw.amplitude * draw.size.modulation
    label = Label(
        "structure",
        WAVES[0],
        at_joint(j),
        draw.amplitude,
        {"share": share, "cycles": float(cycles)},
        kinds=WAVES if j == 1 else WAVES[:1],
    )
    return other_shapes.OtherWave(label, j, share, cycles, phase)
