"""What could be measured next: configurations with loads, as a cell can apply them."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.timeseries import Float1D, Float2D, read_only


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
