"""What was seen of the standard's conditions over a whole measurement."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from calibration_core.timeseries import Condition


def worst(history: Sequence[Sequence[Condition]]) -> tuple[Condition, ...]:
    """Sum up what was seen of every condition over a measurement.

    A violation stays, with the value of the first one, whatever came before or after; otherwise the last known value
    counts.  An override that was given at any time stays.
    """
    summed: dict[str, Condition] = {}
    for conditions in history:
        for one in conditions:
            before = summed.get(one.name)
            if before is None:
                summed[one.name] = one
                continue
            kept = before if before.met is False or (one.met is None and before.met is not None) else one
            summed[one.name] = dataclasses.replace(kept, override=one.override or before.override)
    return tuple(summed.values())
