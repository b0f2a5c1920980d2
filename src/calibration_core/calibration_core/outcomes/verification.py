"""What a verification found, place by place and in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from calibration_core.acceptance.decision import Decision, guard_factor
from calibration_core.acceptance.verification import Verification
from calibration_core.model.identified.calibrated import WITHOUT_INTERVALS
from calibration_core.outcomes.inputs import NOT_COMPARED
from calibration_core.outcomes.prediction import only_positions
from calibration_core.report.rounding import listed
from calibration_core.timeseries import Float2D

SHOWN = 8  # configurations that a sentence names
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


def not_conforming(found: Verification) -> tuple[int, ...]:
    """Return the configurations with a reading that does not conform to the tolerance."""
    return _decided(found, "not_conforming")


def _decided(found: Verification, decision: Decision) -> tuple[int, ...]:
    chosen = [one == decision for one in found.decisions]
    return tuple(int(number) for number in np.unique(found.readings.configuration[chosen]))


def reservations(found: Verification) -> tuple[tuple[str, str], list[tuple[str, str]]]:
    """Return what speaks against the model's use at this tolerance, each in words with what to do about it.

    Returns:
        What does not conform, and with it what stays undecided; and everything else: what stays undecided where nothing
        fails to conform, and what limits the decision itself.
    """
    tolerance = f"the tolerance of {1e3 * found.tolerance:g} mm"
    beyond = not_conforming(found)
    open_ = [number for number in _decided(found, "undecided") if number not in beyond]
    undecided = f"undecided because of measurement uncertainty: {_where(open_)}"
    text = f"not conforming to {tolerance}: {_where(beyond)}" + (f"; {undecided}" if open_ else "")
    step = "run diagnose with this recording and the model, to see what has changed, or calibrate the robot anew"
    if _smaller_elsewhere(found):
        step = "if the tracker was set up anew, run verify again with --fit-tracker; else calibrate the robot anew"
    elif found.only_positions:
        meaning, step = only_positions(nominal=found.nominal_geometry)
        text = f"{text}; {meaning}"
    residual = text, step
    further = []
    if open_ and not beyond:
        step = "measure with less uncertainty, or state a larger tolerance"
        worst = found.least_certain
        if found.shares["geometry"][worst] ** 2 > 0.5 * found.uncertainty[worst] ** 2:  # the most of it
            step = only_positions(nominal=found.nominal_geometry)[1]
        further.append((undecided, step))
    further += [(f"{text[0].lower()}{text[1:]}".rstrip("."), "") for text in _shortcomings(found)]
    return residual, further


def _where(configurations: Sequence[int]) -> str:
    word = "configuration" if len(configurations) == 1 else "configurations"
    return f"{word} {listed([*map(str, configurations)], SHOWN)}"


def _smaller_elsewhere(found: Verification) -> bool:
    """Say whether the error would be far smaller with the tracker's pose fitted to the recording."""
    rms = float(np.sqrt(np.mean(found.error**2)))
    return found.elsewhere is not None and rms > ELSEWHERE * found.elsewhere


def remarks(found: Verification) -> list[str]:
    """Return what a reader must know besides, a sentence each."""
    texts = _shortcomings(found)
    if found.outside.any():
        numbers = np.unique(found.readings.configuration[found.outside])
        texts.append(f"Outside the range that the model was identified in: {_where([*map(int, numbers)])}.")
    return texts


def _shortcomings(found: Verification) -> list[str]:
    """Return what limits the decision itself, a sentence each."""
    texts = []
    if not found.with_intervals:
        texts += [WITHOUT_INTERVALS, "The uncertainty is that of the instruments alone."]
    if found.elsewhere is not None and _smaller_elsewhere(found):
        rms = float(np.sqrt(np.mean(found.error**2)))
        texts.append(
            f"With the tracker's pose fitted to this recording the error would be {1e3 * found.elsewhere:.3f} mm rms "
            f"instead of {1e3 * rms:.3f} mm: if the tracker was set up anew, give --fit-tracker."
        )
    texts += [f"{note.text[:1].upper()}{note.text[1:]}." for note in found.readings.notes if note.kind == NOT_COMPARED]
    return texts
