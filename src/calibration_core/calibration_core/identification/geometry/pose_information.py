"""What a posture tells about frames and geometry, for choosing postures before anything is measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.geometry.fit import AbsoluteProblem, whitened
from calibration_core.identification.geometry.identifiability import candidates, select_frames, select_identifiable
from calibration_core.identification.geometry.terms import PointTerm, Term
from calibration_core.identification.result.estimate import Unidentified
from calibration_core.model.chain import Chain
from calibration_core.model.instruments import tracker_covariance
from calibration_core.model.kinematics import posture
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Float2D, Float3D

JUDGED = 600  # postures by which it is judged what can be told


def pose_problem(chain: Chain, cell: Cell, parameters: ModelParameters, q: Float2D) -> AbsoluteProblem:
    """Return the absolute problem of every measurement point at postures (m, n) rad, point after point.

    The positions are those that the nominal model predicts.
    """
    names, m = tuple(parameters.points), len(q)
    at = posture(chain, q)
    base = np.concatenate([at.point(point) for point in parameters.points.values()], axis=1)
    rotation, origin = parameters.tracker[:3, :3], parameters.tracker[:3, 3:]
    position = rotation.T @ (base - origin)
    root = np.linalg.cholesky(tracker_covariance(cell, position.T))
    whitening = np.moveaxis(np.linalg.inv(root), 0, -1)
    return AbsoluteProblem(
        chain, np.tile(q, (len(names), 1)), position, names, np.repeat(np.arange(len(names)), m), whitening
    )


def geometry_terms(
    chain: Chain, cell: Cell, parameters: ModelParameters, q: Float2D, *, base_known: bool = False
) -> tuple[tuple[Term, ...], tuple[Unidentified, ...]]:
    """Return the terms of frames, points and geometry that postures (m, n) rad can tell, and what they cannot.

    Args:
        chain: The nominal robot.
        cell: The cell.
        parameters: Frames and points.
        q: Postures that can be measured; some of them are judged.
        base_known: Whether the tracker's pose in the base frame is known (CWA 17384, 7.1) and not fitted.
    """
    problem = pose_problem(chain, cell, parameters, q[:: max(len(q) // JUDGED, 1)])
    hidden: tuple[Unidentified, ...] = ()
    if base_known:
        frames: list[Term] = [PointTerm(name, index) for index, name in enumerate(problem.names)]
    else:
        frames, hidden = select_frames(problem, parameters)
    choice = select_identifiable(problem, parameters, frames, candidates(cell))
    return (*frames, choice.term), (*hidden, *choice.unidentified)


def pose_information(
    chain: Chain, cell: Cell, parameters: ModelParameters, q: Float2D, terms: Sequence[Term]
) -> Float3D:
    """Return the Fisher information of the terms' parameters in one reading of all points at each posture, (m, n, n).

    Args:
        chain: The nominal robot.
        cell: The cell, for the tracker's noise.
        parameters: Where the derivatives are taken.
        q: (m, n) rad.
        terms: See `geometry_terms`.
    """
    problem = pose_problem(chain, cell, parameters, q)
    columns, _ = whitened(problem, parameters, terms)  # (n, 3, p m)
    parts = columns.reshape(len(columns), 3, len(problem.names), len(q))
    rows = np.ascontiguousarray(np.moveaxis(parts, 3, 0)).reshape(len(q), len(columns), -1)
    information: Float3D = rows @ rows.transpose(0, 2, 1)
    return information
