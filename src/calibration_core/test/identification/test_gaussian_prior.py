"""What one phase leaves is what the next begins with: nothing is lost, nothing counted twice."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from absolute_cases import make_cell, make_problem, make_readings, random_angles, truth_of

from calibration_core.identification.geometry.fit import fit, normal_equations, start_parameters
from calibration_core.identification.geometry.identifiability import candidates, select_frames, select_identifiable
from calibration_core.identification.geometry.parameter_table import GaussianPrior, difference, learn
from calibration_core.identification.geometry.terms import ElasticityTerm, PointTerm, names_of
from calibration_core.model.nominal import nominal_parameters


def _case(seed: int = 3):
    cell = make_cell(points=("mp1", "mp2", "mp3"), masses=False)
    truth = truth_of(cell, seed)
    readings = make_readings(cell, truth, random_angles(seed, 40, 6), seed=seed)
    problem = make_problem(cell, readings)
    start = start_parameters(problem, nominal_parameters(cell))
    frames, _ = select_frames(problem, start)
    choice = select_identifiable(problem, start, frames, candidates(cell))
    terms = (*frames, choice.term)
    count = len(names_of(terms))
    return problem, GaussianPrior(start, terms, np.zeros((count, count)))


def test_two_phases_in_either_order_are_one() -> None:
    problem, nothing = _case()
    half = len(problem) // 2
    first, second = problem.select(np.arange(half)), problem.select(np.arange(half, len(problem)))
    at_once = learn(problem, nothing)
    for one, other in ((first, second), (second, first)):
        in_turn = learn(other, learn(one, nothing))
        step = difference(at_once.terms, at_once.parameters, in_turn.parameters)
        assert np.abs(step / np.sqrt(np.diag(at_once.covariance))).max() < 0.02
        np.testing.assert_allclose(np.diag(in_turn.covariance), np.diag(at_once.covariance), rtol=2e-3)


def test_the_prior_pulls_as_its_gradient_says() -> None:
    problem, nothing = _case()
    known = learn(problem, nothing)
    rng = np.random.default_rng(1)
    step = 1e-3 * rng.standard_normal(len(known.names))
    from calibration_core.identification.geometry.fit import moved

    there = moved(known.parameters, known.terms, step)
    np.testing.assert_allclose(difference(known.terms, known.parameters, there), step, atol=1e-9)
    normal = known.normal(there)
    assert normal.cost == pytest.approx(step @ known.information @ step, rel=1e-6)
    np.testing.assert_allclose(normal.gradient, -known.information @ step, rtol=1e-5, atol=1e-3)


def test_understated_noise_widens_what_is_left() -> None:
    problem, nothing = _case()
    honest = learn(problem, nothing)
    assert honest.scale == 1.0
    louder = dataclasses.replace(problem, whitening=problem.whitening * 3)
    widened = learn(louder, nothing)
    assert widened.scale == pytest.approx(3.0, rel=0.1)
    np.testing.assert_allclose(np.diag(widened.covariance), np.diag(honest.covariance), rtol=0.25)


def test_louder_readings_leave_the_prior_as_good_as_it_was() -> None:
    """Noise three times the stated one: the spread of solutions drawn by chance is the covariance."""
    problem, nothing = _case()
    terms, p = nothing.terms, len(nothing.names)
    seen = normal_equations(problem, nothing.parameters, terms)
    prior = dataclasses.replace(nothing, information=np.diag(0.5 * np.diag(seen.matrix)))
    found = fit(problem, nothing.parameters, terms, prior)
    rng, root = np.random.default_rng(3), np.linalg.cholesky(found.seen.matrix)
    read = 3.0 * root @ rng.standard_normal((p, 20_000))
    pull = np.sqrt(prior.information) @ rng.standard_normal((p, 20_000))
    drawn = np.linalg.solve(found.normal.matrix, read + pull).std(axis=1)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance(3.0))), drawn, rtol=0.03)
    own = np.sqrt(np.diag(found.covariance()))
    np.testing.assert_allclose(own, np.sqrt(np.diag(np.linalg.inv(found.normal.matrix))), rtol=1e-6)
    assert np.all(drawn < 2.9 * own)
    assert 3 * len(problem) - p < found.freedom < 3 * len(problem)


def test_compliances_are_left_aside_as_a_marginal() -> None:
    problem, nothing = _case()
    known = learn(problem, nothing).and_of(ElasticityTerm((0,), ("C joint_1",)))
    p = len(known.names)
    information = known.information.copy()
    information[p - 1, p - 1] = 1e12
    information[p - 1, :6] = information[:6, p - 1] = 1e3
    known = dataclasses.replace(known, information=information)
    marginal = known.without_compliances()
    np.testing.assert_allclose(marginal.covariance, known.covariance[:-1, :-1], rtol=1e-6, atol=1e-18)
    assert marginal.names == known.names[:-1]


def test_a_point_that_was_never_read_has_no_covariance() -> None:
    problem, nothing = _case()
    known = learn(problem, nothing).and_of(PointTerm("other", 3))
    assert known.names[-3:] == ("other x", "other y", "other z")
    with pytest.raises(np.linalg.LinAlgError):
        _ = known.covariance
