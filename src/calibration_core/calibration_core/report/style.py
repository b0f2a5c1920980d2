"""How the figures look: black on white, legible without colour, same bytes for the same data."""

from __future__ import annotations

import functools
import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import font_manager
from matplotlib.figure import Figure
from matplotlib.ft2font import FT2Font

from calibration_core.timeseries import Float1D, Int1D

INK = "#111111"
GREY = "#8a8a8a"
PALE = "#c9c9c9"
ACCENT = "#1f4e79"
AXES = (("x", "o", INK), ("y", "^", ACCENT), ("z", "s", GREY))
"""Name, marker and colour of each Cartesian axis: told apart by shape first."""

WIDTH = 6.7
"""Width of the text, inches."""

MOST_MARKS = 2500
"""Marks drawn in one panel at most; more would only make the file large."""

_FONTS = ["STIXGeneral", "DejaVu Sans"]
_STYLE: Any = {
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
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure, buffer
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})


def drawable(text: str, limit: int = 22) -> str:
    """Return a name as a figure can show it: short, and a box for every character the fonts do not have."""
    kept = "".join(
        c if c.isprintable() and any(font.get_char_index(ord(c)) for font in _fonts()) else "□" for c in text
    )
    return kept if len(kept) <= limit else kept[: limit - 1] + "…"


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
