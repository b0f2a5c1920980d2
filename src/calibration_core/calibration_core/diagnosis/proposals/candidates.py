"""What could be measured next: configurations with loads, as a cell can apply them, and the readings expected of it."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.simulation.simulate import simulate_plan
from calibration_core.timeseries import Float1D, Float2D, Readings, read_only


@dataclasses.dataclass(frozen=True, eq=False)
class Offer:
    """One configuration with the loads of its steps.

    Attributes:
        number: As it would be counted.
        q: (n,) rad.
        steps: (k, 6) N and N*m, base axes, at the wrench point; the first unloaded.
    """

    number: int
    q: Float1D
    steps: Float2D

    def __post_init__(self) -> None:
        """Copy to read-only arrays."""
        object.__setattr__(self, "q", read_only(self.q))
        object.__setattr__(self, "steps", read_only(self.steps))

    @property
    def full(self) -> Float1D:
        """(6,) N and N*m, the largest load."""
        return np.asarray(self.steps[int(np.argmax(np.linalg.norm(self.steps[:, :3], axis=1)))])

    @functools.cached_property
    def alternating(self) -> Offer:
        """The offer with as many steps, that after the first go to and fro between its extreme loads.

        What grows with the load shows most between extremes, what depends on its path or size in between does not:
        which of the two tells more has to be judged.
        """
        levels = self.steps[:, :3] @ self.full[:3]
        highest, lowest = self.steps[int(np.argmax(levels))], self.steps[int(np.argmin(levels))]
        turns = np.arange(1, len(self.steps)) % 2 == 1
        return dataclasses.replace(self, steps=np.vstack([self.steps[:1], np.where(turns[:, None], highest, lowest)]))


Expected = Callable[[Sequence[Offer], ModelParameters], Readings]


@dataclasses.dataclass(frozen=True, eq=False)
class Offers:
    """What could be measured next in one set-up.

    Attributes:
        each: The offers; none where no posture is fit to be measured.
        expected: (offers, model) -> the readings of these offers that the model expects, without noise, with points and
            frames as those of the recording that they would be added to; configurations counted from 1.
    """

    each: tuple[Offer, ...]
    expected: Expected

    @staticmethod
    def of(each: Sequence[Offer], readings: Readings, cell: Cell) -> Offers:
        """Return offers that would be added to a recording."""

        def expected(several: Sequence[Offer], parameters: ModelParameters) -> Readings:
            numbered = [dataclasses.replace(offer, number=k) for k, offer in enumerate(several, start=1)]
            loaded = any(np.any(offer.steps) for offer in several)
            model = parameters if loaded else parameters.replace(wrench_point=None)
            return _of_points(simulate_plan(numbered, cell, model), readings)

        return Offers(tuple(each), expected)


def _of_points(readings: Readings, recorded: Readings) -> Readings:
    """Return the rows of the points that the recording holds, numbered as there."""
    present = [recorded.points[k] for k in np.unique(recorded.point)]
    kept = np.array([readings.points[k] in present for k in readings.point])
    some = readings.select(kept)
    index = np.array([recorded.points.index(readings.points[k]) for k in some.point])
    return dataclasses.replace(some, points=recorded.points, point=index)
