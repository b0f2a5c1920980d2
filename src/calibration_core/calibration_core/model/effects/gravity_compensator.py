"""A spring or cylinder beside joint 2 carries part of the weight, and stiffens or softens the joint with its angle.

M = K_c (1 - s0/s) a L sin(alpha - q2), s^2 = a^2 + L^2 + 2 a L cos(alpha - q2); its slope adds to the joint's
stiffness, so that the equivalent compliance follows q2.  To first harmonic it is a modulation of C2, which also a
pose-dependent stiffness could be: the two are told apart by absolute sag only.  There the torque itself shows.  Its
first harmonic hides behind the geometry and the weight; the others follow from the triangle, of which a few shapes are
tried, each with its torque and a small turn of alpha.
Source: Klimchik, Pashkevich et al. on heavy robots with gravity compensators.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter
from calibration_core.model.effects.pose_dependent_stiffness import modulated
from calibration_core.model.effects.priors import typical
from calibration_core.model.effects.springs import stacked
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float1D, Float3D

JOINT = 1  # the second joint carries the arm
ANCHORS = np.arange(12) * np.pi / 6  # alpha, rad
FLATNESS = (0.3, 0.55)  # 2 a L / (a^2 + L^2)
PRELOAD = (0.35, 0.65)  # s0 / sqrt(a^2 + L^2)
TURN = 0.15  # rad, half of what lies between two anchors
ALL_ROUND = np.linspace(0, 2 * np.pi, 360, endpoint=False)


def spring_torque(angle: Float1D, flatness: float, preload: float) -> Float1D:
    """Return the torque at angles alpha - q2, (m,) rad, in units of the largest."""

    def torque(beta: Float1D) -> Float1D:
        return np.asarray(np.sin(beta) * (1 - preload / np.sqrt(1 + flatness * np.cos(beta))))

    return np.asarray(torque(angle) / np.abs(torque(ALL_ROUND)).max())


def _sag(state: State, anchor: float, flatness: float, preload: float) -> Float3D:
    """Return the movement per N*m, and what a turn of the anchor by `TURN` changes in it, (m, 3, 2)."""
    beta = anchor - state.q[:, JOINT]
    torque = spring_torque(beta, flatness, preload)
    turned = (spring_torque(beta + TURN, flatness, preload) - spring_torque(beta - TURN, flatness, preload)) / 2
    return stacked(*(state.joint_column(JOINT, state.compliance[JOINT] * part) for part in (torque, turned)))


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
        pair = (Parameter("torque", "N*m", torque), Parameter("torque_turned", "N*m", torque))
        for anchor, flatness, preload in itertools.product(ANCHORS, FLATNESS, PRELOAD):
            variant = f"torque, anchor {np.degrees(anchor):.0f} deg, flatness {flatness:g}, preload {preload:g}"
            columns = partial(_sag, anchor=float(anchor), flatness=flatness, preload=preload)
            yield Candidate(EFFECT.name, EFFECT.family, place, variant, pair, columns)


EFFECT = Effect(
    name="gravity_compensator",
    family="structure",
    equation="M = K_c (1 - s0/s) a L sin(alpha - q2)",
    source="Klimchik, Pashkevich et al., heavy robots with gravity compensators (arXiv 1311.6810)",
    reveal="absolute positions over the range of joint 2; the same load at six values of its angle",
    candidates=_candidates,
)
