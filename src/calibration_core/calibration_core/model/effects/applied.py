"""Effects that a model already contains: from their description back to what they do to a recording."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.model.effects import candidates
from calibration_core.model.effects.approach_direction import approach
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.state import State
from calibration_core.model.effects.transmission_error import harmonic, order_of
from calibration_core.model.parameters import AppliedEffect
from calibration_core.timeseries import Float1D, Float2D

RELATIVE = frozenset({"backlash", "hysteresis", "nonlinear_stiffness", "soft_zone"})  # to the largest torque
REFERENCE = "reference_torque"


def applied(candidate: Candidate, value: Float1D, state: State) -> AppliedEffect:
    """Describe a candidate with its fitted parameters, (k,) in its units.

    A law that is relative to the largest torque of the recording keeps this torque, so that it stays the same law on
    another recording.
    """
    parameters = {p.name: float(v) for p, v in zip(candidate.parameters, value, strict=True)}
    if candidate.effect in RELATIVE:
        joint = state.chain.joints.index(str(candidate.location["joint"]))
        parameters[REFERENCE] = state.largest_torque(joint, candidate.variant)
    return AppliedEffect(candidate.effect, candidate.location, candidate.variant, parameters)


def restored(effect: AppliedEffect, state: State) -> Candidate:
    """Return the candidate that a description means, for the given recording.

    Raises:
        ValueError: This recording cannot carry it, for example because it has no temperatures.
    """
    joints = state.chain.joints
    if effect.effect == "transmission_error":
        name = str(effect.location["joint"])
        return harmonic(joints.index(name), name, order_of(effect.variant), state.rated_load)
    if effect.effect == "approach_direction":
        names = [key.removeprefix("half_width").strip() or effect.location["joint"] for key in effect.parameters]
        return approach(state, tuple(joints.index(str(name)) for name in names), effect.location)
    key = (effect.effect, tuple(sorted(effect.location.items())), effect.variant)
    for candidate in candidates(state):
        if candidate.key == key:
            return candidate
    msg = f"{effect.effect} ({effect.variant}) at {dict(effect.location)} cannot be evaluated on this recording"
    raise ValueError(msg)


def applied_shift(effects: Sequence[AppliedEffect], state: State) -> Float2D:
    """Return the (m, 3) m, base axes, that the effects move the measured points.

    Raises:
        ValueError: As `restored`.
    """
    shift = np.zeros((state.m, 3))
    for effect in effects:
        own = state
        if REFERENCE in effect.parameters:
            own = dataclasses.replace(state, reference_torque=np.full((2, state.chain.n), effect.parameters[REFERENCE]))
        candidate = restored(effect, state)
        value = np.array([effect.parameters[p.name] for p in candidate.parameters])
        shift += candidate.columns(own) @ value
    return shift
