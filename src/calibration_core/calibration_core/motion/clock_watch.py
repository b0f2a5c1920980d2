"""Did the clock by which messages are stamped jump, and do messages arrive late by it?  Rules without own clocks."""

from __future__ import annotations

import math

from calibration_core.timeseries import NANOSECONDS

BACKWARDS = 1e-3  # s, that a clock may go back by: two threads that read it at the same moment
DRIFT = 1e-3  # two quartz clocks differ by 2e-4 at most, and time servers slew one by up to 5e-4
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


class Lateness:
    """How much later than it could does a message arrive, by its stamp?

    What passes between stamp and arrival is the offset of two clocks and a delay; no single message tells them apart.
    The smallest that was seen is the offset with the smallest delay, and whatever exceeds it is delay.  Clocks drift
    apart by at most `DRIFT`: what was seen t s ago may have grown by `DRIFT` t since.  A delay that grows faster is
    seen, but for the share of `DRIFT` in its growth.  One that grows more slowly looks like a drift, and one that is
    there from the first message on looks like an offset.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin anew: stamps come from another clock."""
        self._least, self._since = math.inf, -math.inf

    def late(self, stamp: float, now: float) -> float:
        """Return how much later than it could a message arrives, s.

        Args:
            stamp: s of the sender's clock.
            now: s of the receiver's steady clock.
        """
        grown = DRIFT * (now - self._since) if now > self._since > -math.inf else 0.0
        self._least, self._since = min(self._least + grown, now - stamp), now
        return now - stamp - self._least
