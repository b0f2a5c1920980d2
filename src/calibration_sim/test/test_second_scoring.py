"""How answers to the second grid are scored, and what its table says."""

from __future__ import annotations

from typing import Any

import pytest

from calibration_sim.proving.diagnosing import Run
from calibration_sim.proving.measures import Case, as_table, second_measures
from calibration_sim.proving.scoring import score

CONSISTENT: dict[str, Any] = {"verdict": "consistent", "findings": [], "anomalies": [], "stiffness": []}


def _effect(effect: str = "off_axis_compliance", **changes: Any) -> dict[str, Any]:
    plain = {"family": "structure", "effect": effect, "location": {"joint": "joint_2"}, "parameters": {}}
    return {**plain, "equivalent": [], "same_law": False, "configurations": [], **changes}


def _label(*effects: dict[str, Any], group: str, **changes: Any) -> dict[str, Any]:
    return {"group": group, "effects": list(effects), "stiffness": [], "true_anyway": [], **changes}


def _finding(effect: str = "off_axis_compliance", joint: str = "joint_2", **changes: Any) -> dict[str, Any]:
    return {"effect": effect, "family": "structure", "location": {"joint": joint}, "parameters": [], **changes}


def _result(*findings: dict[str, Any], **changes: Any) -> dict[str, Any]:
    return {**CONSISTENT, "verdict": "missing_physics", "findings": list(findings), **changes}


def _case(label: dict[str, Any], result: dict[str, Any] | None) -> Case:
    run = Run("0" * 64, 0 if result is not None else 1, 2.0, 200.0)
    return Case("r", label, None if result is None else score(label, result), run)


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
