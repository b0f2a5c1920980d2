"""Blocks of columns for absolute positions: how the residual of a point answers to each parameter.

The prediction of a measured point is linearised block by block; a block (a `Term`) knows its parameters' names, writes
their columns for many readings at once, and applies a step to the model.  A fit is a list of terms, so a further
effect is a further term and nothing else.  With the residual e = (R y + t) - p in base axes (measured minus
predicted), every column is -de/dx.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from calibration_core.model.chain import Chain, rotation_about, rotation_xyz, rotation_y, rotation_z
from calibration_core.model.equilibrium import Equilibrium
from calibration_core.model.kinematics import Posture, linear_jacobian, turn
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.statics import gravity_torque
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D

AXES = ("x", "y", "z")
CORRECTIONS = ("x", "y", "z", "rx", "ry", "rz")


@dataclasses.dataclass(frozen=True, eq=False)
class TermContext:
    """What a term sees of m readings at the current parameters; everything in the base frame.

    Attributes:
        chain: The chain with its geometry corrected.
        at: The posture, deflected where the joints are elastic.
        target: (3, m) m, predicted point.
        measured: (3, m) m, measured point, brought into the base frame by the current tracker pose.
        point: (m,) index of the measurement point of each reading; None where there is only one point.
        rest: The equilibrium behind `at`; None for a rigid robot.
        recording: (m,) which of several recordings each reading comes from; None: one alone.
    """

    chain: Chain
    parameters: ModelParameters
    at: Posture
    target: Float2D
    measured: Float2D
    point: Int1D | None
    rest: Equilibrium | None
    recording: Int1D | None = None


class Term(Protocol):
    """A block of parameters with their columns."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of the columns."""
        ...

    @property
    def lower(self) -> Float1D:
        """Lower bounds of the *values* (not steps) of the parameters; -inf where there is none."""
        ...

    def values(self, parameters: ModelParameters) -> Float1D:
        """Return the current values, those that the bounds apply to."""
        ...

    def write(self, view: TermContext, out: Float3D) -> None:
        """Write the columns into `out`, (p, 3, m), base axes."""
        ...

    def moved(self, parameters: ModelParameters, step: Float1D) -> ModelParameters:
        """Return the parameters after a step of this block."""
        ...


class PoseSteps:
    """What the steps of every pose have in common: six parameters without bounds, relative to the current pose."""

    @property
    def lower(self) -> Float1D:
        """No bounds."""
        return np.full(6, -np.inf)

    def values(self, parameters: ModelParameters) -> Float1D:  # noqa: ARG002 - a pose has no bounded values
        """Return zeros: the step is relative to the current pose."""
        return np.zeros(6)


@dataclasses.dataclass(frozen=True)
class TrackerTerm(PoseSteps):
    """Pose of the tracker frame in the base frame: three translations, then three rotations about the base axes.

    A step (v, w) makes T -> [exp(w), v] T: the rotation is about the origin of the base frame.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the six parameters."""
        return tuple(f"tracker {name}" for name in CORRECTIONS)

    def write(self, view: TermContext, out: Float3D) -> None:
        """Write -v and -(w x measured)."""
        out[:6] = 0.0
        for k in range(3):
            out[k, k] = -1.0
        x, y, z = view.measured
        out[3, 1], out[3, 2] = z, -y
        out[4, 0], out[4, 2] = -z, x
        out[5, 0], out[5, 1] = y, -x

    def moved(self, parameters: ModelParameters, step: Float1D) -> ModelParameters:
        """Apply a twist from the left."""
        tracker = rotation_about(step[3:]) @ parameters.tracker[:3, :]
        tracker[:, 3] += step[:3]
        return parameters.replace(tracker=np.vstack([tracker, [0.0, 0.0, 0.0, 1.0]]))


@dataclasses.dataclass(frozen=True)
class PointTerm:
    """Position of one measurement point in the flange frame, m.

    Attributes:
        point: Its name.
        index: Its number in `TermContext.point`.
        axes: Which of its coordinates are fitted.
    """

    point: str
    index: int
    axes: tuple[int, ...] = (0, 1, 2)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return tuple(f"{self.point} {AXES[axis]}" for axis in self.axes)

    @property
    def lower(self) -> Float1D:
        """No bounds."""
        return np.full(len(self.axes), -np.inf)

    def values(self, parameters: ModelParameters) -> Float1D:
        """Return the coordinates."""
        return parameters.points[self.point][list(self.axes)]

    def write(self, view: TermContext, out: Float3D) -> None:
        """Write the axes of the flange, zero where another point was read."""
        for column, axis in zip(out, self.axes, strict=True):
            column[:] = view.at.flange[axis]
        if view.point is not None:
            out[:, :, view.point != self.index] = 0.0

    def moved(self, parameters: ModelParameters, step: Float1D) -> ModelParameters:
        """Move the point."""
        position = parameters.points[self.point].copy()
        position[list(self.axes)] += step
        return parameters.replace(points={**parameters.points, self.point: position})


@dataclasses.dataclass(frozen=True)
class GeometryTerm:
    """Chosen corrections of the frames before the joints (`ModelParameters.geometry`).

    Exact for a rigid robot; with elastic joints the change of the load by the geometry is left out, which is the
    deflection in rad times the column (about a thousandth of it).

    Attributes:
        chosen: (joint, correction) pairs, both counted from 0, corrections in the order of `CORRECTIONS`.
    """

    chosen: tuple[tuple[int, int], ...]
    labels: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the chosen corrections."""
        return self.labels

    @property
    def lower(self) -> Float1D:
        """No bounds."""
        return np.full(len(self.chosen), -np.inf)

    def values(self, parameters: ModelParameters) -> Float1D:
        """Return the corrections."""
        return np.array([parameters.geometry[pair] for pair in self.chosen])

    def write(self, view: TermContext, out: Float3D) -> None:
        """Write the direction of a translation, or the axis of a rotation times the lever to the point."""
        lever, joint_of_lever = view.target, -1
        for column, (joint, kind) in zip(out, self.chosen, strict=True):
            axis = turn(view.at.before[joint], correction_axis(view.parameters.geometry[joint], kind))
            if kind < 3:
                column[:] = axis
                continue
            if joint != joint_of_lever:
                lever, joint_of_lever = view.target - view.at.origin[joint], joint
            cross_into(axis, lever, column)

    def moved(self, parameters: ModelParameters, step: Float1D) -> ModelParameters:
        """Add to the chosen corrections."""
        geometry = parameters.geometry.copy()
        for pair, change in zip(self.chosen, step, strict=True):
            geometry[pair] += change
        return parameters.replace(geometry=geometry)


@dataclasses.dataclass(frozen=True)
class ElasticityTerm:
    """Axial compliances of chosen joints under the robot's own weight, rad/(N*m), not negative.

    Column of joint j: (a_j x (p - o_j)) tau_j, with the answer of the equilibrium where the joints already give way.

    Attributes:
        joints: Chosen joints, counted from 0.
        gravity: (3,) m/s^2 in base axes: torques from this gravity at the posture as it is, without the equilibrium.
            Such a term serves a linearised fit only (comparison with the negative control); None for the true one.
            External load is no part of them.
        either_sign: Lift the bound; the control may take either sign, to give it every chance.
    """

    joints: tuple[int, ...]
    labels: tuple[str, ...]
    gravity: tuple[float, ...] | None = None
    either_sign: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the compliances."""
        return self.labels

    @property
    def lower(self) -> Float1D:
        """Springs do not push back: zero."""
        return np.full(len(self.joints), -np.inf if self.either_sign else 0.0)

    def values(self, parameters: ModelParameters) -> Float1D:
        """Return the compliances."""
        return parameters.compliance[list(self.joints)]

    def write(self, view: TermContext, out: Float3D) -> None:
        """Write the columns."""
        amplification = None
        if self.gravity is not None:
            torque = gravity_torque(view.chain.with_gravity(np.array(self.gravity)), view.at)
        elif view.rest is not None:
            torque, amplification = view.rest.torque, view.rest.amplification
        else:
            torque = gravity_torque(view.chain, view.at)
        levers = linear_jacobian(view.at, view.target)
        for column, j in zip(out, self.joints, strict=True):
            lever = levers[j] if amplification is None else np.einsum("iam,im->am", levers, amplification[:, j])
            np.multiply(lever, 0.0 if view.chain.rigid[j] else torque[j], out=column)

    def moved(self, parameters: ModelParameters, step: Float1D) -> ModelParameters:
        """Add to the compliances; what rounding leaves below zero becomes zero."""
        compliance = parameters.compliance.copy()
        compliance[list(self.joints)] = np.maximum(compliance[list(self.joints)] + step, 0.0)
        return parameters.replace(compliance=compliance)


@dataclasses.dataclass(frozen=True)
class HarmonicTerm:
    """First harmonic of the transmission of chosen joints: dq_j = A sin q_j + B cos q_j, rad, q_j the encoder angle.

    Sag under gravity looks much like it (its torque goes with the sine and cosine of the joint's angle), so it is the
    second control of an elasticity claim.  It serves a linearised fit only; `moved` raises TypeError.

    Attributes:
        joints: Chosen joints, counted from 0.
    """

    joints: tuple[int, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the amplitudes."""
        return tuple(f"{part} q{joint + 1}" for joint in self.joints for part in ("sin", "cos"))

    @property
    def lower(self) -> Float1D:
        """No bounds."""
        return np.full(2 * len(self.joints), -np.inf)

    def values(self, parameters: ModelParameters) -> Float1D:  # noqa: ARG002 - the model has no harmonics
        """Return zeros."""
        return np.zeros(2 * len(self.joints))

    def write(self, view: TermContext, out: Float3D) -> None:
        """Write the lever of each joint times sine and cosine of its angle, taken from the posture."""
        levers = linear_jacobian(view.at, view.target)
        for k, joint in enumerate(self.joints):
            if view.chain.prismatic[joint]:
                out[2 * k : 2 * k + 2] = 0.0
                continue
            x, y, _ = view.at.before[joint]
            turned_x = view.at.body[joint][0]
            np.multiply(levers[joint], np.einsum("am,am->m", turned_x, y), out=out[2 * k])
            np.multiply(levers[joint], np.einsum("am,am->m", turned_x, x), out=out[2 * k + 1])

    def moved(self, parameters: ModelParameters, step: Float1D) -> ModelParameters:
        """Refuse: there is nothing in the model to move."""
        msg = f"a harmonic has no place in the model parameters of {parameters.joints} (step {step})"
        raise TypeError(msg)


def names_of(terms: Sequence[Term]) -> tuple[str, ...]:
    """Return the names of all parameters, in the order of the columns."""
    return tuple(name for term in terms for name in term.names)


def places_of(terms: Sequence[Term]) -> list[tuple[Term, slice]]:
    """Return every term with the place of its parameters among those of all."""
    ends = np.cumsum([0, *(len(term.names) for term in terms)]).tolist()
    return [(term, slice(first, last)) for term, first, last in zip(terms, ends[:-1], ends[1:], strict=True)]


def columns_of(view: TermContext, terms: Sequence[Term]) -> Float3D:
    """Return the columns of all terms, (p, 3, m), base axes."""
    columns = np.empty((len(names_of(terms)), *view.target.shape))
    for term, place in places_of(terms):
        term.write(view, columns[place])
    return columns


def correction_axis(geometry: Float1D, kind: int) -> Float1D:
    """Return the direction of one correction in the axes of the *corrected* frame, (3,).

    Args:
        geometry: (6,) x, y, z, rx, ry, rz of this frame: the frame is P Trans(x, y, z) Rx Ry Rz.
        kind: Which correction, 0 to 5.
    """
    rx, ry, rz = geometry[3:]
    unit = np.zeros(3)
    unit[kind % 3] = 1.0
    if not np.any(geometry[3:]) or kind == 5:
        return unit
    if kind < 3:
        return rotation_xyz(rx, ry, rz).T @ unit
    return rotation_z(rz).T @ (rotation_y(ry).T @ unit if kind == 3 else unit)


def cross_into(a: Float2D, b: Float2D, out: Float2D) -> None:
    """Write the cross products of (3, m) vectors into `out`."""
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(a[j], b[k], out=out[i])
        out[i] -= a[k] * b[j]
