"""How the figures look: black on white, legible without colour, same bytes for the same data."""

from __future__ import annotations

import functools
import io
import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import font_manager
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ft2font import FT2Font
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from calibration_core.timeseries import Float1D, Float2D, Int1D

INK = "#111111"
GREY = "#8a8a8a"
PALE = "#c9c9c9"
ACCENT = "#1f4e79"
AXES = (("x", "o", INK), ("y", "^", ACCENT), ("z", "s", GREY))
"""Name, marker and colour of each Cartesian axis: distinguished by shape first."""

WIDTH = 6.7
"""Width of the text, inches."""

NARROW = 4.8
"""Width of a single diagram, inches: as wide as a telephone can show it legibly."""

MARGINS = np.array([[0.5, 0.42], [0.06, 0.22]])
"""Left and bottom, right and top of most diagrams, inches: names and numbers of the axes, and the title."""

MOST_VECTORS = 400
"""Marks of one kind that are drawn as shapes; more of them become pixels, which every viewer shows faster."""

DPI = 180  # of what becomes pixels

MOST_MARKS = 2500
"""Marks drawn in one panel at most; more would only make the file large."""

_POINTS = 72.0  # per inch
_PAD = 0.04  # inches between what is drawn and the edge
_PANEL = b"<!-- diagram -->\n"
_SIZE = re.compile(rb'<svg [^>]*?\bwidth="([0-9.]+)')
_FONTS = ["STIXGeneral", "DejaVu Sans"]
STYLE: Any = {
    "font.family": _FONTS,
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.labelsize": 9,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "lines.linewidth": 0.9,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # said, for to look for it takes a fifth of the drawing
    "text.parse_math": False,
    "axes.formatter.use_mathtext": False,
    "axes.unicode_minus": True,
    "svg.fonttype": "path",
    "svg.hashsalt": "calibration",
    "axes.grid": False,
    "path.simplify": True,
    "savefig.facecolor": "white",
    "figure.facecolor": "white",
}


@contextmanager
def drawing(height: float, width: float = WIDTH) -> Iterator[tuple[Figure, io.BytesIO]]:
    """Give an empty figure in the report's style; what was drawn is in the buffer as SVG afterwards.

    Args:
        height: Inches.
        width: Inches.
    """
    buffer = io.BytesIO()
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure, buffer
        for line in (line for axes in figure.axes for line in axes.lines):
            if line.get_marker() not in {"None", "", None} and np.size(line.get_xdata()) > MOST_VECTORS:
                line.set_rasterized(True)
        engine = figure.get_layout_engine()
        if figure.axes and engine is not None:  # saving with an engine draws everything twice
            if len(figure.axes) == 1 and figure.axes[0].get_aspect() == "auto":
                fit(figure)
            else:
                engine.execute(figure)
            figure.set_layout_engine(None)
        figure.savefig(buffer, format="svg", dpi=DPI, metadata={"Date": None, "Creator": None})


@contextmanager
def panels(*rows: tuple[float, Sequence[float]]) -> Iterator[tuple[list[Axes], io.BytesIO]]:
    """Give diagrams beside and below each other; what was drawn is in the buffer as one SVG afterwards.

    Each diagram is a drawing of its own within the SVG, so that a narrow screen can show one below the other
    (`parts`).

    Args:
        rows: Height of each row, inches, and the widths of its diagrams, in any unit: a row is as wide as the text.
            A negative width is left empty.
    """
    buffer = io.BytesIO()
    sizes = [(height, [WIDTH * share / sum(map(abs, shares)) for share in shares]) for height, shares in rows]
    drawn = []
    with ExitStack() as opened:
        axes = []
        for height, widths in sizes:
            for width in (width for width in widths if width > 0):
                figure, part = opened.enter_context(drawing(height, width))
                axes.append(figure.subplots())
                drawn.append(part)
        yield axes, buffer
    buffer.write(_composed(sizes, [part.getvalue() for part in drawn]))


def parts(svg: bytes) -> list[tuple[bytes, float]]:
    """Return the diagrams of a drawing, each an SVG, and its width as a share of the text's.

    Args:
        svg: As `drawing` or `panels` made it.
    """
    diagrams = svg.split(_PANEL)[1:-1] or [svg]
    found = [_SIZE.search(diagram) for diagram in diagrams]
    widths = [float(size.group(1)) if size else WIDTH * _POINTS for size in found]
    return [(diagram, width / (WIDTH * _POINTS)) for diagram, width in zip(diagrams, widths, strict=True)]


def _composed(sizes: Sequence[tuple[float, Sequence[float]]], drawn: Sequence[bytes]) -> bytes:
    """Place diagrams, SVG each, in one SVG: sizes as in `panels`, inches."""
    wide, high = _POINTS * WIDTH, _POINTS * sum(height for height, _ in sizes)
    content = [
        b'<?xml version="1.0" encoding="utf-8"?>\n<svg xmlns="http://www.w3.org/2000/svg" version="1.1" '
        b'width="%.6gpt" height="%.6gpt" viewBox="0 0 %.6g %.6g">\n' % (wide, high, wide, high)
    ]
    remaining, y = list(drawn), 0.0
    for height, widths in sizes:
        x = 0.0
        for width in widths:
            if width > 0:
                _, _, inner = remaining.pop(0).partition(b"<svg ")
                place = b'<svg x="%.6g" y="%.6g" ' % (_POINTS * x, _POINTS * y)
                content += [_PANEL, place, inner.replace(b'pt"', b'"', 2)]
            x += abs(width)
        y += height
    return b"".join([*content, _PANEL, b"</svg>\n"])


def fit(figure: Figure) -> None:
    """Place the only diagram of a figure so that its labels end `_PAD` inside the figure's edges.

    It is measured where it usually comes to lie, and again where it then has other ticks, for the length of an axis
    decides about them; where two places change the ticks to and fro, there is room for either.  Constrained layout
    measures everything twice at least.
    """
    (axes,) = figure.axes
    renderer = FigureCanvasAgg(figure).get_renderer()  # type: ignore[no-untyped-call]
    margins = before = MARGINS
    _place(axes, margins / figure.get_size_inches())
    for _ in range(3):
        ticks, before = _ticks(axes), margins
        outer = axes.get_tightbbox(renderer, for_layout_only=True)
        if outer is None:  # nothing is drawn
            return
        inner = axes.get_window_extent(renderer)
        margins = _PAD + np.abs(inner.get_points() - outer.get_points()) / figure.dpi
        _place(axes, margins / figure.get_size_inches())
        if _ticks(axes) == ticks:
            return
    _place(axes, np.maximum(margins, before) / figure.get_size_inches())


def _ticks(axes: Axes) -> tuple[list[float], list[float]]:
    return list(axes.get_xticks()), list(axes.get_yticks())


def place(axes: Axes, margins: Float2D = MARGINS) -> None:
    """Place the only diagram of a figure once and for all; margins (2, 2) left and bottom, right and top, inches."""
    figure = axes.get_figure(root=True)
    assert figure is not None  # noqa: S101 - a diagram is in a figure
    figure.set_layout_engine(None)
    _place(axes, margins / figure.get_size_inches())


def _place(axes: Axes, margins: Float2D) -> None:
    """Place a diagram; margins (2, 2) left and bottom, right and top, as shares of the figure."""
    (left, bottom), (right, top) = margins
    axes.set_position((left, bottom, max(1.0 - left - right, 0.05), max(1.0 - bottom - top, 0.05)))


def drawable(text: str, limit: int = 22) -> str:
    """Return a name as a figure can show it: short, and a box for every character the fonts do not have."""
    kept = "".join(
        c if c.isprintable() and any(font.get_char_index(ord(c)) for font in _fonts()) else "□" for c in text
    )
    return kept if len(kept) <= limit else kept[: limit - 1] + "…"


def plain_numbers(axis: Axis, subs: Sequence[float] = (1.0,)) -> None:
    """Write the numbers of a logarithmic axis in full: powers of ten are formulae, which these fonts do not set.

    Args:
        axis: The axis, logarithmic already.
        subs: Which multiples of powers of ten have a number.
    """
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def thinned(size: Float1D, most: int = MOST_MARKS) -> Int1D:
    """Return the rows to draw: all, or evenly spaced ones together with the tenth that is largest.

    Args:
        size: (m,) what makes a row worth showing.
        most: Number of rows at most.
    """
    rows = len(size)
    if rows <= most:
        return np.arange(rows)
    largest = np.argsort(-size, kind="stable")[: most // 10]
    even = np.linspace(0, rows - 1, most - len(largest)).astype(np.int64)
    return np.unique(np.concatenate([even, largest]))


@functools.cache
def _fonts() -> tuple[FT2Font, ...]:
    return tuple(font_manager.get_font(font_manager.findfont(name)) for name in _FONTS)
