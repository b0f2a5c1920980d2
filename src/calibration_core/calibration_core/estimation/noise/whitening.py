"""What the readings of one configuration share: the step's tracker noise, the wrench's noise, and an offset per point.

In units of a reading's own noise the covariance of a configuration is

    V = I + s^2 S S^T + W W^T + o^2 O O^T,

S the steps (what all points of a step share: slow tracker noise), W what the noise of the step's wrench moves, O one
offset per point (set-up and second-order geometry that absolute positions do not explain).  s and o are sizes of their
own, found by likelihood (`likelihood/restricted.py`).  Configurations are independent, so that V^(-1/2) is closed form,
block by block, and rows keep their configuration.
Source: variance components (Patterson and Thompson 1971).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D

AT_ONCE = 1_000_000  # numbers that are made independent at a time


@dataclasses.dataclass(frozen=True, eq=False)
class Strata:
    """Which rows of some readings belong together.

    Attributes:
        configuration: (r,) index of the configuration.
        step: (r,) number of the step.
        point: (r,) index of the point.
        wrench: (r, 3, 6) what one standard deviation of the step's wrench moves, in units of the own noise; None where
            no wrench was recorded.
    """

    configuration: Int1D
    step: Int1D
    point: Int1D
    wrench: Float3D | None

    @property
    def steps_shared(self) -> bool:
        """Whether any step was seen at several points."""
        keys = np.column_stack([self.configuration, self.step])
        return len(np.unique(keys, axis=0)) < len(keys)

    @property
    def points_repeated(self) -> bool:
        """Whether any point was seen several times in one configuration."""
        keys = np.column_stack([self.configuration, self.point])
        return len(np.unique(keys, axis=0)) < len(keys)

    def groups(self) -> list[Int1D]:
        """Return index arrays (c, k): the readings of configurations with equally many, one row a configuration."""
        order = np.argsort(self.configuration, kind="stable")
        _, starts, counts = np.unique(self.configuration[order], return_index=True, return_counts=True)
        return [order[starts[counts == k][:, None] + np.arange(k)] for k in np.unique(counts)]


@dataclasses.dataclass(frozen=True, eq=False)
class Whitening:
    """V^(-1/2) of every configuration.

    Attributes:
        shared: s, in units of the own noise.
        offset: o, likewise.
        parts: Per number of readings: rows (c, 3 k) and matrices (c, 3 k, 3 k).
        same_point: Likewise (c, k, k): which readings of a configuration are of one point; none in a single step.
        log_determinant: Of V over all rows.
    """

    shared: float
    offset: float
    parts: tuple[tuple[Int1D, Float3D], ...]
    same_point: tuple[Float3D, ...]
    log_determinant: float

    def __call__(self, values: Float2D) -> Float2D:
        """Return rows (3 r, k), in units of the own noise, as independent rows of unit variance.

        Where they are that already, the same array is returned.
        """
        if not self.parts:
            return values
        result = np.array(values)
        self.inside(result)
        return result

    def inside(self, values: Float2D) -> None:
        """Make rows (3 r, k) independent where they stand; there may be hundreds of megabytes of them."""
        for rows, root in self.parts:
            together = max(1, AT_ONCE // (rows.shape[1] * max(values.shape[1], 1)))
            for k in range(0, len(rows), together):
                some = rows[k : k + together]
                values[some] = root[k : k + together] @ values[some]

    def without_offsets(self, values: Float1D) -> Float1D:
        """Return rows (3 r,), in units of the own noise, less the most probable offset of each configuration."""
        result = np.array(values)
        if self.offset == 0:
            return result
        for (rows, root), point in zip(self.parts, self.same_point, strict=True):
            white = (root @ (root @ values[rows][:, :, None]))[:, :, 0]
            c, width = rows.shape
            result[rows] -= self.offset**2 * np.einsum("cij,cja->cia", point, white.reshape(c, -1, 3)).reshape(c, width)
        return result


def whiten(strata: Strata, shared: float, offset: float) -> Whitening:
    """Return the whitening for sizes s and o (see the module)."""
    parts, points, log_determinant = [], [], 0.0
    for index in strata.groups():
        c, k = index.shape
        if k == 1 and strata.wrench is None:
            continue
        step, point = strata.step[index], strata.point[index]
        same_step = (step[:, :, None] == step[:, None, :]).astype(float)
        same_point = (point[:, :, None] == point[:, None, :]).astype(float)
        several = (step != step[:, :1]).any(axis=1)
        same_point = same_point * several[:, None, None]  # one step tells no offset from posture
        rows = (3 * index[:, :, None] + np.arange(3)).reshape(c, 3 * k)
        between = (shared**2 * same_step * (k > 1)) + (offset**2 * same_point * (k > 1))
        covariance = np.einsum("cij,ab->ciajb", between, np.eye(3)).reshape(c, 3 * k, 3 * k)
        covariance = covariance + np.eye(3 * k)
        if strata.wrench is not None:
            moved = strata.wrench[index].reshape(c, 3 * k, 6)
            common = (moved @ moved.transpose(0, 2, 1)).reshape(c, k, 3, k, 3) * same_step[:, :, None, :, None]
            covariance = covariance + common.reshape(c, 3 * k, 3 * k)
        values, vectors = np.linalg.eigh(covariance)
        points.append(same_point)
        parts.append((rows, (vectors / np.sqrt(values)[:, None, :]) @ vectors.transpose(0, 2, 1)))
        log_determinant += float(np.log(values).sum())
    return Whitening(shared, offset, tuple(parts), tuple(points), log_determinant)
