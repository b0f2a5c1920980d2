"""What a joint's output does beside following its encoder: periodic errors of gear, encoder ring and coupling.

dq_j = A sin(k q_j + phi), k cycles per revolution of the joint: 1 eccentricity, 2 ellipse or wave generator, higher
ones teeth, pole pairs and whatever the manufacturer built in.  A candidate is one order; how close orders may lie to be
distinguishable depends on the range of the joint's angles, how high they may be on their number.
Source: Tuttle and Seering on kinematic error of strain-wave gears (1996); eccentricity of angle encoders.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, typical
from calibration_core.model.effects.state import State
from calibration_core.model.parameters import AppliedEffect
from calibration_core.timeseries import Float1D, Float2D, Float3D

HIGHEST = 320  # orders: twice the ratio of the common strain-wave gears
LEAST_RANGE = 0.1  # rad; a joint that moves less shows no period
ORDER = re.compile(r"order ([1-9]\d{0,4})")  # as a model file says it
SAME = 1e-3  # rad; closer angles are one sample


def distinguishable_orders(angle: Float1D) -> int:
    """Return the highest order that the sampled angles of a joint, (m,) rad, carry.

    Half a period per distinct angle on average (Nyquist), at most `HIGHEST`; 0 where the joint hardly moves.
    """
    span = float(np.ptp(angle))
    if span < LEAST_RANGE:
        return 0
    distinct = len(np.unique(np.round(angle / SAME)))
    return int(min(HIGHEST, np.pi * (distinct - 1) / span))


def harmonic(joint: int, name: str, order: int, rated_load: float) -> Candidate:
    """Return the hypothesis of one order at one joint.

    Args:
        joint: Index of the joint.
        name: Its name.
        order: Cycles per revolution of the joint.
        rated_load: kg, for the prior.
    """
    size = typical("transmission_error", rated_load)
    parameters = (Parameter("sine", "rad", size), Parameter("cosine", "rad", size))
    turns, columns = partial(_turns, joint=joint, order=order), partial(_columns, joint=joint, order=order)
    form = partial(Candidate, EFFECT.name, EFFECT.family, {"joint": name}, f"order {order}", row_by_row=True)
    return form(parameters, columns, turns=turns, shape=order)


def _restored(described: AppliedEffect, state: State) -> Candidate | None:
    name, joints, written = described.location.get("joint"), state.chain.joints, ORDER.fullmatch(described.variant)
    if name not in joints or written is None:
        return None
    return harmonic(joints.index(str(name)), str(name), int(written[1]), state.rated_load)


def _turns(state: State, joint: int, order: int) -> Float2D:
    phase = order * state.q[:, joint]
    return np.stack([np.sin(phase), np.cos(phase)], axis=1)


def _columns(state: State, joint: int, order: int) -> Float3D:
    return stacked(*(state.joint_column(joint, turn) for turn in _turns(state, joint, order).T))


def _candidates(state: State) -> Iterator[Candidate]:
    for joint in state.chain.revolute:
        name = state.chain.joints[joint]
        for order in range(1, distinguishable_orders(state.q[:, joint]) + 1):
            yield harmonic(joint, name, order, state.rated_load)


EFFECT = Effect(
    name="transmission_error",
    family="absolute",
    equation="dq_j = A sin(k q_j + phi)",
    source="Tuttle and Seering 1996 (strain-wave gears); eccentricity of encoders",
    reveal="a slow turn of this joint alone over its whole range, in steps of less than half a period",
    candidates=_candidates,
    loaded=False,
    restore=_restored,
    sentence="the gear of {place} runs unevenly",
    traits=frozenset({Trait.DAMAGE}),
)
