"""Effects that a model already contains: from their description back to what they do to a recording."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from calibration_core.model.effects import effect_named, effects_with
from calibration_core.model.effects.candidate import Candidate, Trait
from calibration_core.model.effects.recordings import RECORDING, in_recording
from calibration_core.model.effects.state import State
from calibration_core.model.kinematics import dot
from calibration_core.model.parameters import AppliedEffect
from calibration_core.model.statics import centres_of_mass
from calibration_core.model.virtual_joints import Cut, before_joint, behind_joint, rotation_twist, translation_twist
from calibration_core.timeseries import Float1D, Float2D, Float3D

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


# --- virtual joints with springs about given axes ---------------------------------------------------------------------


NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)  # exact up to the fifth degree


def turning(state: State, cut: Cut, axis: Float2D, origin: Float2D) -> Float2D:
    """Return the (m, 3) movement per unit compliance, rad/(N*m), of a spring about an axis through a point."""
    return state.virtual.column(cut, rotation_twist(axis, origin))


def sliding(state: State, cut: Cut, axis: Float2D) -> Float2D:
    """Return the (m, 3) movement per unit compliance, m/N, of a spring along an axis (3, m)."""
    return state.virtual.column(cut, translation_twist(axis))


def tilting(state: State, cut: Cut, axes: tuple[Float2D, Float2D], origin: Float2D) -> Float3D:
    """Return (m, 3, 3) columns of an elastic hinge about two axes: its two compliances, and the one between them.

    The third, theta_1 = C_12 tau_2 and theta_2 = C_12 tau_1, turns the principal directions.

    Args:
        state: The loaded robot.
        cut: Where the hinge sits.
        axes: (3, m) unit vectors each, base axes.
        origin: (3, m) m.
    """
    first, second = (rotation_twist(axis, origin) for axis in axes)
    virtual = state.virtual
    crossed = virtual.column(cut, first, second) + virtual.column(cut, second, first)
    return stacked(virtual.column(cut, first), virtual.column(cut, second), crossed)


def along_link(
    state: State,
    link: int,
    ends: tuple[Float2D, Float2D],
    column: Callable[[Cut, Float2D], Float3D],
    *,
    own_weight: bool = True,
) -> Float3D:
    """Return the (m, 3, k) columns of springs spread evenly between the two ends of a link, per unit of length.

    The weight of the link itself acts at its centre of gravity: sections before it bear it, those behind do not.
    Integral over both parts; three Gauss points each are exact, the integrands being quadratic in the position.

    Args:
        state: The loaded robot.
        link: Index of the joint that carries the link.
        ends: (3, m) m each, where it begins and ends.
        column: Cut and place (3, m) m -> columns (m, 3, k) of the springs there.
        own_weight: Whether the link bears its own weight; False: it rests on the link's joint.
    """
    start, tip = ends
    span = tip - start
    length = np.linalg.norm(span, axis=0)
    centre = _share_before_centre(state, link, start, span) if own_weight else np.zeros(state.m)
    stage = state.chain.stage(link)
    parts = (behind_joint(stage), np.zeros(state.m), centre), (before_joint(stage + 1), centre, np.ones(state.m))
    total = []
    for cut, begin, end in parts:
        if not np.any(end > begin):
            continue
        for node, weight in zip(NODES, WEIGHTS, strict=True):
            place = start + (begin + (node + 1) / 2 * (end - begin)) * span
            total.append((weight / 2 * (end - begin) * length)[:, None, None] * column(cut, place))
    return np.sum(total, axis=0)


def _share_before_centre(state: State, link: int, start: Float2D, span: Float2D) -> Float1D:
    """Return which share of a link lies before its centre of gravity, (m,), 0 to 1; 0 where masses are not known."""
    if state.chain.mass is None:
        return np.zeros(state.m)
    lever = centres_of_mass(state.chain, state.at)[link] - start
    return np.clip(dot(lever, span) / dot(span, span), 0.0, 1.0)


def stacked(*columns: Float2D) -> Float3D:
    """Return (m, 3, k) from k columns (m, 3)."""
    return np.stack(columns, axis=-1)


def largest(values: Float1D) -> float:
    """Return the largest absolute value, at least a tiny number, so that it can divide."""
    return max(float(np.abs(values).max(initial=0.0)), 1e-12)
