"""How long a load may take to come to the sensor before it is called wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

LOAD_TIME = 3.0  # s by the cell's clock and by the steady one


@dataclass(frozen=True)
class LoadTime:
    """The time that has passed since a load device reported its load as applied.

    A simulated cell's clock may run faster or slower than the steady one: both have to have advanced.  A sensor that
    ended before the time was over is lost, and not at odds with the device: a load is judged only after every
    instrument has given a sign of life from after that moment.

    Attributes:
        cell: s of the cell's clock at which the time began.
        steady: s of the steady clock at which it began.
        due: s of the steady clock at which it was seen to be over; None before.
    """

    cell: float
    steady: float
    due: float | None = None

    def looked(self, cell: float, steady: float, *, lost: bool) -> LoadTime:
        """Return the time as it is now.

        Args:
            cell: s of the cell's clock.
            steady: s of the steady clock.
            lost: An instrument is silent: nobody can say what pulls, and the time begins anew.
        """
        if lost:
            return LoadTime(cell, steady)
        if self.due is None and min(cell - self.cell, steady - self.steady) >= LOAD_TIME:
            return replace(self, due=steady)
        return self

    def over(self, heard_since: Callable[[float], bool]) -> bool:
        """Tell whether the load is to be judged.

        Args:
            heard_since: Tells whether every instrument has given a sign of life after a moment, s of the steady clock.
        """
        return self.due is not None and heard_since(self.due)
