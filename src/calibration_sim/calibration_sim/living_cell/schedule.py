"""When which stream is due: multiples of its period, in the cell's time."""

from __future__ import annotations

from collections.abc import Mapping

from calibration_core.timeseries import NANOSECONDS


class Schedule:
    """Streams by name and rate; counts in whole samples, so that nothing drifts."""

    def __init__(self, rates: Mapping[str, float]) -> None:
        """Take the rates, Hz; a rate of 0 is a stream that is never due."""
        self._period = {name: round(NANOSECONDS / rate) for name, rate in rates.items() if rate > 0.0}
        self._sent = dict.fromkeys(self._period, 0)

    def next(self, now: float) -> float:
        """Return when something is due next, s, after `now`."""
        soonest = min((self._sent[name] + 1) * period for name, period in self._period.items())
        return max(soonest / NANOSECONDS, now)

    def due(self, now: float) -> frozenset[str]:
        """Return the streams that are due at `now` (s), each at most once, and count them as sent."""
        late = frozenset(
            name for name, period in self._period.items() if (self._sent[name] + 1) * period <= round(now * NANOSECONDS)
        )
        for name in late:
            self._sent[name] = round(now * NANOSECONDS) // self._period[name]
        return late
