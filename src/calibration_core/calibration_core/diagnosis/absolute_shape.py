"""The triangle of a gravity compensator, refitted where one may be.

The catalogue offers a few shapes.  By what the true one differs is a wave over the joint's angle, which a transmission
error of the same joint would explain, and several orders together imitate the whole spring.  The shape is therefore
fitted without such waves, which are judged beside it anew.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import least_squares

from calibration_core.diagnosis.absolute_design import AbsoluteDesign
from calibration_core.diagnosis.absolute_evidence import orthonormal
from calibration_core.model.effects import candidates
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.gravity_compensator import Triangle, carriers, pull, spring, triangle_of
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float1D, Float2D, Float3D

REACH = 30.0  # degrees about the offered anchor
LEAST, MOST = 0.05, 0.9  # of flatness and preload
SCALE = (5.0, 0.1, 0.1)  # of anchor, flatness and preload
NO_WORSE = 0.02  # of the squared error on blocks left out
STARTS = 4  # shapes of the catalogue from which the best one is sought
STEPS = 20  # at most, from each


def sharpened(
    build: Callable[[tuple[Candidate, ...]], AbsoluteDesign],
    weigh: Callable[[Float3D], Float2D],
    state: State,
    others: Sequence[Candidate],
) -> Candidate:
    """Return a compensator with the shape that explains most beside others.

    Args:
        build: Sets up the linear model for given hypotheses.
        weigh: Turns movements (m, 3, k) of all readings into the model's columns (3 s, k).
        state: All readings' state.
        others: Hypotheses that are part of the model.
    """
    design = build(tuple(others))
    basis = orthonormal(design.of(range(len(others))))
    residual = design.residual - basis @ (basis.T @ design.residual)

    joint = carriers(state)[0]

    def left(x: Float1D) -> Float1D:
        column = weigh(pull(state, joint, Triangle(*x))[:, :, :1])[:, 0]
        column = column - basis @ (basis.T @ column)
        return np.asarray(residual - column * (column @ residual) / (column @ column))

    name = state.chain.joints[joint]
    offered = [triangle_of(c.variant) for c in candidates(state) if is_spring(c) and c.location["joint"] == name]
    starts = [np.array([shape.anchor, shape.flatness, shape.preload]) for shape in offered if shape is not None]
    starts.sort(key=lambda x: float(np.sum(left(x) ** 2)))
    fits = [least_squares(left, x, bounds=_around(x), x_scale=SCALE, max_nfev=STEPS) for x in starts[:STARTS]]
    best = min(fits, key=lambda fit: float(fit.cost))
    return spring(state, joint, Triangle(*map(float, best.x)))


def _around(start: Float1D) -> tuple[list[float], list[float]]:
    return [float(start[0]) - REACH, LEAST, LEAST], [float(start[0]) + REACH, MOST, MOST]


def is_spring(candidate: Candidate) -> bool:
    """Return whether a hypothesis is a compensator's torque of some shape."""
    return candidate.effect == "gravity_compensator" and triangle_of(candidate.variant) is not None


def by_kind(
    chosen: Sequence[Candidate], state: State
) -> tuple[tuple[Candidate, ...], tuple[Candidate, ...], tuple[Candidate, ...]]:
    """Return springs, waves of the joint that a spring would help, and all others."""
    helped = {state.chain.joints[joint] for joint in carriers(state)}
    springs = tuple(c for c in chosen if is_spring(c))
    waves = tuple(c for c in chosen if c.effect == "transmission_error" and c.location["joint"] in helped)
    return springs, waves, tuple(c for c in chosen if c not in springs and c not in waves)


def spring_is_better(squares: Sequence[float], counts: Sequence[int], *, first: bool) -> bool:
    """Say whether a search that begins with a spring ends better than one that begins with waves.

    What predicts blocks left out better is believed; where neither does, what has fewer parameters; where these are as
    many, what an open search had taken.

    Args:
        squares: Squared error on blocks left out, of the spring's search and of the waves'.
        counts: Parameters of both.
        first: Whether an open search had taken a spring.
    """
    ratio = squares[0] / squares[1]
    if abs(ratio - 1) > NO_WORSE:
        return ratio < 1
    return first if counts[0] == counts[1] else counts[0] < counts[1]
