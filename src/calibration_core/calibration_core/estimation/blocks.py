"""Whole blocks of configurations: what may be left out, and what may be exchanged, when poses are dense.

Neighbouring poses share everything that depends on posture or time, so single poses are no independent evidence.
Blocks are contiguous in time, or clusters of postures; whatever is claimed must hold with both.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.timeseries import Bool1D, Float2D, Int1D, in_time

MOST = 40  # blocks
STAYS = -1  # label of readings that are never left out
FEWEST_PER_CLUSTER = 3  # configurations
SEED = 17384
ITERATIONS = 20


@dataclasses.dataclass(frozen=True, eq=False)
class Blocks:
    """A partition of the readings.

    Attributes:
        kind: `time` or `posture`.
        label: (m,) number of the block of every reading, 0 first, or `STAYS`; a configuration is never parted.
    """

    kind: str
    label: Int1D

    @property
    def count(self) -> int:
        """Number of blocks."""
        return int(self.label.max()) + 1

    def readings(self, block: int) -> slice | Int1D:
        """Return the readings of one block; those that follow each other as a slice, which copies nothing."""
        rows = np.flatnonzero(self.label == block)
        if len(rows) and rows[-1] - rows[0] == len(rows) - 1:
            return slice(int(rows[0]), int(rows[-1]) + 1)
        return rows

    def of(self, rows: Int1D) -> Blocks:
        """Return the partition of some of the readings, numbered anew."""
        return Blocks(self.kind, np.unique(self.label[rows], return_inverse=True)[1].reshape(-1).astype(np.int64))

    def keeping(self, stay: Bool1D) -> Blocks:
        """Return the partition of the other readings, numbered anew, where some, (m,), are never left out."""
        label = np.full(len(stay), STAYS, dtype=np.int64)
        label[~stay] = self.of(np.flatnonzero(~stay)).label
        return Blocks(self.kind, label)


def time_blocks(configuration: Int1D, most: int = MOST) -> Blocks:
    """Part the configurations, in the order in which they were read, into blocks of equal number.

    Args:
        configuration: (m,) configuration of every reading, in the order of time.
        most: Number of blocks, where there are as many configurations.
    """
    order = in_time(configuration)
    count = int(order.max()) + 1
    return Blocks("time", (order * min(most, count) // count).astype(np.int64))


def posture_blocks(q: Float2D, configuration: Int1D, most: int = MOST) -> Blocks:
    """Cluster the configurations by their joint angles (k-means on cosine and sine, Lloyd 1982, seeded).

    Args:
        q: (m, n) rad.
        configuration: (m,) configuration of every reading.
        most: Number of clusters, where there are at least three configurations for each.
    """
    first = np.sort(np.unique(configuration, return_index=True)[1])
    angles = q[first]
    count = min(most, len(first) // FEWEST_PER_CLUSTER)
    if count < 2:
        return time_blocks(configuration, most)
    features = np.concatenate([np.cos(angles), np.sin(angles)], axis=1)
    label = _clusters(features, count)
    return Blocks("posture", label[in_time(configuration)])


def _clusters(features: Float2D, count: int) -> Int1D:
    """Return the cluster of every row after Lloyd's iteration from spread-out rows; empty clusters vanish."""
    from scipy.spatial import cKDTree  # slow to load, and loaded recordings do not need it

    centres = _spread(features, count)
    label = np.zeros(len(features), dtype=np.int64)
    for _ in range(ITERATIONS):
        nearest = cKDTree(centres).query(features)[1]
        before, label = label, np.unique(nearest, return_inverse=True)[1].reshape(-1).astype(np.int64)
        if np.array_equal(label, before):
            break
        sizes = np.bincount(label)
        centres = np.stack([np.bincount(label, column) / sizes for column in features.T], axis=1)
    return label


def _spread(features: Float2D, count: int) -> Float2D:
    """Return rows drawn with probability as the squared distance to those drawn (Arthur and Vassilvitskii 2007)."""
    rng = np.random.default_rng(SEED)
    chosen = [int(rng.integers(len(features)))]
    distance = np.sum((features - features[chosen[0]]) ** 2, axis=1)
    while len(chosen) < count and distance.sum() > 0:
        chosen.append(int(rng.choice(len(features), p=distance / distance.sum())))
        distance = np.minimum(distance, np.sum((features - features[chosen[-1]]) ** 2, axis=1))
    return features[chosen]
