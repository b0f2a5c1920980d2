"""The hose package pulls at the flange towards where it is held on the arm.

d tau_j = a_j . ((p - o_j) x F e), e from the flange to the origin of a joint further back.  Movement by the joints'
compliances, which must therefore be known.  Source: statics; hoses pull by some tens of newtons.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter
from calibration_core.model.effects.load_chain.tool_weight import pulled
from calibration_core.model.effects.priors import typical
from calibration_core.model.effects.springs import stacked
from calibration_core.model.effects.state import State
from calibration_core.model.effects.traits import Trait
from calibration_core.timeseries import Float3D

SHORTEST = 1e-3  # m; nearer holds give no direction


def _columns(state: State, holder: int) -> Float3D:
    pull = state.at.origin[holder] - state.at.flange_origin
    length = np.maximum(np.linalg.norm(pull, axis=0), SHORTEST)
    return stacked(pulled(state, state.at.flange_origin, pull / length))


def _candidates(state: State) -> Iterator[Candidate]:
    if not np.any(state.compliance):
        return
    parameters = (Parameter("force", "N", typical("cable_force", state.rated_load)),)
    for holder in range(state.chain.n - 1):
        variant = f"held at {state.chain.joints[holder]}"
        columns = partial(_columns, holder=holder)
        yield Candidate(EFFECT.name, EFFECT.family, {"tool": "tool"}, variant, parameters, columns)


EFFECT = Effect(
    name="cable_force",
    family="load chain",
    equation="d tau_j = a_j . ((p - o_j) x F e)",
    source="statics of a hose package",
    reveal="the same poses with and without the hose package",
    candidates=_candidates,
    loaded=False,
    sentence="a cable or dress pack pulls",
    traits=frozenset({Trait.ACTS_IN_USE}),
)
