"""What a verification found, place by place and in words."""

from __future__ import annotations

from typing import Any

import numpy as np

from calibration_core.acceptance.decision import guard_factor
from calibration_core.acceptance.verification import Verification
from calibration_core.model.identified.calibrated import WITHOUT_INTERVALS
from calibration_core.outcomes.own_recordings import NOT_COMPARED
from calibration_core.report.rounding import listed
from calibration_core.timeseries import Float2D

ELSEWHERE = 3.0  # so much smaller would the error be: tracker or robot stand elsewhere than in the model


def error_sizes(error: Float2D) -> dict[str, float]:
    """Return `rms` per coordinate, and `mean` and `max` of the lengths, of errors (m, 3) m."""
    lengths = np.linalg.norm(error, axis=1)
    return {
        "rms": float(np.sqrt(np.mean(error**2))), "mean": float(lengths.mean()), "max": float(lengths.max())
    }  # fmt: skip


def places(found: Verification) -> list[dict[str, Any]]:
    """Return one row per configuration: its reading that is nearest to, or furthest beyond, the tolerance."""
    rows = []
    margin = found.size + guard_factor() * found.uncertainty
    for number in np.unique(found.readings.configuration):
        members = np.flatnonzero(found.readings.configuration == number)
        worst = members[int(np.argmax(margin[members]))]
        decisions = [found.decisions[k] for k in members]
        rows.append(
            {
                "configuration": int(number),
                "step": int(found.readings.step[worst]),
                "point": found.readings.points[found.readings.point[worst]],
                "before": None if found.before is None else float(np.linalg.norm(found.before[worst])),
                "error": float(found.size[worst]),
                "standard_uncertainty": float(found.uncertainty[worst]),
                "decision": next((d for d in ("not_conforming", "undecided") if d in decisions), "conforming"),
                "outside_valid_range": bool(found.outside[members].any()),
            }
        )
    return rows


def remarks(found: Verification) -> list[str]:
    """Return what a reader must know besides, a sentence each."""
    texts = []
    if not found.with_intervals:
        texts += [WITHOUT_INTERVALS, "The uncertainty is that of the instruments alone."]
    rms = float(np.sqrt(np.mean(found.error**2)))
    if found.elsewhere is not None and rms > ELSEWHERE * found.elsewhere:
        texts.append(
            f"With the tracker's pose fitted to this recording the error would be {1e3 * found.elsewhere:.3f} mm rms "
            f"instead of {1e3 * rms:.3f} mm: if the tracker was set up anew, give --fit-tracker."
        )
    if found.outside.any():
        numbers = np.unique(found.readings.configuration[found.outside])
        named = f"{'configuration' if len(numbers) == 1 else 'configurations'} {listed([*map(str, numbers)], 8)}"
        texts.append(f"Outside the range that the model was identified in: {named}.")
    texts += [f"{note.text[:1].upper()}{note.text[1:]}." for note in found.readings.notes if note.kind == NOT_COMPARED]
    return texts
