"""Axes of the wrench that take axes to axes: turned, left-handed, or of forces or torques alone.

The motion per unit compliance is linear in the wrench, so that all of them are fitted from the products of 18 columns a
joint: each recorded component of force and torque along each axis.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from calibration_core.input_checks.anomaly import InputAnomaly
from calibration_core.input_checks.explained import Motion, Reading, columns_of, nonnegative
from calibration_core.input_checks.tracker_axes import quarter_turns
from calibration_core.model.kinematics import Posture
from calibration_core.timeseries import Float1D, Float2D

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
