"""Effects that a model already contains: from their description back to what they do to a recording."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration_core.model.effects import effect_named, effects_with
from calibration_core.model.effects.candidate import Candidate, Trait
from calibration_core.model.effects.recordings import RECORDING, in_recording
from calibration_core.model.effects.state import State
from calibration_core.model.parameters import AppliedEffect
from calibration_core.timeseries import Float1D, Float2D

Acting = tuple[tuple[Candidate, Float1D], ...]  # effects that act on joints, with their parameters


def acting(candidates: Sequence[Candidate], values: Sequence[Float1D]) -> Acting:
    """Return those of several effects, (k,) parameters each, that act on a joint with a torque."""
    several = zip(candidates, values, strict=True)
    return tuple((one, value) for one, value in several if one.torques is not None and np.any(value))


def with_side_torques(state: State, springs: Acting) -> State:
    """Return a state in which joints carry the torques of springs beside them, too."""
    if not springs:
        return state if state.side_torque is None else dataclasses.replace(state, side_torque=None)
    side = np.zeros((state.chain.n, state.m))
    for candidate, value in springs:
        if candidate.torques is not None:
            side[state.chain.joints.index(str(candidate.location["joint"]))] += candidate.torques(state) @ value
    return dataclasses.replace(state, side_torque=side)


REFERENCE = "reference_torque"


def applied(candidate: Candidate, value: Float1D, state: State) -> AppliedEffect:
    """Describe a candidate with its fitted parameters, (k,) in its units.

    A law that is relative to the largest torque of the recording keeps this torque, so that it stays the same law on
    another recording.
    """
    parameters = {p.name: float(v) for p, v in zip(candidate.parameters, value, strict=True)}
    if candidate.effect in effects_with(Trait.OF_LARGEST_TORQUE):
        joint = state.chain.joints.index(str(candidate.location["joint"]))
        parameters[REFERENCE] = state.largest_torque(joint, candidate.shape)
    return AppliedEffect(candidate.effect, candidate.location, candidate.variant, parameters)


def restored(effect: AppliedEffect, state: State) -> Candidate:
    """Return the candidate that a description means, for the given recording.

    What a law needs a load for may stand in the model of an absolute recording, and the other way round: it then moves
    nothing that was not moved before.

    Raises:
        ValueError: This recording cannot carry it, for example because it has no times; or there is no such form of
            the effect, or a parameter is missing or one too many.
    """
    number = effect.location.get(RECORDING)
    bare = {key: value for key, value in effect.location.items() if key != RECORDING}
    entry = effect_named(effect.effect)
    found = entry.restored(dataclasses.replace(effect, location=bare), state)
    if found is None:
        msg = f"{effect.effect} ({effect.variant}) at {dict(effect.location)} cannot be evaluated on this recording"
        raise ValueError(msg)
    if number is not None:
        found = in_recording(found, str(number))
    names = [parameter.name for parameter in found.parameters]
    given = [name for name in effect.parameters if name != REFERENCE]
    if sorted(names) != sorted(given):
        msg = f"{effect.effect} with the parameters {', '.join(given)}, not {', '.join(names)}"
        raise ValueError(msg)
    if effect.parameters.get(REFERENCE, 1.0) <= 0:
        msg = f"{effect.effect} with {REFERENCE} {effect.parameters[REFERENCE]:g}, which is not positive"
        raise ValueError(msg)
    return found


def applied_shift(effects: Sequence[AppliedEffect], state: State) -> Float2D:
    """Return the (m, 3) m, base axes, that the effects move the measured points.

    Raises:
        ValueError: As `restored`.
    """
    shift = np.zeros((state.m, 3))
    state = with_side_torques(state, side_springs(effects, state))
    for effect in effects:
        own = state
        if REFERENCE in effect.parameters:
            own = dataclasses.replace(state, reference_torque=np.full((2, state.chain.n), effect.parameters[REFERENCE]))
        candidate, value = _with_value(effect, state)
        shift += candidate.columns(own) @ value
    return shift


def side_springs(effects: Sequence[AppliedEffect], state: State) -> Acting:
    """Return the effects that act on joints with a torque, which laws of these joints feel.

    Raises:
        ValueError: As `restored`.
    """
    springs = effects_with(Trait.SPRING)
    several = [_with_value(one, state) for one in effects if one.effect in springs]
    return acting([candidate for candidate, _ in several], [value for _, value in several])


def _with_value(effect: AppliedEffect, state: State) -> tuple[Candidate, Float1D]:
    candidate = restored(effect, state)
    return candidate, np.array([effect.parameters[p.name] for p in candidate.parameters])
