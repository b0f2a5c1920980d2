"""Values that are known with an uncertainty, all of them together: one normal distribution."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from calibration_core.timeseries import Float1D, Float2D, Int1D, read_only


@dataclasses.dataclass(frozen=True, eq=False)
class GaussianEstimate:
    """Named parameters with their joint covariance.

    An infinite variance belongs to a parameter of which the recording says nothing; it then varies with no other.

    Attributes:
        names: (p,) as in `named_values`, e.g. `compliance.joint_2`.
        units: (p,) SI units, e.g. `rad/(N*m)`.
        value: (p,) in these units.
        covariance: (p, p) symmetric, products of these units.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    value: Float1D
    covariance: Float2D

    def __post_init__(self) -> None:
        """Copy to read-only arrays; raise ValueError on wrong shapes or repeated names."""
        p = len(self.names)
        object.__setattr__(self, "value", read_only(self.value))
        object.__setattr__(self, "covariance", read_only(self.covariance))
        if len(self.units) != p or self.value.shape != (p,) or self.covariance.shape != (p, p):
            shapes = f"{len(self.units)} units, values {self.value.shape}, covariance {self.covariance.shape}"
            msg = f"{p} names, but {shapes}"
            raise ValueError(msg)
        object.__setattr__(self, "covariance", read_only((self.covariance + self.covariance.T) / 2))  # to the last bit
        if len(set(self.names)) != p:
            msg = f"repeated names among {', '.join(self.names)}"
            raise ValueError(msg)

    @staticmethod
    def nothing() -> GaussianEstimate:
        """Return the estimate of no parameters."""
        return GaussianEstimate((), (), np.zeros(0), np.zeros((0, 0)))

    @staticmethod
    def independent(parts: Sequence[GaussianEstimate]) -> GaussianEstimate:
        """Return parameters of several estimates that know nothing of each other as one."""
        total = sum(len(part.names) for part in parts)
        covariance, start = np.zeros((total, total)), 0
        for part in parts:
            end = start + len(part.names)
            covariance[start:end, start:end] = part.covariance
            start = end
        return GaussianEstimate(
            tuple(name for part in parts for name in part.names),
            tuple(unit for part in parts for unit in part.units),
            np.concatenate([np.zeros(0), *(part.value for part in parts)]),
            covariance,
        )

    @property
    def std(self) -> Float1D:
        """(p,) standard deviations; infinite where nothing is known."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def unknown(self) -> tuple[str, ...]:
        """Names of the parameters of which nothing is known."""
        return tuple(name for name, std in zip(self.names, self.std, strict=True) if np.isinf(std))

    def chosen(self, index: Sequence[int] | Int1D) -> GaussianEstimate:
        """Return some of the parameters, by their positions."""
        rows = np.asarray(index, dtype=np.int64)
        return GaussianEstimate(
            tuple(self.names[k] for k in rows),
            tuple(self.units[k] for k in rows),
            self.value[rows],
            self.covariance[np.ix_(rows, rows)],
        )

    def scaled(self, factors: Mapping[str, float]) -> GaussianEstimate:
        """Return the same with the standard deviations of some parameters, by name, larger by factors."""
        factor = np.array([factors.get(name, 1.0) for name in self.names])
        return dataclasses.replace(self, covariance=self.covariance * np.outer(factor, factor))

    def with_std(self, std: Mapping[str, float]) -> GaussianEstimate:
        """Return the same with these standard deviations of some parameters, by name; what is unknown stays so."""
        own = dict(zip(self.names, self.std, strict=True))
        known = {name: own[name] for name in std if 0 < own.get(name, 0.0) < np.inf}
        return self.scaled({name: std[name] / before for name, before in known.items()})

    def renamed(self, names: Sequence[str]) -> GaussianEstimate:
        """Return the same parameters under other names."""
        return dataclasses.replace(self, names=tuple(names))

    def root(self) -> Float2D:
        """Return a (p, p) matrix L with L L^T the covariance of what is known; rows of what is not are zero."""
        known = np.isfinite(np.diag(self.covariance))
        std = np.where(known, self.std, 1.0)
        std = np.where(std > 0, std, 1.0)
        scaled = np.where(np.outer(known, known), self.covariance, 0.0) / np.outer(std, std)
        values, vectors = np.linalg.eigh(scaled)
        return np.asarray(std[:, None] * vectors * np.sqrt(np.clip(values, 0.0, None)))
