"""A compliance that cannot be negative gives a stiffness with finite ends, and the usual one where it is well known."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.identification.result.observability import joint_stiffness, positive_quantile


@pytest.mark.parametrize("mean", [-40.0, -31.0, -29.0, -3.0, 0.0, 0.5, 2.0, 8.0])
@pytest.mark.parametrize("probability", [0.025, 0.5, 0.975])
def test_the_quantiles_are_those_of_the_normal_distribution_above_zero(mean: float, probability: float) -> None:
    from scipy.stats import truncnorm  # slow to load

    true = truncnorm.ppf(probability, -mean, np.inf, loc=mean)
    assert positive_quantile(3.0 * mean, 3.0, probability) == pytest.approx(3.0 * true, rel=3e-3)


def test_a_compliance_at_its_bound_gives_a_finite_stiffness() -> None:
    joint = joint_stiffness("a", 0.0, 1e-6, centre=-1e-6)
    assert 0 < joint.interval[0] < joint.value < joint.interval[1] < np.inf
    assert np.isfinite(joint.std)


def test_a_well_known_compliance_gives_the_usual_interval() -> None:
    joint = joint_stiffness("a", 1e-6, 1e-8)
    assert joint.value == pytest.approx(1e6)
    assert joint.std == pytest.approx(1e4)
    assert joint.interval == pytest.approx((1 / 1.0196e-6, 1 / 0.9804e-6), rel=1e-5)


def test_where_nothing_is_known_nothing_is_stated() -> None:
    assert joint_stiffness("a", 1e-6, np.inf, identifiable=False).interval == (0.0, np.inf)


def test_a_compliance_that_may_be_zero_tells_the_least_stiffness_alone() -> None:
    joint = joint_stiffness("a", 1e-6, 0.6e-6)
    assert not joint.identifiable
    assert joint.interval[0] == pytest.approx(4.57e5, rel=1e-3)
    assert joint.reason.endswith("the stiffness is at least 4.6·10⁵ N·m/rad")
    assert joint.interval[0] == pytest.approx(1 / positive_quantile(1e-6, 0.6e-6, 0.975))
    known = joint_stiffness("a", 1e-6, 0.4e-6)
    assert known.identifiable
    assert not known.reason
