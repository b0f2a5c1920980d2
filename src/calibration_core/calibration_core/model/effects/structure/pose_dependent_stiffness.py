"""The stiffness of a joint's transmission changes with its angle.

theta = C tau (1 + a cos q + b sin q), and the same with more waves a turn.  Source: tooth contact and eccentricity over
one turn.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, typical
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D

ONE_TURN = "one turn"
FORMS = {ONE_TURN: (1,), "to four waves a turn": (1, 2, 3, 4)}


def modulated(state: State, joint: int, orders: Sequence[int] = (1,)) -> Float3D:
    """Return the (m, 3, 2 k) columns of a compliance that follows cos n q and sin n q, relative to the joint's own.

    Args:
        state: Where the readings were taken.
        joint: Index.
        orders: The k numbers n of waves a turn.
    """
    deflection = state.compliance[joint] * state.torque[joint]
    angles = [n * state.q[:, joint] for n in orders]
    waves = [wave(angle) for angle in angles for wave in (np.cos, np.sin)]
    return stacked(*(state.joint_column(joint, deflection * wave) for wave in waves))


def _forms(state: State) -> Iterator[Candidate]:
    size = typical("pose_dependent_stiffness", state.rated_load)
    for joint in state.chain.revolute:
        place = {"joint": state.chain.joints[joint]}
        for variant, orders in FORMS.items():
            names = [f"{name}{f' {n}' if n > 1 else ''}" for n in orders for name in ("cosine", "sine")]
            parameters = tuple(Parameter(name, "1", size) for name in names)
            columns = partial(modulated, joint=joint, orders=orders)
            yield Candidate(EFFECT.name, EFFECT.family, place, variant, parameters, columns)


def _candidates(state: State) -> Iterator[Candidate]:
    """Offer joints that a torque deflects, and several waves to postures at rest alone: few loads tell them apart."""
    for candidate in _forms(state):
        joint = state.chain.joints.index(str(candidate.location["joint"]))
        deflected = state.compliance[joint] > 0 and (state.bears_weight(joint) or state.bears_load(joint))
        if deflected and (candidate.variant == ONE_TURN or not state.loaded):
            yield candidate


EFFECT = Effect(
    name="pose_dependent_stiffness",
    family="structure",
    equation="theta = C tau (1 + a cos q + b sin q)",
    source="tooth contact and eccentricity over one turn of the joint",
    reveal="the same load at six or more values of the joint's angle",
    candidates=_candidates,
    forms=_forms,
    sentence="the stiffness of {place} depends on the posture",
)
