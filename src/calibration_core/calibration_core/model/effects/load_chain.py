"""Effects of the load chain: what lies between the load at the robot and the wrench as recorded."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import partial

import numpy as np

from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Effect, Parameter, Trait, along_axes, typical
from calibration_core.model.effects.state import State
from calibration_core.model.kinematics import by_axis, dot, linear_jacobian
from calibration_core.timeseries import Float2D, Float3D

FAMILY = "load chain"
AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
MOST = 0.5  # a channel that has lost one of its two half bridges reads half; more is a wrong range or unit
SENSOR, TOOL = {"sensor": "force_torque"}, {"tool": "tool"}
ARM = 0.2  # m: lever with which forces and torques of a sensor are compared; of a tool's centre of gravity, typically
LAWS = {1: "winds up with", 3: "winds up, ever stiffer, with"}  # power of the angle
SHORTEST = 1e-3  # m; nearer holds give no direction


# --- the force/torque sensor ------------------------------------------------------------------------------------------


def _gain_columns(state: State, axes: tuple[int, ...]) -> Float3D:
    """To first order the points move by -g times what the read load moves them."""
    return -state.by_wrench[:, :, axes] * state.wrench[:, None, axes]


def _gains(state: State) -> Iterator[Candidate]:
    """A gain common to all axes is an exact alias of all compliances together."""
    several = [("forces", (0, 1, 2)), ("all axes", (0, 1, 2, 3, 4, 5)), *((name, (k,)) for k, name in enumerate(AXES))]
    for variant, axes in several:
        size = typical(GAIN.name, state.rated_load)
        parameters = tuple(Parameter(f"gain_{AXES[axis]}", "1", size, most=MOST) for axis in axes)
        yield Candidate(GAIN.name, FAMILY, SENSOR, variant, parameters, partial(_gain_columns, axes=axes))


GAIN = Effect(
    name="wrench_gain",
    family=FAMILY,
    equation="f_read = (1 + g) f, per axis",
    source="calibration error of the force/torque sensor",
    reveal="known masses in several attitudes of the sensor",
    candidates=_gains,
    absolute=False,
    sentence="the force/torque sensor reads too much or too little",
)


def _pairs(count: int) -> list[tuple[int, int]]:
    return [(to, source) for to in range(count) for source in range(count) if to != source]


def _crosstalk_columns(state: State, count: int) -> Float3D:
    """To first order w = (I - X) w_read."""
    return np.stack(
        [-state.by_wrench[:, :, to] * state.wrench[:, None, source] for to, source in _pairs(count)], axis=-1
    )


def _crosstalk(state: State) -> Iterator[Candidate]:
    size = typical(CROSSTALK.name, state.rated_load)
    for variant, count in (("forces", 3), ("all axes", 6)):
        parameters = []
        for to, source in _pairs(count):
            force_to_torque = to >= 3 > source
            torque_to_force = source >= 3 > to
            scale = ARM if force_to_torque else 1 / ARM if torque_to_force else 1.0
            unit = "m" if force_to_torque else "1/m" if torque_to_force else "1"
            parameters.append(Parameter(f"{AXES[source]}_to_{AXES[to]}", unit, size * scale, most=MOST * scale))
        columns = partial(_crosstalk_columns, count=count)
        yield Candidate(CROSSTALK.name, FAMILY, SENSOR, variant, tuple(parameters), columns)


CROSSTALK = Effect(
    name="wrench_crosstalk",
    family=FAMILY,
    equation="w_read = (I + X) w, X off the diagonal",
    source="decoupling matrix of the force/torque sensor",
    reveal="loads along every axis of the sensor",
    candidates=_crosstalk,
    absolute=False,
    sentence="the axes of the force/torque sensor influence each other",
)


def _drift_columns(state: State) -> Float3D:
    return -state.by_wrench * (state.time - state.time.min())[:, None, None]


def _drift(state: State) -> Iterator[Candidate]:
    if np.isfinite(state.time).all():
        force = typical("wrench_drift_force", state.rated_load)
        torque = typical("wrench_drift_torque", state.rated_load)
        sizes = [("N/s", force)] * 3 + [("N*m/s", torque)] * 3
        parameters = tuple(Parameter(f"drift_{name}", *size) for name, size in zip(AXES, sizes, strict=True))
        yield Candidate(DRIFT.name, FAMILY, SENSOR, "linear in time", parameters, _drift_columns)


DRIFT = Effect(
    name="wrench_drift",
    family=FAMILY,
    equation="w = w_read - b' t",
    source="creep and temperature of strain gauges",
    reveal="unloaded readings and a tare before and after every configuration",
    candidates=_drift,
    absolute=False,
    sentence="the force/torque sensor drifts",
    traits=frozenset({Trait.DRIFT}),
)


def _turned_columns(state: State) -> Float3D:
    columns = []
    for axis in np.eye(3):
        turned = np.hstack([np.cross(axis, state.wrench[:, :3]), np.cross(axis, state.wrench[:, 3:])])
        columns.append(np.einsum("mak,mk->ma", state.by_wrench, turned))
    return stacked(*columns)


def _turned(state: State) -> Iterator[Candidate]:
    parameters = along_axes("rotation", "rad", typical(MISALIGNMENT.name, state.rated_load))
    yield Candidate(MISALIGNMENT.name, FAMILY, SENSOR, "small rotation", parameters, _turned_columns)


MISALIGNMENT = Effect(
    name="wrench_frame_misalignment",
    family=FAMILY,
    equation="w = (I + [a]x) w_read",
    source="mounting of the sensor",
    reveal="a known mass hung in three orientations",
    candidates=_turned,
    absolute=False,
    sentence="the force/torque sensor is turned against the cell file",
    stated="frames.force_torque",
)


def _lever_columns(state: State) -> Float3D:
    columns = []
    for axis in np.eye(3):
        moment = np.cross(axis, state.wrench[:, :3])
        columns.append(np.einsum("mak,mk->ma", state.by_wrench[:, :, 3:], moment))
    return stacked(*columns)


def _lever(state: State) -> Iterator[Candidate]:
    parameters = along_axes("offset", "m", typical(POINT_OFFSET.name, state.rated_load))
    yield Candidate(POINT_OFFSET.name, FAMILY, SENSOR, "lever arm", parameters, _lever_columns)


POINT_OFFSET = Effect(
    name="wrench_point_offset",
    family=FAMILY,
    equation="t = t_read + e x f",
    source="lever arm of the wrench (CWA 17384, 7.4)",
    reveal="measure the point in known configurations; pure moments",
    candidates=_lever,
    absolute=False,
    sentence="the load pulls at another point than stated",
    stated="frames.force_torque",
    stated_otherwise="frames.wrench_point where wrench_at is wrench_point",
)


# --- what pulls at the tool: movement by the joints' compliances, which must therefore be known -----------------------


def pulled(state: State, where: Float2D, force: Float2D) -> Float2D:
    """Return the (m, 3) m that a force (3, m) N at points (3, m) m moves the measured point, by the joints alone."""
    moved = np.zeros((3, state.m))
    torque = dot(by_axis(linear_jacobian(state.at, where)), force[:, None])
    for joint, compliance in enumerate(state.compliance):
        moved += state.answer[:, joint] * (compliance * torque[joint])
    return moved.T


def _weight_columns(state: State) -> Float3D:
    gravity = np.broadcast_to(state.chain.gravity[:, None], (3, state.m))
    weight = pulled(state, state.at.flange_origin, gravity)
    levers = [pulled(state, state.at.flange_origin + axis, gravity) - weight for axis in state.at.flange]
    return stacked(weight, *levers)


def _weight(state: State) -> Iterator[Candidate]:
    if np.any(state.compliance):
        mass = typical(WEIGHT.name, state.rated_load)
        parameters = (Parameter("mass", "kg", mass), *along_axes("moment", "kg*m", ARM * mass))
        yield Candidate(WEIGHT.name, FAMILY, TOOL, "mass and first moments", parameters, _weight_columns)


WEIGHT = Effect(
    name="tool_weight",
    family=FAMILY,
    equation="d tau_j = a_j . ((c - o_j) x M g)",
    source="statics of the tool",
    reveal="the same poses with and without the tool, or with a second payload",
    candidates=_weight,
    loaded=False,
    sentence="the weight of the tool is not what the model takes it for",
    traits=frozenset({Trait.ACTS_IN_USE}),
)


def _cable_columns(state: State, holder: int) -> Float3D:
    """The pull e points from the flange to the origin of a joint further back, where the hose is held on the arm."""
    pull = state.at.origin[holder] - state.at.flange_origin
    length = np.maximum(np.linalg.norm(pull, axis=0), SHORTEST)
    return stacked(pulled(state, state.at.flange_origin, pull / length))


def _wound_columns(state: State, joint: int, power: int) -> Float3D:
    turned = state.compliance[joint] * state.q[:, [joint]] ** np.arange(1, power + 1)
    return stacked(*(state.joint_column(joint, one) for one in turned.T))


def _cables(state: State) -> Iterator[Candidate]:
    """Of a loop that winds up with one joint, k q_j, the constant is a zero of the joint."""
    if not np.any(state.compliance):
        return
    parameters = (Parameter("force", "N", typical(CABLE.name, state.rated_load)),)
    for holder in range(state.chain.n - 1):
        variant = f"held at {state.chain.joints[holder]}"
        yield Candidate(CABLE.name, FAMILY, TOOL, variant, parameters, partial(_cable_columns, holder=holder))
    size = typical("cable_stiffness", state.rated_load)
    names = ("stiffness", "N*m/rad"), ("stiffening", "N*m/rad^2"), ("stiffening_square", "N*m/rad^3")
    stiffness = tuple(Parameter(*name, size) for name in names)
    for joint, (power, how) in itertools.product(state.chain.revolute, LAWS.items()):
        if state.compliance[joint] > 0:
            variant, columns = f"{how} {state.chain.joints[joint]}", partial(_wound_columns, joint=joint, power=power)
            yield Candidate(CABLE.name, FAMILY, TOOL, variant, stiffness[:power], columns)


CABLE = Effect(
    name="cable_force",
    family=FAMILY,
    equation="d tau_j = a_j . ((p - o_j) x F e), or k q_j",
    source="statics of a hose package",
    reveal="the same poses with and without the hose package",
    candidates=_cables,
    loaded=False,
    sentence="a cable or dress pack pulls",
    traits=frozenset({Trait.ACTS_IN_USE}),
)
