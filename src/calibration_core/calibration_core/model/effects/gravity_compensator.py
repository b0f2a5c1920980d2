"""A spring or cylinder beside joint 2 carries part of the weight, and stiffens or softens the joint with its angle.

M = K_c (1 - s0/s) a L sin(alpha - q2); its slope adds to the joint's stiffness, so that the equivalent compliance
follows q2.  To first harmonic it is a modulation of C2, which also a pose-dependent stiffness could be: the two are
told apart by absolute sag only.  In absolute data its torque itself shows, as harmonics of q2 on the sag: with
s^2 = a^2 + L^2 + 2 a L cos(alpha - q2) the spring's length brings in the second and the third, each weaker by the ratio
of the triangle's sides.
Source: Klimchik, Pashkevich et al. on heavy robots with gravity compensators.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter
from calibration_core.model.effects.pose_dependent_stiffness import modulated
from calibration_core.model.effects.priors import typical
from calibration_core.model.effects.springs import stacked
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D

JOINT = 1  # the second joint carries the arm
HARMONICS = (1.0, 0.2, 0.04)  # of the torque, relative: a triangle with sides of one to four


def _sag(state: State) -> Float3D:
    angle = state.q[:, JOINT]
    waves = (wave(k * angle) for k in range(1, len(HARMONICS) + 1) for wave in (np.cos, np.sin))
    return stacked(*(state.joint_column(JOINT, state.compliance[JOINT] * wave) for wave in waves))


def _candidates(state: State) -> Iterator[Candidate]:
    if state.compliance[JOINT] <= 0:
        return
    place = {"joint": state.chain.joints[JOINT]}
    if state.loaded:
        size = typical("gravity_compensator", state.rated_load)
        pair = (Parameter("modulation_cosine", "1", size), Parameter("modulation_sine", "1", size))
        yield Candidate(EFFECT.name, EFFECT.family, place, "stiffness", pair, partial(modulated, joint=JOINT))
    else:
        torque = typical("gravity_compensator_torque", state.rated_load)
        waves = tuple(
            Parameter(f"torque_{wave}_{k}", "N*m", share * torque)
            for k, share in enumerate(HARMONICS, start=1)
            for wave in ("cosine", "sine")
        )
        yield Candidate(EFFECT.name, EFFECT.family, place, "torque", waves, _sag)


EFFECT = Effect(
    name="gravity_compensator",
    family="structure",
    equation="M = K_c (1 - s0/s) a L sin(alpha - q2)",
    source="Klimchik, Pashkevich et al., heavy robots with gravity compensators (arXiv 1311.6810)",
    reveal="absolute positions over the range of joint 2; the same load at six values of its angle",
    candidates=_candidates,
)
