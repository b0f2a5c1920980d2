"""The figures of a plant, each a pure function to SVG."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from calibration_core.fleet.plant import JointState
from calibration_core.report.figures.style import ACCENT, GREY, INK, drawable, drawing

MARK: dict[str, Any] = {"linestyle": "none", "markersize": 3.0, "markerfacecolor": "none", "markeredgewidth": 0.5}
NAMED = 6  # outliers of a joint that are named
BAND = 0.32  # half height of a row of marks, of the distance between joints
REACH = 60.0  # %, how far the axis reaches at most


def distribution_figure(states: Sequence[JointState]) -> bytes:
    """Draw the stiffness of every joint of all robots of a type, relative to their median; outliers by name.

    Args:
        states: Stiffnesses of the robots of one type.
    """
    joints = list(dict.fromkeys(state.joint for state in states))
    with drawing(0.9 + 0.42 * len(joints)) as (figure, buffer):
        axes = figure.subplots()
        for row, joint in enumerate(joints):
            members = [state for state in states if state.joint == joint]
            value = np.array([state.raw for state in members])
            middle = float(np.median(value))
            share = 100 * (value / middle - 1)
            # Marks of one joint stand apart by a fixed pattern, the same for the same data.
            height = row + BAND * (2 * ((np.arange(len(members)) * 0.618034) % 1.0) - 1)
            fits = np.array([state.belongs for state in members])
            axes.plot(np.clip(share[fits], -REACH, REACH), height[fits], "o", color=GREY, **MARK)
            axes.plot(np.clip(share[~fits], -REACH, REACH), height[~fits], "D", color=ACCENT, **MARK)
            odd = sorted(np.flatnonzero(~fits), key=lambda k: -abs(share[k]))[:NAMED]
            for k in odd:
                place = (float(np.clip(share[k], -REACH, REACH)), float(height[k]))
                axes.annotate(drawable(members[k].robot), place, xytext=(3, 2), textcoords="offset points", fontsize=7)
        axes.axvline(0, color=INK, linewidth=0.6, zorder=0)
        axes.set_yticks(range(len(joints)), [drawable(joint) for joint in joints])
        axes.set_ylim(len(joints) - 0.5, -0.5)
        axes.set_xlabel("stiffness relative to the median of the type [%]")
    return buffer.getvalue()


def percent(spread: float) -> str:
    """Return a spread of logarithms in words: the percentage that it means."""
    return f"{100 * math.expm1(spread):.2g} %"
