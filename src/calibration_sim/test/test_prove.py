"""The proof: how a diagnosis is scored, and what the table says."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from calibration_sim.proving.diagnosing import Run
from calibration_sim.proving.measures import PLACES, Case, Measure, as_table, measures, power, second_measures, wrong
from calibration_sim.proving.scoring import same_place, score

CONSISTENT: dict[str, Any] = {"schema": 1, "verdict": "consistent", "findings": [], "anomalies": [], "stiffness": []}


def _effect(effect: str = "off_axis_compliance", **changes: Any) -> dict[str, Any]:
    return {
        "family": "structure",
        "effect": effect,
        "location": {"joint": "joint_2"},
        "amplitude": 1.0,
        "parameters": {},
        "equivalent": [],
        "same_law": False,
        "configurations": [],
        **changes,
    }


def _label(*effects: dict[str, Any], group: str = "single", **changes: Any) -> dict[str, Any]:
    return {
        "group": group,
        "robot": "heavy",
        "protocol": "L",
        "effects": list(effects),
        "snr": [10.0] * len(effects),
        "clutter": 0.0,
        "stiffness": [1e6, 2e6],
        "true_anyway": [],
        **changes,
    }


def _finding(effect: str = "off_axis_compliance", joint: str = "joint_2", **changes: Any) -> dict[str, Any]:
    return {
        "effect": effect,
        "family": "structure",
        "location": {"joint": joint},
        "parameters": [],
        "evidence": {"magnitude": 5e-5},
        "cannot_be_told_from": [],
        **changes,
    }


def _result(*findings: dict[str, Any], verdict: str = "missing_physics", **changes: Any) -> dict[str, Any]:
    return {**CONSISTENT, "verdict": verdict if findings else "consistent", "findings": list(findings), **changes}


def test_a_right_answer_is_right() -> None:
    outcome = score(_label(_effect()), _result(_finding()))
    assert outcome.first_right is True
    assert outcome.effect_right == (True,)
    assert outcome.place_right == (True,)
    assert outcome.named == ()
    assert outcome.found == outcome.large == 1


def test_another_joint_is_right_only_where_the_true_one_is_listed() -> None:
    listed = {"effect": "off_axis_compliance", "location": {"joint": "joint_2"}}
    assert score(_label(_effect()), _result(_finding(joint="joint_3"))).place_right == (False,)
    outcome = score(_label(_effect()), _result(_finding(joint="joint_3", cannot_be_told_from=[listed])))
    assert outcome.place_right == (True,)
    assert outcome.effect_right == (True,)


def test_an_exact_alias_counts_as_the_effect() -> None:
    alias = {"effect": "base_compliance", "location": {"base": "base"}}
    effect = _effect(location={"joint": "joint_1"}, equivalent=[alias])
    finding = _finding("base_compliance", location={"base": "base"})
    outcome = score(_label(effect), _result(finding))
    assert outcome.first_right is True
    assert outcome.place_right == (True,)
    assert not outcome.aliases_named
    said = {**finding, "cannot_be_told_from": [{"effect": effect["effect"], "location": effect["location"]}]}
    assert score(_label(effect), _result(said)).aliases_named


def test_a_wrong_name_is_wrong_and_a_second_one_is_false() -> None:
    outcome = score(_label(_effect()), _result(_finding("hysteresis"), _finding()))
    assert outcome.first_right is False
    assert outcome.effect_right == (True,)
    assert outcome.named == ("hysteresis",)


def test_what_is_true_anyway_is_no_false_finding_unless_it_is_the_question() -> None:
    plain = _label(group="nothing", true_anyway=["geometry_error"])
    assert score(plain, _result(_finding("geometry_error"))).found == 0
    asked = _label(_effect("geometry_error"), true_anyway=["geometry_error"])
    assert score(asked, _result(_finding("geometry_error"))).first_right is True


def test_empirical_terms_are_no_physics() -> None:
    outcome = score(_label(group="outside"), _result(_finding("sparse_law", family="empirical"), verdict="unexplained"))
    assert outcome.found == 0
    assert outcome.flagged


def test_parameters_and_stiffnesses_are_held_against_their_intervals() -> None:
    parameters = [
        {"name": "compliance_x", "value": 2.0e-7, "std": 1e-8},
        {"name": "compliance_y", "value": 2.0e-7, "std": 1e-8},
    ]
    effect = _effect(parameters={"compliance_x": 2.15e-7, "compliance_y": 2.5e-7}, same_law=True)
    rows = [
        {"joint": "joint_1", "value": 1.01e6, "std": 1e4, "identifiable": True},
        {"joint": "joint_2", "value": 2.5e6, "std": 1e4, "identifiable": True},
    ]
    outcome = score(_label(effect), _result(_finding(parameters=parameters), stiffness=rows))
    assert outcome.covered == (True, False)
    assert outcome.stiffness_covered == (True, False)
    assert score(_label({**effect, "same_law": False}), _result(_finding(parameters=parameters))).covered == ()


@pytest.mark.parametrize(
    ("stated", "right"),
    [([10, 18], True), ([9, 18], True), ([1, 9], True), ([3, 18], False), ([1, 18], False)],
)
def test_a_moved_target_is_located_by_its_first_configuration(stated: list[int], right: bool) -> None:
    effect = _effect("target_moved", family="anomaly", location={"point": "mp1"}, configurations=list(range(10, 19)))
    anomaly = {"kind": "target_moved", "location": {"point": "mp1"}, "configurations": stated}
    label = _label(effect, group="anomaly")
    assert score(label, {**CONSISTENT, "anomalies": [anomaly]}).anomaly_right == (right,)
    elsewhere = {**anomaly, "location": {"point": "mp2"}}
    assert score(label, {**CONSISTENT, "anomalies": [elsewhere]}).anomaly_right == (False,)


def test_places() -> None:
    assert same_place({"joints": ["joint_2", "joint_1"]}, {"joints": ["joint_1", "joint_2"]})
    assert not same_place({"joint": "joint_2"}, {"link": "link_2"})
    assert not same_place({}, {"joint": "joint_2"})
    assert same_place({"sensor": "force_torque"}, {"sensor": "sensor"})


def _case(label: dict[str, Any], result: dict[str, Any] | None, seconds: float = 2.0) -> Case:
    run = Run("0" * 64, 0 if result is not None else 1, seconds, 200.0)
    return Case("r", label, None if result is None else score(label, result), run)


def _measure(cases: list[Case], start: str) -> Measure:
    return next(m for m in measures(cases) if m.text.startswith(start))


def test_the_table_counts_what_it_says() -> None:
    nothing = _label(group="nothing")
    both = _label(_effect(), _effect("hysteresis"), group="pair")
    cases = [
        *[_case(nothing, _result())] * 3,
        _case(nothing, _result(_finding("creep"))),
        _case(both, _result(_finding(), _finding("hysteresis"))),
        _case(both, _result(_finding(), _finding("creep"))),
        _case(_label(_effect()), _result(_finding())),
        _case(_label(_effect()), _result()),
        _case(_label(_effect(family="outside", effect="nest_slip"), group="outside"), _result(verdict="unexplained")),
    ]
    assert _measure(cases, "nothing missing: a finding").value == pytest.approx(0.25)
    assert _measure(cases, "nothing missing: a finding").met is False
    assert _measure(cases, "pairs: both found").value == pytest.approx(0.5)
    assert _measure(cases, "pairs: a false third").value == pytest.approx(0.5)
    assert _measure(cases, "effect right, given something found").value == pytest.approx(1.0)
    assert _measure(cases, "effect right, typical, with unloading").value == pytest.approx(0.5)
    assert _measure(cases, "outside: flagged, nothing").value == pytest.approx(0.0)  # consistent: not flagged
    assert _measure(cases, "aliases").value is None
    assert "| nothing missing: a finding | 0.25 | <= 0.01 | **no** | 4 |" in as_table(measures(cases))
    assert power(cases)[0]["right"] == {"1": 0.5}
    assert [row["group"] for row in wrong(cases)] == ["nothing", "pair", "single", "outside"]


def test_no_test_could_tell_what_is_in_the_noise() -> None:
    """A simulated best test that chooses among as many places does as well as the table says."""
    ratios = [0.0, 2.0, 4.0, 40.0]
    cases = [_case(_label(_effect(), snr=[ratio]), _result()) for ratio in ratios]
    limit = _measure(cases, "about the most that can be told, typical, with unloading")
    assert limit.value is not None
    rng = np.random.default_rng(0)
    largest = np.array([rng.standard_normal(PLACES).max() for _ in range(100_000)])
    told = np.array(ratios) + rng.standard_normal((100_000, 1)) > np.quantile(largest, 0.99)
    assert limit.value == pytest.approx(told.mean(), abs=0.005)
    assert limit.count == 4
    assert _measure(cases, "about the most that can be told, typical, with reversed").value is None
    seen = [_case(_label(_effect(effect="measurement_point_offset"), snr=[1.0]), _result())]
    assert _measure(seen, "about the most that can be told, typical, with unloading").value == pytest.approx(1.0)


def test_a_recording_without_a_result_counts_against() -> None:
    cases = [_case(_label(group="nothing"), None), _case(_label(_effect()), None)]
    assert _measure(cases, "nothing missing: a finding").value == pytest.approx(1.0)
    assert _measure(cases, "effect right, typical, with unloading").value == pytest.approx(0.0)
    assert _measure(cases, "diagnoses that failed").value == pytest.approx(1.0)


def test_the_table_holds_processor_time_against_the_bar() -> None:
    label = {**_label(group="nothing"), "protocol": "L"}
    slow, fast, old = (_case(label, _result(), seconds=99.0) for _ in range(3))
    cases = [
        dataclasses.replace(case, run=dataclasses.replace(case.run, processor=busy))
        for case, busy in ((slow, 12.0), (fast, 2.0), (old, None))
        if case.run is not None
    ]
    assert _measure(cases[1:], "processor s per recording") == Measure(
        "processor s per recording (18 x 9 x 3), 95 %", 2.0, "<= 10", True, 1
    )
    assert _measure(cases, "processor s per recording").met is False
    assert _measure(cases[2:], "processor s per recording").value is None


# --- the second grid -------------------------------------------------------------------------------------------------


def _other_law(effect: str = "hysteresis", **changes: Any) -> dict[str, Any]:
    law = _effect(effect, family="joint law", kinds=[effect])
    return _label(law, group="other_law", noise={"outlier_rate": 0.0}, noise_seen=2e-5, **changes)


@pytest.mark.parametrize(
    ("findings", "verdict", "after", "right"),
    [
        (("hysteresis",), "missing_physics", 2.1e-5, True),
        (("hysteresis",), "missing_physics", 2.5e-5, False),  # more than the noise is called noise
        (("hysteresis",), "partly_explained", 2.5e-5, True),
        (("creep",), "partly_explained", 2.5e-5, False),
        (("hysteresis", "creep"), "partly_explained", 2.5e-5, False),
        ((), "unexplained", 2.5e-5, True),
        ((), "consistent", 2.0e-5, False),
    ],
)
def test_a_law_of_another_shape_is_told_by_its_kind_or_called_unexplained(
    findings: tuple[str, ...], verdict: str, after: float, right: bool
) -> None:
    said = [_finding(name) for name in findings]
    result = {**CONSISTENT, "verdict": verdict, "findings": said, "fit": {"rms_after": after}}
    assert score(_other_law(), result).kind_right is right
    elsewhere = {**result, "findings": [_finding(name, joint="joint_5") for name in findings]}
    assert score(_other_law(), elsewhere).kind_right is (right and not findings)
    wild = {**_other_law(), "noise": {"outlier_rate": 0.01}}
    assert score(wild, {**result, "verdict": "missing_physics"}).kind_right is (findings == ("hysteresis",))


def test_what_every_joint_has_is_right_at_each_of_them_and_together() -> None:
    label = _label(_effect("hysteresis", location={"joints": "all"}), group="everywhere")
    outcome = score(label, _result(_finding("hysteresis", joint="joint_4"), _finding("hysteresis", joint="joint_1")))
    assert outcome.first_right is True
    assert outcome.place_right == (True,)
    assert outcome.named == ()
    assert score(label, _result(_finding("hysteresis", location={"joints": "all"}))).place_right == (True,)
    single = _label(_effect("hysteresis"), group="rest")
    assert score(single, _result(_finding("hysteresis", location={"joints": "all"}))).place_right == (False,)


def test_the_second_table_counts_its_kinds() -> None:
    right, wrong_name = _result(_finding()), _result(_finding("hysteresis"))
    cases = [
        _case(_label(_effect(), group="rest"), right),
        _case(_label(_effect(), group="rest"), wrong_name),
        _case(_label(_effect(), group="mixed"), None),
        _case(_label(_effect(), _effect("backlash"), group="across"), _result(_finding(), _finding("creep"))),
        _case(_other_law(), _result(_finding("hysteresis"), fit={"rms_after": 2e-5})),
        _case(_label(group="nothing_else"), _result(_finding("creep"))),
    ]
    rows = {row.text: row for row in second_measures(cases)}
    assert (rows["at rest: named first"].value, rows["at rest: named first"].met) == (0.5, False)
    assert rows["at rest: place right, given the effect is right"].value == 1.0
    assert rows["loaded and at rest: named first"].value == 0.0
    assert rows["loaded and at rest: a false second finding"].value == 1.0
    assert rows["one under load and one at rest: both found"].value == 0.0
    assert rows["one under load and one at rest: a false third finding"].value == 1.0
    assert rows["laws of other shapes: joint and kind right or unexplained, never to the noise"].met is True
    assert rows["nothing missing: a finding"].value == 1.0
    assert rows["diagnoses that failed"].value == pytest.approx(1 / 6)
    assert not [text for text in rows if text.startswith("robots of")]
    assert "| at rest: named first | 0.5 | >= 0.95 | **no** | 2 |" in as_table(second_measures(cases))


def test_intervals_of_stiffnesses_count_where_the_cause_is_right() -> None:
    stiffness = [
        {"joint": "joint_1", "value": 1.1e6, "std": 1e5, "identifiable": True},
        {"joint": "joint_2", "value": 2.5e6, "std": 1e5, "identifiable": True},
    ]
    label = _label(_effect(), group="mixed", stiffness=[1e6, 2e6])
    right, wrong = _result(_finding(), stiffness=stiffness), _result(_finding("creep"), stiffness=stiffness)
    cases = [_case(label, right), _case(label, wrong), _case({**label, "group": "across"}, right)]
    rows = {row.text: row for row in second_measures(cases)}
    for kind, which in (("loaded and at rest", "cause"), ("one under load and one at rest", "a cause")):
        row = rows[f"{kind}: stiffnesses in their 95 % intervals, {which} right"]
        assert (row.value, row.count, row.met) == (0.5, 2, False)
