"""A moment by two clocks."""

from __future__ import annotations

import dataclasses
import time


@dataclasses.dataclass(frozen=True)
class Since:
    """A moment by the cell's clock and by the steady one: a simulation outruns life, and a cell's clock may jump.

    Attributes:
        cell: s, of the cell.
        steady: s, of wall time.
    """

    cell: float
    steady: float = dataclasses.field(default_factory=time.monotonic)

    def longer(self, now: float, seconds: float) -> bool:
        """Return whether more than so many seconds have passed by both clocks; `now` is of the cell."""
        return min(now - self.cell, time.monotonic() - self.steady) > seconds
