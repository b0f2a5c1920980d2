"""The tracker, or the robot's base, moves slowly against the other.

d = f(t) (v + om x p), p the absolute position.  f = t, or tau (1 - exp(-t / tau)): what warms up comes to rest, and v
and om are the velocities at first.  Source: thermal drift of stands and floors; Newton's law of cooling.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, typical
from calibration_core.model.effects.state import State
from calibration_core.model.parameters import AppliedEffect
from calibration_core.timeseries import Float3D

LINEAR = "linear in time"
SETTLES = re.compile(r"settles in (\d{1,8}(?:\.\d)?) s")  # as a model file says it
FASTEST, SLOWER = 16, 2.0  # the shortest time constant is a sixteenth of the recording, each further one twice the last


def _columns(state: State, constant: float | None) -> Float3D:
    time = (state.time - state.time.min())[:, None]
    if constant is not None:
        time = -constant * np.expm1(-time / constant)
    arm = state.point.T - state.tracker[:3, 3]
    shifts = [time * np.broadcast_to(axis, (state.m, 3)) for axis in np.eye(3)]
    return stacked(*shifts, *(time * np.cross(axis, arm) for axis in np.eye(3)))


def _drift(state: State, constant: float | None) -> Candidate:
    """Return the hypothesis of a drift with a time constant, s; None: at one rate."""
    shift, turn = typical("tracker_drift", state.rated_load), typical("tracker_drift_rotation", state.rated_load)
    parameters = tuple(Parameter(f"velocity_{axis}", "m/s", shift) for axis in "xyz") + tuple(
        Parameter(f"rate_{axis}", "rad/s", turn) for axis in "xyz"
    )
    variant = LINEAR if constant is None else f"settles in {constant:.1f} s"
    columns = partial(_columns, constant=constant)
    return Candidate(EFFECT.name, EFFECT.family, {"tracker": "tracker"}, variant, parameters, columns)


def _candidates(state: State) -> Iterator[Candidate]:
    if not np.isfinite(state.time).all():
        return
    yield _drift(state, None)
    whole = float(np.ptp(state.time))
    constant = whole / FASTEST
    while 0.0 < constant < whole:
        yield _drift(state, round(constant, 1))
        constant *= SLOWER


def _restored(described: AppliedEffect, state: State) -> Candidate | None:
    written = SETTLES.fullmatch(described.variant)
    if not np.isfinite(state.time).all() or (written is None and described.variant != LINEAR):
        return None
    return _drift(state, None if written is None else float(written[1]))


EFFECT = Effect(
    name="tracker_drift",
    family="point chain",
    equation="d = f(t) (v + om x p), f = t or tau (1 - exp(-t / tau))",
    source="thermal drift of stands and floors",
    reveal="the home pose every three to five configurations; fixed reference targets",
    candidates=_candidates,
    restore=_restored,
    sentence="the tracker drifts",
    traits=frozenset({Trait.DRIFT, Trait.HISTORY}),
)
