"""Where a robot is soft: a map of deflections over a plane."""

from __future__ import annotations

import numpy as np

from calibration_core.report.figures.style import WIDTH, drawing
from calibration_core.timeseries import Float1D, Float2D


def map_figure(across: Float1D, up: Float1D, size: Float2D, plane: str) -> bytes:
    """Draw deflections (mm), (rows up, columns across), NaN where there are none, over a plane (m)."""
    span = (np.ptp(across), np.ptp(up))
    with drawing(min(4.8, 0.8 * WIDTH * float(span[1] / span[0]) + 0.6), 0.8 * WIDTH) as (figure, buffer):
        axes = figure.add_subplot()
        drawn = axes.pcolormesh(
            across, up, np.ma.masked_invalid(size), shading="nearest", cmap="viridis", rasterized=False
        )
        axes.set(xlabel=f"{plane[0]} [m]", ylabel=f"{plane[1]} [m]", aspect="equal")
        figure.colorbar(drawn, ax=axes, label="deflection [mm]")
    return buffer.getvalue()
