"""How uncertain predicted readings are: by the model's numbers, by the wrench, and by the robot's repeatability."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.statistics import beyond_noise
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.named_values import with_values
from calibration_core.model.parameters import ModelParameters
from calibration_core.observations.average import wrench_covariance
from calibration_core.timeseries import Float2D, Float3D, Readings

OFF = 2.0  # times the uncertainty: positions that are off in half of the configurations, not in one that was disturbed
SAME_LOAD = 0.02  # of the largest load: steps so near to each other repeat a load


def model_columns(
    readings: Readings,
    cell: Cell,
    parameters: ModelParameters,
    estimate: GaussianEstimate | None,
    frame: Float3D | None,
) -> tuple[GaussianEstimate, Float3D]:
    """Return what is known of the model with limits, and (m, 3, p) how the predictions move with it, per unit.

    Central differences over one standard deviation.  With a frame that is fitted, (m, 3, 6), what a rigid movement of
    all points takes up is taken off.
    """
    m = len(readings)
    std = np.zeros(0) if estimate is None else estimate.std
    known = GaussianEstimate.nothing() if estimate is None else estimate.chosen(
        np.flatnonzero(np.isfinite(std) & (std > 0))
    )  # fmt: skip
    columns = np.zeros((m, 3, len(known.names)))
    for k, (name, value, step) in enumerate(zip(known.names, known.value, known.std, strict=True)):
        ends = [
            predict_readings(readings, cell, with_values(parameters, {name: value + sign * step}))
            for sign in (1.0, -1.0)
        ]
        columns[:, :, k] = (ends[0] - ends[1]) / (2 * step)
    if frame is not None:
        basis, _ = np.linalg.qr(frame.reshape(-1, 6))
        flat = columns.reshape(3 * m, -1)
        columns = (flat - basis @ (basis.T @ flat)).reshape(columns.shape)
    return known, columns


def propagated(known: GaussianEstimate, columns: Float3D, chosen: Callable[[str], bool]) -> Float3D:
    """Return what is not known of some of the model's numbers, by their group, in the predictions, (m, 3, 3) m^2."""
    rows = [k for k, name in enumerate(known.names) if chosen(name.partition(".")[0])]
    part, covariance = columns[:, :, rows], known.covariance[np.ix_(rows, rows)]
    return np.asarray(part @ covariance @ np.swapaxes(part, 1, 2))


def by_wrench(readings: Readings, cell: Cell, parameters: ModelParameters) -> Float3D:
    """Return what the noise of the wrench does to the predictions, by central differences."""
    m = len(readings)
    if readings.wrench is None:
        return np.zeros((m, 3, 3))
    covariance = wrench_covariance(readings, cell)
    columns = np.zeros((m, 3, 6))
    for k in range(6):
        step = np.zeros((m, 6))
        step[:, k] = np.sqrt(covariance[:, k, k])
        if not step.any():
            continue
        ends = [
            predict_readings(dataclasses.replace(readings, wrench=readings.wrench + sign * step), cell, parameters)
            for sign in (1.0, -1.0)
        ]
        columns[:, :, k] = (ends[0] - ends[1]) / 2
    scale = np.sqrt(np.einsum("mkk->mk", covariance))
    scale = np.where(scale > 0, scale, 1.0)
    correlation = covariance / (scale[:, :, None] * scale[:, None, :])
    return np.asarray(np.einsum("mak,mkl,mbl->mab", columns, correlation, columns))


def repeatability(readings: Readings, error: Float2D, tracker: Float3D) -> Float3D:
    """Return the robot's scatter at repeated loads beyond the tracker's, (m, 3, 3) m^2; zeros where none was repeated.

    Repeated are steps of one configuration and point whose wrenches differ by less than 2 % of the largest.
    """
    none = np.zeros((len(readings), 3, 3))
    if readings.wrench is None:
        return none
    largest = np.linalg.norm(readings.wrench[:, :3], axis=1).max(initial=0.0)
    if largest == 0.0:
        return none
    level = np.round(readings.wrench[:, :3] / (SAME_LOAD * largest)).astype(np.int64)
    keys = np.column_stack([readings.configuration, readings.point, level])
    _, group, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    group = group.reshape(-1)
    repeated = count[group] > 1
    freedom = int(np.sum(count[count > 1] - 1))
    if freedom == 0:
        return none
    mean = np.stack([np.bincount(group, weights=error[:, k]) / count for k in range(3)], axis=1)
    scatter = float(np.sum((error - mean[group])[repeated] ** 2)) / (3 * freedom)
    noise = float(np.mean(np.trace(tracker[repeated], axis1=1, axis2=2))) / 3
    return none + max(scatter - noise, 0.0) * np.eye(3)


def less_offsets(readings: Readings, error: Float2D, columns: Float3D) -> tuple[Float2D, Float3D, int]:
    """Return errors and columns less their means over each configuration and point, and how many of these there are."""
    _, group = np.unique(np.column_stack([readings.configuration, readings.point]), axis=0, return_inverse=True)
    group = group.reshape(-1)
    count = int(group.max()) + 1
    share = np.zeros((count, len(group)))
    share[group, np.arange(len(group))] = 1.0 / np.bincount(group)[group]
    return error - (share @ error)[group], columns - np.einsum("gm,mak->gak", share, columns)[group], count


def weighted_square(error: Float2D, noise: Float3D, known: GaussianEstimate, columns: Float3D) -> float:
    """Return e' S^-1 e of errors (m, 3) m with S = noise + columns covariance columns' (matrix inversion lemma)."""
    weight = np.linalg.inv(noise)
    weighted = np.einsum("mab,mb->ma", weight, error)
    square = float(np.sum(weighted * error))
    if not known.names:
        return square
    scale = known.std
    scaled = columns * scale
    gradient = np.einsum("mak,ma->k", scaled, weighted)
    normal = np.einsum("mak,mab,mbl->kl", scaled, weight, scaled, optimize=True)
    correlation = known.covariance / np.outer(scale, scale)
    taken = np.linalg.solve(np.eye(len(scale)) + correlation @ normal, correlation @ gradient)
    return max(square - float(gradient @ taken), 0.0)


def only_positions_off(
    readings: Readings, error: Float2D, noise: Float3D, known: GaussianEstimate, columns: Float3D
) -> bool:
    """Say whether positions are off in most configurations, while the differences within each are as they should be.

    Args:
        readings: The recording.
        error: (m, 3) m, of the positions.
        noise: (m, 3, 3) m^2 of one reading.
        known: What is known of the model with limits.
        columns: (m, 3, p): how the predictions move with it.
    """
    allowed = np.einsum("maa->m", noise + propagated(known, columns, lambda _: True))
    _, place = np.unique(readings.configuration, return_inverse=True)
    square = np.bincount(place, np.sum(error**2, axis=1)) / np.bincount(place, allowed)
    error, columns, groups = less_offsets(readings, error, columns)
    freedom = 3 * (len(readings) - groups)
    if readings.wrench is None or not readings.wrench.any() or freedom < 1 or np.median(square) < OFF**2:
        return False
    return not beyond_noise(float(np.sqrt(weighted_square(error, noise, known, columns) / freedom)), freedom, 1.0)[1]
