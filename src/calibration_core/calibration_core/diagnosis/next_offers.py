"""What could be measured next: configurations with loads, as a cell can apply them."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.timeseries import Float1D, Float2D, Readings, read_only

LEAST = 0.02  # of the largest load: levels closer than this are the same


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


def alternating(offer: Offer) -> Offer:
    """Return an offer with as many steps, that after the first go to and fro between its extreme loads.

    What grows with the load shows most between extremes, what depends on its path or size in between does not: which
    of the two tells more has to be judged.
    """
    levels = offer.steps[:, :3] @ offer.full[:3]
    highest, lowest = offer.steps[int(np.argmax(levels))], offer.steps[int(np.argmin(levels))]
    turns = np.arange(1, len(offer.steps)) % 2 == 1
    return dataclasses.replace(offer, steps=np.vstack([offer.steps[:1], np.where(turns[:, None], highest, lowest)]))


def levels_of(readings: Readings) -> tuple[float, ...]:
    """Return the load levels of a recording's steps, as shares of the full load, the first being none.

    Of the configurations with as many readings as most have, the one of the largest load stands for all (a reference
    that is measured again and again is not loaded); a load against the first full one is negative.
    """
    assert readings.wrench is not None  # noqa: S101 - a loaded recording has a wrench
    numbers, counts = np.unique(readings.configuration, return_counts=True)
    usual, often = np.unique(counts, return_counts=True)
    size = np.linalg.norm(readings.wrench[:, :3], axis=1)
    among = np.isin(readings.configuration, numbers[counts == usual[np.argmax(often)]])
    inside = readings.configuration == readings.configuration[np.argmax(np.where(among, size, -1.0))]
    steps, first = np.unique(readings.step[inside], return_index=True)
    wrench = readings.wrench[inside][first][np.argsort(steps)]
    size = np.linalg.norm(wrench[:, :3], axis=1)
    full = wrench[int(np.argmax(size >= (1 - LEAST) * size.max())), :3]
    power = float(full @ full)
    if power == 0.0:
        return (0.0,)
    levels = np.round(wrench[:, :3] @ full / power, 2)
    levels[np.abs(levels) < LEAST] = 0.0
    return tuple(float(level) for level in np.clip(levels, -1.0, 1.0))


def largest_force(readings: Readings) -> float:
    """Return the largest force of a recording, N."""
    assert readings.wrench is not None  # noqa: S101 - a loaded recording has a wrench
    return float(np.linalg.norm(readings.wrench[:, :3], axis=1).max())
