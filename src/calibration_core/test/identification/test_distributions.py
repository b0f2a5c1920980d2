"""Tails and quantiles agree with the reference implementation of `scipy.stats`."""

from __future__ import annotations

import pytest

from calibration_core.identification import statistics as distributions


@pytest.mark.parametrize("probability", [1e-9, 0.01, 0.5, 0.975])
@pytest.mark.parametrize("freedom", [1, 3, 40, 33_000])
def test_quantiles(probability: float, freedom: int) -> None:
    from scipy import stats  # slow to load

    assert distributions.student_quantile(probability, freedom) == pytest.approx(stats.t.ppf(probability, freedom))
    assert distributions.chi2_limit(probability, freedom) == pytest.approx(stats.chi2.isf(probability, freedom))
    assert distributions.f_limit(probability, 3, freedom) == pytest.approx(
        stats.f.isf(probability, 3, freedom), rel=1e-6
    )
    assert distributions.normal_quantile(probability) == pytest.approx(stats.norm.ppf(probability))


@pytest.mark.parametrize(("value", "freedom"), [(0.3, 2), (7.8, 3), (1200.0, 1000)])
def test_tails(value: float, freedom: int) -> None:
    from scipy import stats  # slow to load

    assert distributions.chi2_tail(value, freedom) == pytest.approx(stats.chi2.sf(value, freedom))
    assert distributions.f_tail(value / freedom, freedom, 25) == pytest.approx(stats.f.sf(value / freedom, freedom, 25))
