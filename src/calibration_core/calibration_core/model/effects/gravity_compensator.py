"""A spring or cylinder beside joint 2 carries part of the weight, and stiffens or softens the joint with its angle.

M = K_c (1 - s0/s) a L sin(alpha - q2), s^2 = a^2 + L^2 + 2 a L cos(alpha - q2); its slope adds to the joint's
stiffness, so that the equivalent compliance follows q2.  To first harmonic it is a modulation of C2, which also a
pose-dependent stiffness could be: the two are told apart by absolute sag only.  There the torque itself shows.  Its
first harmonic hides behind the geometry and the weight; the others follow from the triangle, of which a few shapes are
offered, each with its torque and a small turn of alpha; any other can be made (`spring`).
Source: Klimchik, Pashkevich et al. on heavy robots with gravity compensators.
"""

from __future__ import annotations

import dataclasses
import itertools
import re
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
ANCHORS = range(0, 360, 30)  # alpha, degrees
FLATNESS = (0.3, 0.55)  # 2 a L / (a^2 + L^2)
PRELOAD = (0.35, 0.65)  # s0 / sqrt(a^2 + L^2)
TURN = 0.15  # rad, half of what lies between two anchors
SHAPE = re.compile(r"torque, anchor (\d{1,3}(?:\.\d)?) deg, flatness (0\.\d{1,3}), preload (0\.\d{1,3})")
ALL_ROUND = np.linspace(0, 2 * np.pi, 360, endpoint=False)


@dataclasses.dataclass(frozen=True)
class Triangle:
    """Shape of the spring's triangle.

    Attributes:
        anchor: alpha, degrees.
        flatness: 2 a L / (a^2 + L^2).
        preload: s0 / sqrt(a^2 + L^2).
    """

    anchor: float
    flatness: float
    preload: float

    @property
    def variant(self) -> str:
        """The shape in words, a tenth of a degree and a thousandth being the smallest that it tells."""
        anchor = f"{round(self.anchor % 360, 1) % 360:g}"
        return f"torque, anchor {anchor} deg, flatness {round(self.flatness, 3):g}, preload {round(self.preload, 3):g}"


def triangle_of(variant: str) -> Triangle | None:
    """Return the shape that a variant tells; None if it tells none."""
    found = SHAPE.fullmatch(variant)
    return None if found is None else Triangle(*map(float, found.groups()))


def spring(state: State, triangle: Triangle) -> Candidate:
    """Return the hypothesis of a spring of one shape, as exactly as its variant tells it."""
    told = triangle_of(triangle.variant)
    assert told is not None  # noqa: S101 - a variant can be read back
    torque = typical("gravity_compensator_torque", state.rated_load)
    pair = (Parameter("torque", "N*m", torque), Parameter("torque_turned", "N*m", torque))
    place = {"joint": state.chain.joints[JOINT]}
    return Candidate(EFFECT.name, EFFECT.family, place, told.variant, pair, partial(sag, triangle=told))


def spring_torque(angle: Float1D, flatness: float, preload: float) -> Float1D:
    """Return the torque at angles alpha - q2, (m,) rad, in units of the largest."""

    def torque(beta: Float1D) -> Float1D:
        return np.asarray(np.sin(beta) * (1 - preload / np.sqrt(1 + flatness * np.cos(beta))))

    return np.asarray(torque(angle) / np.abs(torque(ALL_ROUND)).max())


def sag(state: State, triangle: Triangle) -> Float3D:
    """Return the movement per N*m, and what a turn of the anchor by `TURN` changes in it, (m, 3, 2)."""
    beta = np.radians(triangle.anchor) - state.q[:, JOINT]
    torque, ahead, behind = (
        spring_torque(beta + turn, triangle.flatness, triangle.preload) for turn in (0.0, TURN, -TURN)
    )
    turned = (ahead - behind) / 2
    return stacked(*(state.joint_column(JOINT, state.compliance[JOINT] * part) for part in (torque, turned)))


def _candidates(state: State) -> Iterator[Candidate]:
    if state.compliance[JOINT] <= 0:
        return
    if state.loaded:
        size = typical("gravity_compensator", state.rated_load)
        pair = (Parameter("modulation_cosine", "1", size), Parameter("modulation_sine", "1", size))
        place = {"joint": state.chain.joints[JOINT]}
        yield Candidate(EFFECT.name, EFFECT.family, place, "stiffness", pair, partial(modulated, joint=JOINT))
    else:
        for shape in itertools.product(ANCHORS, FLATNESS, PRELOAD):
            yield spring(state, Triangle(*shape))


EFFECT = Effect(
    name="gravity_compensator",
    family="structure",
    equation="M = K_c (1 - s0/s) a L sin(alpha - q2)",
    source="Klimchik, Pashkevich et al., heavy robots with gravity compensators (arXiv 1311.6810)",
    reveal="absolute positions over the range of joint 2; the same load at six values of its angle",
    candidates=_candidates,
)
