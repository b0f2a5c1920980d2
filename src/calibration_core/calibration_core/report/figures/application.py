"""What a calibration is good for, drawn: errors row by row with what they may be, and changes with their intervals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.ticker import MaxNLocator

from calibration_core.report.figures.style import ACCENT, GREY, INK, NARROW, drawing, plain_numbers, thinned
from calibration_core.timeseries import Float1D

LEAST = 1e-4  # mm, drawn at least: what is left of a solution found by iteration is no error of a robot


def errors_figure(
    before: Float1D | None, error: Float1D, bound: Float1D, labels: tuple[str, str], tolerance: float | None = None
) -> bytes:
    """Draw sizes of errors row by row, logarithmic; those below `LEAST` at it.

    Args:
        before: (m,) mm, without the calibration; None: not known.
        error: (m,) mm, with it.
        bound: (m,) mm, the end of its 95 % interval; NaN where there is none.
        labels: What a row is, and what `error` is.
        tolerance: mm; None: none.
    """
    row = np.arange(1, len(error) + 1)
    seen = thinned(np.nan_to_num(error))
    error = np.maximum(error, LEAST)
    with drawing(2.6, NARROW) as (figure, buffer):
        axes = figure.add_subplot()
        if before is not None:
            axes.plot(row[seen], before[seen], "o", color=GREY, markersize=3, markerfacecolor="none", label="without")
        axes.plot(row[seen], error[seen], "s", color=INK, markersize=2.5, label=labels[1])
        if np.isfinite(bound).any():
            axes.plot(row[seen], bound[seen], "_", color=ACCENT, markersize=5, label="95 %")
        if tolerance is not None:
            axes.axhline(tolerance, color=INK, linewidth=0.6, linestyle="--", label="tolerance")
        axes.set(yscale="log", xlabel=labels[0], ylabel="error [mm]")
        plain_numbers(axes.yaxis)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return buffer.getvalue()


def changes_figure(
    names: Sequence[str], change: Float1D, low: Float1D, high: Float1D, changed: Sequence[bool]
) -> bytes:
    """Draw relative changes with their 95 % intervals.

    Args:
        names: What has changed, one line each.
        change: (k,) %.
        low: (k,) %, lower ends.
        high: (k,) %, upper ends.
        changed: Per line whether it counts as changed: a filled mark.
    """
    with drawing(0.75 + 0.22 * len(names), NARROW) as (figure, buffer):
        axes = figure.add_subplot()
        axes.axvline(0.0, color=GREY, linewidth=0.6)
        for line, (middle, ends, stands_out) in enumerate(
            zip(change, zip(low, high, strict=True), changed, strict=True)
        ):
            if np.isfinite(ends).all():
                axes.plot(ends, [line, line], color=INK, linewidth=1.1, marker="|", markersize=6)
                face = INK if stands_out else "white"
                axes.plot(middle, line, "o", color=INK, markersize=4.5, markerfacecolor=face)
        axes.set(xlabel="change of stiffness [%]", ylim=(len(names) - 0.5, -0.5))
        axes.set_yticks(range(len(names)), names)
    return buffer.getvalue()
