"""Two measurements of one robot: a change is found, nothing is made of noise, and what cannot be told is said."""

from __future__ import annotations

import dataclasses
import datetime as dt
from typing import Any

import numpy as np
import pytest
from acceptance_cases import identified, measured, shares_of_one, small

from calibration_core.acceptance.comparison import Measurement, QuantityChange, changes, compare, trends
from calibration_core.acceptance.joint_laws import joint_laws, reference_torques
from calibration_core.identification.identify import identify
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect
from calibration_core.outcomes.comparison import Compared, described, reservations

NONE = GaussianEstimate.nothing()
LAW = 1e-4


def compliances(estimate: GaussianEstimate) -> GaussianEstimate:
    return estimate.chosen([k for k, name in enumerate(estimate.names) if name.startswith("compliance.")])


def measurement(estimate: GaussianEstimate, laws: GaussianEstimate = NONE, date: str | None = None) -> Measurement:
    when = None if date is None else dt.datetime.fromisoformat(date).replace(tzinfo=dt.UTC)
    return Measurement("one", when, 18, estimate, laws)


def test_a_change_is_found_and_noise_is_none() -> None:
    """1,000 pairs drawn from the covariance of one measurement of 18 configurations, as many with a change."""
    found, _ = identified()
    estimate = compliances(found.estimate)
    share = np.maximum(6.5 * shares_of_one(found), 0.05)
    root, rng = estimate.root(), np.random.default_rng(41)

    def drawn(value: np.ndarray) -> Measurement:
        return measurement(dataclasses.replace(estimate, value=value + root @ rng.standard_normal(6)))

    hits = alarms = 0
    for k in range(1000):
        joint = k % 6
        changed = estimate.value.copy()
        changed[joint] /= 1 - share[joint]
        first = drawn(estimate.value)
        alarms += any(one.verdict == "changed" for one in compare([first, drawn(estimate.value)], LAW)[0])
        hits += compare([first, drawn(changed)], LAW)[0][joint].verdict == "changed"
    assert hits >= 900
    assert alarms <= 10


def test_the_compliances_of_a_rigid_joint_are_compared() -> None:
    found, _ = identified()
    estimate = compliances(found.estimate)
    value = estimate.value.copy()
    value[5] = 0.0
    rigid = dataclasses.replace(estimate, value=value)
    for pair, sign in (((estimate, rigid), -1), ((rigid, estimate), 1)):
        rows = compare([measurement(one) for one in pair], LAW)[0]
        assert [one.quantity for one in rows] == ["stiffness"] * 5 + ["compliance"]
        last = rows[5]
        assert (last.location, last.unit, last.verdict) == ("joint_6", "rad/(N*m)", "changed")
        assert (last.first, last.second) == (pair[0].value[5], pair[1].value[5])
        assert last.change == pytest.approx(sign * estimate.value[5])
        assert last.high - last.low == pytest.approx(2 * 1.96 * np.sqrt(2) * estimate.std[5])
        assert last.limit == pytest.approx(0.05 * estimate.value[5])
    (*_, both) = compare([measurement(rigid), measurement(rigid)], LAW)[0]
    assert (both.change, both.verdict, both.configurations) == (0.0, "cannot_tell", None)
    unknown = dataclasses.replace(rigid, covariance=np.diag([*np.diag(rigid.covariance)[:5], np.inf]))
    (*_, open_) = compare([measurement(unknown), measurement(estimate)], LAW)[0]
    assert (open_.quantity, open_.verdict) == ("compliance", "cannot_tell")
    assert np.isfinite([open_.first, open_.second, open_.change]).all()


def test_a_compliance_that_may_be_none_leaves_no_bound_to_the_change() -> None:
    found, _ = identified()
    estimate = compliances(found.estimate)
    value = estimate.value.copy()
    value[5] = 0.5 * estimate.std[5]
    (*_, last) = compare([measurement(estimate), measurement(dataclasses.replace(estimate, value=value))], LAW)[0]
    assert last.low < last.change < last.high == np.inf


def test_what_cannot_be_told_says_what_would_tell() -> None:
    """With so many configurations the change of the limit would be found in nine of ten."""
    found, _ = identified()
    estimate = compliances(found.estimate)
    wide = dataclasses.replace(estimate, covariance=36 * estimate.covariance)
    rows = compare([measurement(wide), measurement(wide)], LAW)[0]
    open_ = [one for one in rows if one.verdict == "cannot_tell"]
    assert open_
    for one in open_:
        assert one.configurations is not None
        assert one.configurations > 18
        k = rows.index(one)
        narrow = wide.covariance * 18 / one.configurations
        noncentrality = 0.05 * estimate.value[k] / np.sqrt(2 * narrow[k, k])
        assert noncentrality > 3.29 + 1.28 - 0.05


@pytest.mark.parametrize(("changes", "said"), [
    ({"verdict": "changed"}, ("changed: stiffness of joint_2", "find out what was done to the robot")),
    ({"verdict": "cannot_tell", "configurations": 40},
     ("whether it has changed stays open: stiffness of joint_2", "measure 40 configurations each time")),
    ({"verdict": "cannot_tell", "configurations": 2648},
     ("whether it has changed stays open: stiffness of joint_2", "plan configurations in which the load turns")),
    ({"verdict": "cannot_tell", "configurations": None},
     ("whether it has changed stays open: stiffness of joint_2", "measure again what is not known")),
    ({"verdict": "not_changed"}, None),
    ({"verdict": "cannot_tell", "quantity": "backlash", "configurations": None}, None),  # a reducer is judged beside
])  # fmt: skip
def test_what_has_changed_speaks_against_the_earlier_model(
    changes: dict[str, Any], said: tuple[str, str] | None
) -> None:
    row = QuantityChange("stiffness", "joint_2", 1e6, 8e5, "N*m/rad", -0.2, -0.25, -0.15, "changed", None, 0.05)
    rows = ((dataclasses.replace(row, **changes),),)
    found = reservations(Compared((), rows, (), (), {}, (), None, loaded=True))
    assert len(found) == (said is not None)
    if said is not None:
        assert found[0][0] == said[0]
        assert found[0][1].startswith(said[1])


@pytest.mark.parametrize(("changes", "said"), [
    ({}, "perhaps changed (certain of this one alone, not among all that were compared); 40 configurations each"),
    ({"high": 0.05}, "joint_2: -20.0 % (-25.0 to +5.0 %), cannot tell; 40 configurations each"),
    ({"high": 0.05, "configurations": 2648}, "cannot tell; more than 100 configurations each would tell"),
    ({"verdict": "changed", "configurations": None}, "(-25.0 to -15.0 %), changed"),
])  # fmt: skip
def test_an_interval_and_what_is_made_of_it_agree(changes: dict[str, Any], said: str) -> None:
    row = QuantityChange("stiffness", "joint_2", 1e6, 8e5, "N*m/rad", -0.2, -0.25, -0.15, "cannot_tell", 40, 0.05)
    assert said in described(dataclasses.replace(row, **changes))


def test_unknown_in_one_is_not_compared() -> None:
    found, _ = identified()
    estimate = compliances(found.estimate)
    covariance = estimate.covariance.copy()
    covariance[2], covariance[:, 2] = 0.0, 0.0
    covariance[2, 2] = np.inf
    rows = compare([measurement(estimate), measurement(dataclasses.replace(estimate, covariance=covariance))], LAW)[0]
    assert rows[2].verdict == "cannot_tell"
    assert rows[2].configurations is None
    assert not np.isfinite(rows[2].low)


def test_changes_that_look_alike_are_named_together() -> None:
    correlated = np.array([[1.0, -0.999, 0.0], [-0.999, 1.0, 0.0], [0.0, 0.0, 1.0]])
    truth = np.array([5.0, 0.0, 0.0])
    found = changes(truth, correlated, 3.3)
    assert set(found) == {0}
    confused = changes(np.array([2.6, 2.4, 0.0]) * 3, np.array([[1.0, 0.999, 0], [0.999, 1.0, 0], [0, 0, 1.0]]), 1e9)
    assert confused == {}


def test_a_trend_over_three_years() -> None:
    found, _ = identified()
    estimate = compliances(found.estimate)
    values = [estimate.value.copy() for _ in range(4)]
    for year, value in enumerate(values):
        value[1] /= 1 - 0.04 * year
    dates = ["2023-01-01", "2024-01-01", "2025-01-01", "2026-01-01"]
    series = [
        measurement(dataclasses.replace(estimate, value=value), date=date)
        for value, date in zip(values, dates, strict=True)
    ]
    slopes = {one.location: one for one in trends(series)}
    assert slopes["joint_2"].verdict == "changed"
    assert slopes["joint_2"].slope == pytest.approx(-0.042, rel=0.15)
    assert (1 + slopes["joint_2"].slope) ** 3 == pytest.approx(0.88, abs=0.005)  # what three years make of it
    assert slopes["joint_2"].low < slopes["joint_2"].slope < slopes["joint_2"].high
    assert [one.location for one in slopes.values() if one.verdict == "changed"] == ["joint_2"]
    assert trends(series[:2]) == ()
    assert trends([dataclasses.replace(one, date=None) for one in series]) == ()


@pytest.mark.parametrize(
    ("effect", "size"), [("backlash", 2e-4), ("hysteresis", 1e-4)]
)  # as the priors have them for a robot of this class
def test_lost_motion_is_found_beside_an_unchanged_stiffness(effect: str, size: float) -> None:
    """A reducer that lost motion: the law's size changes, and no false stiffness is named in its place."""
    nominal = nominal_parameters(small())
    torque = float(np.abs(reference_torques(measured(nominal, None), small(), nominal)[1]))
    variant, parameters = {
        "backlash": ("load torque, within 2 %", {"clearance": size}),
        "hysteresis": ("virgin start", {f"half_width_{r}_percent": size / 4 for r in ("2", "6", "15", "40")}),
    }[effect]
    worn = nominal.replace(
        effects=(AppliedEffect(effect, {"joint": "joint_2"}, variant, {**parameters, "reference_torque": torque}),)
    )
    both = []
    for parameters_of, seed in ((nominal, 71), (worn, 72)):
        readings = measured(parameters_of, seed)
        both.append((readings, identify(readings, small())))
    common = np.max([reference_torques(r, small(), one.model) for r, one in both], axis=0)
    rows = compare(
        [
            measurement(compliances(one.estimate), joint_laws(r, small(), one.model, common, one.noise.scale))
            for r, one in both
        ],
        LAW,
    )[0]
    changed = {(one.quantity, one.location): one for one in rows if one.verdict == "changed"}
    assert (effect, "joint_2") in changed
    assert changed[effect, "joint_2"].change > 0.3 * size
