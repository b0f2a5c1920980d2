"""The circle-point method: base coordinate system and joint axes from single-joint motions (CWA 17384, 7.1, 7.2)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.circle_point.circle import Circle, fit_circle, fit_coaxial
from calibration_core.model.chain import Chain, rotation_vector, rpy_of
from calibration_core.model.kinematics import posture
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Float1D, Float2D, Int1D, Readings

STILL = 2e-4  # rad: how much a joint at rest may seem to move
LEAST = 5  # poses in a sweep


@dataclasses.dataclass(frozen=True, eq=False)
class Sweep:
    """Consecutive readings of one point with one set of moving joints.

    Attributes:
        joints: Indices of the joints that move.
        rows: Indices of the readings, in the order of the recording.
    """

    joints: tuple[int, ...]
    rows: Int1D


def single_joint_sweeps(q: Float2D, point: Int1D) -> tuple[Sweep, ...]:
    """Return the sweeps in which exactly one joint moves, of at least five poses each.

    Args:
        q: (m, n) rad.
        point: (m,) measurement point of each reading.
    """
    found = []
    for name in np.unique(point):
        rows = np.flatnonzero(point == name)
        moved = np.abs(np.diff(q[rows], axis=0)) > STILL
        passed = 0
        for start in map(int, np.flatnonzero(moved.sum(axis=1) == 1)):
            if start < passed:
                continue
            end = start + 1
            while end + 1 < len(rows) and _still(q[rows[start]], q[rows[end + 1]], moved[start]):
                end += 1
            if end - start + 1 >= LEAST:
                found.append(Sweep((int(np.argmax(moved[start])),), rows[start : end + 1]))
                passed = end
    return tuple(found)


def _still(first: Float2D, other: Float2D, moving: np.ndarray) -> bool:
    return bool(np.all(np.abs(other - first)[~moving] <= STILL))


def wrist_sweep(q: Float2D, point: Int1D, wrist: tuple[int, ...]) -> tuple[Sweep, ...]:
    """Return, per point, the longest stretch in which the arm stands and only the wrist joints move.

    Args:
        q: (m, n) rad.
        point: (m,).
        wrist: Indices of the wrist joints.
    """
    arm = np.ones(q.shape[1], dtype=bool)
    arm[list(wrist)] = False
    found = []
    for name in np.unique(point):
        rows = np.flatnonzero(point == name)
        best = rows[:0]
        start = 0
        for end in range(1, len(rows) + 1):
            if end == len(rows) or np.any(np.abs(q[rows[end]] - q[rows[start]])[arm] > STILL):
                if end - start > len(best):
                    best = rows[start:end]
                start = end
        if len(best) >= LEAST:
            found.append(Sweep(wrist, best))
    return tuple(found)


SHORT_ARC = np.radians(60)  # below it a base frame to 0.1 mm is out of reach at 20 um
STEP = 1e-6  # m and rad, of the differences by which uncertainties are propagated


@dataclasses.dataclass(frozen=True, eq=False)
class Axis:
    """A joint's axis of rotation as a line in the tracker frame.

    Attributes:
        joint: Index of the joint.
        point: (3,) m, centre of that circle whose centre is known best.
        direction: (3,) unit vector, in the positive sense of the joint.
        q: (n,) rad, where the other joints stood.
        circles: The circles it was made of, one per measurement point, each fitted alone; the axis is fitted to all.
        covariance: (6, 6) of point (m) and direction (-), from the points' own scatter about all circles.
    """

    joint: int
    point: Float1D
    direction: Float1D
    q: Float1D
    circles: tuple[Circle, ...]
    covariance: Float2D

    @property
    def line(self) -> Float1D:
        """(6,) point and direction."""
        return np.concatenate([self.point, self.direction])

    @property
    def point_std(self) -> float:
        """M, of the point across the axis: root mean square of the two directions."""
        across = np.eye(3) - np.outer(self.direction, self.direction)
        return float(np.sqrt(np.trace(across @ self.covariance[:3, :3]) / 2))

    @property
    def direction_std(self) -> float:
        """Rad: root mean square of the two tilts."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:]) / 2))


@dataclasses.dataclass(frozen=True, eq=False)
class BaseFrame:
    """The base coordinate system in the tracker frame (CWA 17384, 7.1).

    Attributes:
        tracker: (4, 4) pose of the tracker frame in the robot's base frame: the axes of joints 1 and 2, and the foot of
            their common normal on axis 1, laid on their nominal places.
        covariance: (6, 6) of its x, y, z (m), roll, pitch, yaw (rad).
        origin: (3,) m, tracker frame, as clause 7.1 has it: x and y of the centre of joint 1's circle, z of the centre
            of joint 2's, in the base coordinate system's own axes.
        axes_in_tracker: (3, 3) columns x, y, z of the base coordinate system in the tracker frame, as clause 7.1 has
            it: z the normal of joint 1's circle, y along the cross product of the normals of joints 1 and 2.
        clause_covariance: (6, 6) of `origin` (m) and of a rotation vector of `axes_in_tracker` (rad), tracker frame.
        axis_angle_error: rad, angle between the axes of joints 1 and 2 less its nominal value.
        axes: The two axes.
        warnings: What limits the result.
    """

    tracker: Float2D
    covariance: Float2D
    origin: Float1D
    axes_in_tracker: Float2D
    clause_covariance: Float2D
    axis_angle_error: float
    axes: tuple[Axis, Axis]
    warnings: tuple[str, ...]

    @property
    def std(self) -> Float1D:
        """(6,) m and rad, of x, y, z, roll, pitch, yaw."""
        return np.sqrt(np.diag(self.covariance))


@dataclasses.dataclass(frozen=True, eq=False)
class AxisGeometry:
    """Joint axes by the circle-point method (CWA 17384, 7.2).

    Attributes:
        geometry: (n, 6) corrections x, y, z (m), rx, ry, rz (rad) of the frame before each joint; what circles do not
            show (position along an axis, joint zeros, joints that did not move) stays zero: nominal.
        std: (n, 6) one standard deviation; zero of what stays nominal.
        axes: Joint name -> axis.
        not_observed: Joints whose axes stay nominal.
    """

    base: BaseFrame
    geometry: Float2D
    std: Float2D
    axes: Mapping[str, Axis]
    not_observed: tuple[str, ...]

    def __post_init__(self) -> None:
        """Freeze the mapping."""
        object.__setattr__(self, "axes", MappingProxyType(dict(self.axes)))


def identify_axes(readings: Readings, cell: Cell) -> AxisGeometry:
    """Find the base coordinate system and, relative to it, the axes of all joints that were swept alone.

    Base orientation: the normals of joints 1 and 2 and their cross product; position: the axis of joint 1 at the height
    of joint 2, taken to the base with the nominal geometry.

    Raises:
        IdentificationError: No sweep of joint 1 or 2 with five poses on a circle.
    """
    chain = chain_of(cell)
    axes = _axes(readings, chain)
    base = _base(readings, chain, axes)
    used = tuple(axes.values())

    def corrections(lines: Float2D) -> Float1D:
        return _corrections(chain, used, lines).ravel()

    lines = np.stack([axis.line for axis in used])
    variance = np.diag(_propagated(corrections, lines, [axis.covariance for axis in used])).copy()
    variance[corrections(lines) == 0.0] = 0.0
    missing = tuple(name for joint, name in enumerate(chain.joints) if joint not in axes)
    return AxisGeometry(
        base=base,
        geometry=_corrections(chain, used, lines),
        std=np.sqrt(variance).reshape(chain.n, 6),
        axes={chain.joints[joint]: axis for joint, axis in axes.items()},
        not_observed=missing,
    )


def first_guess(readings: Readings, cell: Cell) -> tuple[Float2D, Float2D]:
    """Return tracker pose (4, 4) and corrections (n, 6) by circles, without their uncertainty; see `identify_axes`.

    Raises:
        IdentificationError: As `identify_axes`.
    """
    chain = chain_of(cell)
    axes = _axes(readings, chain)
    _require_both(readings, chain, axes)
    used = tuple(axes.values())
    lines = np.stack([axis.line for axis in used])
    return _pose(chain, axes[1].q, axes[0].line, axes[1].line), _corrections(chain, used, lines)


def _corrections(chain: Chain, axes: tuple[Axis, ...], lines: Float2D) -> Float2D:
    """Return the corrections (n, 6) that put every joint from the second on its line.

    Args:
        chain: The nominal robot.
        axes: Which joints the lines are of, and where the other joints stood; joints 1 and 2 first.
        lines: (k, 6) points (m) and directions, tracker frame.
    """
    base = _pose(chain, axes[1].q, lines[0], lines[1])
    rotation, shift = base[:3, :3], base[:3, 3]
    geometry = np.zeros((chain.n, 6))
    for axis, line in zip(axes[1:], lines[1:], strict=True):
        joint = axis.joint
        at = posture(chain.corrected(geometry), axis.q[None, :])
        frame, origin = at.before[joint][:, :, 0].T, at.origin[joint][:, 0]
        direction = frame.T @ (rotation @ line[3:]) / np.linalg.norm(line[3:])
        point = frame.T @ (rotation @ line[:3] + shift - origin)
        foot = point - direction * point[2] / direction[2]
        geometry[joint] = [foot[0], foot[1], 0.0, np.arctan2(-direction[1], direction[2]), np.arcsin(direction[0]), 0.0]
    return geometry


def _axes(readings: Readings, chain: Chain) -> dict[int, Axis]:
    sweeps: dict[int, list[Sweep]] = {}
    circling = chain.circling
    for sweep in single_joint_sweeps(readings.q, readings.point):
        sweeps.setdefault(sweep.joints[0], []).append(sweep)
    return {joint: _axis(readings, joint, found) for joint, found in sorted(sweeps.items()) if joint in circling}


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
    together = fit_coaxial(circles, [readings.position[sweep.rows] for sweep in same])
    best = int(np.argmin([float(np.trace(together.line_covariance(k)[:3, :3])) for k in range(len(circles))]))
    return Axis(
        joint=joint,
        point=together.centres[best],
        direction=together.normal,
        q=home,
        circles=tuple(circles),
        covariance=together.line_covariance(best),
    )


def _require_both(readings: Readings, chain: Chain, axes: dict[int, Axis]) -> None:
    for joint in (0, 1):
        if joint not in axes:
            found, expected = "no sweep", "five or more poses in which only it moves"
            if chain.leading[joint]:
                found, expected = "joints that mimic it", "a joint that alone turns the flange about its axis"
            raise IdentificationError(readings.provenance.path, chain.joints[joint], found, expected)


def _base(readings: Readings, chain: Chain, axes: dict[int, Axis]) -> BaseFrame:
    _require_both(readings, chain, axes)
    first, second = axes[0], axes[1]

    lines = np.stack([first.line, second.line])
    pose = _pose(chain, second.q, *lines)
    origin, axes_seen = _clause(*lines)
    angles = rpy_of(pose[:3, :3])

    def vector(moved: Float2D) -> Float1D:
        there = _pose(chain, second.q, moved[0], moved[1])
        turned = rpy_of(there[:3, :3])
        return np.concatenate([there[:3, 3], turned - 2 * np.pi * np.round((turned - angles) / (2 * np.pi))])

    def clause(moved: Float2D) -> Float1D:
        there, turned = _clause(moved[0], moved[1])
        return np.concatenate([there, rotation_vector(turned @ axes_seen.T)])

    nominal = posture(chain, second.q[None, :])
    expected = float(nominal.axis(0)[:, 0] @ nominal.axis(1)[:, 0])
    found = float(first.direction @ second.direction)
    arcs = {1: max(c.arc for c in first.circles), 2: max(c.arc for c in second.circles)}
    warnings = tuple(
        f"joint {joint} turned by {np.degrees(arc):.0f} degrees only: its arc decides the uncertainty"
        for joint, arc in arcs.items()
        if arc < SHORT_ARC
    )
    return BaseFrame(
        tracker=pose,
        covariance=_propagated(vector, lines, [first.covariance, second.covariance]),
        origin=origin,
        axes_in_tracker=axes_seen,
        clause_covariance=_propagated(clause, lines, [first.covariance, second.covariance]),
        axis_angle_error=float(np.arccos(np.clip(found, -1, 1)) - np.arccos(np.clip(expected, -1, 1))),
        axes=(first, second),
        warnings=warnings,
    )


def _clause(first: Float1D, second: Float1D) -> tuple[Float1D, Float2D]:
    """Return origin (3,) m and axes (3, 3) of the base coordinate system in the tracker frame (CWA 17384, 7.1).

    Args:
        first: (6,) centre (m) and normal of joint 1's circle, tracker frame.
        second: (6,) the same of joint 2.
    """
    z, other = (line[3:] / np.linalg.norm(line[3:]) for line in (first, second))
    frame, _ = _triad(z, first[:3], other, second[:3])
    return first[:3] + z * (z @ (second[:3] - first[:3])), frame


def _pose(chain: Chain, q: Float1D, first: Float1D, second: Float1D) -> Float2D:
    """Return the pose (4, 4) of the tracker frame in the base frame.

    Args:
        chain: The nominal robot.
        q: (n,) rad, where it stood when joint 2 was swept.
        first: (6,) point (m) and direction of the axis of joint 1, tracker frame.
        second: (6,) the same of joint 2.
    """
    at = posture(chain, q[None, :])
    nominal = [(at.axis(joint)[:, 0], at.origin[joint][:, 0]) for joint in (0, 1)]
    directions = [line[3:] / np.linalg.norm(line[3:]) for line in (first, second)]
    seen_frame, seen_foot = _triad(directions[0], first[:3], directions[1], second[:3])
    frame, foot = _triad(*nominal[0], *nominal[1])
    pose = np.eye(4)
    pose[:3, :3] = frame @ seen_frame.T
    pose[:3, 3] = foot - pose[:3, :3] @ seen_foot
    return pose


def _propagated(function: Callable[[Float2D], Float1D], lines: Float2D, covariances: list[Float2D]) -> Float2D:
    """Return the covariance of a function of independent lines, to first order, by central differences.

    Args:
        function: Lines (k, 6) -> values (p,).
        lines: (k, 6).
        covariances: k of (6, 6).
    """
    size = len(function(lines))
    total = np.zeros((size, size))
    for k, covariance in enumerate(covariances):
        columns = []
        for i in range(6):
            step = np.zeros_like(lines)
            step[k, i] = STEP
            columns.append((function(lines + step) - function(lines - step)) / (2 * STEP))
        slope = np.column_stack(columns)
        total += slope @ covariance @ slope.T
    return total


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
