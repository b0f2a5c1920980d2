"""Friction between motor and link: the deflection depends on where the torque came from.

theta = C tau - sum_r h_r stop_r[tau]/r: elements that stick up to r and slip beyond (Prandtl-Ishlinskii, Maxwell slip),
under load and weight.  What happened before step 0 is unknown.  Tried are elements that the weight alone has strained
from nothing, relaxed ones (a virgin start), and ones on the verge in the direction against the first load (a centred
start).  The radii form one block.
Source: Al-Bender, Lampaert, Swevers on presliding; stop operators.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter
from calibration_core.model.effects.priors import typical
from calibration_core.model.effects.springs import stacked
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float2D, Float3D

RADII = (0.02, 0.06, 0.15, 0.4)  # of the largest torque


STARTS = {"virgin start": 0.0, "centred start": 1.0, "from the weight": None}


def stop(torque: Float2D, radius: float, start: float | None) -> Float2D:
    """Return the stop operator along the steps, (s, k): what an element of strength `radius` carries.

    Args:
        torque: (s, k) N*m, steps in the order of time.
        radius: Strength, N*m.
        start: What the element carries at step 0, as a fraction of its strength, against the first change of torque;
            None: the torque there, as far as it can.
    """
    direction = np.sign(torque[:, 1:2] - torque[:, :1]) if torque.shape[1] > 1 else np.zeros((len(torque), 1))
    carried = np.clip(torque[:, 0], -radius, radius) if start is None else -start * radius * direction[:, 0]
    result = np.empty_like(torque)
    result[:, 0] = carried
    for k in range(1, torque.shape[1]):
        carried = np.clip(carried + torque[:, k] - torque[:, k - 1], -radius, radius)
        result[:, k] = carried
    return result


def _columns(state: State, joint: int, start: float | None) -> Float3D:
    torque = state.torque[joint]
    scale = state.largest_torque(joint)
    return stacked(
        *(
            -state.joint_column(
                joint, state.along_steps(torque, partial(stop, radius=r * scale, start=start)) / (r * scale)
            )
            for r in RADII
        )
    )


def _forms(state: State) -> Iterator[Candidate]:
    size = typical("hysteresis", state.rated_load)
    for joint, name in enumerate(state.chain.joints):
        unit = state.chain.units[joint]
        parameters = tuple(Parameter(f"half_width_{100 * r:g}_percent", unit, size, positive=True) for r in RADII)
        for variant, start in STARTS.items():
            columns = partial(_columns, joint=joint, start=start)
            yield Candidate(EFFECT.name, EFFECT.family, {"joint": name}, variant, parameters, columns)


def _candidates(state: State) -> Iterator[Candidate]:
    """Leave out starts that are the same: from a weight that is none; or all others, where there are no later steps."""
    several = bool(np.any(state.step != state.step[:1]))
    borne = {name for joint, name in enumerate(state.chain.joints) if state.bears_weight(joint)}
    for candidate in _forms(state):
        if candidate.location["joint"] in borne if candidate.variant == "from the weight" else several:
            yield candidate


EFFECT = Effect(
    name="hysteresis",
    family="joint law",
    equation="theta = C tau - sum_r h_r stop_r[tau]/r",
    source="Prandtl-Ishlinskii stop operators, Maxwell slip (Al-Bender, Lampaert, Swevers)",
    reveal="unloading through the same levels; then holds, to tell it from creep",
    candidates=_candidates,
    forms=_forms,
)
