"""A spring or cylinder beside a joint carries part of the weight of the arm.

M = K_c (1 - s0/s) a L sin(alpha - x), s^2 = a^2 + L^2 + 2 a L cos(alpha - x), at the link's angle x, deflection
included: at rest it is a torque, and its slope adds to the joint's stiffness under load; both are one law, in one
recording too.  Its first harmonic hides behind the geometry and the weight; the others follow from the triangle, of
which a few shapes are offered, each with its torque and a small turn of alpha; any other can be made (`spring`).
It is offered where the weight of the arm acts most, on joints that stand across gravity.
Source: Klimchik, Pashkevich et al. on heavy robots with gravity compensators.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import re
from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, typical
from calibration_core.model.effects.state import State
from calibration_core.model.effects.structure.pose_dependent_stiffness import modulated
from calibration_core.model.parameters import AppliedEffect
from calibration_core.timeseries import Float1D, Float2D, Float3D

HALF = 0.5  # of the largest torque of the weight: a joint that bears less has no compensator
ACROSS = 0.3  # cosine between a joint's axis and gravity, below which the joint stands across
ANCHORS = range(0, 360, 30)  # alpha, degrees
FLATNESS = (0.3, 0.55)  # 2 a L / (a^2 + L^2)
PRELOAD = (0.35, 0.65)  # s0 / sqrt(a^2 + L^2)
TURN = 0.15  # rad
REACH = np.radians(15.0) / TURN  # half of what lies between two anchors
OPEN = "torque, shape open"  # any law that is smooth in the link's angle
OPEN_ORDERS = 4  # waves with which it is described, and
DECAY = 3.0  # the power of the order by which they grow smaller: more freely they imitate gears
OPEN_SHARE = 1 / 6  # of a usual torque: a spring that would have to be 60 times as large is none
WRITTEN = re.compile(r"torque, anchor (\d{1,3}(?:\.\d)?) deg, flatness (0\.\d{1,3}), preload (0\.\d{1,3})")
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
    def rounded(self) -> Triangle:
        """The shape to a tenth of a degree and a thousandth, as exactly as it is written."""
        return Triangle(round(self.anchor % 360, 1) % 360, round(self.flatness, 3), round(self.preload, 3))

    @property
    def variant(self) -> str:
        """The shape in words."""
        one = self.rounded
        return f"torque, anchor {one.anchor:g} deg, flatness {one.flatness:g}, preload {one.preload:g}"


def triangle_of(variant: str) -> Triangle | None:
    """Return the shape that a model file states in words; None if it states none."""
    found = WRITTEN.fullmatch(variant)
    return None if found is None else Triangle(*map(float, found.groups()))


def carriers(state: State) -> tuple[int, ...]:
    """Return the joints that a compensator could help: across gravity in all readings, and loaded most by the weight.

    Where masses are not known it is the first joint across gravity.
    """
    gravity = state.chain.gravity
    size = float(np.linalg.norm(gravity))
    if size == 0.0:
        return ()
    turning = [j for j in state.chain.revolute if state.compliance[j] > 0]
    across = [j for j in turning if float(np.abs(gravity @ state.at.axis(j)).max()) < ACROSS * size]
    weight = np.sqrt(np.mean(state.gravity_torque**2, axis=1)) * ~np.array(state.chain.prismatic)
    if not weight.any():
        return tuple(across[:1])
    return tuple(j for j in across if weight[j] >= HALF * weight.max())


def spring(state: State, joint: int, triangle: Triangle) -> Candidate:
    """Return the hypothesis of a spring of one shape beside a joint, as exactly as it is written."""
    stated = triangle.rounded
    torque = typical("gravity_compensator_torque", state.rated_load)
    pair = (Parameter("torque", "N*m", torque), Parameter("torque_turned", "N*m", torque, reach=REACH))
    place = {"joint": state.chain.joints[joint]}
    columns, torques = (partial(one, joint=joint, triangle=stated) for one in (pull, side_torques))
    return Candidate(EFFECT.name, EFFECT.family, place, stated.variant, pair, columns, torques=torques, shape=stated)


def open_spring(state: State, joint: int) -> Candidate:
    """Return the hypothesis of a spring of any law: its torque, N*m, is a smooth function of the link's angle.

    Source: a Fourier series of that function; its mean is a zero offset of the joint, which geometry takes up.

    Args:
        state: Of postures at rest, or of a model that is read.
        joint: Index of the joint.
    """
    torque = OPEN_SHARE * typical("gravity_compensator_torque", state.rated_load)
    parameters = tuple(
        Parameter(f"torque_{part}_{order}", "N*m", torque / order**DECAY)
        for order in range(1, OPEN_ORDERS + 1)
        for part in ("sine", "cosine")
    )
    place = {"joint": state.chain.joints[joint]}
    columns, torques = (partial(one, joint=joint) for one in (_moved_by_waves, _waves))
    return Candidate(EFFECT.name, EFFECT.family, place, OPEN, parameters, columns, torques=torques)


def _waves(state: State, joint: int) -> Float2D:
    """Return sine and cosine of every order at the link's angle, (m, 2 o)."""
    phase = np.outer(_link_angle(state, joint), np.arange(1, OPEN_ORDERS + 1))
    return np.stack([np.sin(phase), np.cos(phase)], axis=-1).reshape(state.m, -1)


def _moved_by_waves(state: State, joint: int) -> Float3D:
    compliance = state.compliance[joint]
    return stacked(*(state.joint_column(joint, compliance * part) for part in _waves(state, joint).T))


def _link_angle(state: State, joint: int) -> Float1D:
    """Return the joint's angle with what load and weight deflect, (m,) rad."""
    bent = state.compliance[joint] * (state.load_torque[joint] + state.gravity_torque[joint])
    return np.asarray(state.q[:, joint] + bent)


def spring_torque(angle: Float1D, flatness: float, preload: float) -> Float1D:
    """Return the torque at angles alpha - q2, (m,) rad, in units of the largest."""
    return _torque(angle, flatness, preload) / _largest(flatness, preload)


def _torque(angle: Float1D, flatness: float, preload: float) -> Float1D:
    return np.asarray(np.sin(angle) * (1 - preload / np.sqrt(1 + flatness * np.cos(angle))))


@functools.lru_cache(maxsize=256)
def _largest(flatness: float, preload: float) -> float:
    return float(np.abs(_torque(ALL_ROUND, flatness, preload)).max())


def pull(state: State, joint: int, triangle: Triangle) -> Float3D:
    """Return the movement per N*m, and what a turn of the anchor by `TURN` changes in it, (m, 3, 2)."""
    compliance = state.compliance[joint]
    return stacked(*(state.joint_column(joint, compliance * part) for part in side_torques(state, joint, triangle).T))


def side_torques(state: State, joint: int, triangle: Triangle) -> Float2D:
    """Return the torque beside a joint per N*m, and what a turn of the anchor by `TURN` changes in it, (m, 2)."""
    beta = np.radians(triangle.anchor) - _link_angle(state, joint)
    torque, ahead, behind = (
        spring_torque(beta + turn, triangle.flatness, triangle.preload) for turn in (0.0, TURN, -TURN)
    )
    return np.stack([torque, (ahead - behind) / 2], axis=1)


def _restored(described: AppliedEffect, state: State) -> Candidate | None:
    name, joints, triangle = described.location.get("joint"), state.chain.joints, triangle_of(described.variant)
    if name not in joints:
        return None
    if described.variant == "stiffness":  # what files of earlier versions say of loaded recordings
        pair = (Parameter("modulation_cosine", "1", 1.0), Parameter("modulation_sine", "1", 1.0))
        columns = partial(modulated, joint=joints.index(str(name)))
        return Candidate(EFFECT.name, EFFECT.family, described.location, described.variant, pair, columns)
    if described.variant == OPEN:
        return open_spring(state, joints.index(str(name)))
    return None if triangle is None else spring(state, joints.index(str(name)), triangle)


def _candidates(state: State) -> Iterator[Candidate]:
    for joint in carriers(state):
        for shape in itertools.product(ANCHORS, FLATNESS, PRELOAD):
            yield spring(state, joint, Triangle(*shape))
        if np.any(state.gravity_torque) and not state.loaded:
            yield open_spring(state, joint)


EFFECT = Effect(
    name="gravity_compensator",
    family="structure",
    equation="M = K_c (1 - s0/s) a L sin(alpha - q)",
    source="Klimchik, Pashkevich et al., heavy robots with gravity compensators (arXiv 1311.6810)",
    reveal="absolute positions over the range of the joint; the same load at six values of its angle",
    candidates=_candidates,
    restore=_restored,
    sentence="the gravity compensator of {place} acts",
    traits=frozenset({Trait.SPRING}),
)
