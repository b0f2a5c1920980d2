"""How large what readings share is: found by likelihood, with the catalogue's effects free to be there a little."""

from __future__ import annotations

import itertools

import numpy as np

from calibration_core.cell import Cell
from calibration_core.estimation.hypotheses import WAVE, Offered
from calibration_core.estimation.likelihood.restricted import Gram, fit_sizes
from calibration_core.estimation.noise.whitening import Strata, Whitening, whiten
from calibration_core.estimation.rows import NullModel, weighted
from calibration_core.estimation.shifts import FAMILY
from calibration_core.model.effects import effect_named
from calibration_core.model.effects.applied import largest
from calibration_core.model.effects.candidate import number_of, typical
from calibration_core.model.effects.joint_law.hysteresis import stop
from calibration_core.model.effects.recordings import each_recording
from calibration_core.model.effects.state import State
from calibration_core.observations.average import wrench_covariance
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D, in_time

SHARED = (0.0, 0.5, 1.0, 1.5)  # of the own noise: slow tracker noise, common to the points of a step
OFFSETS = (0.0, 0.5, 2.0, 8.0, 30.0)  # of the own noise
SIMPLE = 2  # parameters of a form that may be there a little
BEGIN = (0.0, 2.0)
LOW = 2  # orders of transmissions that may be there a little


def strata_of(model: NullModel, rows: Int1D) -> Strata:
    """Return which of some readings share what."""
    readings = model.readings.select(rows)
    configuration = in_time(readings.configuration)
    wrench = None if model.problem.load is None else _wrench(model, model.cell)[rows]
    return Strata(configuration, readings.step, readings.point, wrench)


def fit_whitening(strata: Strata, residual: Float1D, flat: Float2D, columns: Float2D, offered: Offered) -> Whitening:
    """Return the whitening at the most probable sizes, by one coordinate after the other.

    Args:
        strata: Which rows share what.
        residual: (3 r,) in units of the claimed noise.
        flat: (3 r, f) columns of the null model.
        columns: (3 r, p) columns of all candidates.
        offered: What they are.
    """
    blocks = _a_little(offered)
    index = np.concatenate(blocks)
    some, renumbered = columns[:, index], _renumbered(blocks)
    flat = flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
    tried: dict[tuple[float, float], tuple[float, Whitening]] = {}

    def value(shared: float, offset: float) -> float:
        if (shared, offset) not in tried:
            whitening = whiten(strata, shared, offset)
            tried[shared, offset] = _likelihood(whitening, residual, flat, some, renumbered), whitening
        return tried[shared, offset][0]

    shared, offset = BEGIN[0], BEGIN[1] if strata.points_repeated else 0.0
    if strata.points_repeated:
        offset = max(OFFSETS, key=lambda size: value(shared, size))
    if strata.steps_shared:
        shared = max(SHARED, key=lambda size: value(size, offset))
        if shared > 0 and strata.points_repeated:
            offset = max(OFFSETS, key=lambda size: value(shared, size))
    value(shared, offset)
    return tried[shared, offset][1]


def _likelihood(whitening: Whitening, residual: Float1D, flat: Float2D, columns: Float2D, blocks: list[Int1D]) -> float:
    white = whitening(np.column_stack([flat, columns, residual]))
    f = flat.shape[1]
    u, s, _ = np.linalg.svd(white[:, :f], full_matrices=False)
    basis = u[:, s > 1e-7 * s[0]]
    left = white[:, f:] - basis @ (basis.T @ white[:, f:])
    gram = left.T @ left
    condensed = Gram(gram[:-1, :-1], gram[:-1, -1], float(gram[-1, -1]), len(white) - basis.shape[1])
    return (
        fit_sizes(condensed, blocks).value - 0.5 * whitening.log_determinant - float(np.log(s[s > 1e-7 * s[0]]).sum())
    )


def _a_little(offered: Offered) -> list[Int1D]:
    """Return the columns of low waves, and of the simplest form of every other effect at every place."""
    waves: list[Int1D] = []
    others: dict[object, Int1D] = {}
    for candidate, block in zip(offered.candidates, offered.blocks, strict=True):
        columns = np.arange(block.start, block.stop)
        if candidate.effect == WAVE:
            if number_of(candidate) <= LOW:
                waves.append(columns)
        elif candidate.family != FAMILY and len(columns) < len(others.get(candidate.place, range(SIMPLE + 1))):
            others[candidate.place] = columns
    return [np.concatenate(several) for several in (waves, list(others.values())) if several]


def _renumbered(blocks: list[Int1D]) -> list[Int1D]:
    ends = np.cumsum([0, *(len(block) for block in blocks)])
    return [np.arange(first, last) for first, last in itertools.pairwise(ends)]


def _wrench(model: NullModel, cell: Cell) -> Float2D:
    """Return what one standard deviation of every wrench reading moves, (m, 3, 6), in units of the own noise."""
    values, vectors = np.linalg.eigh(wrench_covariance(model.readings, cell))
    root = vectors * np.sqrt(np.clip(values, 0.0, None))[:, None, :]
    moved = model.state.by_wrench @ root
    return weighted(model.problem, model.parameters, moved).reshape(len(model.readings), 3, 6)


LAG_RADIUS = 0.3  # of the largest load: change after which a sensor's lag has turned over
SENSOR_MOUNTING = 5.0  # times better a tracker is registered than a sensor is screwed on


def usual_errors(state: State) -> Float3D:
    """Return (m, 3, k) movements of the points, each for one standard deviation of what is usual, m."""
    if not state.loaded:
        return np.zeros((state.m, 3, 0))
    return np.concatenate([each_recording(sensor_lag, state), each_recording(sensor_mounting, state)], axis=2)


def sensor_lag(state: State) -> Float3D:
    """Return (m, 3, 6) what the lag of every axis of the sensor moves, m."""
    share = typical("wrench_hysteresis", state.rated_load)
    force = largest(np.linalg.norm(state.wrench[:, :3], axis=1))
    torque = largest(np.linalg.norm(state.wrench[:, 3:], axis=1))
    columns = []
    for axis in range(6):
        values = state.wrench[:, axis]
        span = force if axis < 3 else torque
        lag = state.along_steps(values, lambda v, span=span: stop(v, LAG_RADIUS * span, 0.0))  # type: ignore[misc]
        columns.append(state.by_wrench[:, :, axis] * (share * lag / LAG_RADIUS)[:, None])
    return np.stack(columns, axis=-1)


def sensor_mounting(state: State) -> Float3D:
    """Return (m, 3, 3) what a turn of the sensor's mounting moves, m."""
    turned = effect_named("wrench_frame_misalignment")
    size = typical("registration_rotation", state.rated_load) * SENSOR_MOUNTING
    return np.concatenate([candidate.columns(state) * size for candidate in turned.candidates(state)], axis=2)
