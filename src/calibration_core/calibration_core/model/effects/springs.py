"""Rotary springs about given axes: what several structural effects are made of."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float1D, Float2D, Float3D


def tilting(state: State, axes: tuple[Float2D, Float2D], origin: Float2D) -> Float3D:
    """Return (m, 3, 3) columns of an elastic hinge about two axes: its two compliances, and the one between them.

    The third, theta_1 = C_12 tau_2 and theta_2 = C_12 tau_1, turns the principal directions.

    Args:
        state: The loaded robot.
        axes: (3, m) unit vectors each, base axes.
        origin: (3, m) m.
    """
    first, second = axes
    of_first, of_second = state.spring_torque(first, origin), state.spring_torque(second, origin)
    crossed = state.rotation_column(first, origin, of_second) + state.rotation_column(second, origin, of_first)
    own = (state.spring_column(axis, origin) for axis in axes)
    return stacked(*own, crossed)


def along_link(state: State, link: int, tip: Float2D, column: Callable[[Float2D], Float3D]) -> Float3D:
    """Return the (m, 3, k) columns of springs spread evenly between a link's joint and its tip, per unit of length.

    Integral over the link; three Gauss points are exact, the integrand being quadratic in the position.

    Args:
        state: The loaded robot.
        link: Index of the joint where the link begins.
        tip: (3, m) m, where it ends.
        column: Place (3, m) m -> columns (m, 3, k) of the springs there.
    """
    start = state.at.origin[link]
    length = np.linalg.norm(tip - start, axis=0)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    places = [start + (node + 1) / 2 * (tip - start) for node in nodes]
    parts = [weight / 2 * length[:, None, None] * column(at) for weight, at in zip(weights, places, strict=True)]
    return np.sum(parts, axis=0)


def stacked(*columns: Float2D) -> Float3D:
    """Return (m, 3, k) from k columns (m, 3)."""
    return np.stack(columns, axis=-1)


def largest(values: Float1D) -> float:
    """Return the largest absolute value, at least a tiny number, so that it can divide."""
    return max(float(np.abs(values).max(initial=0.0)), 1e-12)
