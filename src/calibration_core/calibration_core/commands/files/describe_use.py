"""What the results of `verify`, `compare`, `compensate`, `deflect` and `predict` say: decision, numbers, next step.

A result may have been edited or be of an earlier version: whatever is missing in it, or is no number, is passed over.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from calibration_core.report.rounding import counted, fixed, listed, phrase, significant

Content = Mapping[str, Any]
FEW = 5  # refused rows that are named
HUGE = 1e300  # a larger number is no size of anything, and may be beyond what floating point holds
CONFORMING, NOT_CONFORMING = "conforming", "not_conforming"


def describe_use(result: Content) -> list[str]:
    """Return what a result of one of the five commands says, in whole sentences; nothing for other commands."""
    sentences = SENTENCES.get(str(result.get("command")))
    return [] if sentences is None else [text for text in sentences(result) if text]


def records(of: Content, key: str) -> list[Content]:
    """Return the records of a list in a result; none where there is no such list."""
    value = of.get(key)
    return [one for one in value if isinstance(one, Mapping)] if isinstance(value, list) else []


def _part(of: Content, key: str) -> Content:
    value = of.get(key)
    return value if isinstance(value, Mapping) else {}


def _number(of: Content, key: str) -> float:
    """Return a number of a result; NaN where there is none."""
    return _finite(of.get(key))


def _numbers(of: Content, key: str) -> list[float]:
    """Return the numbers of a list in a result, NaN for what is none; none where there is no list."""
    value = of.get(key)
    return [_finite(one) for one in value] if isinstance(value, list) else []


def _finite(value: Any) -> float:
    return float(value) if isinstance(value, int | float) and abs(value) < HUGE else math.nan


def _known(*values: float) -> bool:
    return all(math.isfinite(value) for value in values)


def _texts(of: Content, key: str) -> list[str]:
    value = of.get(key)
    return [str(one) for one in value] if isinstance(value, list) else []


def _mm(value: float) -> str:
    return f"{fixed(1e3 * value, 3)} mm"


def _percent(value: float) -> str:
    return f"{'+' if value > 0 else ''}{fixed(100 * value, 2)} %"


def _error_sentence(mean: float, largest: float, before: float) -> str:
    """Say how large the errors are; `before`: mean with the cell file's model, NaN where it states none."""
    if not _known(mean, largest):
        return ""
    beside = f"; with the cell file's model the mean is {_mm(before)}" if _known(before) else ""
    return f"The error of a reading is {_mm(mean)} on average and {_mm(largest)} at most{beside}."


def _verify(result: Content) -> Iterable[str]:
    decision, tolerance, rule = result.get("decision"), _number(result, "tolerance"), _part(result, "decision_rule")
    after, before = (_part(_part(result, "error"), name) for name in ("after", "before"))
    uncertainty = _part(result, "uncertainty")
    if decision is None:  # the input was refused
        return
    if _known(tolerance):
        statement = {
            CONFORMING: "The robot conforms to the tolerance of",
            NOT_CONFORMING: "The robot does not conform to the tolerance of",
        }.get(str(decision), "The measurement uncertainty leaves open whether the robot conforms to the tolerance of")
        yield (
            f"{statement} {_mm(tolerance)} ({rule.get('standard', 'ISO 14253-1')}, conformance probability "
            f"{fixed(100 * _number(rule, 'probability'), 0)} %)."
        )
    yield _error_sentence(_number(after, "mean"), _number(after, "max"), _number(before, "mean"))
    expanded = _number(uncertainty, "expanded")
    if _known(expanded):
        factor = significant(_number(uncertainty, "coverage_factor"), 1)
        yield f"The expanded uncertainty of the least certain reading is {_mm(expanded)} (k = {factor})."
    yield _places(records(result, "places"))
    if result.get("intervals_of_the_model") is False:
        yield "The model states no covariance: the uncertainty is that of the instruments alone."
    rms, fitted = _number(after, "rms"), _number(result, "rms_with_tracker_fitted")
    elsewhere = _known(rms, fitted) and rms > 2 * fitted
    if elsewhere:
        yield f"With the tracker's pose fitted to this recording, the error would be {_mm(fitted)} rms, not {_mm(rms)}."
    if decision == CONFORMING:
        yield "Next step: use the model within this tolerance; calibration plan --for verify plans the next re-check."
    elif elsewhere:
        yield "Next step: if the tracker was set up anew, run verify again with --fit-tracker."
    elif decision == NOT_CONFORMING:
        yield "Next step: run diagnose with this recording and the model, or calibrate the robot anew."
    else:
        yield "Next step: measure with less uncertainty, or state a larger tolerance."


def _places(places: Sequence[Content]) -> str:
    """Say how many configurations do not conform, or stay open."""
    counts = {
        text: len({str(one.get("configuration")) for one in places if one.get("decision") == kind})
        for kind, text in ((NOT_CONFORMING, "not conforming"), ("undecided", "undecided"))
    }
    parts = [f"{count} {text}" for text, count in counts.items() if count]
    return f"Of {counted(len(places), 'configuration')}, {phrase(parts)}." if parts else ""


def _compare(result: Content) -> Iterable[str]:
    rows: list[Content] = []
    for one in records(result, "comparisons"):
        differences = records(one, "differences")
        yield f"The measurement {one.get('second')} is compared with {one.get('first')}."
        yield from _differences(differences)
        rows += differences
    for one in records(result, "trends"):
        ends = [_number(one, key) for key in ("slope", "low", "high")]
        if one.get("verdict") == "changed" and _known(*ends):
            what = f"The {one.get('quantity')} of {one.get('location')} changes by"
            yield f"{what} {_change(one, *ends)} each year."
    yield from _texts(result, "remarks")
    wanted = max((x for row in rows if _known(x := _number(row, "configurations"))), default=0.0)
    if any(row.get("verdict") == "changed" for row in rows):
        yield "Next step: find out what was done to the robot, and identify it anew before the earlier model is used."
    elif wanted:
        yield f"Next step: measure {fixed(wanted, 0)} configurations each time to decide on every quantity."
    elif rows and all(row.get("verdict") == "not_changed" for row in rows):
        yield "Next step: none is needed; the earlier model still holds."


def _differences(rows: Sequence[Content]) -> Iterable[str]:
    """Say what has changed and how a stiffness has not; the other quantities that have not are counted."""
    for row in rows:
        sizes = [_number(row, key) for key in ("change", "low", "high")]
        what = f"the {row.get('quantity')} of {row.get('location')}"
        if not _known(*sizes):
            continue
        change = _change(row, *sizes)
        if row.get("verdict") == "changed":
            alike = _texts(row, "or_else")
            instead = f"; the change may as well be at {' or '.join(alike)}" if alike else ""
            yield f"T{what[1:]} has changed by {change}{instead}."
        elif row.get("quantity") == "stiffness":
            wanted = _number(row, "configurations")
            more = f"; {fixed(wanted, 0)} configurations each time would show it" if _known(wanted) else ""
            limit = f"{significant(100 * _number(row, 'limit'), 1)} %"
            if row.get("verdict") == "not_changed":
                yield f"T{what[1:]} has not changed by more than {limit}: the difference is {change}."
            else:
                yield f"Whether {what} has changed by {limit} stays open: the difference is {change}{more}."
    others = [row for row in rows if row.get("quantity") != "stiffness" and row.get("verdict") != "changed"]
    fine = sum(row.get("verdict") == "not_changed" for row in others)
    if others:
        yield f"Of backlash, hysteresis and effects, {fine} have not changed, and {len(others) - fine} stay open."


def _change(row: Content, size: float, low: float, high: float) -> str:
    """Return a change with its 95 % interval: in % of a stiffness, else in its unit."""
    if row.get("quantity") == "stiffness":
        return f"{_percent(size)} (95 % interval {_percent(low)} to {_percent(high)})"
    unit = str(row.get("unit", "")).replace("*", "·")
    return f"{significant(size)} {unit} (95 % interval {significant(low)} to {significant(high)} {unit})"


def _compensate(result: Content) -> Iterable[str]:
    rows, done, refused = _number(result, "rows"), _number(result, "compensated"), records(result, "refused")
    if _known(rows, done):
        yield f"Corrected targets were found for {int(done):,} of {counted(int(rows), 'row')}."
    before, bound = _part(result, "error_before"), _part(result, "u95")
    mean, largest = _number(before, "mean"), _number(before, "max")
    if _known(mean, largest):
        yield f"Without the correction, the tool would be off by {_mm(mean)} on average and {_mm(largest)} at most."
    mean, largest = _number(bound, "mean"), _number(bound, "max")
    if _known(mean, largest):
        yield (
            f"With it, the error stays in 95 % of cases below {_mm(mean)} on average, and below {_mm(largest)} in the "
            "least certain row, by the covariance of the model."
        )
    without = _number(result, "without_interval")
    if _known(without) and without:
        yield f"{counted(int(without), 'row')} without an interval: the recording did not determine what counts there."
    named = [f"row {one.get('row')}: {one.get('reason')}" for one in refused[:FEW]]
    if named:
        more = f"; and {len(refused) - FEW} more" if len(refused) > FEW else ""
        yield f"{counted(len(refused), 'row')} refused ({'; '.join(named)}{more})."
    for what, beyond in _part(result, "outside_valid_range").items():
        if isinstance(beyond, list):
            yield f"Beyond what the model's recording covered ({what}): {counted(len(beyond), 'row')}."
    yield from _texts(result, "remarks")
    if refused:
        yield "Next step: change the rows that were refused, and compensate them again."
    else:
        yield f"Next step: send the robot to the corrected targets ({listed(_texts(result, 'files'))})."


def _deflect(result: Content) -> Iterable[str]:
    largest = _number(_part(result, "largest"), "value")
    tool = [one for one in records(result, "deflections") if one.get("point") == "tool"]
    if _known(largest):
        rows = counted(len(tool), "row")
        yield f"Against the robot under its own weight, the load moves the tool by {_mm(largest)} at most, in {rows}."
    if tool:
        yield _moved(tool[0])
    stiff = next(iter(records(result, "stiffness_ellipsoid")), {})
    ends = _numbers(stiff, "stiffness")
    if ends and _known(*ends):
        low, high = (significant(1e-6 * x, 3) for x in (min(ends), max(ends)))
        yield (
            f"In row {stiff.get('row')} the stiffness of the tool's point is {low} N/µm in the softest direction and "
            f"{high} N/µm in the stiffest."
        )
    yield from _texts(result, "remarks")
    yield "deflections.csv holds every row and point."
    yield "Next step: calibration compensate finds targets at which the tool arrives in spite of the load."


def _moved(one: Content) -> str:
    """Say how far the tool moves and turns in one row, mm and mrad, with the 95 % intervals."""
    values, bounds = _numbers(one, "moved"), _numbers(one, "u95")
    if len(values) != 6 or not _known(*values):
        return ""
    bounds = bounds if len(bounds) == 6 else [math.nan] * 6
    shown = [
        fixed(1e3 * x, 4) + (f" ± {fixed(1e3 * u, 4)}" if math.isfinite(u) else "")
        for x, u in zip(values, bounds, strict=True)
    ]
    sure = "; ± is the 95 % interval" if _known(*bounds) else ""
    return (
        f"In row {one.get('row')} it moves by ({', '.join(shown[:3])}) mm and turns by ({', '.join(shown[3:])}) mrad "
        f"along and about x, y, z of the base{sure}."
    )


def _predict(result: Content) -> Iterable[str]:
    fit, uncertainty, deflection = (_part(result, key) for key in ("fit", "uncertainty", "deflection"))
    yield _error_sentence(_number(fit, "mean_after"), _number(fit, "max_after"), math.nan)
    after, before = _number(fit, "rms_after"), _number(fit, "rms_before")
    if _known(after):
        beside = f"; with the cell file's model it is {_mm(before)}" if _known(before) else ""
        yield f"The root mean square of a coordinate of the error is {_mm(after)}{beside}."
    ratio, standard = _number(uncertainty, "ratio"), _number(uncertainty, "standard")
    if _known(ratio, standard):
        source = "noise and the model's intervals" if result.get("intervals_of_the_model") else "the noise"
        yield f"A coordinate of it is {significant(ratio)} times the {_mm(standard)} that {source} let expect."
    moved = _part(deflection, "after")
    mean, largest = _number(moved, "mean"), _number(moved, "maximum")
    if _known(mean, largest):
        yield f"The error of the deflection alone is {_mm(mean)} on average and {_mm(largest)} at most."


SENTENCES: Mapping[str, Callable[[Content], Iterable[str]]] = {
    "verify": _verify,
    "compare": _compare,
    "compensate": _compensate,
    "deflect": _deflect,
    "predict": _predict,
}
