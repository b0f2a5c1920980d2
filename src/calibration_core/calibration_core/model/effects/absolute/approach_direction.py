"""Where a joint stands depends on the side from which it came: friction, cable drives, lost motion.

dq_j = h sign(last motion of q_j), h half the reversal error.  The last motion is taken from the order of the poses; no
velocity is needed.  A joint changes its side after it has travelled the reversal, 2 h at typical h.  Of the first poses
nothing is known: they count as zero.
Source: reversal error of positioning axes (ISO 230-2); friction in cable drives.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from functools import partial

import numpy as np

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, typical
from calibration_core.model.effects.state import State
from calibration_core.model.parameters import AppliedEffect
from calibration_core.timeseries import Float2D, Float3D

REVERSAL = 2.0  # typical half widths that a joint must travel before it stands on the other side


def last_motion(q: Float2D, reversal: float) -> Float2D:
    """Return -1, 0 or 1 per reading and joint, (m, n): the side from which the joint came, 0 as long as unknown.

    Args:
        q: (m, n) rad, in the order of time.
        reversal: rad; a joint that moved back by less keeps its side.
    """
    side = np.zeros_like(q)
    turning_point = q[0].copy() if len(q) else np.zeros(q.shape[1])
    for k in range(1, len(q)):
        travelled = q[k] - turning_point
        far = np.abs(travelled) > reversal
        side[k] = np.where(far, np.sign(travelled), side[k - 1])
        turning_point = np.where(far | (travelled * side[k] > 0), q[k], turning_point)
    return side


def sides(state: State) -> Float2D:
    """Return -1, 0 or 1 per reading and joint, (m, n): the side from which the joint came, 0 as long as unknown."""
    return _last_motion(state.q.tobytes(), state.q.shape, REVERSAL * typical("approach_direction", state.rated_load))


@functools.lru_cache(maxsize=4)
def _last_motion(q: bytes, shape: tuple[int, int], reversal: float) -> Float2D:
    return last_motion(np.frombuffer(q).reshape(shape), reversal)


def _columns(state: State, joints: tuple[int, ...]) -> Float3D:
    side = sides(state)
    return stacked(*(state.joint_column(joint, side[:, joint]) for joint in joints))


def approach(state: State, joints: tuple[int, ...], location: Mapping[str, str | tuple[str, ...]]) -> Candidate:
    """Return the hypothesis that the given joints (indices) stop short, named by where it is said to be."""
    size = typical("approach_direction", state.rated_load)
    names = [""] if "joint" in location else [f" {state.chain.joints[joint]}" for joint in joints]
    units = [state.chain.units[joint] for joint in joints]
    parameters = tuple(Parameter(f"half_width{name}", unit, size) for name, unit in zip(names, units, strict=True))
    return Candidate(EFFECT.name, EFFECT.family, location, "sign", parameters, partial(_columns, joints=joints))


def _restored(described: AppliedEffect, state: State) -> Candidate | None:
    joints = state.chain.joints
    names = [key.removeprefix("half_width").strip() or described.location.get("joint") for key in described.parameters]
    if not names or any(name not in joints for name in names):
        return None
    return approach(state, tuple(joints.index(str(name)) for name in names), described.location)


def _candidates(state: State) -> Iterator[Candidate]:
    seen = sides(state)
    turning = tuple(j for j in range(state.chain.n) if np.any(seen[:, j]))
    for joint in turning:
        yield approach(state, (joint,), {"joint": state.chain.joints[joint]})
    if len(turning) > 1:
        yield approach(state, turning, {"robot": "all joints"})


EFFECT = Effect(
    name="approach_direction",
    family="absolute",
    equation="dq_j = h sign(last motion of q_j)",
    source="reversal error of positioning axes (ISO 230-2)",
    reveal="the same poses once more, every joint approached from the other side",
    candidates=_candidates,
    loaded=False,
    restore=_restored,
    sentence="the position of {place} depends on the direction of approach",
    traits=frozenset({Trait.HISTORY, Trait.PATH}),
)
