"""What the results of `verify`, `compare`, `compensate`, `deflect`, `predict` say: decision, numbers, next step."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

from calibration_core.commands.files.result_parts import (
    FEW,
    Content,
    known,
    mm,
    number,
    numbers,
    part,
    percent,
    records,
    texts,
)
from calibration_core.outcomes.verification import ELSEWHERE
from calibration_core.report.rounding import counted, fixed, listed, phrase, significant

CONFORMING, NOT_CONFORMING = "conforming", "not_conforming"


def _error_sentence(mean: float, largest: float, before: float) -> str:
    """Say how large the errors are; `before`: mean with the cell file's model, NaN where it states none."""
    if not known(mean, largest):
        return ""
    beside = f"; with the cell file's model the mean is {mm(before)}" if known(before) else ""
    return f"The error of a reading is {mm(mean)} on average and {mm(largest)} at most{beside}."


def _verify(result: Content) -> Iterable[str]:
    decision, tolerance, rule = result.get("decision"), number(result, "tolerance"), part(result, "decision_rule")
    after, before = (part(part(result, "error"), name) for name in ("after", "before"))
    uncertainty = part(result, "uncertainty")
    if decision is None:  # the input was refused
        return
    if known(tolerance):
        statement = {
            CONFORMING: "The robot conforms to the tolerance of",
            NOT_CONFORMING: "The robot does not conform to the tolerance of",
        }.get(str(decision), "The measurement uncertainty leaves open whether the robot conforms to the tolerance of")
        yield (
            f"{statement} {mm(tolerance)} ({rule.get('standard', 'ISO 14253-1')}, conformance probability "
            f"{fixed(100 * number(rule, 'probability'), 0)} %)."
        )
    yield _error_sentence(number(after, "mean"), number(after, "max"), number(before, "mean"))
    expanded = number(uncertainty, "expanded")
    if known(expanded):
        factor = significant(number(uncertainty, "coverage_factor"), 1)
        yield f"The expanded uncertainty of the least certain reading is {mm(expanded)} (k = {factor})."
    yield _places(records(result, "places"))
    if result.get("intervals_of_the_model") is False:
        yield "The model states no covariance: the uncertainty is that of the instruments alone."
    rms, fitted = number(after, "rms"), number(result, "rms_with_tracker_fitted")
    if known(rms, fitted) and rms > ELSEWHERE * fitted:
        yield f"With the tracker's pose fitted to this recording, the error would be {mm(fitted)} rms, not {mm(rms)}."
    if decision == CONFORMING:
        yield "Next step: use the model within this tolerance; calibration plan --for verify plans the next re-check."


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
        ends = [number(one, key) for key in ("slope", "low", "high")]
        if one.get("verdict") == "changed" and known(*ends):
            what = f"The {one.get('quantity')} of {one.get('location')} changes by"
            yield f"{what} {_change(one, *ends)} each year."
    yield from texts(result, "remarks")
    if rows and all(row.get("verdict") == "not_changed" for row in rows):
        yield "Next step: none is needed; the earlier model still holds."


def _differences(rows: Sequence[Content]) -> Iterable[str]:
    """Say what has changed and how a stiffness has not; the other quantities that have not are counted."""
    for row in rows:
        sizes = [number(row, key) for key in ("change", "low", "high")]
        what = f"the {row.get('quantity')} of {row.get('location')}"
        if not known(*sizes):
            continue
        change = _change(row, *sizes)
        if row.get("verdict") == "changed":
            alike = texts(row, "or_else")
            instead = f"; the change may as well be at {' or '.join(alike)}" if alike else ""
            yield f"T{what[1:]} has changed by {change}{instead}."
        elif row.get("quantity") == "stiffness":
            wanted = number(row, "configurations")
            more = f"; {fixed(wanted, 0)} configurations each time would show it" if known(wanted) else ""
            limit = f"{significant(100 * number(row, 'limit'), 1)} %"
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
        return f"{percent(size)} (95 % interval {percent(low)} to {percent(high)})"
    unit = str(row.get("unit", "")).replace("*", "·")
    return f"{significant(size)} {unit} (95 % interval {significant(low)} to {significant(high)} {unit})"


def _compensate(result: Content) -> Iterable[str]:
    rows, done, refused = number(result, "rows"), number(result, "compensated"), records(result, "refused")
    if known(rows, done):
        yield f"Corrected targets were found for {int(done):,} of {counted(int(rows), 'row')}."
    before, bound = part(result, "error_before"), part(result, "u95")
    mean, largest = number(before, "mean"), number(before, "max")
    if known(mean, largest):
        yield f"Without the correction, the tool would be off by {mm(mean)} on average and {mm(largest)} at most."
    mean, largest = number(bound, "mean"), number(bound, "max")
    if known(mean, largest):
        yield (
            f"With it, the error stays in 95 % of cases below {mm(mean)} on average, and below {mm(largest)} in the "
            "least certain row, by the covariance of the model."
        )
    without = number(result, "without_interval")
    if known(without) and without:
        yield f"{counted(int(without), 'row')} without an interval: the recording did not determine what counts there."
    named = [f"row {one.get('row')}: {one.get('reason')}" for one in refused[:FEW]]
    if named:
        more = f"; and {len(refused) - FEW} more" if len(refused) > FEW else ""
        yield f"{counted(len(refused), 'row')} refused ({'; '.join(named)}{more})."
    for what, beyond in part(result, "outside_valid_range").items():
        if isinstance(beyond, list):
            yield f"Beyond what the model's recording covered ({what}): {counted(len(beyond), 'row')}."
    yield from texts(result, "remarks")
    if refused:
        yield "Next step: change the rows that were refused, and compensate them again."
    else:
        yield f"Next step: send the robot to the corrected targets ({listed(texts(result, 'files'))})."


def _deflect(result: Content) -> Iterable[str]:
    largest = number(part(result, "largest"), "value")
    tool = [one for one in records(result, "deflections") if one.get("point") == "tool"]
    if known(largest):
        rows = counted(len(tool), "row")
        yield f"Against where the robot stands without it, the load moves the tool by {mm(largest)} at most, in {rows}."
    if tool:
        yield _moved(tool[0])
    stiff = next(iter(records(result, "stiffness_ellipsoid")), {})
    ends = numbers(stiff, "stiffness")
    if ends and known(*ends):
        low, high = (significant(1e-6 * x, 3) for x in (min(ends), max(ends)))
        yield (
            f"In row {stiff.get('row')} the stiffness of the tool's point is {low} N/µm in the softest direction and "
            f"{high} N/µm in the stiffest."
        )
    yield from texts(result, "remarks")
    yield "deflections.csv holds every row and point."
    yield "Next step: calibration compensate finds targets at which the tool arrives in spite of the load."


def _moved(one: Content) -> str:
    """Say how far the tool moves and turns in one row, mm and mrad, with the 95 % intervals."""
    values, bounds = numbers(one, "moved"), numbers(one, "u95")
    if len(values) != 6 or not known(*values):
        return ""
    bounds = bounds if len(bounds) == 6 else [math.nan] * 6
    shown = [
        fixed(1e3 * x, 4) + (f" ± {fixed(1e3 * u, 4)}" if math.isfinite(u) else "")
        for x, u in zip(values, bounds, strict=True)
    ]
    sure = "; ± is the 95 % interval" if known(*bounds) else ""
    return (
        f"In row {one.get('row')} it moves by ({', '.join(shown[:3])}) mm and turns by ({', '.join(shown[3:])}) mrad "
        f"along and about x, y, z of the base{sure}."
    )


def _predict(result: Content) -> Iterable[str]:
    fit, uncertainty, deflection = (part(result, key) for key in ("fit", "uncertainty", "deflection"))
    if not fit or result.get("usable") == "no":  # the input was refused
        return
    yield _error_sentence(number(fit, "mean_after"), number(fit, "max_after"), math.nan)
    after, before = number(fit, "rms_after"), number(fit, "rms_before")
    if known(after):
        beside = f"; with the cell file's model it is {mm(before)}" if known(before) else ""
        yield f"The root mean square of a coordinate of the error is {mm(after)}{beside}."
    ratio, standard = number(uncertainty, "ratio"), number(uncertainty, "standard")
    if known(ratio, standard):
        source = "noise and the model's intervals" if result.get("intervals_of_the_model") else "the noise"
        yield f"A coordinate of it is {significant(ratio)} times the {mm(standard)} that {source} let expect."
    moved = part(deflection, "after")
    mean, largest = number(moved, "mean"), number(moved, "maximum")
    if known(mean, largest):
        yield f"The error of the deflection alone is {mm(mean)} on average and {mm(largest)} at most."
    yield "Next step: calibration verify decides whether such errors conform to a tolerance."


OF_USE: Mapping[str, Callable[[Content], Iterable[str]]] = {
    "verify": _verify,
    "compare": _compare,
    "compensate": _compensate,
    "deflect": _deflect,
    "predict": _predict,
}
