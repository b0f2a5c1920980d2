"""An absolute recording as a least-squares problem, and a start for it that needs no guess of the frames."""

from __future__ import annotations

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.geometry.fit import AbsoluteProblem, fit
from calibration_core.identification.geometry.frames import fit_frames
from calibration_core.identification.geometry.terms import TrackerTerm
from calibration_core.model.chain import Chain
from calibration_core.model.equilibrium import solve_equilibrium
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.recorded_load import load_of
from calibration_core.observations.kinds import references_alone
from calibration_core.timeseries import Float3D, Readings

MIN_CONFIGURATIONS = 3
MIN_SPREAD = 1e-3  # m: second singular value of the centred positions over sqrt(m); below it they lie on one line
START_READINGS = 400  # enough for a first solution of the frames


def absolute_problem(
    readings: Readings, cell: Cell, chain: Chain, nominal: ModelParameters, covariance: Float3D
) -> AbsoluteProblem:
    """Set up the problem; its points are those that were read.

    Args:
        readings: The recording.
        cell: The cell file.
        chain: The nominal robot.
        nominal: What the cell file believes.
        covariance: (m, 3, 3) m^2 of the positions, tracker axes.

    Raises:
        IdentificationError: The recording holds differences instead of positions, or too few to fix the frames.
        CellError: A wrench was recorded and the cell file does not say where the sensor is.
    """
    require_positions(readings, cell)
    return problem_of(readings, cell, chain, nominal, covariance)


def problem_of(
    readings: Readings, cell: Cell, chain: Chain, nominal: ModelParameters, covariance: Float3D
) -> AbsoluteProblem:
    """Return the same of readings that need not fix the frames, as those of a single posture."""
    present, point = np.unique(readings.point, return_inverse=True)
    names = tuple(readings.points[index] for index in present)
    loaded = readings.wrench is not None and bool(np.any(readings.wrench))
    return AbsoluteProblem(
        chain=chain,
        q=readings.q,
        position=np.ascontiguousarray(readings.position.T),
        names=names,
        point=point.reshape(-1).astype(np.int64) if len(names) > 1 else None,
        whitening=_whitening(covariance),
        load=load_of(readings, cell, nominal) if loaded else None,
        recording=readings.recording,
    )


def start_parameters(problem: AbsoluteProblem, nominal: ModelParameters) -> ModelParameters:
    """Return the nominal model with frames from a solution that is linear in them: no guess is needed.

    Several recordings were brought into one frame before; their frames and points are known to begin with.

    Args:
        problem: All readings; up to 400, evenly taken, are used.
        nominal: What the cell file believes; its tracker pose is not used.
    """
    if problem.recording is not None:
        return nominal
    rows = np.unique(np.linspace(0, len(problem) - 1, START_READINGS).astype(int))
    some = problem.select(rows)
    chain = some.chain.corrected(nominal.geometry)
    at = solve_equilibrium(chain, some.q, nominal.compliance, some.load).at
    point = np.zeros(len(some), dtype=np.int64) if some.point is None else some.point
    guess = np.stack([nominal.points[name] for name in some.names])
    frames = fit_frames(at, some.position.T, point, guess, None)
    fitted = dict(zip(some.names, frames.points, strict=True))
    return nominal.replace(tracker=frames.tracker, points={**nominal.points, **fitted})


def nominal_with_tracker(
    problem: AbsoluteProblem, nominal: ModelParameters, start: ModelParameters, *, known: bool
) -> ModelParameters:
    """Return what the cell file predicts; where it states no tracker pose, the best one for its points."""
    if known:
        return nominal
    return fit(problem, nominal.replace(tracker=start.tracker), [TrackerTerm()]).parameters


def require_positions(readings: Readings, cell: Cell) -> None:
    """Refuse readings that do not fix tracker pose and measurement points.

    Raises:
        IdentificationError: They are differences instead of positions, too few, or on one line.
    """
    path = readings.provenance.path
    if cell.measurements.points == "displacement":
        raise references_alone(readings)
    count = len(np.unique(readings.configuration))
    if count < MIN_CONFIGURATIONS:
        raise IdentificationError(
            path, "configuration", f"{count} configurations", f"at least {MIN_CONFIGURATIONS} to fix the tracker frame"
        )
    centred = readings.position - readings.position.mean(axis=0)
    width = float(np.linalg.svd(centred, compute_uv=False)[1] / np.sqrt(len(readings)))
    if width < MIN_SPREAD:
        found = f"positions on one line (to {1e3 * width:.2g} mm)"
        raise IdentificationError(path, "x y z", found, "positions that fix the tracker frame")
    parameters = 6 + 3 * len(np.unique(readings.point))
    if 3 * len(readings) <= parameters:
        raise IdentificationError(
            path,
            "",
            f"{3 * len(readings)} coordinates",
            f"more than the {parameters} parameters of the tracker pose and the measurement points",
        )


def _whitening(covariance: Float3D) -> float | Float3D:
    """Return 1/sigma where all readings have the same isotropic noise, else symmetric roots V^(-1/2), (3, 3, m).

    Symmetric, so that what several readings share keeps its direction, however the tracker is turned.
    """
    variance = float(covariance[0, 0, 0])
    if np.allclose(covariance, variance * np.eye(3), rtol=1e-9, atol=1e-9 * variance):
        return float(1.0 / np.sqrt(variance))
    values, vectors = np.linalg.eigh(covariance)
    roots = (vectors / np.sqrt(values)[:, None, :]) @ vectors.transpose(0, 2, 1)
    return np.ascontiguousarray(np.moveaxis(roots, 0, -1))
