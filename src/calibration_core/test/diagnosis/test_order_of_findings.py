"""Findings stand by their size, largest first; what is confounded with one stands by how near it comes."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

from calibration_core.diagnosis.result.finding import by_size
from calibration_core.estimation.alternatives import nearest_first


def test_the_largest_effect_on_the_measured_points_is_first() -> None:
    several = [SimpleNamespace(magnitude=size) for size in (2e-5, 5e-4, 1e-4)]
    for order in itertools.permutations(several):
        assert [one.magnitude for one in by_size(order)] == [5e-4, 1e-4, 2e-5]


def test_the_nearest_alternative_is_first_on_either_side() -> None:
    for order in itertools.permutations([(7, 96.0), (3, 101.5), (5, 99.0)]):
        assert nearest_first(order, 100.0) == ((5, 99.0), (3, 101.5), (7, 96.0))
