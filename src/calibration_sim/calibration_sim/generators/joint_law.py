"""Draws joint laws."""

from __future__ import annotations

from calibration_sim.effect_models import joints
from calibration_sim.effect_models.effect import Effect, Label
from calibration_sim.generators.draw import Draw, at_joint


def nonlinear_stiffness(draw: Draw) -> Effect:
    """A spring that hardens or softens."""
    j = draw.among(0, 1, 2, 3, 4)
    k = draw.sign() * draw.amplitude * draw.size.hardening
    reference = draw.size.rated_torque[j]
    parameters = {"stiffness_change": k, "reference_torque": reference}
    label = Label("joint law", "nonlinear_stiffness", at_joint(j), draw.amplitude, parameters)
    return joints.Hardening(label, j, k, reference)


def soft_zone(draw: Draw) -> Effect:
    """Three stiffnesses of a strain-wave gear."""
    j = draw.among(0, 1, 2, 3, 4)
    first = draw.amplitude * draw.size.soft
    low = draw.size.soft_torque * draw.size.rated_torque[j] * float(draw.rng.uniform(0.8, 1.25))
    high = low * float(draw.rng.uniform(1.8, 2.6))
    parameters = {"extra_compliance": first, "first_torque": low, "second_torque": high}
    label = Label("joint law", "soft_zone", at_joint(j), draw.amplitude, parameters)
    return joints.SoftZone(label, j, first, 0.3 * first, (low, high))


def backlash(draw: Draw) -> Effect:
    """A clearance."""
    j = draw.among(0, 1, 2, 3, 4, 5)
    clearance = draw.amplitude * draw.size.clearance[j // 3]
    within = draw.size.clearance_torque * draw.size.rated_torque[j] * float(draw.rng.uniform(0.5, 2.0))
    label = Label("joint law", "backlash", at_joint(j), draw.amplitude, {"clearance": clearance})
    return joints.DeadZone(label, j, clearance, within)


def hysteresis(draw: Draw) -> Effect:
    """Friction."""
    j = draw.among(0, 1, 2, 3, 4, 5)
    width = draw.amplitude * draw.size.friction[j // 3]
    label = Label("joint law", "hysteresis", at_joint(j), draw.amplitude, {"half_width": width})
    return joints.MaxwellSlip(label, j, width, draw.seed())


def creep(draw: Draw) -> Effect:
    """Logarithmic creep."""
    j = draw.among(0, 1, 2, 3, 4)
    share = draw.amplitude * draw.size.creep
    label = Label("joint law", "creep", at_joint(j), draw.amplitude, {"share_per_decade": share})
    return joints.LogCreep(label, j, share, draw.size.creep_time)
