"""Zeros of joints that are off by far more than a robot in order has: a mastering that was lost, a wrong encoder."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from calibration_core.timeseries import Bool1D, Float1D

LEAST = 0.01  # rad, ten times what robots in order have
MOST = 0.35  # rad, beyond which it is no zero
STEP = 0.03  # rad, of the first parabola
ROUNDS = 4


@dataclasses.dataclass(frozen=True)
class Zero:
    """The zero of one joint that explains a recording best.

    Attributes:
        joint: Index.
        offset: What is to be added to the recorded angle, rad.
        rest: Sum of squares that stays, m^2.
    """

    joint: int
    offset: float
    rest: float


def best_zero(rest: Callable[[Float1D], float], stands: float, revolute: Bool1D, least: float = LEAST) -> Zero | None:
    """Return the single zero, of `least` to MOST in size, that leaves the least; None where none does better.

    The sum of squares is nearly a parabola in the offset; its lowest point is found by three of its values, again and
    again (successive parabolic interpolation), from both sides.

    Args:
        rest: Sum of squares, m^2, for (n,) rad added to the recorded angles.
        stands: The same for none added.
        revolute: (n,) joints that turn.
        least: rad.
    """
    found = [_lowest(rest, stands, int(joint), len(revolute)) for joint in np.flatnonzero(revolute)]
    better = [zero for zero in found if least <= abs(zero.offset) <= MOST and zero.rest < stands]
    return min(better, key=lambda zero: zero.rest, default=None)


def _lowest(rest: Callable[[Float1D], float], stands: float, joint: int, n: int) -> Zero:
    unit = np.eye(n)[joint]
    at, value, step, move, farthest = 0.0, stands, STEP, 0.0, MOST
    for _ in range(ROUNDS):
        left, right = rest((at - step) * unit), rest((at + step) * unit)
        bend = left - 2 * value + right
        move = 0.5 * step * (left - right) / bend if bend > 0 else step * float(np.sign(left - right))
        farthest = 3 * step
        move = float(np.clip(move, -farthest, farthest))
        there = rest((at + move) * unit)
        if there < value:
            at, value = at + move, there
        step = max(0.3 * abs(move), 1e-3)
        if abs(move) < 2e-4 or abs(at) > MOST:
            break
    if abs(move) >= farthest:  # still on its way: no lowest point was found
        return Zero(joint, 0.0, stands)
    return Zero(joint, at, value)
