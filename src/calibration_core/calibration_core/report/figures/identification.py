"""The figures of the report, each a pure function from the answer to SVG."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import cbook
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator
from scipy.special import ndtri

from calibration_core.identification.result.estimate import JointStiffness, Residuals
from calibration_core.report.figures.style import (
    ACCENT,
    AXES,
    GREY,
    INK,
    PALE,
    drawable,
    drawing,
    panels,
    plain_numbers,
    thinned,
)
from calibration_core.report.rounding import STIFFNESS, Unit, length_unit, rms
from calibration_core.timeseries import Float1D, Float2D, Int1D, Readings

MOST_CONFIGURATIONS = 120
"""Configurations drawn one by one; more are drawn in blocks of equal number."""

PREDICTED_MARKS = 700
"""Readings drawn at most in the comparison of predicted and measured values."""

MOST_BEYOND = 300
"""Single readings drawn at most beyond the whiskers of one axis."""

_MARK: dict[str, Any] = {"linestyle": "none", "markersize": 3.2, "markerfacecolor": "none", "markeredgewidth": 0.6}


def stiffness_figure(stiffness: Sequence[JointStiffness], nominal: Sequence[float] | None) -> bytes:
    """Draw the stiffnesses, logarithmic, and beside them their 95 % intervals relative to the value.

    Args:
        stiffness: One per joint.
        nominal: What the cell file states, N*m/rad; None if nothing.
    """
    finite = [(i, joint) for i, joint in enumerate(stiffness) if math.isfinite(joint.value)]
    with panels((0.75 + 0.27 * len(stiffness), (1, 1))) as ((left, right), buffer):
        for i, joint in finite:
            low, high = _relative(joint)
            face = INK if joint.identifiable else "none"
            left.plot(joint.value * STIFFNESS.factor, i, "o", color=INK, markersize=4.5, markerfacecolor=face)
            right.plot([low, high], [i, i], color=INK, linewidth=1.1)
            right.plot([low, high], [i, i], "|", color=INK, markersize=6)
            right.plot(0.0, i, "o", color=INK, markersize=4, markerfacecolor=face)
        for i, joint in enumerate(stiffness):
            if not math.isfinite(joint.value):
                right.annotate(
                    "not determined", (0.5, i), xycoords=("axes fraction", "data"), ha="center", va="center", fontsize=8
                )
        if nominal is not None:
            left.plot(
                np.asarray(nominal) * STIFFNESS.factor,
                range(len(nominal)),
                "D",
                color=GREY,
                markersize=6,
                markerfacecolor="none",
                label="cell file",
                zorder=0,
            )
            for i, joint in finite:
                right.plot(
                    100 * (nominal[i] / joint.value - 1),
                    i,
                    "D",
                    color=GREY,
                    markersize=6,
                    markerfacecolor="none",
                    zorder=0,
                )
            left.plot([], [], "o", color=INK, markersize=4.5, label="identified")
            left.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, borderaxespad=0)
        for axes in (left, right):
            axes.set_yticks(range(len(stiffness)), [drawable(joint.joint) for joint in stiffness])
            axes.set_ylim(len(stiffness) - 0.5, -0.5)
        _log_axis(left)
        left.set_title("a)")
        left.set_xlabel(f"stiffness [{STIFFNESS.name}]")
        right.axvline(0, color=PALE, linewidth=0.6, zorder=-1)
        right.set_title("b)")
        right.set_xlabel("95 % interval relative to the value [%]")
        right.set_xlim(*_within([line.get_xdata() for line in right.lines], 150.0))
    return buffer.getvalue()


def residual_figure(readings: Readings, residuals: Residuals, reach: Float1D) -> bytes:
    """Draw the residuals per configuration, per axis, and against the load (without a load: the reach).

    Args:
        readings: What was evaluated.
        residuals: Row by row.
        reach: (m,) m, horizontal distance of each reading from the base's z axis.
    """
    used = ~np.asarray(residuals.excluded, dtype=bool)
    unit = length_unit(rms(residuals.residual[used]))
    with panels((2.35, (-1, 5, -1)), (2.25, (1, 1))) as ((every, per_axis, over), buffer):
        _per_configuration(every, readings, residuals, unit)
        _per_axis(per_axis, residuals.residual[used] * unit.factor, rms(residuals.sigma[used]) * unit.factor, unit)
        loaded = bool(np.any(residuals.load > 0))
        against, name = (residuals.load, "load [N]") if loaded else (reach, "distance from base axis z [m]")
        _against(over, against[used], np.linalg.norm(residuals.residual[used], axis=1) * unit.factor, name, unit)
    return buffer.getvalue()


def prediction_figure(residuals: Residuals, loaded: bool) -> bytes:
    """Draw predicted against measured, and the residual against the prediction, per base axis."""
    used = ~np.asarray(residuals.excluded, dtype=bool)
    measured, predicted, left_over = (a[used] for a in (residuals.measured, residuals.predicted, residuals.residual))
    rows = thinned(np.linalg.norm(left_over, axis=1), PREDICTED_MARKS)
    unit, fine = length_unit(rms(measured)), length_unit(rms(left_over))
    what = "deflection" if loaded else "position"
    with panels((2.9, (1, 1))) as ((left, right), buffer):
        for i, (name, marker, colour) in enumerate(AXES):
            style = {"marker": marker, "markeredgecolor": colour, "label": name, **_MARK, "markersize": 2.6}
            left.plot(predicted[rows, i] * unit.factor, measured[rows, i] * unit.factor, **style)
            right.plot(predicted[rows, i] * unit.factor, left_over[rows, i] * fine.factor, **style)
        ends = np.array([np.min(predicted), np.max(predicted)]) * unit.factor
        left.plot(ends, ends, color=INK, linewidth=0.7, zorder=0)
        left.set(xlabel=f"predicted {what} [{unit.name}]", ylabel=f"measured {what} [{unit.name}]")
        left.set_title("a)")
        left.legend(loc="upper left", handletextpad=0.1)
        sigma = rms(residuals.sigma[used]) * fine.factor
        for level in (-2 * sigma, 0.0, 2 * sigma):
            right.axhline(
                level, color=INK if level == 0 else GREY, linewidth=0.7, linestyle="-" if level == 0 else "--", zorder=0
            )
        right.set(xlabel=f"predicted {what} [{unit.name}]", ylabel=f"measured − predicted [{fine.name}]")
        right.set_title("b)")
    return buffer.getvalue()


def normality_figure(residuals: Residuals) -> bytes:
    """Draw the standardised residuals: normal probability plot and histogram."""
    used = ~np.asarray(residuals.excluded, dtype=bool)
    with np.errstate(invalid="ignore", divide="ignore"):
        scaled = (residuals.residual[used] / residuals.sigma[used]).ravel()
    scaled = np.sort(scaled[np.isfinite(scaled)])
    with panels((2.6, (1, 1))) as ((left, right), buffer):
        if scaled.size:
            rows = thinned(np.abs(scaled), 600)
            expected = ndtri((rows + 0.5) / scaled.size)
            left.plot(expected, scaled[rows], marker="o", markeredgecolor=INK, **_MARK)
            ends = np.array([expected[0], expected[-1]])
            left.plot(ends, ends, color=GREY, linewidth=0.8, zorder=0)
            span = max(4.0, min(float(np.max(np.abs(scaled))), 8.0))
            edges = np.linspace(-span, span, 41).tolist()
            right.hist(np.clip(scaled, -span, span), edges, density=True, color=PALE, edgecolor="white", linewidth=0.3)
            grid = np.linspace(-span, span, 200)
            right.plot(grid, np.exp(-(grid**2) / 2) / math.sqrt(2 * math.pi), color=INK)
        left.set(xlabel="expected for normal noise [σ]", ylabel="residual / expected σ")
        left.set_title("a)")
        right.set(xlabel="residual / expected σ", ylabel="density")
        right.set_title("b)")
    return buffer.getvalue()


def correlation_figure(names: Sequence[str], matrix: Float2D) -> bytes:
    """Draw a correlation matrix: the area of a square is |r|, full squares are positive, hollow ones negative."""
    p = len(names)
    size = min(max(2.4, 0.19 * p + 1.4), 5.6)
    font = 8 if p <= 24 else max(3.0, 8 * 24 / p)
    with drawing(size, size + 0.4) as (figure, buffer):
        axes = figure.subplots()
        for i, j in zip(*np.nonzero(np.isfinite(matrix)), strict=True):
            side = 0.92 * math.sqrt(abs(matrix[i, j]))
            if side < 0.04:
                continue
            corner = (float(j) - side / 2, float(i) - side / 2)
            face = "white" if matrix[i, j] < 0 else (GREY if i == j else INK)
            edge = GREY if i == j else INK
            axes.add_patch(Rectangle(corner, side, side, facecolor=face, edgecolor=edge, linewidth=0.6))
        labels = [drawable(name, 18) for name in names]
        axes.set_yticks(range(p), labels, fontsize=font)
        axes.set_xticks(range(p), labels, fontsize=font, rotation=90)
        axes.xaxis.tick_top()
        axes.set(xlim=(-0.6, p - 0.4), ylim=(p - 0.4, -0.6), aspect="equal")
        axes.tick_params(length=0)
        for side_name in ("left", "bottom"):
            axes.spines[side_name].set_visible(False)
    return buffer.getvalue()


def grouped_rms(configuration: Int1D, values: Float2D) -> tuple[Float1D, Float1D, Float1D]:
    """Return number, rms per coordinate and largest length for every configuration, (k,) each."""
    numbers, index = np.unique(configuration, return_inverse=True)
    count = np.bincount(index)
    square = np.sum(values**2, axis=1)
    largest = np.zeros(len(numbers))
    with np.errstate(invalid="ignore"):  # NaN where nothing was left out stays NaN
        np.maximum.at(largest, index, np.sqrt(square))
    return numbers.astype(np.float64), np.sqrt(np.bincount(index, square) / (3 * count)), largest


def grouped(values: Float1D, most: int = 8) -> Int1D:
    """Return (m,) the group of every value, from 0 in rising order: separate levels, else ranges of equal number.

    Args:
        values: (m,).
        most: Number of groups at most; levels are apart where a gap exceeds 4 % of the largest value.
    """
    apart = 0.04 * float(np.max(np.abs(values), initial=0.0))
    if not len(values) or np.ptp(values) <= apart:
        return np.zeros(len(values), dtype=np.int64)
    order = np.argsort(values, kind="stable")
    gaps = np.diff(values[order]) > apart
    level = np.concatenate([[0], np.cumsum(gaps)])
    if not 1 < level[-1] + 1 <= most:
        level = np.arange(len(values)) * most // len(values)
    group = np.empty(len(values), dtype=np.int64)
    group[order] = level
    return group


def _per_configuration(axes: Axes, readings: Readings, residuals: Residuals, unit: Unit) -> None:
    used = ~np.asarray(residuals.excluded, dtype=bool)
    numbers, fitted, _ = grouped_rms(readings.configuration[used], residuals.residual[used] * unit.factor)
    _, held_out, _ = grouped_rms(readings.configuration[used], residuals.held_out[used] * unit.factor)
    place, name = np.arange(len(numbers), dtype=np.float64), "configuration"
    if len(numbers) > MOST_CONFIGURATIONS:
        blocks = np.array_split(np.arange(len(numbers)), MOST_CONFIGURATIONS)
        fitted, held_out = (np.array([rms(a[b]) for b in blocks]) for a in (fitted, held_out))
        place = np.array([float(np.mean(numbers[b])) for b in blocks])
        name = f"configuration (blocks of {len(blocks[0])})"
    elif len(numbers) <= 45:
        every = 1 if len(numbers) <= 30 else 2
        axes.set_xticks(place[::every], [f"{int(no)}" for no in numbers[::every]])
    else:
        place = numbers
    name_of_fit = "fitted" if np.any(np.isfinite(held_out)) else "predicted"
    axes.vlines(place, 0, fitted, color=PALE, linewidth=2.4 if len(place) <= 45 else 1.2)
    axes.plot(place, fitted, "o", color=INK, markersize=3.4, label=name_of_fit)
    if np.any(np.isfinite(held_out)):
        axes.plot(
            place,
            held_out,
            "D",
            color=ACCENT,
            markersize=4.2,
            markerfacecolor="none",
            markeredgewidth=0.7,
            label="predicted from the others",
        )
    axes.axhline(rms(residuals.sigma[used]) * unit.factor, color=INK, linestyle="--", linewidth=0.8, label="expected")
    axes.set(xlabel=name, ylabel=f"rms residual [{unit.name}]")
    axes.set_ylim(0, None)
    axes.set_title("a) per configuration")
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, borderaxespad=0.2)


def _per_axis(axes: Axes, values: Float2D, sigma: float, unit: Unit) -> None:
    boxes = cbook.boxplot_stats(values, whis=(2.5, 97.5), labels=["x", "y", "z"])
    for box in boxes:
        beyond = np.asarray(box["fliers"])
        box["fliers"] = beyond[thinned(np.abs(beyond), MOST_BEYOND)]
    line = {"color": INK, "linewidth": 0.8}
    axes.bxp(
        boxes,
        widths=0.45,
        boxprops=line,
        whiskerprops=line,
        capprops=line,
        medianprops={"color": INK, "linewidth": 1.4},
        flierprops={"marker": ".", "markersize": 2, "markeredgecolor": GREY},
    )
    for level in (-1.96 * sigma, 1.96 * sigma):
        axes.axhline(level, color=GREY, linestyle="--", linewidth=0.8, zorder=0)
    axes.set(xlabel="base axis", ylabel=f"residual [{unit.name}]")
    axes.set_title("b) per axis")


def _against(axes: Axes, against: Float1D, size: Float1D, name: str, unit: Unit) -> None:
    rows = thinned(size)
    axes.plot(against[rows], size[rows], marker="o", markeredgecolor=GREY, **{**_MARK, "markersize": 2.4})
    group = grouped(against)
    numbers = np.unique(group)
    if len(numbers) > 1:
        middle = [float(np.mean(against[group == number])) for number in numbers]
        level = [rms(size[group == number]) for number in numbers]
        axes.plot(middle, level, "s-", color=INK, markersize=3.4, label="rms of a group")
        axes.legend(loc="upper left", bbox_to_anchor=(0, 1.0))
    axes.set(xlabel=name, ylabel=f"length of residual [{unit.name}]")
    axes.set_ylim(0, None)
    axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.set_title("c) against " + name.split(" [", maxsplit=1)[0])


def _relative(joint: JointStiffness) -> tuple[float, float]:
    low, high = (100 * (end / joint.value - 1) for end in joint.interval)
    return (low if math.isfinite(low) else -100.0, high if math.isfinite(high) else 1e4)


def _within(values: Sequence[object], most: float) -> tuple[float, float]:
    ends = np.concatenate([np.asarray(v, dtype=np.float64) for v in values] or [np.zeros(1)])
    ends = ends[np.isfinite(ends) & (np.abs(ends) <= most)]
    span = max(float(np.max(np.abs(ends))) if ends.size else 1.0, 1.0) * 1.12
    return -span, span


def _log_axis(axes: Axes) -> None:
    axes.set_xscale("log")
    plain_numbers(axes.xaxis, (1.0, 2.0, 5.0))
