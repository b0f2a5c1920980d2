"""Sweeps: stretches of a recording in which only some joints move."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.timeseries import Float2D, Int1D

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
