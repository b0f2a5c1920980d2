"""Virtual joints with springs about given axes: what several structural effects are made of."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from calibration_core.model.effects.state import State
from calibration_core.model.kinematics import dot
from calibration_core.model.statics import centres_of_mass
from calibration_core.model.virtual_joints import Cut, before_joint, behind_joint, rotation_twist, translation_twist
from calibration_core.timeseries import Float1D, Float2D, Float3D

NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)  # exact up to the fifth degree


def turning(state: State, cut: Cut, axis: Float2D, origin: Float2D) -> Float2D:
    """Return the (m, 3) movement per unit compliance, rad/(N*m), of a spring about an axis through a point."""
    return state.virtual.column(cut, rotation_twist(axis, origin))


def sliding(state: State, cut: Cut, axis: Float2D) -> Float2D:
    """Return the (m, 3) movement per unit compliance, m/N, of a spring along an axis (3, m)."""
    return state.virtual.column(cut, translation_twist(axis))


def tilting(state: State, cut: Cut, axes: tuple[Float2D, Float2D], origin: Float2D) -> Float3D:
    """Return (m, 3, 3) columns of an elastic hinge about two axes: its two compliances, and the one between them.

    The third, theta_1 = C_12 tau_2 and theta_2 = C_12 tau_1, turns the principal directions.

    Args:
        state: The loaded robot.
        cut: Where the hinge sits.
        axes: (3, m) unit vectors each, base axes.
        origin: (3, m) m.
    """
    first, second = (rotation_twist(axis, origin) for axis in axes)
    virtual = state.virtual
    crossed = virtual.column(cut, first, second) + virtual.column(cut, second, first)
    return stacked(virtual.column(cut, first), virtual.column(cut, second), crossed)


def along_link(
    state: State,
    link: int,
    ends: tuple[Float2D, Float2D],
    column: Callable[[Cut, Float2D], Float3D],
    *,
    own_weight: bool = True,
) -> Float3D:
    """Return the (m, 3, k) columns of springs spread evenly between the two ends of a link, per unit of length.

    The weight of the link itself acts at its centre of gravity: sections before it bear it, those behind do not.
    Integral over both parts; three Gauss points each are exact, the integrands being quadratic in the position.

    Args:
        state: The loaded robot.
        link: Index of the joint that carries the link.
        ends: (3, m) m each, where it begins and ends.
        column: Cut and place (3, m) m -> columns (m, 3, k) of the springs there.
        own_weight: Whether the link bears its own weight; False: it rests on the link's joint.
    """
    start, tip = ends
    span = tip - start
    length = np.linalg.norm(span, axis=0)
    centre = _share_before_centre(state, link, start, span) if own_weight else np.zeros(state.m)
    stage = state.chain.stage(link)
    parts = (behind_joint(stage), np.zeros(state.m), centre), (before_joint(stage + 1), centre, np.ones(state.m))
    total = []
    for cut, begin, end in parts:
        if not np.any(end > begin):
            continue
        for node, weight in zip(NODES, WEIGHTS, strict=True):
            place = start + (begin + (node + 1) / 2 * (end - begin)) * span
            total.append((weight / 2 * (end - begin) * length)[:, None, None] * column(cut, place))
    return np.sum(total, axis=0)


def _share_before_centre(state: State, link: int, start: Float2D, span: Float2D) -> Float1D:
    """Return which share of a link lies before its centre of gravity, (m,), 0 to 1; 0 where masses are not known."""
    if state.chain.mass is None:
        return np.zeros(state.m)
    lever = centres_of_mass(state.chain, state.at)[link] - start
    return np.clip(dot(lever, span) / dot(span, span), 0.0, 1.0)


def stacked(*columns: Float2D) -> Float3D:
    """Return (m, 3, k) from k columns (m, 3)."""
    return np.stack(columns, axis=-1)


def largest(values: Float1D) -> float:
    """Return the largest absolute value, at least a tiny number, so that it can divide."""
    return max(float(np.abs(values).max(initial=0.0)), 1e-12)
