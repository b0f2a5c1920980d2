"""A joint that hardens or softens with load.

theta = C tau (1 - k (tau/tau_r)^2), tau_r the largest torque of the recording; k > 0 hardens, k < 0 softens.
Source: Hertzian contact of reducers; cubic as the lowest odd term.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, typical
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float1D, Float3D

TORQUES = ("total torque", "load torque")


def acting_torque(state: State, joint: int, of: str) -> Float1D:
    """Return the (m,) torque that a law acts on: with the robot's own weight, or the load alone."""
    return state.torque[joint] if of == "total torque" else state.load_torque[joint]


def torques(state: State, joint: int) -> tuple[str, ...]:
    """Say which torques a law could act on: the whole one; where masses are guesses, that of the load as well."""
    if not state.bears_weight(joint):
        return ("load torque",) if state.bears_load(joint) else ()
    return ("total torque",) if state.chain.inertials_known else TORQUES


def all_torques(state: State, joint: int) -> tuple[str, ...]:  # noqa: ARG001  # whatever the state
    """Name every torque that a law in a model file may act on."""
    return TORQUES


def _columns(state: State, joint: int, of: str) -> Float3D:
    torque = acting_torque(state, joint, of)
    curved = state.compliance[joint] * torque * (torque / state.largest_torque(joint, of)) ** 2
    return stacked(-state.joint_column(joint, curved))


def _forms(state: State, of: Callable[[State, int], tuple[str, ...]]) -> Iterator[Candidate]:
    parameter = Parameter("hardening", "1", typical("nonlinear_stiffness", state.rated_load))
    for joint, name in enumerate(state.chain.joints):
        if state.compliance[joint] > 0:
            for torque in of(state, joint):
                columns = partial(_columns, joint=joint, of=torque)
                yield Candidate(
                    EFFECT.name, EFFECT.family, {"joint": name}, torque, (parameter,), columns, shape=torque
                )


EFFECT = Effect(
    name="nonlinear_stiffness",
    family="joint law",
    equation="theta = C tau (1 - k (tau/tau_r)^2)",
    source="contact stiffness of reducers, lowest odd term",
    reveal="more load levels and reversed loads",
    candidates=partial(_forms, of=torques),
    forms=partial(_forms, of=all_torques),
    sentence="{place} gives way not in proportion to its load",
    traits=frozenset({Trait.OF_LARGEST_TORQUE}),
)
