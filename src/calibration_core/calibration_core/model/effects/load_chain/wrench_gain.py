"""The force/torque sensor reads one axis too high or too low.

f_read = (1 + g) f per axis; to first order the points move by -g times what the read load moves them.  A gain common to
all axes is an exact alias of all compliances together.
Source: calibration error of the sensor.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, typical
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float3D

AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
MOST = 0.5  # a channel that has lost one of its two half bridges reads half; more is a wrong range or unit


def _columns(state: State, axes: tuple[int, ...]) -> Float3D:
    return -state.by_wrench[:, :, axes] * state.wrench[:, None, axes]


def _candidates(state: State) -> Iterator[Candidate]:
    size = typical("wrench_gain", state.rated_load)
    sensor = {"sensor": "force_torque"}
    for variant, axes in (("forces", (0, 1, 2)), ("all axes", (0, 1, 2, 3, 4, 5))):
        parameters = tuple(Parameter(f"gain_{AXES[axis]}", "1", size, most=MOST) for axis in axes)
        yield Candidate(EFFECT.name, EFFECT.family, sensor, variant, parameters, partial(_columns, axes=axes))
    for axis, name in enumerate(AXES):
        one = (Parameter(f"gain_{name}", "1", size, most=MOST),)
        yield Candidate(EFFECT.name, EFFECT.family, sensor, name, one, partial(_columns, axes=(axis,)))


EFFECT = Effect(
    name="wrench_gain",
    family="load chain",
    equation="f_read = (1 + g) f, per axis",
    source="calibration error of the force/torque sensor",
    reveal="known masses in several attitudes of the sensor",
    candidates=_candidates,
    absolute=False,
    sentence="the force/torque sensor reads too much or too little",
)
