"""Arm and wrist apart: stiffnesses through the wrist centre point (CWA 17384, 5.2).

The axes of the wrist meet in the wrist centre, so its displacement is the arm's alone: three equations a step for the
arm's joints.  The rotation of the tool, less what the arm's joints turn, is the wrist's: three more.  The joint
identification uses the same readings at once and is never less precise; that both agree within what they can differ
by chance is a test of the model.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.result.estimate import Decoupled, Identification
from calibration_core.identification.statistics import LEVEL, Rows, chi2_limit
from calibration_core.identification.stiffness.fit import as_poses
from calibration_core.identification.stiffness.loaded import (
    Options,
    PreparedLoaded,
    identify_prepared,
    prepare_loaded,
)
from calibration_core.identification.wrist import WRIST
from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import Posture, cross, posture
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D, Readings

MEETS = 5e-3  # m: how far the wrist axes may pass by the wrist centre; their share in its displacement is subtracted
PARALLEL = 1e-3  # sine of the angle between the last two axes
SINGULAR = 1e-8  # inverse condition number of the scaled normal matrix
ITERATIONS = 3  # the equilibrium is nearly linear in the compliances
DISTINGUISHED = 1e-4  # variance of a difference, in units of the joint estimate's, below which it is rounding


def identify_loaded(readings: Readings, cell: Cell, options: Options, test: Readings | None = None) -> Identification:
    """Identify from the differences between loaded and unloaded steps alone, with arm and wrist apart beside it.

    Raises:
        InputError: As `prepare_loaded`.
    """
    prepared = prepare_loaded(readings, cell, options)
    return with_decoupled(identify_prepared(prepared, cell, options, test), prepared)


def with_decoupled(
    found: Identification, prepared: PreparedLoaded, wrist_centre: Float1D | None = None
) -> Identification:
    """Return the answer with arm and wrist identified apart as well, or with the reason why they are not."""
    try:
        return dataclasses.replace(found, decoupled=identify_decoupled(prepared, found.noise.scale, wrist_centre))
    except IdentificationError as error:
        return dataclasses.replace(found, not_decoupled=str(error))


def identify_decoupled(prepared: PreparedLoaded, scale: float, wrist_centre: Float1D | None = None) -> Decoupled:
    """Identify arm and wrist apart.

    An error of the wrist centre has no effect to first order: residuals and columns belong to the point taken, and the
    wrist's own share in its displacement is subtracted as it is known.

    Args:
        prepared: The loaded recording, fitted.
        scale: Factor on the standard deviations after the noise audit.
        wrist_centre: (3,) m, flange frame, as measured (7.3); None: from the geometry.

    Raises:
        IdentificationError: No three points, a wrist whose axes do not meet, or joints that cannot be distinguished.
    """
    problem = prepared.problem.select(np.flatnonzero(prepared.rejection.used))
    path, chain, n = problem.readings.provenance.path, problem.chain, problem.chain.n
    if n <= WRIST:
        raise IdentificationError(path, "joints", f"{n}", f"more than {WRIST}: an arm that carries a wrist")
    if not chain.wrist_apart(WRIST):
        raise IdentificationError(path, "joints", "mimic joints in the wrist", "last three joints that move alone")
    centre = wrist_centre_of(chain) if wrist_centre is None else wrist_centre
    off = np.inf if centre is None else _passing(posture(chain, problem.readings.q), centre)
    if centre is None or off > MEETS:
        found = "last axes that are parallel" if centre is None else f"axes that pass it by {1e3 * off:.2g} mm"
        raise IdentificationError(path, "wrist centre", found, f"last three axes that meet to {1e3 * MEETS:g} mm")

    def displacements(compliance: Float1D) -> tuple[Rows, Float2D, Float3D]:
        return as_poses(problem, problem.linearise(compliance), problem.rest(compliance).at.point(centre).T)

    apart = together = prepared.parameters.compliance
    for _ in range(ITERATIONS):
        rows, residual, columns = displacements(apart)
        apart = apart + _applied(_separate(rows, columns, n - WRIST, path), residual)
        rows, residual, columns = displacements(together)
        together = together + _applied(_gains(rows, columns, path), residual)
    rows, _, columns = displacements(apart)
    spread = _errors(rows, _separate(rows, columns, n - WRIST, path))
    rows, _, columns = displacements(together)
    joint = _errors(rows, _gains(rows, columns, path))
    between = scale * (spread - joint)
    chi2, freedom = _distance(apart - together, between @ between.T, scale * np.linalg.norm(joint, axis=1))
    return Decoupled(
        joints=chain.joints,
        arm=n - WRIST,
        compliance=apart,
        covariance=scale**2 * spread @ spread.T,
        together=together,
        difference_std=np.linalg.norm(between, axis=1),
        chi2=chi2,
        freedom=freedom,
        limit=chi2_limit(LEVEL, freedom) if freedom else 0.0,
        wrist_centre=centre,
        measured=wrist_centre is not None,
    )


def wrist_centre_of(chain: Chain) -> Float1D | None:
    """Return the point of the last axis that is nearest to the axis before it, (3,) m, flange frame.

    None where the two are parallel.
    """
    at = posture(chain, np.zeros((1, chain.n)))
    (first, second), (here, there) = (
        [at.axis(joint)[:, 0] for joint in (chain.n - 1, chain.n - 2)],
        [at.origin[joint][:, 0] for joint in (chain.n - 1, chain.n - 2)],
    )
    c = float(first @ second)
    if 1 - c**2 < PARALLEL**2:
        return None
    between = there - here
    foot = here + first * (between @ first - c * (between @ second)) / (1 - c**2)
    return np.asarray(at.flange[:, :, 0] @ (foot - at.flange_origin[:, 0]))


def _passing(at: Posture, centre: Float1D) -> float:
    """Return the largest distance of the wrist axes from a point in the flange frame, m."""
    place, n = at.point(centre), len(at.origin)
    arms = [cross(at.axis(joint), place - at.origin[joint]) for joint in range(n - WRIST, n)]
    return float(max(np.linalg.norm(arm, axis=0).max() for arm in arms))


Gains = list[
    tuple[Int1D, Float3D]
]  # rows (b, m) of configurations of equal shape, and what they add up with (b, k, m d)


def _gains(rows: Rows, columns: Float3D, path: str) -> Gains:
    """Return the best linear unbiased estimator of the parameters of `columns`, (s, d, k), offsets left free.

    Raises:
        IdentificationError: The rows do not determine every parameter.
    """
    k, parts, matrix = columns.shape[2], [], np.zeros((columns.shape[2], columns.shape[2]))
    for _, index, white in rows.contrasts:
        design = white @ columns[index].reshape(len(index), white.shape[2], k)
        matrix += np.einsum("brk,brl->kl", design, design)
        parts.append((index, np.swapaxes(design, 1, 2) @ white))
    size = np.sqrt(np.diag(matrix))
    if not np.all(size > 0) or np.linalg.cond(matrix / np.outer(size, size)) > 1 / SINGULAR:
        raise IdentificationError(
            path, "configuration", "joints whose loads cannot be distinguished", "more configurations"
        )
    inverse = np.linalg.inv(matrix / np.outer(size, size)) / np.outer(size, size)
    return [(index, inverse @ part) for index, part in parts]


def _separate(rows: Rows, columns: Float3D, arm: int, path: str) -> Gains:
    """Return the estimator of the arm from translations and, with the arm known, of the wrist from rotations."""
    shifts, turns = (
        Rows(rows.configuration, rows.offset, rows.load, rows.noise[:, part, part], rows.shared[:, part])
        for part in (slice(0, 3), slice(3, 6))
    )
    of_arm = _gains(shifts, columns[:, :3, :arm], path)
    of_wrist = _gains(turns, columns[:, 3:, arm:], path)
    from_arm = sum(
        np.einsum("bkx,bxl->kl", gain, columns[index, 3:, :arm].reshape(len(index), -1, arm))
        for index, gain in of_wrist
    )
    result = []
    for (index, first), (_, second) in zip(of_arm, of_wrist, strict=True):
        b, m = index.shape
        gain = np.zeros((b, columns.shape[2], m, 6))
        gain[:, :arm, :, :3] = first.reshape(b, arm, m, 3)
        gain[:, arm:, :, :3] = -np.einsum("kl,blmx->bkmx", from_arm, gain[:, :arm, :, :3])
        gain[:, arm:, :, 3:] = second.reshape(b, -1, m, 3)
        result.append((index, gain.reshape(b, columns.shape[2], m * 6)))
    return result


def _applied(gains: Gains, residual: Float2D) -> Float1D:
    return np.asarray(
        sum(np.einsum("bkx,bx->k", gain, residual[index].reshape(len(index), -1)) for index, gain in gains)
    )


def _errors(rows: Rows, gains: Gains) -> Float2D:
    """Return (k, r): the estimator's errors in terms of independent ones of unit variance (those of the contrasts)."""
    parts = []
    for (_, _, white), (_, gain) in zip(rows.contrasts, gains, strict=True):
        turned = np.swapaxes(white, 1, 2)
        independent = np.swapaxes(np.linalg.solve(white @ turned, white @ np.swapaxes(gain, 1, 2)), 1, 2)
        parts.append(np.moveaxis(independent, 0, 1).reshape(gain.shape[1], -1))
    return np.concatenate(parts, axis=1)


def _distance(difference: Float1D, covariance: Float2D, unit: Float1D) -> tuple[float, int]:
    """Return chi-square of a difference and its degrees of freedom; directions without a difference are left out."""
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    kept = values > DISTINGUISHED
    projected = vectors[:, kept].T @ (difference / unit)
    return float(np.sum(projected**2 / values[kept])), int(kept.sum())
