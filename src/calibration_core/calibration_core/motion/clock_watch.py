"""Did the clock by which messages are stamped jump?  The rule, without a clock of its own."""

from __future__ import annotations

import math

from calibration_core.timeseries import NANOSECONDS

BACKWARDS = 1e-3  # s, that a clock may go back by: two threads that read it at the same moment
SHORTEST = 1.0  # s, an advance in a shorter time is judged as if it had taken so long


class ClockWatch:
    """Compares the clock of messages with a steady one.

    A simulation's clock is as old as its last message: a process that was held up for ten seconds still reads the time
    of before, and a moment later that of now; or the time that it looks at was read ten seconds ago.  What the clock
    may advance by is therefore counted from the look before the one at which it was last seen to advance, for the time
    seen there was read after that look.

    Args:
        rate: What the clock may advance by in a second, s.
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._seen, self._since, self._looked = 0, -math.inf, -math.inf

    def jumped(self, clock: int, now: float) -> bool:
        """Look at the clock; say whether it went back or leapt since it last advanced.

        Args:
            clock: ns of the clock of messages; 0: it does not run yet.
            now: s of the steady clock.
        """
        before, self._looked = self._looked, now
        advance = (clock - self._seen) / NANOSECONDS
        if not advance:
            return False
        runs, elapsed = bool(self._seen), now - self._since
        self._seen, self._since = clock, before
        return runs and not -BACKWARDS <= advance <= self._rate * max(elapsed, SHORTEST)
