"""The pictures of the pages on statistics and architecture, drawn from simulated numbers with fixed seeds."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, BLUE, GREY, PALE = "#111111", "#1f4e79", "#8a8a8a", "#c9c9c9"


def draw(folder: Path) -> None:
    """Draw all pictures into a folder, made if missing."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, (size, columns, drawing) in PICTURES.items():
        figure = Figure(figsize=size, layout="constrained")
        drawing(list(np.atleast_1d(figure.subplots(1, columns)).ravel()))
        buffer = io.BytesIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
        (folder / f"{name}.svg").write_bytes(buffer.getvalue())


def intervals(axes: list[Axes]) -> None:
    """Draw forty intervals of one stiffness, found by least squares from simulated deflections."""
    rng = np.random.default_rng(3)
    true, torque, noise = 1.0e-6, np.linspace(-900, 900, 9), 6.0e-5  # rad/(N*m), N*m, rad
    for number in range(40):
        angle = true * torque + rng.normal(0, noise, len(torque))
        compliance = float(torque @ angle / (torque @ torque))
        std = noise / float(np.linalg.norm(torque))
        low, high = 1e-6 / (compliance + 1.96 * std), 1e-6 / (compliance - 1.96 * std)
        missed = not low < 1.0 < high
        axes[0].plot([number, number], [low, high], color=BLUE if missed else INK, linewidth=2.2 if missed else 1.0)
        axes[0].plot(number, 1e-6 / compliance, "o", markersize=2.5, color=BLUE if missed else INK)
    axes[0].axhline(1.0, linestyle="--", linewidth=0.8, color=GREY)
    axes[0].set(xlabel="repetition of the measurement", ylabel="stiffness [10⁶ N·m/rad]")


def residuals(axes: list[Axes]) -> None:
    """Draw residuals against the load: noise, and noise with a missing effect."""
    rng = np.random.default_rng(5)
    load = np.repeat(np.linspace(0, 2000, 9), 6)
    for one, missing, title in zip(axes, (0.0, 0.045), ("complete model", "a bearing is missing"), strict=True):
        side = np.tile(np.linspace(-1, 1, 6), 9)
        values = rng.normal(0, 20, len(load)) + missing * load * side
        one.plot(load, values, "o", markersize=2.8, markerfacecolor="none", color=INK)
        for level in (-40, 40):
            one.axhline(level, linestyle="--", linewidth=0.8, color=GREY)
        one.set(xlabel="load [N]", ylabel="residual [µm]", title=title, ylim=(-140, 140))


def held_out(axes: list[Axes]) -> None:
    """Draw the error of polynomials of growing degree: on what was fitted, and on what was left out."""
    rng = np.random.default_rng(8)
    x = np.sort(rng.uniform(-1, 1, 18))
    y = 1.2 * x - 0.8 * x**2 + rng.normal(0, 0.12, len(x))
    degrees = range(1, 10)
    fitted, left_out = [], []
    for degree in degrees:
        fitted.append(float(np.sqrt(np.mean((np.polyval(np.polyfit(x, y, degree), x) - y) ** 2))))
        errors = [np.polyval(np.polyfit(np.delete(x, i), np.delete(y, i), degree), x[i]) - y[i] for i in range(len(x))]
        left_out.append(float(np.sqrt(np.mean(np.square(errors)))))
    axes[0].plot(degrees, fitted, "o-", color=INK, markersize=3, label="fitted")
    axes[0].plot(degrees, left_out, "D--", color=BLUE, markersize=3, label="left out of the fit")
    axes[0].axhline(0.12, color=GREY, linestyle=":", linewidth=1, label="noise")
    axes[0].set(xlabel="parameters of the model", ylabel="rms error", yscale="log")
    axes[0].legend(frameon=False)


def confounded(axes: list[Axes]) -> None:
    """Draw the likelihood of two compliances that move the points almost alike, and with one more configuration."""
    grid = np.linspace(0, 2, 160)
    first, second = np.meshgrid(grid, grid)
    along = ((first + second - 2) / 0.08) ** 2
    across = ((first - second) / 1.6) ** 2
    for one, cut, title in zip(
        axes, (1.0, 60.0), ("only the sum is determined", "with another load direction"), strict=True
    ):
        one.contour(first, second, along + cut * across, levels=[1, 4, 9], colors=[INK, BLUE, PALE], linewidths=1)
        one.plot(1, 1, "+", color=INK)
        one.set(xlabel="compliance of joint 2", ylabel="compliance of joint 3", title=title, aspect="equal")


def house(axes: list[Axes]) -> None:
    """Draw the packages and layers, and the direction of the imports."""
    one = axes[0]
    one.set(xlim=(0, 10), ylim=(0, 11.2))
    one.axis("off")
    left, right, whole = (2.9, 2.0), (5.1, 2.0), (2.9, 4.2)
    rows = (
        ((whole, "errors, files, timeseries, cell"),),
        ((whole, "recording"),),
        ((whole, "observations"),),
        ((whole, "model, effects by family"),),
        ((left, "input_checks"), (right, "motion")),
        ((left, "identification,\nestimation"), (right, "planning")),
        ((left, "diagnosis"), (right, "measurement")),
        ((left, "report"), (right, "compensation,\nformats, acceptance")),
        ((whole, "outcomes"),),
        ((whole, "report/documents"),),
        ((whole, "commands, library, fleet"),),
    )
    for level, row in enumerate(rows):
        bottom = 0.1 + level * 0.95
        for (x, width), name in row:
            _box(one, x, bottom, width, 0.7, name)
            if level and (x, level) != (right[0], 7):
                middle = x + width / 2
                arrow = {"arrowstyle": "->", "color": INK}
                one.annotate("", (middle, bottom - 0.25), (middle, bottom), arrowprops=arrow)
    for level in (5, 7):  # planning looks at what is observable; what is put to use was identified
        start, end = (5.1, 0.45 + level * 0.95), (4.9, 0.45 + 5 * 0.95)
        one.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": INK})
    one.text(5.0, 10.75, "calibration_core", ha="center", fontsize=9, fontweight="bold")
    _box(one, 0.1, 0.1, 2.1, 3.4, "calibration_sim\n\nsimulated cell,\nMuJoCo physics,\nno kinematics of\nthe core")
    _box(one, 7.8, 4.1, 2.1, 5.0, "calibration\n\nROS 2 nodes:\nconvert,\ncall the core,\nconvert back")
    _box(one, 7.8, 0.1, 2.1, 2.0, "calibration_\ninterfaces\n\nmessages")
    arrows = (((2.2, 1.2), (2.9, 1.2)), ((7.8, 6.1), (7.1, 6.1)), ((8.85, 4.1), (8.85, 2.1)))
    for start, end in arrows:
        one.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": BLUE})


def _box(one: Axes, x: float, y: float, width: float, height: float, text: str) -> None:
    from matplotlib.patches import Rectangle

    one.add_patch(Rectangle((x, y), width, height, facecolor="white", edgecolor=INK, linewidth=0.9))
    one.text(x + width / 2, y + height / 2, text, ha="center", va="center", fontsize=8)


Drawing = Callable[[list[Axes]], None]
PICTURES: dict[str, tuple[tuple[float, float], int, Drawing]] = {
    "intervals": ((6.7, 2.6), 1, intervals),
    "residuals": ((6.7, 2.6), 2, residuals),
    "held_out": ((6.7, 2.6), 1, held_out),
    "confounded": ((6.7, 3.3), 2, confounded),
    "house": ((6.7, 6.6), 1, house),
}
