"""The figures of a diagnosis: where recording and model differ, and how much less with the findings."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from calibration_core.diagnosis.comparison.result import Comparison, StepByStep, WaterfallStep
from calibration_core.diagnosis.location import Located
from calibration_core.report.figures.identification import MOST_CONFIGURATIONS, grouped_rms
from calibration_core.report.figures.style import ACCENT, GREY, INK, PALE, drawable, panels
from calibration_core.report.rounding import Unit, length_unit, rms
from calibration_core.timeseries import Float1D, Float2D, Int1D, Readings

SHOWN_DEPENDENCES = 8
LABELLED = 40  # configurations whose numbers are all written


def before_after_figure(readings: Readings, before: Float2D, after: Float2D, noise: float) -> bytes:
    """Draw the rms of every configuration, and the distribution of the lengths, without and with the findings.

    Args:
        readings: The m readings.
        before: (m, 3) m, residual of the model without the findings.
        after: (m, 3) m, with them.
        noise: m per coordinate.
    """
    unit = length_unit(rms(before))
    with panels((2.7, (2.2, 1))) as ((left, right), buffer):
        numbers, first, _ = grouped_rms(readings.configuration, before * unit.factor)
        _, second, _ = grouped_rms(readings.configuration, after * unit.factor)
        place, label = _places(numbers)
        if len(numbers) > MOST_CONFIGURATIONS:
            blocks = np.array_split(np.arange(len(numbers)), MOST_CONFIGURATIONS)
            first, second = (np.array([rms(values[b]) for b in blocks]) for values in (first, second))
            place = np.array([float(np.mean(numbers[b])) for b in blocks])
            label = f"configuration (blocks of {len(blocks[0])})"
        left.vlines(place, second, first, color=PALE, linewidth=2.2 if len(place) <= LABELLED else 1.0)
        left.plot(place, first, "D", color=ACCENT, markersize=3.6, markerfacecolor="none", label="without findings")
        left.plot(place, second, "o", color=INK, markersize=3.0, label="with findings")
        left.axhline(noise * unit.factor, color=INK, linestyle="--", linewidth=0.8, label="noise")
        if len(numbers) <= LABELLED:
            left.set_xticks(place, [f"{int(n)}" for n in numbers], fontsize=8 if len(numbers) <= 24 else 6)
        left.set(xlabel=label, ylabel=f"rms residual [{unit.name}]")
        left.set_ylim(0, None)
        left.set_title("a) per configuration")
        left.legend(
            loc="lower right", bbox_to_anchor=(1, 1), ncols=3, borderaxespad=0.2, columnspacing=1.0, handletextpad=0.3
        )
        _distributions(right, before, after, unit)
    return buffer.getvalue()


def where_figure(where: Located) -> bytes:
    """Draw how well turns about every joint explain the residual, and what it follows: load levels, or other things."""
    with panels((2.5, (1, 1.25) if where.shares else (-1, 3, -1))) as (axes, buffer):
        if where.shares:
            _joint_shares(axes[0], where)
            axes[0].set_title("a)")
            axes[1].set_title("b)")
        if len(where.levels) > 2:
            _level_curve(axes[-1], where)
        else:
            _dependence_bars(axes[-1], where)
    return buffer.getvalue()


def comparison_figure(steps: StepByStep) -> bytes:
    """Draw the difference of recording and simulation per configuration and step: a map where there are steps."""
    unit = length_unit(steps.rms)
    if steps.grid is not None and steps.grid.shape[1] > 1:
        return _difference_map(steps, steps.grid * unit.factor, unit)
    with panels((2.4, (1.8, 1))) as ((left, right), buffer):
        for axes, parts, name, letter in (
            (left, sorted(steps.by_configuration, key=lambda part: int(part.name)), "configuration", "a)"),
            (right, steps.by_step, "step", "b)"),
        ):
            place = np.arange(len(parts))
            size = np.array([part.rms for part in parts]) * unit.factor
            axes.vlines(place, 0, size, color=PALE, linewidth=2.4 if len(parts) <= LABELLED else 1.0)
            axes.plot(place, size, "o", color=INK, markersize=3.2)
            axes.axhline(steps.noise * unit.factor, color=INK, linestyle="--", linewidth=0.8, label="noise of both")
            every = max(len(parts) // 20, 1)
            axes.set_xticks(place[::every], [part.name for part in parts][::every], fontsize=7)
            axes.set_xlabel(name)
            axes.set_title(letter)
            axes.set_ylabel(f"recording − simulation, rms [{unit.name}]")
        right.set_ylim(0, left.set_ylim(0, max(axes.get_ylim()[1] for axes in (left, right)))[1])
        right.legend(loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.2)
    return buffer.getvalue()


def _difference_map(steps: StepByStep, grid: Float2D, unit: Unit) -> bytes:
    names = sorted((part.name for part in steps.by_configuration), key=int)
    with panels((0.9 + 0.2 * grid.shape[1], (1,))) as ((axes,), buffer):
        shown = axes.imshow(grid.T, cmap="Greys", vmin=0.0, aspect="auto", interpolation="nearest")
        every = max(len(names) // 20, 1)
        axes.set_xticks(np.arange(len(names))[::every], names[::every], fontsize=7)
        axes.set_yticks(np.arange(grid.shape[1]), [part.name for part in steps.by_step])
        axes.set_xlabel("configuration")
        axes.set_ylabel("step")
        axes.figure.colorbar(shown, ax=axes, label=f"rms [{unit.name}]", fraction=0.04, pad=0.02)
    return buffer.getvalue()


def waterfall_figure(compared: Comparison) -> bytes:
    """Draw what is left of the difference of recording and simulation after every step, and by the new simulation."""
    steps = list(compared.waterfall)
    if compared.improved is not None:
        again = compared.improved
        steps.append(WaterfallStep("new simulation", "", again.rms, float("nan"), again.test_rms, 0.0))
    unit = length_unit(steps[0].rms)
    names = [drawable(step.name.replace("_", " "), 26) for step in steps]
    place = np.arange(len(steps))
    kinds = ("rms", "held_out_rms", "test_rms")
    left, out, test = (np.array([getattr(step, kind) for step in steps]) * unit.factor for kind in kinds)
    with panels((0.7 + 0.32 * len(steps), (1,))) as ((axes,), buffer):
        axes.barh(place, left, height=0.62, color=INK)
        before = np.append(left[0], left[:-1])
        axes.barh(place, before - left, left=left, height=0.62, color=PALE)
        axes.plot(out, place, "o", color=ACCENT, markersize=4, markerfacecolor="white", label="left out")
        axes.plot(test, place, "D", color=ACCENT, markersize=4, label="test recording")
        axes.set_yticks(place, names)
        axes.set_ylim(len(steps) - 0.5, -0.5)
        axes.set_xlim(0, 1.04 * float(np.nanmax([left, out, test])))
        axes.set_xlabel(f"recording − model, rms [{unit.name}]")
        axes.legend(loc="lower right")
    return buffer.getvalue()


def _places(numbers: Float1D) -> tuple[Float1D, str]:
    if len(numbers) <= LABELLED:
        return np.arange(len(numbers), dtype=np.float64), "configuration"
    return numbers, "configuration"


def _distributions(axes: Axes, before: Float2D, after: Float2D, unit: Unit) -> None:
    lengths = [np.sort(np.linalg.norm(values, axis=1)) * unit.factor for values in (before, after)]
    for values, colour, style in ((lengths[0], ACCENT, "-"), (lengths[1], INK, "-")):
        kept: Int1D = np.unique(np.linspace(0, len(values) - 1, min(len(values), 300)).astype(int))
        axes.plot(values[kept], 100 * (kept + 1) / len(values), style, color=colour, linewidth=1.2)
    axes.set(xlabel=f"length of residual [{unit.name}]", ylabel="readings below [%]", ylim=(0, 100))
    axes.set_xlim(0, float(np.quantile(lengths[0], 0.995)) * 1.1 + 1e-9)
    axes.set_title("b) lengths")


def _joint_shares(axes: Axes, where: Located) -> None:
    shares = sorted(where.shares, key=lambda share: share.joint)
    place = np.arange(len(shares))
    axes.barh(place, [100 * share.any_axis for share in shares], color=PALE, height=0.66, label="any axis through it")
    axes.barh(
        place, [100 * share.own_axis for share in shares], height=0.34, facecolor=INK, label="its own axis"
    )  # fmt: skip
    axes.set_yticks(place, [drawable(share.joint, 16) for share in shares])
    best = int(np.argmax([share.any_axis for share in shares]))
    axes.barh(best, 100 * shares[best].any_axis, height=0.66, facecolor="none", edgecolor=ACCENT, linewidth=1.4)
    axes.get_yticklabels()[best].set_fontweight("bold")
    axes.set_ylim(len(shares) - 0.5, -0.5)
    axes.set_xlim(0, 100)
    axes.set_xlabel("residual explained by turns about the joint [%]")
    axes.legend(
        loc="lower right", bbox_to_anchor=(1, 1), ncols=2, borderaxespad=0.2, handlelength=1.0, columnspacing=1.0
    )


def _level_curve(axes: Axes, where: Located) -> None:
    unit = length_unit(where.rms)
    share = np.array([100 * level.level for level in where.levels])
    along = np.array([level.along for level in where.levels]) * unit.factor
    full = int(np.argmax(share))
    axes.plot(share[: full + 1], along[: full + 1], "o-", color=INK, markersize=3.6, label="loading")
    axes.plot(share[full:], along[full:], "D--", color=ACCENT, markersize=4, markerfacecolor="none", label="afterwards")
    axes.plot([min(share.min(), 0), 100], [along[full] * min(share.min(), 0) / 100, along[full]], color=GREY, lw=0.7)
    axes.set(xlabel="load [% of the full pull]", ylabel=f"residual along its full-load direction [{unit.name}]")
    axes.legend(loc="upper left")


def _dependence_bars(axes: Axes, where: Located) -> None:
    shown = where.dependences[:SHOWN_DEPENDENCES]
    place = np.arange(len(shown))
    for k, dependence in enumerate(shown):
        fill = INK if dependence.chance < 0.01 else "white"
        axes.barh(k, 100 * dependence.share, height=0.6, color=fill, edgecolor=INK, linewidth=0.6)
    axes.set_yticks(place, [drawable(dependence.on, 34) for dependence in shown])
    axes.set_ylim(max(len(shown), 1) - 0.5, -0.5)
    axes.set_xlabel("share of the residual that follows it [%]\n(full: not by chance)")
