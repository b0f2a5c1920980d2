"""Bayes factors, levels and left-out predictions against dense computations of the same joint normal distribution."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from calibration_core.diagnosis.evidence.bayes_factors import (
    at_its_level,
    chance_alone,
    estimates,
    gram_cache,
    judge,
    log_bayes_factors,
    marginal_model,
    posterior,
)
from calibration_core.diagnosis.evidence.confounding import are_confounded
from calibration_core.diagnosis.evidence.design import Design
from calibration_core.diagnosis.evidence.positive_share import log_positive
from calibration_core.diagnosis.evidence.predictive_density import FLAT, log_predictive_densities, passes
from calibration_core.diagnosis.evidence.selection import select
from calibration_core.diagnosis.evidence.threshold import threshold
from calibration_core.model.effects.candidate import Candidate, Parameter

ROWS, CONFIGURATIONS = 120, 12


def candidate(effect: str, joint: int, count: int, *, positive: bool = False) -> Candidate:
    parameters = tuple(Parameter(f"p{k}", "1", 1.0, positive=positive) for k in range(count))
    return Candidate(effect, "structure", {"joint": f"joint_{joint}"}, "law", parameters, lambda _: np.zeros((1, 3, 1)))


def design(
    seed: int, truth: dict[int, float] | None = None, *, positive: bool = False, places: int = 8, chance: int = 0
) -> Design:
    """Return a random design of candidates with two columns each at far apart joints, with some columns planted.

    Candidate 2 leaves `chance` configurations to chance, with a column for each.
    """
    rng = np.random.default_rng(seed)
    candidates = tuple(candidate(f"effect_{k}", 3 * k + 1, 2, positive=positive) for k in range(places))
    own = 2 * places
    null, columns = 30 * rng.standard_normal((ROWS, 3)), 2 * rng.standard_normal((ROWS, own + 2 + chance))
    configuration = np.repeat(np.arange(CONFIGURATIONS), ROWS // CONFIGURATIONS)
    columns[:, own + 2 :] *= configuration[:, None] == np.arange(chance)
    last = slice(own + 2, own + 2 + chance)
    residual = rng.standard_normal(ROWS) + null @ [0.5, -1.0, 2.0]
    for column, value in (truth or {}).items():
        residual += columns[:, column] * value
    return Design(
        residual=residual, null=null, columns=columns,
        configuration=configuration, candidates=candidates,
        blocks=tuple(slice(2 * k, 2 * k + 2) for k in range(places)), prior=np.ones(own + 2 + chance),
        positive=np.array([positive] * own + [False] * (2 + chance)), discrepancy=slice(own, own + 2),
        chances=tuple(last if k == 2 else slice(last.stop, last.stop) for k in range(places)),
        joints=tuple(f"joint_{k + 1}" for k in range(3 * places)),
    )  # fmt: skip


def dense(d: Design, weights: np.ndarray, flat: float = 50.0) -> float:
    covariance = np.eye(ROWS) + (d.columns * weights**2) @ d.columns.T + flat**2 * d.null @ d.null.T
    return float(multivariate_normal.logpdf(d.residual, np.zeros(ROWS), covariance, allow_singular=False))


@pytest.mark.parametrize("level", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("chance", [0, 4])
def test_bayes_factors_are_ratios_of_marginal_likelihoods(level: float, chance: int) -> None:
    d = design(1, {4: 1.0}, chance=chance)
    f = marginal_model(gram_cache(d), (5,), level)
    scores = log_bayes_factors(f)
    for index in (0, 2, 7):
        more = f.weights.copy()
        more[d.own(index)] = np.hypot(more[d.own(index)], 1.0)
        assert scores[index] == pytest.approx(dense(d, more) - dense(d, f.weights), abs=1e-3)


def test_levels_are_compared_by_their_marginal_likelihood() -> None:
    d = design(2)
    one, two = (marginal_model(gram_cache(d), (), level) for level in (0.5, 3.0))
    assert one.likelihood - two.likelihood == pytest.approx(dense(d, one.weights) - dense(d, two.weights), abs=1e-3)


def test_what_is_negative_speaks_against_an_effect_that_cannot_be() -> None:
    signs = {}
    for value in (0.5, -0.5):
        d = design(3, {4: value, 5: value}, positive=True)
        signs[value] = log_bayes_factors(marginal_model(gram_cache(d), (), 0.0))[2]
    assert signs[0.5] > 20
    assert signs[-0.5] < 0


def test_the_share_of_a_posterior_that_is_positive_counts_all_parameters_together() -> None:
    covariance = np.array([[1.0, 0.7, -0.3], [0.7, 2.0, 0.2], [-0.3, 0.2, 0.5]])
    means = np.array([[0.5, -1.0, 0.3], [2.0, 1.0, -0.5], [-1.0, -1.5, 0.2]])
    seen = log_positive(means.T, covariance)
    exact = [multivariate_normal(np.zeros(3), covariance).cdf(mean) for mean in means]
    np.testing.assert_allclose(seen, np.log(exact), atol=0.15)
    apart = np.diag([1.0, 4.0])
    np.testing.assert_allclose(log_positive(means[:, :2].T, apart), norm.logcdf(means[:, :2] / [1, 2]).sum(axis=1))


def test_a_threshold_is_higher_where_the_noise_is_known_badly() -> None:
    f = marginal_model(gram_cache(design(4)), (), 0.0)
    assert threshold(f, 20) > threshold(f, 200) > threshold(f, 0) - 0.5


def test_the_threshold_is_passed_by_chance_in_one_of_a_hundred() -> None:
    above = 0
    for seed in range(300):
        cache = gram_cache(design(1000 + seed))
        above += bool(judge(cache, ()).scores.max() > threshold(at_its_level(cache, ()), seed=seed))
    assert above <= 12  # 1 % expected, 12 of 300 has a chance below 1e-4; choosing the level costs a little


def test_estimates_are_those_of_generalised_least_squares() -> None:
    d = design(5, {4: 1.0, 5: -0.5})
    value, covariance = estimates(marginal_model(gram_cache(d), (2,), 0.0))
    columns = np.column_stack([d.null, d.columns[:, 4:6], d.columns[:, 16:]])
    prior = np.diag([0.0] * 3 + [1.0] * 4)
    inverse = np.linalg.inv(columns.T @ columns + prior)
    np.testing.assert_allclose(value, (inverse @ columns.T @ d.residual)[:5], rtol=1e-6)
    np.testing.assert_allclose(covariance, inverse[:5, :5], rtol=1e-5, atol=1e-10)
    mean, _ = posterior(marginal_model(gram_cache(d), (), 0.0), 2)
    np.testing.assert_allclose(mean, value[3:], rtol=1e-6)


@pytest.mark.parametrize("chance", [0, CONFIGURATIONS])
def test_left_out_densities_are_conditional_densities(chance: int) -> None:
    d = design(6, {4: 0.6}, chance=chance)
    f = marginal_model(gram_cache(d), (), 1.0)
    more = f.weights.copy()
    more[d.own(2)] = np.hypot(more[d.own(2)], 1.0)
    null = d.null / np.linalg.norm(d.null, axis=0) * FLAT
    for seen, weights in zip(log_predictive_densities(f, 2), (f.weights, more), strict=True):
        covariance = np.eye(ROWS) + null @ null.T + (d.columns * weights**2) @ d.columns.T
        expected = []
        for k in range(CONFIGURATIONS):
            out, rest = np.flatnonzero(d.configuration == k), np.flatnonzero(d.configuration != k)
            gain = covariance[np.ix_(out, rest)] @ np.linalg.inv(covariance[np.ix_(rest, rest)])
            conditional = covariance[np.ix_(out, out)] - gain @ covariance[np.ix_(rest, out)]
            density = multivariate_normal(gain @ d.residual[rest], (conditional + conditional.T) / 2)
            expected.append(density.logpdf(d.residual[out]) + 0.5 * len(out) * np.log(2 * np.pi))
        np.testing.assert_allclose(seen, expected, atol=1e-4)
    assert passes(np.zeros(5), np.full(5, 1.0))
    assert not passes(np.zeros(5), np.array([9.0, -1.0, -1.0, -1.0, -1.0]))  # one configuration alone


def test_chance_is_part_of_the_covariance_where_its_effect_is_accepted() -> None:
    d = design(10, {4: 1.0}, chance=CONFIGURATIONS)
    without, with_it = (marginal_model(gram_cache(d), accepted, 0.0) for accepted in ((), (2,)))
    assert np.all(without.weights[d.chances[2]] == 0)
    assert np.all(with_it.weights[d.chances[2]] == 1)
    value, covariance = estimates(with_it)
    columns = np.column_stack([d.null, d.columns[:, 4:6], d.columns[:, 16:]])
    inverse = np.linalg.inv(columns.T @ columns + np.diag([0.0] * 3 + [1.0] * (columns.shape[1] - 3)))
    np.testing.assert_allclose(value, (inverse @ columns.T @ d.residual)[:5], rtol=1e-6)
    np.testing.assert_allclose(covariance, inverse[:5, :5], rtol=1e-5, atol=1e-10)


def test_what_an_effect_leaves_to_chance_is_no_evidence_for_it() -> None:
    chance = {18 + k: (-1.0) ** k * 4.0 for k in range(CONFIGURATIONS)}
    d = design(7, chance, chance=CONFIGURATIONS)
    f = marginal_model(gram_cache(d), (), 0.0)
    assert log_bayes_factors(f)[2] > 50
    assert chance_alone(f, 2) > log_bayes_factors(f)[2] - 1
    assert chance_alone(f, 3) == 0.0  # which leaves nothing to chance
    assert 2 not in select(d).accepted
    assert select(design(7, {**chance, 4: 2.0}, chance=CONFIGURATIONS)).accepted == (2,)


def test_two_planted_effects_are_selected_and_nothing_else() -> None:
    d = design(7, {4: 1.2, 12: -1.5}, places=24)
    assert set(select(d).accepted) == {2, 6}
    assert select(design(8, places=24)).accepted == ()


def test_one_large_effect_does_not_raise_the_level_and_hide() -> None:
    chosen = select(design(9, {4: 6.0, 5: 4.0}))
    assert chosen.accepted == (2,)
    assert chosen.level <= 1.0


def test_of_two_forms_that_explain_as_much_the_one_with_fewer_parameters_is_chosen() -> None:
    """One parameter of the longer form moves nothing that the null model does not move as well."""
    d = design(9, {4: 1.0})
    d.columns[:, 5], d.columns[:, 6] = 0.0, d.columns[:, 4]
    longer, shorter = d.candidates[2], dataclasses.replace(candidate("effect_2", 7, 1), variant="shorter")
    assert shorter.place == longer.place
    d = dataclasses.replace(
        d,
        candidates=(*d.candidates[:3], shorter, *d.candidates[4:]),
        blocks=(*d.blocks[:3], slice(6, 7), *d.blocks[4:]),
    )
    assert select(d).accepted == (3,)


def test_one_law_in_every_joint_is_found_where_its_parts_hide_each_other() -> None:
    found = 0
    for seed in range(4):
        rng = np.random.default_rng(seed)
        d = design(200 + seed, {k: float(rng.choice([-0.4, 0.4])) for k in range(12)}, places=14)
        same = tuple(dataclasses.replace(one, effect="friction", family="joint law") for one in d.candidates[:6])
        several = dataclasses.replace(d, candidates=(*same, *d.candidates[6:]))
        chosen = select(several).accepted
        assert set(chosen) <= set(range(6))
        found += len(chosen) >= 5
        assert len(select(d).accepted) < 5  # the same columns, each an effect of its own
    assert found == 4


def test_a_crowd_of_small_effects_is_no_finding() -> None:
    rng = np.random.default_rng(3)
    named = 0
    for seed in range(20):
        d = design(50 + seed)
        unit = gram_cache(d).unit[:16]
        crowd = d.columns[:, :16] @ (3 * unit * rng.standard_normal(16))
        named += bool(select(dataclasses.replace(d, residual=d.residual + crowd)).accepted)
    assert named <= 3


@pytest.mark.parametrize(
    "joints",
    [
        tuple(f"joint_{k}" for k in range(1, 7)),
        ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"),
        ("kr240_a6", "link_2", "S", "10", "2nd", ""),
    ],
)
def test_confounded_are_laws_of_one_joint_and_neighbours_of_the_structure(joints: tuple[str, ...]) -> None:
    def place(effect: str, family: str, **location: object) -> Candidate:
        return Candidate(effect, family, location, "law", (Parameter("p", "1", 1.0),), lambda _: np.zeros((1, 3, 1)))  # type: ignore[arg-type]

    def confounded(first: Candidate, second: Candidate) -> bool:
        assert are_confounded(first, second, joints) == are_confounded(second, first, joints)
        return are_confounded(first, second, joints)

    soft, gap = (place(e, "joint law", joint=joints[1]) for e in ("soft_zone", "backlash"))
    assert confounded(soft, gap)
    assert not confounded(soft, place("backlash", "joint law", joint=joints[2]))
    assert not confounded(soft, place("hysteresis", "joint law", joint=joints[1]))
    lag, drift = place("hysteresis", "joint law", joint=joints[1]), place("wrench_drift", "load chain", sensor="s")
    assert confounded(lag, drift)
    assert confounded(drift, place("creep", "joint law", joint=joints[3]))
    assert not confounded(drift, soft)
    second = place("off_axis_compliance", "structure", joint=joints[1])
    assert confounded(second, place("link_bending", "structure", link="link_2"))
    assert confounded(second, place("link_bending", "structure", link="link_1"))
    assert confounded(second, place("base_compliance", "structure", base="base"))
    assert confounded(second, place("joint_coupling", "structure", joints=joints[2:4]))
    assert not confounded(second, place("joint_coupling", "structure", joints=joints[3:5]))
    assert not confounded(second, place("off_axis_compliance", "structure", joint=joints[4]))
    assert not confounded(second, place("tool_compliance", "structure", tool="tool"))
    assert confounded(
        place("wrench_gain", "load chain", sensor="s"), place("wrench_crosstalk", "load chain", sensor="s")
    )
    assert not confounded(second, soft)
