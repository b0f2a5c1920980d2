"""When a recording was made, as far as its clock can tell."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from calibration_core.timeseries import NANOSECONDS, Float1D

EARLIEST_DATE = 946_684_800  # 2000-01-01; earlier stamps count from a start-up, not from the epoch


def iso_date(time: int) -> str:
    """Return ns since the epoch as a UTC date, empty where the clock evidently does not count from the epoch."""
    seconds = time // NANOSECONDS
    if seconds < EARLIEST_DATE:
        return ""
    try:
        return datetime.fromtimestamp(seconds, UTC).isoformat()
    except (OverflowError, ValueError, OSError):
        return ""


def start_of(times: Float1D) -> str:
    """Return the UTC date of the first of times in s, empty where none is known, or none counts from the epoch."""
    known = times[np.isfinite(times)]
    return iso_date(int(float(known.min()) * NANOSECONDS)) if len(known) else ""
