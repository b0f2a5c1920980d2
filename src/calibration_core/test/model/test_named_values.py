"""Every number of a model has a name, under which it is found and changed."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.model.chain import pose_matrix
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.named_values import unit_of, value_of, with_values
from calibration_core.model.parameters import AppliedEffect, ModelParameters

POSE = np.array([0.1, -0.2, 0.3, 0.4, -0.5, 0.6])


def model() -> ModelParameters:
    return ModelParameters(
        joints=("a.b", "c"),
        compliance=np.array([1e-6, 2e-6]),
        geometry=np.arange(12.0).reshape(2, 6) * 1e-4,
        tracker=pose_matrix(POSE[:3], POSE[3:]),
        points={"p.1": np.array([1.0, 2.0, 3.0])},
        wrench_point=np.array([4.0, 5.0, 6.0]),
        force_torque=pose_matrix(POSE[:3], POSE[3:]),
        effects=(AppliedEffect("creep", {"joint": "c"}, "30 s", {"creep_share": 0.1}),),
    )


EVERYTHING = (
    ("compliance.a.b", 1e-6, "rad/(N*m)"),
    ("compliance.c", 2e-6, "m/N"),
    ("geometry.a.b.rz", 5e-4, "rad"),
    ("geometry.c.y", 7e-4, "m"),
    ("tracker.y", -0.2, "m"),
    ("tracker.pitch", -0.5, "rad"),
    ("force_torque.roll", 0.4, "rad"),
    ("measurement_points.p.1.z", 3.0, "m"),
    ("wrench_point.x", 4.0, "m"),
    ("effects.0.creep_share", 0.1, None),
)


@pytest.mark.parametrize(("name", "value", "unit"), EVERYTHING)
def test_a_number_is_found_and_changed_by_its_name_and_no_other_with_it(name: str, value: float, unit: str) -> None:
    before = model()
    assert value_of(before, name) == pytest.approx(value, rel=1e-12)
    after = with_values(before, {name: 0.25})
    assert value_of(after, name) == pytest.approx(0.25, rel=1e-12)
    for other, same, _ in EVERYTHING:
        if other != name:
            assert value_of(after, other) == pytest.approx(same, rel=1e-12)
    if unit is not None:
        assert unit_of(name, {"a.b": False, "c": True}) == unit


@pytest.mark.parametrize(
    "name",
    ["", "compliance", "compliance.d", "geometry.c.q", "geometry.c", "tracker.rx", "effects.1.creep_share",
     "effects.0.x", "effects.-1.creep_share", "measurement_points.p.x", "stiffness.c", "wrench_point.p.x"],
)  # fmt: skip
def test_what_the_model_does_not_have_is_refused(name: str) -> None:
    with pytest.raises(KeyError):
        value_of(model(), name)
    with pytest.raises(KeyError):
        with_values(model(), {name: 1.0})


def test_compliances_do_not_become_negative() -> None:
    assert value_of(with_values(model(), {"compliance.c": -1.0}), "compliance.c") == 0.0


def test_a_root_of_the_covariance_leaves_out_what_is_unknown() -> None:
    covariance = np.array([[4.0, 1e-4, 0.0], [1e-4, 1e-8, 0.0], [0.0, 0.0, np.inf]])
    estimate = GaussianEstimate(("x", "y", "z"), ("m", "rad", "m"), np.zeros(3), covariance)
    root = estimate.root()
    expected = np.where(np.isinf(covariance), 0.0, covariance)
    np.testing.assert_allclose(root @ root.T, expected, rtol=1e-12, atol=1e-20)
    assert estimate.unknown == ("z",)
    assert estimate.chosen([2, 0]).names == ("z", "x")
    both = GaussianEstimate.independent((estimate, estimate.renamed(("u", "v", "w"))))
    assert both.covariance.shape == (6, 6)
    assert not both.covariance[:3, 3:].any()
