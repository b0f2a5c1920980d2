"""A joint that hardens or softens with load.

theta = C tau (1 - k (tau/tau_r)^2), tau_r the largest torque of the recording; k > 0 hardens, k < 0 softens.
Source: Hertzian contact of reducers; cubic as the lowest odd term.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter
from calibration_core.model.effects.priors import typical
from calibration_core.model.effects.springs import stacked
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float1D, Float3D


def carried(state: State, joint: int, of: str) -> Float1D:
    """Return the (m,) torque that a law acts on: with the robot's own weight, or the load alone."""
    return state.torque[joint] if of == "total torque" else state.load_torque[joint]


def torques(state: State, joint: int) -> tuple[str, ...]:
    """Say which torques a law could act on; the weight is left out where a compensator may carry it."""
    return ("total torque", "load torque") if state.gravity_torque[joint].any() else ("load torque",)


def _columns(state: State, joint: int, of: str) -> Float3D:
    torque = carried(state, joint, of)
    curved = state.compliance[joint] * torque * (torque / state.largest_torque(joint, of)) ** 2
    return stacked(-state.joint_column(joint, curved))


def _candidates(state: State) -> Iterator[Candidate]:
    parameter = Parameter("hardening", "1", typical("nonlinear_stiffness", state.rated_load))
    for joint, name in enumerate(state.chain.joints):
        if state.compliance[joint] > 0:
            for of in torques(state, joint):
                columns = partial(_columns, joint=joint, of=of)
                yield Candidate(EFFECT.name, EFFECT.family, {"joint": name}, of, (parameter,), columns)


EFFECT = Effect(
    name="nonlinear_stiffness",
    family="joint law",
    equation="theta = C tau (1 - k (tau/tau_r)^2)",
    source="contact stiffness of reducers, lowest odd term",
    reveal="more load levels and reversed loads",
    candidates=_candidates,
    absolute=False,
)
