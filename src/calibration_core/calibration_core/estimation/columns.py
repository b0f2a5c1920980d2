"""Columns of everything that is fitted together: they are large, and never copied into one array.

An effect that does nothing but turn a joint by t(q) moves a reading's point by its lever l times t.  So its columns are
kept as levers and angles, a number a reading in the stead of three, and the products of two are sums of (l l') t t'.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from calibration_core.timeseries import Float1D, Float2D, FloatND, Int1D


@dataclasses.dataclass(frozen=True, eq=False)
class Turns:
    """Columns of effects that turn one joint, and do nothing else.

    Attributes:
        place: (k,) which of the effects' columns they are.
        lever: (m, 3) how the readings move with the joint, per rad.
        angle: (m, k) rad per unit of the parameters.
    """

    place: Int1D
    lever: Float2D
    angle: Float2D


@dataclasses.dataclass(frozen=True, eq=False)
class Effects:
    """The p columns of effects, of m readings.

    Attributes:
        place: (q,) which of them are held as they are.
        whole: (3 m, q) these.
        turns: All others.
    """

    place: Int1D
    whole: Float2D
    turns: tuple[Turns, ...] = ()

    @staticmethod
    def of(columns: Float2D) -> Effects:
        """Return columns, (3 m, p), that are all held as they are."""
        return Effects(np.arange(columns.shape[1]), columns)

    @property
    def count(self) -> int:
        """Number p of columns."""
        return len(self.place) + sum(len(one.place) for one in self.turns)

    def rows(self, readings: slice | Int1D) -> Effects:
        """Return the columns of some readings."""
        some = (Turns(one.place, one.lever[readings], one.angle[readings]) for one in self.turns)
        return Effects(self.place, rows_of_readings(self.whole, readings), tuple(some))

    def __matmul__(self, value: Float1D) -> Float1D:
        """Return the rows' movement, (3 m,), for values of the parameters, (p,)."""
        moved = self.whole @ value[self.place]
        for one in self.turns:
            moved += (one.lever * (one.angle @ value[one.place])[:, None]).reshape(-1)
        return moved

    def against(self, values: FloatND) -> FloatND:
        """Return the columns' products, (p,) or (p, c), with rows, (3 m,) or (3 m, c)."""
        result = np.empty((self.count, *values.shape[1:]))
        result[self.place] = (values.T @ self.whole).T  # so the large one is read once
        for one in self.turns:
            along = np.einsum("ma,ma...->m...", one.lever, values.reshape(len(values) // 3, 3, *values.shape[1:]))
            result[one.place] = (along.T @ one.angle).T
        return result

    @property
    def products(self) -> Float2D:
        """(p, p) of each with each."""
        places = np.concatenate([self.place, *(one.place for one in self.turns)])
        ends = np.cumsum([len(self.place), *(len(one.place) for one in self.turns)])
        result, across = np.empty((self.count, self.count)), self.against(self.whole)[places]
        result[:, : ends[0]], result[: ends[0]] = across, across.T
        parts = [(one, slice(a, b)) for one, (a, b) in zip(self.turns, itertools.pairwise(ends), strict=True)]
        for (one, here), (other, there) in itertools.combinations_with_replacement(parts, 2):
            along = np.einsum("ma,ma->m", one.lever, other.lever)
            result[here, there] = one.angle.T @ (along[:, None] * other.angle)
            result[there, here] = result[here, there].T
        back = np.argsort(places)
        return result[back].take(back, axis=1)


@dataclasses.dataclass(frozen=True, eq=False)
class Columns:
    """Columns of the null model, f, and of the effects, p.

    Attributes:
        flat: (3 m, f).
        effects: Of the same rows.
    """

    flat: Float2D
    effects: Effects

    def rows(self, readings: slice | Int1D) -> Columns:
        """Return the columns of some readings."""
        return Columns(rows_of_readings(self.flat, readings), self.effects.rows(readings))

    def moved(self, step: Float1D) -> Float1D:
        """Return the rows' movement, (3 m,), for values of the parameters, (f + p,)."""
        f = self.flat.shape[1]
        return self.flat @ step[:f] + self.effects @ step[f:]

    def against(self, values: FloatND) -> FloatND:
        """Return the columns' products, (f + p,) or (f + p, c), with rows, (3 m,) or (3 m, c)."""
        return np.concatenate([(values.T @ self.flat).T, self.effects.against(values)])

    def products(self, effects: Float2D | None = None) -> Float2D:
        """Return the products of all, (f + p, f + p); those of the effects, (p, p), may be given."""
        across, f = self.against(self.flat), self.flat.shape[1]
        result = np.empty((len(across), len(across)))
        result[:, :f], result[:f] = across, across.T
        result[f:, f:] = self.effects.products if effects is None else effects
        return result


def rows_of_readings(values: FloatND, readings: slice | Int1D) -> FloatND:
    """Return the rows, (3 r, ...), of r readings; of a slice of readings they are no copy."""
    some = values.reshape(len(values) // 3, 3, *values.shape[1:])[readings]
    return some.reshape(3 * len(some), *values.shape[1:])
