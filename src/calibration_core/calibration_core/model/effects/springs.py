"""Rotary springs about a joint's axes: what several structural effects are made of."""

from __future__ import annotations

import numpy as np

from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float1D, Float2D, Float3D

X, Y, Z = 0, 1, 2


def before_joint(state: State, joint: int, axis: int) -> Float2D:
    """Return the (m, 3) column of a spring about an axis of the frame before a joint."""
    return state.spring_column(state.at.before[joint][axis], state.at.origin[joint])


def after_joint(state: State, joint: int, axis: int) -> Float2D:
    """Return the (m, 3) column of a spring about an axis of the link's body frame behind a joint."""
    return state.spring_column(state.at.body[joint][axis], state.at.origin[joint])


def along_link(state: State, link: int, axis: Float2D, tip: Float2D) -> Float2D:
    """Return the (m, 3) column of springs spread evenly between a link's joint and its tip, per unit of 1/EI or 1/GJ.

    Integral over the link of spring columns about `axis`; three Gauss points are exact, the integrand being quadratic
    in the position.

    Args:
        state: The loaded robot.
        link: Index of the joint where the link begins.
        axis: (3, m) unit vectors, base axes.
        tip: (3, m) m, where it ends.
    """
    start = state.at.origin[link]
    length = np.linalg.norm(tip - start, axis=0)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    total = np.zeros((state.m, 3))
    for node, weight in zip(nodes, weights, strict=True):
        at = start + (node + 1) / 2 * (tip - start)
        total += weight / 2 * length[:, None] * state.spring_column(axis, at)
    return total


def stacked(*columns: Float2D) -> Float3D:
    """Return (m, 3, k) from k columns (m, 3)."""
    return np.stack(columns, axis=-1)


def largest(values: Float1D) -> float:
    """Return the largest absolute value, at least a tiny number, so that it can divide."""
    return max(float(np.abs(values).max(initial=0.0)), 1e-12)
