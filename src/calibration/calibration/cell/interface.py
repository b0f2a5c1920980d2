"""What the runner asks of the cell."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from calibration.cell.clients import Measured
from calibration_core.measurement import messages as m


class Cell(Protocol):
    """What the cell offers; implemented by the node.  Every method returns at once."""

    def seconds(self) -> float:
        """Return the cell's time, s."""

    def measure(self, answered: Callable[[Measured], None]) -> None:
        """Average over one window."""

    def apply_load(self, command: m.RequestLoad, answered: Callable[[bool, str], None]) -> None:
        """Change the load, or ask the operator to."""

    def pulls(self) -> str | None:
        """Say what pulls although nothing should; empty: nothing does.  None: nobody knows now."""

    def confirm(self, command: m.TakeReading, measured: Measured) -> None:
        """Put readings on the disk and announce them; raise ReadingError or SessionError."""

    def carry_out(self, command: m.Command) -> None:
        """Announce or store what needs no answer: marks, attempts, records, questions."""

    def scaling(self) -> float:
        """Return the share of the programmed speed at which the controller moves; NaN: not known."""

    def lost(self, now: float) -> str:
        """Say which recorder or instrument has fallen silent; empty if none has.  `now` is s of the steady clock."""

    def ready(self, since: float) -> bool:
        """Tell whether all that a reading needs has given a sign of life since then, s of the steady clock."""

    def recorded(self, since: float) -> bool:
        """Tell whether the recorder has."""

    def look(self, now: float) -> None:
        """Give up requests that are not answered; `now` is s of the steady clock."""

    def progress(self) -> None:
        """Tell how far it is."""
