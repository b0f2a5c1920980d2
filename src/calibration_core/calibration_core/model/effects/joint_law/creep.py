"""A joint goes on giving way under a constant torque.

theta = C tau + eps C int (1 - exp(-(t - s)/T)) dtau(s), T between 30 and 1000 s, tau of load and weight.  Torques are
taken as held from one reading to the next, with a step half way.  What happened before a configuration is either
forgotten, or remembered from the first reading of the recording on: the weight, which changes with the posture, creeps
as well.  Source: linear viscoelasticity (standard linear solid).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, typical
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float1D, Float3D, Int1D

TIMES = (30.0, 150.0, 800.0)  # s
FROM_WEIGHT = ", from the weight"


def relaxed(state: State, torque: Float1D, constant: float, *, remembered: bool = False) -> Float1D:
    """Return the (m,) creep integral of a torque (m,), N*m.

    Args:
        state: The loaded robot.
        torque: (m,).
        constant: s.
        remembered: Whether a configuration begins with what those before it left, instead of at rest.
    """
    result = np.empty(state.m)
    for index in _in_time(state) if remembered else state.sequences:
        values, time = torque[index.T], state.time[index.T]  # (k, s), step after step
        passed = np.clip(np.diff(time, axis=0), 0.0, None) / constant
        decay, more = np.exp(-passed), np.diff(values, axis=0) * np.exp(-passed / 2)
        left = np.zeros_like(values)  # of all changes, what has not crept yet
        for k in range(1, len(left)):
            left[k] = left[k - 1] * decay[k - 1] + more[k - 1]
        result[index.T] = values - values[0] - left
    return result


def _in_time(state: State) -> list[Int1D]:
    """Return index arrays (s, k): all rows of every point in the order of time, points with equally many together."""
    rows = [np.flatnonzero(state.point_index == point) for point in np.unique(state.point_index)]
    ordered = [row[np.argsort(state.time[row], kind="stable")] for row in rows]
    return [np.stack([row for row in ordered if len(row) == k]) for k in sorted({len(row) for row in ordered})]


def _columns(state: State, joint: int, constant: float, *, remembered: bool) -> Float3D:
    creeping = relaxed(state, state.torque[joint], constant, remembered=remembered)
    return stacked(state.joint_column(joint, state.compliance[joint] * creeping))


def _forms(state: State) -> Iterator[Candidate]:
    """Return every form; its shape is whether it begins with the weight."""
    if not np.isfinite(state.time).all():
        return
    parameter = Parameter("creep_share", "1", typical("creep", state.rated_load), positive=True)
    for joint, name in enumerate(state.chain.joints):
        if state.compliance[joint] > 0:
            for constant in TIMES:
                for remembered, words in ((False, ""), (True, FROM_WEIGHT)):
                    columns = partial(_columns, joint=joint, constant=constant, remembered=remembered)
                    variant = f"{constant:g} s{words}"
                    yield Candidate(
                        EFFECT.name, EFFECT.family, {"joint": name}, variant, (parameter,), columns, shape=remembered
                    )


def _candidates(state: State) -> Iterator[Candidate]:
    """Leave out what is the same: without weight, or without later steps."""
    several = bool(np.any(state.step != state.step[:1]))
    borne = {name for joint, name in enumerate(state.chain.joints) if state.bears_weight(joint)}
    for candidate in _forms(state):
        if candidate.location["joint"] in borne if candidate.shape else several:
            yield candidate


EFFECT = Effect(
    name="creep",
    family="joint law",
    equation="theta = C tau + eps C int (1 - exp(-(t - s)/T)) dtau(s)",
    source="linear viscoelasticity, standard linear solid",
    reveal="ten-minute holds at full and at zero load",
    candidates=_candidates,
    forms=_forms,
    sentence="{place} creeps under load",
    traits=frozenset({Trait.MEMORY}),
)
