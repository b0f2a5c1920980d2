"""What is selected of loaded steps, and its estimate, on random designs of known truth."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from calibration_core.diagnosis.evidence.design import Design, field_of, select
from calibration_core.diagnosis.evidence.extended import estimates
from calibration_core.diagnosis.evidence.residual import held_out_ratio, weighted_rest
from calibration_core.estimation.alternatives import are_confounded
from calibration_core.estimation.likelihood.gains import shared_power
from calibration_core.model.effects.candidate import Candidate, Parameter
from calibration_core.policy import PRIOR_WIDTH

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
        discrepancy=slice(own, own + 2),
        chances=tuple(last if k == 2 else slice(last.stop, last.stop) for k in range(places)),
        joints=tuple(f"joint_{k + 1}" for k in range(3 * places)),
    )  # fmt: skip


def test_the_error_of_configurations_left_out_is_held_against_what_noise_makes_it() -> None:
    """One on the average, whatever the leverage; more where a model that was accepted does not hold."""

    def exact(seed: int, truth: dict[int, float] | None = None) -> Design:
        d = design(seed, truth)
        columns = d.columns.copy()
        columns[:, d.discrepancy] = 0.0
        return dataclasses.replace(d, columns=columns)

    ratios = [held_out_ratio(exact(seed), accepted) for seed in range(20) for accepted in ((), (2,), (1, 2, 5))]
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)
    assert max(ratios) < 1.5
    assert held_out_ratio(exact(1, {4: 1.0, 5: -0.5}), ()) > 1.5
    usual = [design(seed) for seed in range(40)]
    drawn = [
        d.columns[:, d.discrepancy] @ np.random.default_rng(seed).standard_normal(2) for seed, d in enumerate(usual)
    ]
    ratios = [
        held_out_ratio(dataclasses.replace(d, residual=d.residual + e), ()) for d, e in zip(usual, drawn, strict=True)
    ]
    assert np.mean(np.square(ratios)) == pytest.approx(1.0, abs=0.4)


def test_estimates_are_those_of_generalised_least_squares() -> None:
    d = design(5, {4: 1.0, 5: -0.5})
    value, covariance = estimates(d, (2,))
    columns = np.column_stack([d.null, d.columns[:, 4:6], d.columns[:, 16:]])
    prior = np.diag([0.0] * 3 + [1.0] * 4)
    inverse = np.linalg.inv(columns.T @ columns + prior)
    np.testing.assert_allclose(value, (inverse @ columns.T @ d.residual)[:5], rtol=1e-6)
    np.testing.assert_allclose(covariance, inverse[:5, :5], rtol=1e-5, atol=1e-10)


def test_small_effects_widen_the_estimate_as_their_columns_do() -> None:
    d = design(5, {4: 1.0, 5: -0.5})
    value, covariance = estimates(d, (2,), np.full(8, 0.7))
    basis = np.linalg.qr(d.null)[0]
    left = d.columns[:, :16] - basis @ (basis.T @ d.columns[:, :16])
    unit = np.repeat([1 / np.sqrt((left[:, k : k + 2] ** 2).sum()) for k in range(0, 16, 2)], 2)
    others = [k for k in range(16) if k not in (4, 5)]
    small = d.columns[:, others] * np.minimum(0.7 * unit, 1 / PRIOR_WIDTH)[others]
    columns = np.column_stack([d.null, d.columns[:, 4:6], d.columns[:, 16:], small])
    inverse = np.linalg.inv(columns.T @ columns + np.diag([0.0] * 3 + [1.0] * (columns.shape[1] - 3)))
    np.testing.assert_allclose(value, (inverse @ columns.T @ d.residual)[:5], rtol=1e-6)
    np.testing.assert_allclose(covariance, inverse[:5, :5], rtol=1e-5, atol=1e-10)


def test_what_an_accepted_effect_leaves_to_chance_is_part_of_the_covariance() -> None:
    d = design(10, {4: 1.0}, chance=CONFIGURATIONS)
    value, covariance = estimates(d, (2,))
    columns = np.column_stack([d.null, d.columns[:, 4:6], d.columns[:, 16:]])
    inverse = np.linalg.inv(columns.T @ columns + np.diag([0.0] * 3 + [1.0] * (columns.shape[1] - 3)))
    np.testing.assert_allclose(value, (inverse @ columns.T @ d.residual)[:5], rtol=1e-6)
    np.testing.assert_allclose(covariance, inverse[:5, :5], rtol=1e-5, atol=1e-10)


def test_forms_that_share_what_they_leave_to_chance_leave_a_residual() -> None:
    """Columns that stand twice, but for rounding, are one: the decomposition of them must not fail."""
    d = design(11, {4: 1.0, 6: 1.0}, chance=CONFIGURATIONS)
    d = dataclasses.replace(d, chances=tuple(d.chances[2] if k in (2, 3) else one for k, one in enumerate(d.chances)))
    extended = SimpleNamespace(design=d, accepted=(2, 3))
    rest, ratio, freedom = weighted_rest(extended)  # type: ignore[arg-type]
    assert freedom == ROWS - (3 + 4 + CONFIGURATIONS + 2)
    assert ratio == pytest.approx(float(rest @ rest) / freedom)
    assert np.abs(d.columns[:, 4:8].T @ rest).max() < 1e-8


def test_what_an_effect_leaves_to_chance_is_no_evidence_for_it() -> None:
    chance = {18 + k: (-1.0) ** k * 4.0 for k in range(CONFIGURATIONS)}
    assert 2 not in select(design(7, chance, chance=CONFIGURATIONS)).accepted
    assert select(design(7, {**chance, 4: 2.0, 5: 1.5}, chance=CONFIGURATIONS)).accepted == (2,)


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
        field = field_of(d)
        unit = shared_power(np.diag(field.gram.matrix), d.candidates, field.offered.blocks) / PRIOR_WIDTH
        crowd = d.columns[:, :16] @ (3 * unit[:16] * rng.standard_normal(16))
        named += bool(select(dataclasses.replace(d, residual=d.residual + crowd)).accepted)
    assert named <= 3


def test_an_effect_that_cannot_be_negative_is_not_selected_where_it_would_be() -> None:
    for sign, accepted in ((1.0, (2,)), (-1.0, ())):
        truth = {4: sign * 0.8, 5: sign * 0.8}
        assert select(design(3, truth, positive=True)).accepted == accepted
        assert select(design(3, truth)).accepted == (2,)


def test_nothing_is_selected_of_noise() -> None:
    assert sum(bool(select(design(1000 + seed)).accepted) for seed in range(100)) <= 4  # 1 % expected


def test_what_would_have_to_be_far_larger_than_usual_is_not_selected() -> None:
    d = design(13, {4: 0.3})
    assert select(d).accepted == (2,)
    tiny = d.columns.copy()
    tiny[:, 4:6] /= 60.0  # the same movement of the points would be sixty times as large an effect
    assert select(dataclasses.replace(d, columns=tiny)).accepted == ()


def test_forms_of_one_cause_are_one_choice() -> None:
    """Two laws of one joint without memory are one cause; a law with memory beside them is another."""
    d = design(12, {0: 3.0, 2: 2.0, 4: 2.5})
    names = ("soft_zone", "backlash", "hysteresis")
    laws = tuple(
        dataclasses.replace(one, effect=name, family="joint law", location={"joint": "joint_1"})
        for one, name in zip(d.candidates[:3], names, strict=True)
    )
    chosen = select(dataclasses.replace(d, candidates=(*laws, *d.candidates[3:])))
    assert set(chosen.accepted) == {0, 1, 2}
    assert {(c.candidate, c.refinements) for c in chosen.choices} == {(0, (1,)), (2, ())}
    alone = chosen.without([c for c in chosen.choices if c.candidate == 0])
    assert alone.accepted == (2,)
    share, left = chosen.share, alone.share
    assert share is not None
    assert left is not None
    assert np.all(share[:2] > 1.0)  # the laws of the first two, known to a share, may be one another's
    assert np.all(left[:2] < 1.0)
    assert left[2] > 1.0


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
