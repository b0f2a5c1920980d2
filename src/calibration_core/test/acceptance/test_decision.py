"""The decision rule of ISO 14253-1."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.acceptance.decision import decide, guard_factor, overall


def test_the_guard_band_lies_on_either_side_of_the_tolerance() -> None:
    assert guard_factor() == pytest.approx(1.6449, abs=1e-4)
    sizes = np.array([80e-6, 83.5e-6, 83.6e-6, 100e-6, 116.4e-6, 116.5e-6, 200e-6])
    decisions = decide(sizes, np.full(7, 10e-6), 100e-6)
    assert decisions == [
        "conforming", "conforming", "undecided", "undecided", "undecided", "not_conforming", "not_conforming"
    ]  # fmt: skip


def test_without_uncertainty_nothing_is_undecided() -> None:
    assert decide(np.array([1.0, 1.0 + 1e-12]), np.zeros(2), 1.0) == ["conforming", "not_conforming"]


def test_a_robot_that_is_wrong_is_seldom_said_to_conform() -> None:
    """Its error is the tolerance: it is said to conform in 5 % of cases at most, and not to conform in as many."""
    rng = np.random.default_rng(1)
    decisions = decide(1.0 + 0.1 * rng.standard_normal(20_000), np.full(20_000, 0.1), 1.0)
    for kind in ("conforming", "not_conforming"):
        assert decisions.count(kind) / 20_000 == pytest.approx(0.05, abs=0.006)


def test_the_whole() -> None:
    assert overall(["conforming", "conforming"]) == "conforming"
    assert overall(["conforming", "undecided"]) == "undecided"
    assert overall(["undecided", "not_conforming"]) == "not_conforming"
