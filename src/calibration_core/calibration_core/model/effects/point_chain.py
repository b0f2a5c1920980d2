"""Effects of the point chain: what lies between the measured point and its position as recorded."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, along_axes, typical
from calibration_core.model.effects.state import State
from calibration_core.model.parameters import AppliedEffect
from calibration_core.timeseries import Float3D

FAMILY = "point chain"
TRACKER = {"tracker": "tracker"}
LINEAR = "linear in time"
SETTLES = re.compile(r"settles in (\d{1,8}(?:\.\d)?) s")  # as a model file says it
FASTEST, SLOWER = 16, 2.0  # the shortest time constant is a sixteenth of the recording, each further one twice the last


def _clock(state: State) -> Iterator[Candidate]:  # noqa: ARG001  # at rest whatever the state
    """Offer nothing: readings are averages at rest, where v is zero.

    In streams the offset is found on the ramps of the load, and taken out before anything is averaged
    (`observations.clock`).
    """
    yield from ()


CLOCK = Effect(
    name="clock_offset",
    family=FAMILY,
    equation="d = v dt",
    source="clocks that nobody synchronised, 10 to 500 ms",
    reveal="streams through load ramps instead of averages at rest",
    candidates=_clock,
    sentence="the clocks of tracker and robot differ",
    traits=frozenset({Trait.HISTORY}),
)


def _target_columns(state: State, points: tuple[int, ...]) -> Float3D:
    axes = np.moveaxis(state.at.flange, -1, 0).transpose(0, 2, 1)  # (m, 3, 3), columns are flange axes
    columns = np.zeros((state.m, 3, 3 * len(points)))
    for k, point in enumerate(points):
        rows = state.point_index == point
        columns[rows, :, 3 * k : 3 * k + 3] = axes[rows]
    return state.since_step_zero(columns)


def _targets(state: State) -> Iterator[Candidate]:
    parameters = along_axes("offset", "m", typical(TARGET.name, state.rated_load))
    for point in (int(point) for point in np.unique(state.point_index)):
        columns = partial(_target_columns, points=(point,))
        yield Candidate(TARGET.name, FAMILY, {"point": f"#{point}"}, "one point", parameters, columns)


TARGET = Effect(
    name="measurement_point_offset",
    family=FAMILY,
    equation="d = theta_tool x u",
    source="lever arm of a measurement point (CWA 17384, 7.5)",
    reveal="measure the point in known configurations",
    candidates=_targets,
    absolute=False,
    sentence="target {place} is at another place than stated",
    traits=frozenset({Trait.FRAMES}),
    stated="frames.measurement_points",
)


def _drift_columns(state: State, constant: float | None) -> Float3D:
    """Shifts v and turns om about the tracker; with a time constant both are the velocities at first."""
    time = (state.time - state.time.min())[:, None]
    if constant is not None:
        time = -constant * np.expm1(-time / constant)
    arm = state.point.T - state.tracker[:3, 3]
    shifts = [time * np.broadcast_to(axis, (state.m, 3)) for axis in np.eye(3)]
    return stacked(*shifts, *(time * np.cross(axis, arm) for axis in np.eye(3)))


def _drift(state: State, constant: float | None) -> Candidate:
    """Return the hypothesis of a drift with a time constant, s (what warms up comes to rest); None: at one rate."""
    shift, turn = typical("tracker_drift", state.rated_load), typical("tracker_drift_rotation", state.rated_load)
    parameters = along_axes("velocity", "m/s", shift) + along_axes("rate", "rad/s", turn)
    variant = LINEAR if constant is None else f"settles in {constant:.1f} s"
    return Candidate(DRIFT.name, FAMILY, TRACKER, variant, parameters, partial(_drift_columns, constant=constant))


def _drifts(state: State) -> Iterator[Candidate]:
    if not np.isfinite(state.time).all():
        return
    yield _drift(state, None)
    whole = float(np.ptp(state.time))
    constant = whole / FASTEST
    while 0.0 < constant < whole:
        yield _drift(state, round(constant, 1))
        constant *= SLOWER


def _restored_drift(described: AppliedEffect, state: State) -> Candidate | None:
    written = SETTLES.fullmatch(described.variant)
    if not np.isfinite(state.time).all() or (written is None and described.variant != LINEAR):
        return None
    return _drift(state, None if written is None else float(written[1]))


DRIFT = Effect(
    name="tracker_drift",
    family=FAMILY,
    equation="d = f(t) (v + om x p), f = t or tau (1 - exp(-t / tau))",
    source="thermal drift of stands and floors",
    reveal="the home pose every three to five configurations; fixed reference targets",
    candidates=_drifts,
    restore=_restored_drift,
    sentence="the tracker drifts",
    traits=frozenset({Trait.DRIFT, Trait.HISTORY}),
)


def _turned_columns(state: State) -> Float3D:
    deflection = state.since_step_zero(state.point.T)
    return stacked(*(np.cross(axis, deflection) for axis in np.eye(3)))


def _turned(state: State) -> Iterator[Candidate]:
    parameters = along_axes("rotation", "rad", typical(MISALIGNMENT.name, state.rated_load))
    yield Candidate(MISALIGNMENT.name, FAMILY, TRACKER, "small rotation", parameters, _turned_columns)


MISALIGNMENT = Effect(
    name="tracker_frame_misalignment",
    family=FAMILY,
    equation="d = (I + [b]x) d_read",
    source="registration of the tracker (CWA 17384, 5.2, 7.1)",
    reveal="absolute positions in many configurations",
    candidates=_turned,
    absolute=False,
    sentence="the tracker stands turned against the cell file",
    traits=frozenset({Trait.FRAMES}),
    stated="frames.tracker",
)


def _scale_columns(state: State) -> Float3D:
    """Deflections show it nowhere: there it is a common factor of all compliances."""
    return stacked(state.point.T - state.tracker[:3, 3])


def _scales(state: State) -> Iterator[Candidate]:
    parameters = (Parameter("scale", "1", typical(SCALE.name, state.rated_load)),)
    yield Candidate(SCALE.name, FAMILY, TRACKER, "common factor", parameters, _scale_columns)


SCALE = Effect(
    name="tracker_scale",
    family=FAMILY,
    equation="p_read = (1 + s) p, in the tracker's frame",
    source="refraction of air, 1 ppm per K",
    reveal="a scale bar, or targets at known distances",
    candidates=_scales,
    loaded=False,
    sentence="the tracker's scale is off",
)
