"""Axes of the wrench that take axes to axes: turned, left-handed, or of forces or torques alone.

The motion per unit compliance is linear in the wrench, so that all of them are fitted from the products of 18 columns a
joint: each recorded component of force and torque along each axis.

Displacements in other axes than frames.tracker states: turned, or left-handed, the same for all readings.

The turn Q minimises sum_k |Q d_k - sum_i c_i J_ik|^2 over rotations (or reflections) Q and compliances c >= 0: by turns
the compliances for a turn and the turn for a motion (Kabsch, Acta Crystallographica A32, 1976), from every turn that
takes axes to axes.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np

from calibration_core.input_checks.anomaly import InputAnomaly
from calibration_core.input_checks.explained import (
    Explanation,
    Motion,
    Reading,
    columns_of,
    fit,
    nonnegative,
    posture_of,
    seen_columns,
)
from calibration_core.model.chain import rpy_of
from calibration_core.model.kinematics import Posture
from calibration_core.timeseries import Float1D, Float2D, Float3D

LEAST_TURN = 0.2  # rad: less is no other way of setting up a tracker, and leaves the motion well explained
NEAR_TURN = 0.5  # rad: so near to the stated axes, the mirrored coordinate is the one whose sign is wrong
STEPS = 30
MIRROR = np.diag([-1.0, 1.0, 1.0])


@dataclasses.dataclass(frozen=True, eq=False)
class Turned:
    """A recording whose displacements are read in other axes.

    Attributes:
        anomaly: What is wrong, as far as it is known without the figures.
        fit: How well joint springs explain the motion then.
        angle: rad, by which the axes are turned; half a turn for mirrored ones, which no small turn mimics.
    """

    anomaly: InputAnomaly
    fit: Explanation
    angle: float


def turned_axes(motion: Motion, given: Reading, tracker: Float2D | None) -> Turned:
    """Return the axes in which joint springs explain the displacements best, and how well they do.

    Args:
        motion: The motion under load, in base axes by `tracker`.
        given: How the wrench is read.
        tracker: (3, 3) axes of the tracker in the base frame as the cell file states them; None: not stated.
    """
    columns = columns_of(motion, posture_of(motion), motion.force, motion.torque, given)
    problem = _Problem.of(motion, columns)
    found = []
    for mirror in (np.eye(3), MIRROR):
        _, turn = max((problem.settled(one @ mirror) for one in (np.eye(3), *quarter_turns())), key=lambda one: one[0])
        found.append((fit(dataclasses.replace(motion, moved=motion.moved @ turn.T), columns), turn))
    (straight, turn), (mirrored, image) = found
    stated = np.eye(3) if tracker is None else tracker
    if mirrored.rest < straight.rest:
        return Turned(_left_handed(motion, stated, image, known=tracker is not None), mirrored, np.pi)
    return Turned(_other_axes(motion, stated, turn, known=tracker is not None), straight, angle_of(turn))


def quarter_turns() -> list[Float2D]:
    """Return the 23 rotations that take axes to axes, identity left out."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            turn = np.zeros((3, 3))
            turn[range(3), order] = signs
            if np.linalg.det(turn) > 0 and not np.array_equal(turn, np.eye(3)):
                found.append(turn)
    return found


def angle_of(turn: Float2D) -> float:
    """Return the angle of a rotation, rad."""
    return float(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))


@dataclasses.dataclass(frozen=True, eq=False)
class _Problem:
    """Least squares over compliances and a turn, as small as it can be.

    Attributes:
        upper: (c, c) R of the columns' QR.
        moments: (c, 3, 3) sums over all readings of a row of Q, base axes, times the motion as recorded, m.
    """

    upper: Float2D
    moments: Float3D

    @classmethod
    def of(cls, motion: Motion, columns: Float2D) -> _Problem:
        """Return the problem of (3 m, n) columns."""
        scale, used = seen_columns(columns)
        basis, upper = np.linalg.qr(columns[:, used] / scale[used])
        rows = basis.reshape(len(motion.moved), 3, -1)
        return cls(np.asarray(upper), np.asarray(np.einsum("kac,kb->cab", rows, motion.moved, optimize=True)))

    def settled(self, turn: Float2D) -> tuple[float, Float2D]:
        """Return the nearest minimum: how much is explained, m^2, and the (3, 3) turn of the motion."""
        sign = float(np.sign(np.linalg.det(turn)))
        explained = -1.0  # m^2, less than any
        for _ in range(STEPS):
            target = np.einsum("cab,ab->c", self.moments, turn)
            predicted = self.upper @ nonnegative(self.upper, target, np.inf)
            more = float(target @ target - np.sum((predicted - target) ** 2))
            if not more > explained + 1e-6 * abs(explained):
                break
            explained = more
            u, _, vt = np.linalg.svd(np.einsum("c,cab->ab", predicted, self.moments))
            turn = np.asarray((u * np.array([1.0, 1.0, sign * np.linalg.det(u @ vt)])) @ vt)
        return explained, turn


def _other_axes(motion: Motion, stated: Float2D, turn: Float2D, *, known: bool) -> InputAnomaly:
    angle, axes = angle_of(turn), turn @ stated
    rpy = ", ".join(f"{round(float(value), 3) + 0.0:.3f}" for value in rpy_of(axes))
    against = "those of frames.tracker" if known else "the base axes, which hold where frames.tracker is not stated"
    text = f"the displacements are in axes that are turned by {np.degrees(angle):.0f} degrees from {against}"
    other = f", or master {motion.chain.joints[0]} again" if _about_first(motion, turn) else ""
    remedy = f"state the axes of the displacements in frames.tracker (rpy near [{rpy}]){other}"
    return InputAnomaly("no_relation", text, remedy, 0.0, axes=f"rpy [{rpy}]", place="tracker")


def _about_first(motion: Motion, turn: Float2D) -> bool:
    """Say whether a turn is about the axis of the first joint: its zero would do the same."""
    axis = motion.chain.rotation[0][:, 2]
    return bool(np.linalg.norm(turn @ axis - axis) < LEAST_TURN)


def _left_handed(motion: Motion, stated: Float2D, image: Float2D, *, known: bool) -> InputAnomaly:
    flips = [np.diag(np.where(np.arange(3) == k, -1.0, 1.0)) for k in range(3)]
    # readings d of one wrong sign are right as flip d; motion in base axes is stated d
    angles = [angle_of(image @ stated @ flip @ stated.T) for flip in flips]
    k = int(np.argmin(angles))
    near = known and angles[k] < NEAR_TURN
    which = f"{'xyz'[k]} of all displacements" if near else "one of x, y and z of all displacements"
    remedy = f"turn the sign of {which}, or export them in right-handed axes"
    text = "the displacements are mirrored: the tracker's axes are left-handed"
    return InputAnomaly("point_order", text, remedy, 0.0, axes=f"-{'xyz'[k]}" if near else "", points=motion.names)


# --- axes of the wrench that take axes to axes ------------------------------------------------------------------------


SHOWN = 3  # of the best ones are fitted in full
NEGLIGIBLE = 1e-12  # of the largest eigenvalue


@dataclasses.dataclass(frozen=True, eq=False)
class WrenchAxes:
    """Axes in which a wrench may have been recorded.

    Attributes:
        what: `wrench`, `forces` or `torques`: whose axes are others.
        force: (3, 3) what takes recorded forces to those meant.
        torque: (3, 3) the same of torques.
    """

    what: str
    force: Float2D
    torque: Float2D

    @property
    def anomaly(self) -> InputAnomaly:
        """What is wrong then, without the figures."""
        axes = _words(self.torque if self.what == "torques" else self.force)
        if self.what == "wrench" and np.array_equal(self.force, self.torque) and np.linalg.det(self.force) > 0:
            text = f"the axes of the wrench are {axes} of the recorded ones"
            remedy = f"turn frames.force_torque, or record the wrench in axes that are {axes} of the recorded ones"
            return InputAnomaly("wrench_frame", text, remedy, 0.0, axes=axes)
        left = self.what == "wrench" and np.array_equal(self.force, -self.torque)
        also = ", and the torques have the other sign" if left else ""
        text = f"the axes of the {self.what} are {axes} of the recorded ones{also}"
        remedy = f"exchange columns or turn signs of the recorded wrench: {text}"
        return InputAnomaly("wrench_frame", text, remedy, 0.0, axes=axes)


def other_axes(
    motion: Motion, at: Posture, given: Reading, limit: float
) -> Iterator[tuple[InputAnomaly, Float2D, Float2D]]:
    """Yield the axes that explain the motion best: what is wrong then, forces (m, 3) N and torques (m, 3) N*m.

    Args:
        motion: The motion under load.
        at: The posture of its readings.
        given: How the wrench is read.
        limit: m^2: what leaves no less is left out.
    """
    ways = _ways(torques=bool(np.any(motion.torque)))
    rest = _rests(motion, at, given, ways, limit)
    for k in np.argsort(rest, kind="stable")[:SHOWN]:
        if rest[k] < limit:
            yield ways[k].anomaly, motion.force @ ways[k].force.T, motion.torque @ ways[k].torque.T


def _ways(*, torques: bool) -> list[WrenchAxes]:
    """Return all other axes; the sign of the whole wrench is no matter of axes."""
    turns, same = quarter_turns(), np.eye(3)
    mirrored = [-turn for turn in turns]
    ways = [WrenchAxes("wrench", turn, turn) for turn in (*turns, *mirrored)]
    if torques:  # left-handed axes turn the sign of torques once more than that of forces
        ways += [WrenchAxes("wrench", turn, -turn) for turn in mirrored]
        ways += [WrenchAxes("forces", turn, same) for turn in (*turns, *mirrored, -same)]
        ways += [WrenchAxes("torques", same, turn) for turn in (*turns, *mirrored, -same)]
    return ways


def _rests(motion: Motion, at: Posture, given: Reading, ways: list[WrenchAxes], limit: float) -> Float1D:
    """Return the sum of squares, m^2, that joint springs leave in each of the axes."""
    none = np.zeros_like(motion.force)
    blocks = []
    for recorded, forces in ((motion.force, True), (motion.torque, False)):
        for axis in range(3):
            for component in range(3):
                part = none.copy()
                part[:, axis] = recorded[:, component]
                force, torque = (part, none) if forces else (none, part)
                blocks.append(columns_of(motion, at, force, torque, given))
    basis = np.stack(blocks, axis=1)  # (3 m, 18, n)
    rows, count, joints = basis.shape
    flat = basis.reshape(rows, count * joints)
    products = (flat.T @ flat).reshape(count, joints, count, joints).transpose(0, 2, 1, 3).reshape(count**2, joints**2)
    moments = (flat.T @ motion.moved.reshape(-1)).reshape(count, joints)
    weights = np.stack([np.concatenate([way.force.reshape(-1), way.torque.reshape(-1)]) for way in ways])
    pairs = (weights[:, :, None] * weights[:, None, :]).reshape(len(ways), count**2)
    normals, rights = (pairs @ products).reshape(-1, joints, joints), weights @ moments
    explained = [_explained(normal, right, motion.total, limit) for normal, right in zip(normals, rights, strict=True)]
    return motion.total - np.array(explained)


def _explained(normal: Float2D, moment: Float1D, total: float, limit: float) -> float:
    """Return how much of the motion, m^2, compliances explain, none of them negative."""
    scale = np.sqrt(np.maximum(np.diag(normal), 0.0))
    kept = np.flatnonzero(scale > np.sqrt(NEGLIGIBLE) * max(float(scale.max(initial=0.0)), 1e-300))
    if not len(kept):
        return 0.0
    value, vector = np.linalg.eigh(normal[np.ix_(kept, kept)] / np.outer(scale[kept], scale[kept]))
    large = value > NEGLIGIBLE * value[-1]
    root = np.sqrt(value[large])
    target = (vector[:, large].T @ (moment[kept] / scale[kept])) / root
    unseen = max(total - float(target @ target), 0.0)
    if unseen >= limit:  # of any sign they leave no less
        return 0.0
    matrix = root[:, None] * vector[:, large].T
    left = matrix @ nonnegative(matrix, target, limit - unseen) - target
    return total - unseen - float(left @ left)


def _words(turn: Float2D) -> str:
    """Return what the recorded x, y, z should have been, e.g. `y, -x, z`."""
    words = []
    for row in turn:
        k = int(np.argmax(np.abs(row)))
        words.append(("-" if row[k] < 0 else "") + "xyz"[k])
    return ", ".join(words)
