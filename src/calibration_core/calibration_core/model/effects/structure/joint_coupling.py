"""Two joints share a transmission: the torque of one deflects the other.

theta_i = C_ij tau_j and theta_j = C_ij tau_i (a symmetric compliance matrix, by reciprocity).  What gives way stores
energy, so that the matrix is positive: |C_ij| < sqrt(C_ii C_jj).
Source: wrist gear trains, parallelogram drives; Maxwell-Betti.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from itertools import combinations

import numpy as np

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, typical
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D

UNSURE = 1.5  # so many times its stated value may a joint's compliance be


def _columns(state: State, first: int, second: int) -> Float3D:
    torque = state.torque
    return stacked(state.joint_column(first, torque[second]) + state.joint_column(second, torque[first]))


def _candidates(state: State) -> Iterator[Candidate]:
    share = typical("joint_coupling", state.rated_load)
    known = state.compliance[state.compliance > 0]
    usual = float(np.median(known)) if len(known) else 1e-6
    c = np.where(state.compliance > 0, state.compliance, usual)
    for first, second in combinations(state.chain.revolute, 2):
        size = share * float(np.sqrt(c[first] * c[second]))
        place = {"joints": (state.chain.joints[first], state.chain.joints[second])}
        both = float(np.sqrt(state.compliance[first] * state.compliance[second]))
        parameter = Parameter("compliance", "rad/(N*m)", size, most=UNSURE * both or math.inf)
        columns = partial(_columns, first=first, second=second)
        yield Candidate(EFFECT.name, EFFECT.family, place, "symmetric", (parameter,), columns)


EFFECT = Effect(
    name="joint_coupling",
    family="structure",
    equation="theta_i = C_ij tau_j, theta_j = C_ij tau_i",
    source="wrist gear trains and parallelograms; Maxwell-Betti reciprocity",
    reveal="loads that put a torque on one of the two joints only",
    candidates=_candidates,
    sentence="{place} are coupled elastically",
)
