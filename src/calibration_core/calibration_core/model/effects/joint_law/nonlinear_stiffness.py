"""Laws by which a joint gives way not in proportion to its torque: hardening, clearance, softness at low torque.

Torques tau_r, tau_b and T1 refer to the largest one of the recording.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

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


def _hardened(state: State, joint: int, of: str) -> Float3D:
    torque = acting_torque(state, joint, of)
    curved = state.compliance[joint] * torque * (torque / state.largest_torque(joint, of)) ** 2
    return stacked(-state.joint_column(joint, curved))


def _hardening(state: State, of: Callable[[State, int], tuple[str, ...]]) -> Iterator[Candidate]:
    parameter = Parameter("hardening", "1", typical("nonlinear_stiffness", state.rated_load))
    for joint, name in enumerate(state.chain.joints):
        if state.compliance[joint] > 0:
            for torque in of(state, joint):
                columns = partial(_hardened, joint=joint, of=torque)
                yield Candidate(
                    NONLINEAR.name, NONLINEAR.family, {"joint": name}, torque, (parameter,), columns, shape=torque
                )


NONLINEAR = Effect(
    name="nonlinear_stiffness",
    family="joint law",
    equation="theta = C tau (1 - k (tau/tau_r)^2)",
    source="contact stiffness of reducers, lowest odd term",
    reveal="more load levels and reversed loads",
    candidates=partial(_hardening, of=torques),
    forms=partial(_hardening, of=all_torques),
    sentence="{place} gives way not in proportion to its load",
    traits=frozenset({Trait.OF_LARGEST_TORQUE}),
)


CLEARANCES = (0.003, 0.02, 0.04, 0.06)  # of the largest torque


def _lost(state: State, joint: int, of: str, width: float) -> Float3D:
    torque = acting_torque(state, joint, of)
    edge = width * state.largest_torque(joint)
    return stacked(state.joint_column(joint, np.clip(torque / edge, -1.0, 1.0) / 2))


def _clearances(state: State, of: Callable[[State, int], tuple[str, ...]]) -> Iterator[Candidate]:
    size = typical("backlash", state.rated_load)
    for joint, name in enumerate(state.chain.joints):
        parameter = Parameter("clearance", state.chain.units[joint], size, positive=True)
        for torque in of(state, joint):
            for width in CLEARANCES:
                columns = partial(_lost, joint=joint, of=torque, width=width)
                variant = f"{torque}, within {100 * width:g} %"
                yield Candidate(BACKLASH.name, BACKLASH.family, {"joint": name}, variant, (parameter,), columns)


BACKLASH = Effect(
    name="backlash",
    family="joint law",
    equation="theta = C tau + (b/2) clip(tau/tau_b, -1, 1)",
    source="lost motion at +-3 % of the rated torque",
    reveal="reversed loads, small loads, configurations without gravity torque on the joint",
    candidates=partial(_clearances, of=torques),
    forms=partial(_clearances, of=all_torques),
    sentence="{place} has backlash",
    traits=frozenset({Trait.LAG, Trait.OF_LARGEST_TORQUE}),
)


ZONES = (0.08, 0.13, 0.2, 0.3)  # of the largest torque


def _softened(state: State, joint: int, of: str, width: float) -> Float3D:
    torque = acting_torque(state, joint, of)
    edge = width * state.largest_torque(joint)
    return stacked(state.joint_column(joint, state.compliance[joint] * np.clip(torque, -edge, edge)))


def _gradual(state: State, joint: int, of: str) -> Float3D:
    """A law that softens gradually: zones of all widths, one beside the other."""
    return np.concatenate([_softened(state, joint, of, width) for width in ZONES], axis=2)


def _soft_zones(state: State, of: Callable[[State, int], tuple[str, ...]]) -> Iterator[Candidate]:
    size = typical("soft_zone", state.rated_load)
    parameter = Parameter("extra_compliance", "1", size, positive=True)
    for joint, name in enumerate(state.chain.joints):
        place = {"joint": name}
        if state.compliance[joint] > 0:
            for torque in of(state, joint):
                for width in ZONES:
                    columns = partial(_softened, joint=joint, of=torque, width=width)
                    variant = f"{torque}, below {100 * width:g} %"
                    yield Candidate(SOFT_ZONE.name, SOFT_ZONE.family, place, variant, (parameter,), columns)
                several = tuple(
                    Parameter(f"extra_compliance_{100 * width:g}_percent", "1", size, positive=True) for width in ZONES
                )
                gradual = partial(_gradual, joint=joint, of=torque)
                yield Candidate(
                    SOFT_ZONE.name, SOFT_ZONE.family, {"joint": name}, f"{torque}, gradual", several, gradual
                )


SOFT_ZONE = Effect(
    name="soft_zone",
    family="joint law",
    equation="theta = C (tau + s clip(tau, -T1, T1))",
    source="strain-wave gear catalogues (K1, K2, K3); Tuttle 1992",
    reveal="steps at 5 and 10 % of the load",
    candidates=partial(_soft_zones, of=torques),
    forms=partial(_soft_zones, of=all_torques),
    sentence="{place} is softer at small torques",
    traits=frozenset({Trait.OF_LARGEST_TORQUE}),
)
