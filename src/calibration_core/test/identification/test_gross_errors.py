"""Gross errors are found and named, misfit is not thrown away, and what fits comes back."""

from __future__ import annotations

import dataclasses

import numpy as np
from absolute_cases import SIGMA, make_cell, make_problem, make_readings, random_angles, truth_of

from calibration_core.cell import Cell
from calibration_core.identification.absolute.gross_errors import GrossErrorRejection, reject_gross_errors
from calibration_core.identification.geometry.fit import AbsoluteProblem
from calibration_core.identification.geometry.identifiability import candidates, select_frames, select_identifiable
from calibration_core.model.nominal import nominal_parameters
from calibration_core.policy import MOST_EXCLUDED_AT_REST
from calibration_core.timeseries import Readings

COUNT = 120


def _readings(cell: Cell, seed: int = 0, noise: float = SIGMA) -> Readings:
    return make_readings(cell, truth_of(cell, 1), random_angles(2, COUNT, 6), noise=noise, seed=seed)


def _screen(cell: Cell, problem: AbsoluteProblem, used: np.ndarray, protected: np.ndarray) -> GrossErrorRejection:
    start = nominal_parameters(cell)
    frames, _ = select_frames(problem, start)
    return reject_gross_errors(
        problem, start, [*frames, select_identifiable(problem, start, frames, candidates(cell)).term], used, protected
    )


def _run(cell: Cell, readings: Readings, **masks: np.ndarray) -> GrossErrorRejection:
    m = len(readings)
    masks = {"used": np.ones(m, dtype=bool), "protected": np.zeros(m, dtype=bool)} | masks
    return _screen(cell, make_problem(cell, readings), masks["used"], masks["protected"])


def _with_errors(readings: Readings, rows: list[int], size: float) -> Readings:
    position = readings.position.copy()
    position[rows] += size * np.array([0.6, -0.5, 0.62])
    return dataclasses.replace(readings, position=position)


def test_single_mis_measured_poses_are_found() -> None:
    cell = make_cell()
    for size in (5e-4, 5e-3, 0.5):
        screened = _run(cell, _with_errors(_readings(cell), [17, 80], size))
        assert np.flatnonzero(~screened.used).tolist() == [17, 80]
        assert np.sqrt(screened.fit.normal.cost / screened.fit.freedom) < 1.15


def test_clean_recordings_lose_nothing() -> None:
    cell = make_cell()
    assert all(_run(cell, _readings(cell, seed)).used.all() for seed in range(15))
    assert _run(cell, _readings(cell, noise=20 * SIGMA)).used.all()  # noise twenty times the claim is no outlier


def test_misfit_is_not_thrown_away() -> None:
    cell = make_cell()
    q = random_angles(2, COUNT, 6)
    bent = q + 3e-4 * np.sin(3 * q)  # a rest thirty times the noise that no parameter explains
    readings = dataclasses.replace(make_readings(cell, truth_of(cell, 1), bent), q=q)
    assert _run(cell, readings).used.all()


def test_what_fits_comes_back_and_protected_readings_stay() -> None:
    cell = make_cell()
    readings = _with_errors(_readings(cell), [17], 5e-3)
    used = np.ones(COUNT, dtype=bool)
    used[[3, 4, 5]] = False  # set aside without cause
    screened = _run(cell, readings, used=used)
    assert np.flatnonzero(~screened.used).tolist() == [17]
    protected = np.zeros(COUNT, dtype=bool)
    protected[17] = True
    assert _run(cell, readings, protected=protected).used[17]


def test_never_more_than_a_small_share() -> None:
    cell = make_cell()
    screened = _run(cell, _with_errors(_readings(cell), list(range(0, COUNT, 12)), 0.1))
    assert np.sum(~screened.used) <= max(1, int(MOST_EXCLUDED_AT_REST * COUNT))
