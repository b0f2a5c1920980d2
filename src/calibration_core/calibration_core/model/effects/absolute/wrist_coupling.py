"""One wrist axis turns another: the motors sit behind and their shafts run through the joints.

dq_i = c q_j for a driver j before a driven i among the last three joints; the controller compensates the nominal ratio,
c is what is left of it.  Source: kinematics of coupled wrists.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, typical
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D

WRIST = 3  # joints


def _columns(state: State, driver: int, driven: int) -> Float3D:
    return stacked(state.joint_column(driven, state.q[:, driver]))


def _candidates(state: State) -> Iterator[Candidate]:
    names = state.chain.joints
    size = typical("wrist_coupling", state.rated_load)
    first = max(len(names) - WRIST, 0)
    for driven in range(first + 1, len(names)):
        for driver in range(first, driven):
            parameters = (Parameter("ratio", "1", size),)
            columns = partial(_columns, driver=driver, driven=driven)
            variant = f"follows {names[driver]}"
            yield Candidate(EFFECT.name, EFFECT.family, {"joint": names[driven]}, variant, parameters, columns)


EFFECT = Effect(
    name="wrist_coupling",
    family="absolute",
    equation="dq_i = c q_j",
    source="coupled gear trains of wrists",
    reveal="turning the driving axis alone with the driven one standing still",
    candidates=_candidates,
    loaded=False,
    sentence="the joints of the wrist are coupled",
)
