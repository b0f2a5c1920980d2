"""Friction between motor and link: the deflection depends on where the torque came from.

theta = C tau - sum_r h_r stop_r[tau]/r: elements that stick up to r and slip beyond (Prandtl-Ishlinskii, Maxwell slip),
under load and weight.  What happened before step 0 is unknown.  Tried are elements that the weight alone has strained
from nothing, relaxed ones (a virgin start), and ones on the verge in the direction against the first load (a centred
start).  The radii form one block; single elements are tried beside it, for a weak effect does not show its shape.
Friction of teeth grows with what presses them: theta = C tau - |tau|/tau_r sum_r h_r stop_r[tau]/r.  How much the
elements really carry on arrival in a configuration is a matter of chance, whatever the form.  But they lean to the
side from which the joint came: where postures at rest stand beside load steps, what they carry shows in both.
Source: Al-Bender, Lampaert, Swevers on presliding; stop operators; Hamon, Gautier, Garrec 2010 (friction and load).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.absolute.approach_direction import sides
from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, typical
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float1D, Float2D, Float3D, FloatND

RADII = (0.02, 0.06, 0.15, 0.4)  # of the largest torque
CHANCE = 0.25  # standard deviation of what elements carry on arrival, of what they carry at most at the typical size
MOST = 60  # configurations, beyond which chance is left out: its columns would cost more than all others together

FROM_A_SIDE = "from the side of arrival"
FROM_WEIGHT = "from the weight"
STARTS = {"virgin start": 0.0, "centred start": 1.0, FROM_WEIGHT: None}


def stop(torque: Float2D, radius: float | Float1D, start: float | None) -> FloatND:
    """Return the stop operator along the steps, (s, k) or (s, k, r): what elements of strength `radius` carry.

    Args:
        torque: (s, k) N*m, steps in the order of time.
        radius: Strength, N*m; (r,) of several elements.
        start: What an element carries at step 0, as a fraction of its strength, against the first change of torque;
            None: the torque there, as far as it can.
    """
    radius = np.asarray(radius, dtype=np.float64)
    turned = np.sign(np.diff(torque[:, :2], axis=1)).sum(axis=1)  # 0 where there is one step alone
    torque = torque.reshape(*torque.shape, *(1 for _ in radius.shape))
    direction = turned.reshape(-1, *(1 for _ in radius.shape))
    return _slipped(
        torque, radius, np.clip(torque[:, 0], -radius, radius) if start is None else -start * radius * direction
    )


def _slipped(torque: FloatND, radius: Float1D, friction: FloatND) -> FloatND:
    """Return what elements carry along the steps, (s, k, ...), that carry `friction` at step 0."""
    result = np.empty((*torque.shape[:2], *radius.shape))
    result[:, 0] = friction
    for k in range(1, torque.shape[1]):
        friction = np.clip(friction + torque[:, k] - torque[:, k - 1], -radius, radius)
        result[:, k] = friction
    return result


def _elements(state: State, joint: int, start: float | None) -> Float2D:
    """Return what elements carry, (m, r), in parts of their strengths, which are RADII of the largest torque."""
    strength = np.array(RADII) * state.largest_torque(joint)
    return state.along_steps(state.torque[joint], partial(stop, radius=strength, start=start)) / strength


def _columns(
    state: State, joint: int, radii: tuple[float, ...], start: float | None, *, growing: bool = False
) -> Float3D:
    pressed = _pressed(state, joint) if growing else 1.0
    of_radius = dict(zip(RADII, state.once(_elements, joint, start).T, strict=True))
    return stacked(*(-state.joint_column(joint, pressed * of_radius[radius]) for radius in radii))


def _pressed(state: State, joint: int) -> Float1D:
    return np.asarray(np.abs(state.torque[joint]) / state.largest_torque(joint))


def _chances(state: State, joint: int, size: float, *, growing: bool) -> Float3D:
    """Return the (m, 3, c) m that elements carrying more or less on arrival move in each of c configurations.

    Per standard deviation, which is CHANCE of elements of half width `size` that carry all they can.
    """
    more, less = (state.once(_elements, joint, start).mean(axis=1) for start in (1.0, -1.0))
    lag = CHANCE * size * 0.5 * (more - less)
    moved = state.joint_column(joint, _pressed(state, joint) * lag if growing else lag)
    places = np.unique(state.configuration)
    return np.asarray(moved[:, :, None] * (state.configuration[:, None, None] == places))


def _leaning(state: State, joint: int, radii: tuple[float, ...]) -> Float2D:
    """Return the (m, 3) m per rad that elements move which carry all they can, to the side from which a joint came."""
    chosen = [RADII.index(radius) for radius in radii]
    more, less = (state.once(_on_the_verge, joint, sign)[:, chosen].mean(axis=1) for sign in (1.0, -1.0))
    return state.joint_column(joint, sides(state)[:, joint] * 0.5 * (more - less))


def _on_the_verge(state: State, joint: int, sign: float) -> Float2D:
    """Return what elements carry that carry all they can at step 0, (m, r), as `_elements`."""
    strength = np.array(RADII) * state.largest_torque(joint)

    def begun(torque: Float2D) -> FloatND:
        return _slipped(torque[:, :, None], strength, sign * strength)

    return state.along_steps(state.torque[joint], begun) / strength


def _from_a_side(state: State, joint: int, radii: tuple[float, ...]) -> Float3D:
    relaxed = _columns(state, joint, radii, 0.0)
    return np.concatenate([relaxed, stacked(_leaning(state, joint, radii))], axis=2)


def _forms(state: State) -> Iterator[Candidate]:
    """Return every form; its shape is what memory starts from."""
    size = typical("hysteresis", state.rated_load)
    few = len(np.unique(state.configuration)) <= MOST
    for joint, name in enumerate(state.chain.joints):
        unit = state.chain.units[joint]
        form = partial(Candidate, EFFECT.name, EFFECT.family, {"joint": name})
        plain, growing = (
            partial(_chances, joint=joint, size=size, growing=grows) if few else None for grows in (False, True)
        )
        several = tuple(Parameter(f"half_width_{100 * r:g}_percent", unit, size, positive=True) for r in RADII)
        for variant, start in STARTS.items():
            columns = partial(_columns, joint=joint, radii=RADII, start=start)
            yield form(variant, several, columns, plain, shape=variant)
        virgin = partial(_columns, joint=joint, start=0.0)
        yield form("virgin start, growing", several, partial(virgin, radii=RADII, growing=True), growing)
        one = (Parameter("half_width", unit, size, positive=True),)
        for radius in RADII:
            words = f"below {100 * radius:g} %"
            yield form(f"virgin start, {words}", one, partial(virgin, radii=(radius,)), plain)
            yield form(f"virgin start, {words}, growing", one, partial(virgin, radii=(radius,), growing=True), growing)
        lean = Parameter("half_width_on_arrival", unit, size)
        leaning = partial(_from_a_side, joint=joint)
        yield form(FROM_A_SIDE, (*several, lean), partial(leaning, radii=RADII), plain, shape=FROM_A_SIDE)
        for radius in RADII:
            words = f"{FROM_A_SIDE}, below {100 * radius:g} %"
            yield form(words, (*one, lean), partial(leaning, radii=(radius,)), plain, shape=FROM_A_SIDE)


def _candidates(state: State) -> Iterator[Candidate]:
    """Leave out starts that are the same: from a weight that is none; or all others, where there are no later steps."""
    several = bool(np.any(state.step != state.step[:1]))
    single = any(index.shape[1] == 1 for index in state.sequences)
    borne = {name for joint, name in enumerate(state.chain.joints) if state.bears_weight(joint)}
    turning = {name for name, seen in zip(state.chain.joints, sides(state).T, strict=True) if np.any(seen)}
    for candidate in _forms(state):
        if candidate.shape == FROM_A_SIDE:
            if several and single and candidate.location["joint"] in turning:
                yield candidate
        elif candidate.location["joint"] in borne if candidate.shape == FROM_WEIGHT else several:
            yield candidate


EFFECT = Effect(
    name="hysteresis",
    family="joint law",
    equation="theta = C tau - g sum_r h_r stop_r[tau]/r, g = 1, or abs(tau)/tau_r where friction grows with the load",
    source="Prandtl-Ishlinskii, Maxwell slip (Al-Bender, Lampaert, Swevers); with load: Hamon, Gautier, Garrec 2010",
    reveal="unloading through the same levels; then holds, to tell it from creep",
    candidates=_candidates,
    forms=_forms,
    sentence="{place} shows hysteresis",
    traits=frozenset({Trait.LAG, Trait.MEMORY, Trait.OF_LARGEST_TORQUE}),
)
