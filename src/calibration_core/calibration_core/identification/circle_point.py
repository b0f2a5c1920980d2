"""The circle-point method: base coordinate system and joint axes from single-joint motions (CWA 17384, 7.1, 7.2)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.circle import Circle, fit_circle
from calibration_core.identification.sweeps import Sweep, single_joint_sweeps
from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import posture
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Float1D, Float2D, Readings

SHORT_ARC = np.radians(60)  # below it a base frame to 0.1 mm is out of reach at 20 um


@dataclasses.dataclass(frozen=True, eq=False)
class Axis:
    """A joint's axis of rotation as a line in the tracker frame.

    Attributes:
        joint: Index of the joint.
        point: (3,) m, centre of its best circle.
        direction: (3,) unit vector, in the positive sense of the joint.
        q: (n,) rad, where the other joints stood.
        circles: The circles it was made of, one per measurement point.
        point_std: m, of the point across the axis.
        direction_std: rad.
    """

    joint: int
    point: Float1D
    direction: Float1D
    q: Float1D
    circles: tuple[Circle, ...]
    point_std: float
    direction_std: float


@dataclasses.dataclass(frozen=True, eq=False)
class BaseFrame:
    """The base coordinate system in the tracker frame (CWA 17384, 7.1).

    Attributes:
        tracker: (4, 4) pose of the tracker frame in the base frame.
        origin: (3,) m, tracker frame: foot of joint 2's circle on the axis of joint 1, as the standard defines it.
        position_std: m.
        orientation_std: rad.
        axis_angle_error: rad, angle between the axes of joints 1 and 2 less its nominal value.
        axes: The two axes.
        warnings: What limits the result.
    """

    tracker: Float2D
    origin: Float1D
    position_std: float
    orientation_std: float
    axis_angle_error: float
    axes: tuple[Axis, Axis]
    warnings: tuple[str, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class AxisGeometry:
    """Joint axes by the circle-point method (CWA 17384, 7.2).

    Attributes:
        base: The base coordinate system.
        geometry: (n, 6) corrections x, y, z (m), rx, ry, rz (rad) of the frame before each joint; what circles do not
            show (position along an axis, joint zeros, joints that did not move) stays zero: nominal.
        axes: Joint name -> axis.
        not_observed: Joints whose axes stay nominal.
    """

    base: BaseFrame
    geometry: Float2D
    axes: Mapping[str, Axis]
    not_observed: tuple[str, ...]

    def __post_init__(self) -> None:
        """Freeze the mapping."""
        object.__setattr__(self, "axes", MappingProxyType(dict(self.axes)))


def identify_base_frame(readings: Readings, cell: Cell) -> BaseFrame:
    """Find the base coordinate system from sweeps of joints 1 and 2.

    Orientation: the two normals and their cross product; position: the axis of joint 1 at the height of joint 2,
    carried to the base by the nominal geometry.

    Raises:
        IdentificationError: No sweep of joint 1 or 2 with five poses on a circle.
    """
    chain = chain_of(cell)
    axes = _axes(readings, chain)
    for joint in (0, 1):
        if joint not in axes:
            raise IdentificationError(
                readings.provenance.path, chain.joints[joint], "no sweep", "five or more poses in which only it moves"
            )
    return _base(chain, axes[0], axes[1])


def identify_axes(readings: Readings, cell: Cell) -> AxisGeometry:
    """Find the axes of all joints that were swept alone, relative to the base coordinate system.

    Raises:
        IdentificationError: As `identify_base_frame`.
    """
    chain = chain_of(cell)
    base = identify_base_frame(readings, cell)
    axes = _axes(readings, chain)
    rotation, shift = base.tracker[:3, :3], base.tracker[:3, 3]
    geometry = np.zeros((chain.n, 6))
    for joint in range(1, chain.n):
        if joint not in axes:
            continue
        axis = axes[joint]
        at = posture(chain.corrected(geometry), axis.q[None, :])
        frame, origin = at.before[joint][:, :, 0].T, at.origin[joint][:, 0]
        direction = frame.T @ (rotation @ axis.direction)
        point = frame.T @ (rotation @ axis.point + shift - origin)
        foot = point - direction * point[2] / direction[2]
        geometry[joint] = [foot[0], foot[1], 0.0, np.arctan2(-direction[1], direction[2]), np.arcsin(direction[0]), 0.0]
    missing = tuple(name for joint, name in enumerate(chain.joints) if joint not in axes)
    return AxisGeometry(base, geometry, {chain.joints[joint]: axis for joint, axis in axes.items()}, missing)


def _axes(readings: Readings, chain: Chain) -> dict[int, Axis]:
    sweeps: dict[int, list[Sweep]] = {}
    for sweep in single_joint_sweeps(readings.q, readings.point):
        sweeps.setdefault(sweep.joints[0], []).append(sweep)
    return {joint: _axis(readings, joint, found) for joint, found in sorted(sweeps.items()) if joint < chain.n}


def _axis(readings: Readings, joint: int, sweeps: list[Sweep]) -> Axis:
    home = readings.q[sweeps[0].rows[0]]
    others = np.delete(np.arange(readings.q.shape[1]), joint)
    same = [s for s in sweeps if np.allclose(readings.q[s.rows[0]][others], home[others], atol=1e-3)]
    circles = []
    for sweep in same:
        try:
            circle = fit_circle(readings.position[sweep.rows])
        except ValueError as error:
            path = readings.provenance.path
            raise IdentificationError(path, f"joint {joint + 1}", str(error), "points on a circle") from None
        turns = np.sign(np.median(np.diff(readings.q[sweep.rows, joint])))
        circles.append(dataclasses.replace(circle, normal=turns * circle.normal))
    weights = np.array([1 / max(np.trace(c.covariance[3:5, 3:5]), 1e-30) for c in circles])
    direction = np.einsum("k,ki->i", weights, np.stack([c.normal for c in circles]))
    best = min(circles, key=lambda c: float(np.trace(c.covariance[:3, :3])))
    return Axis(
        joint=joint,
        point=best.centre,
        direction=direction / np.linalg.norm(direction),
        q=home,
        circles=tuple(circles),
        point_std=float(np.sqrt(np.trace(best.covariance[:3, :3]) / 2)),
        direction_std=float(np.sqrt(1 / weights.sum() / 2)),
    )


def _base(chain: Chain, first: Axis, second: Axis) -> BaseFrame:
    at = posture(chain, second.q[None, :])
    nominal = [(at.axis(joint)[:, 0], at.origin[joint][:, 0]) for joint in (0, 1)]
    seen_frame, seen_foot = _triad(first.direction, first.point, second.direction, second.point)
    frame, foot = _triad(*nominal[0], *nominal[1])
    rotation = frame @ seen_frame.T
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = foot - rotation @ seen_foot
    angle = np.arccos(np.clip(first.direction @ second.direction, -1, 1))
    expected = np.arccos(np.clip(nominal[0][0] @ nominal[1][0], -1, 1))
    arcs = {1: max(c.arc for c in first.circles), 2: max(c.arc for c in second.circles)}
    warnings = tuple(
        f"joint {joint} turned by {np.degrees(arc):.0f} degrees only: its arc decides the uncertainty"
        for joint, arc in arcs.items()
        if arc < SHORT_ARC
    )
    return BaseFrame(
        tracker=pose,
        origin=seen_foot,
        position_std=float(np.hypot(first.point_std, second.point_std)),
        orientation_std=float(np.hypot(first.direction_std, second.direction_std)),
        axis_angle_error=float(angle - expected),
        axes=(first, second),
        warnings=warnings,
    )


def _triad(axis: Float1D, point: Float1D, other: Float1D, there: Float1D) -> tuple[Float2D, Float1D]:
    """Return axes (3, 3), z along `axis` and y along axis x other, and the point of `axis` nearest to the other line.

    Joints 1 and 2 of an articulated robot are not parallel, so the cross product exists.
    """
    y = np.cross(axis, other)
    y = y / np.linalg.norm(y)
    frame = np.column_stack([np.cross(y, axis), y, axis])
    between = there - point
    c = float(axis @ other)
    along = (between @ axis - c * (between @ other)) / (1 - c**2)
    return frame, point + along * axis
