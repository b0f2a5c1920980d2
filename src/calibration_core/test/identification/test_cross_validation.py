"""Folds by configuration, the shortcut through normal matrices, and the rule for keeping a model."""

from __future__ import annotations

import numpy as np
from absolute_cases import make_cell, make_problem, make_readings, random_angles, truth_of

from calibration_core.identification.absolute.prediction_error import LinearModel, compare, folds, held_out
from calibration_core.identification.geometry.fit import GeometryFit, fit, normal_equations
from calibration_core.identification.geometry.identifiability import candidates, select_frames, select_identifiable
from calibration_core.identification.geometry.parameter_table import GaussianPrior
from calibration_core.identification.geometry.terms import ElasticityTerm, names_of
from calibration_core.model.nominal import nominal_parameters

POINTS = ("mp1", "mp2")


def test_configurations_are_never_parted_and_folds_are_reproducible() -> None:
    configuration = np.repeat(np.arange(100), 3)
    fold = folds(configuration)
    assert np.array_equal(fold, folds(configuration))
    assert np.all(fold.reshape(100, 3) == fold.reshape(100, 3)[:, :1])
    assert np.array_equal(np.unique(fold, return_counts=True)[1], [60] * 5)
    assert len(np.unique(folds(np.repeat(np.arange(29), 2)))) == 29  # few: one at a time


def test_held_out_equals_fits_without_the_fold() -> None:
    cell = make_cell(points=POINTS)
    truth = truth_of(cell, 1, geometry=3e-3)
    readings = make_readings(cell, truth, random_angles(2, 40, 6))
    problem = make_problem(cell, readings)
    start = nominal_parameters(cell)
    frames, _ = select_frames(problem, start)
    terms = [*frames, select_identifiable(problem, start, frames, candidates(cell)).term]
    used = np.ones(len(problem), dtype=bool)
    used[[3, 50]] = False
    whole = fit(problem.select(np.flatnonzero(used)), start, terms)
    fold = folds(readings.configuration)
    fast = held_out(problem, whole, fold, used)
    for k in range(5):
        alone = fit(problem.select(np.flatnonzero(used & (fold != k))), start, terms)
        rows = np.flatnonzero(fold == k)
        np.testing.assert_allclose(fast[:, rows], problem.select(rows).residual(alone.parameters), atol=1e-9)
    assert np.mean(fast**2) > np.mean(problem.residual(whole.parameters) ** 2)


def test_what_was_known_before_is_known_to_every_fold() -> None:
    cell = make_cell()
    truth = nominal_parameters(cell).replace(compliance=np.array([0, 8e-7, 5e-7, 0, 0, 0]))
    readings = make_readings(cell, truth, random_angles(2, 12, 6))
    problem, start = make_problem(cell, readings), nominal_parameters(cell)
    terms = (*select_frames(problem, start)[0], ElasticityTerm((1, 2), ("C2", "C3")))
    known = np.zeros(len(names_of(terms)))
    known[-2:] = 1e-8**-2.0  # about as much as the readings say, about zero
    prior = GaussianPrior(start, terms, np.diag(known))
    whole, fold = fit(problem, start, terms, prior), folds(readings.configuration)
    assert whole.parameters.compliance[2] < 0.7 * truth.compliance[2]
    fast = held_out(problem, whole, fold, np.ones(12, dtype=bool))
    for k in range(12):
        alone = fit(problem.select(np.flatnonzero(fold != k)), start, terms, prior)
        rows = np.flatnonzero(fold == k)
        np.testing.assert_allclose(fast[:, rows], problem.select(rows).residual(alone.parameters), atol=2e-8)


def test_nothing_fitted_has_nothing_to_hold_out() -> None:
    cell = make_cell()
    readings = make_readings(cell, truth_of(cell, 1), random_angles(2, 12, 6))
    problem, start = make_problem(cell, readings), nominal_parameters(cell)
    nothing = GeometryFit(start, (), normal_equations(problem, start, ()), 0, converged=True)
    left = held_out(problem, nothing, folds(readings.configuration), np.ones(12, dtype=bool))
    np.testing.assert_array_equal(left, problem.residual(start))


def test_the_linear_model_agrees_with_the_equilibrium() -> None:
    cell = make_cell()
    truth = nominal_parameters(cell).replace(compliance=np.array([0, 8e-7, 5e-7, 0, 0, 0]))
    readings = make_readings(cell, truth, random_angles(2, 60, 6))
    problem, start = make_problem(cell, readings), nominal_parameters(cell)
    frames, _ = select_frames(problem, start)
    rigid = fit(problem, start, frames)
    elastic = [*frames, ElasticityTerm((1, 2), ("C2", "C3"))]
    fold = folds(readings.configuration)
    linear = LinearModel(problem, rigid.parameters, elastic, fold)
    exact = held_out(problem, fit(problem, start, elastic), fold, np.ones(60, dtype=bool))
    sag = np.abs(problem.residual(truth) - problem.residual(truth.replace(compliance=np.zeros(6)))).max()
    assert sag > 1e-3
    assert np.abs(linear.held_out(range(len(linear.names))) - exact).max() < 5e-3 * sag
    plain = held_out(problem, rigid, fold, np.ones(60, dtype=bool))
    np.testing.assert_allclose(linear.held_out(range(len(rigid.names))), plain, atol=1e-6)
    assert np.abs(plain).max() > 20 * np.abs(exact).max()


def test_a_gain_must_be_clear() -> None:
    rng = np.random.default_rng(0)
    configuration = np.arange(200)
    before = rng.standard_normal((3, 200))
    better = compare(before, 0.9 * before, configuration)
    assert better.clear
    assert 0 < better.after < better.before
    equals = [compare(*np.random.default_rng(k).standard_normal((2, 3, 200)), configuration) for k in range(200)]
    assert np.mean([gain.clear for gain in equals]) < 0.06  # equally good models: about 2.3 %


def test_one_lucky_configuration_is_no_clear_gain() -> None:
    before = np.full((3, 50), 1e-4)
    after = before.copy()
    before[:, 7] = 5e-3
    gain = compare(before, after, np.arange(50))
    assert gain.after < gain.before
    assert not gain.clear


def test_what_nearly_every_configuration_gains_is_a_gain_though_two_gain_far_more() -> None:
    rng = np.random.default_rng(4)
    before = rng.standard_normal((3, 42))
    before[:, :2] *= 100.0
    gain = compare(before, 0.3 * before, np.arange(42))
    assert not gain.clear
    assert gain.general
    assert gain.better == 42
    equals = [compare(*np.random.default_rng(k).standard_normal((2, 3, 42)), np.arange(42)) for k in range(400)]
    assert sum(one.general for one in equals) <= 4
