"""Which configurations of a recording were loaded."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibration_core.observations.kinds import loaded_configurations, unloaded_visits
from calibration_core.timeseries import Provenance, Readings

UNBIASED = np.zeros(6)
TOOL = np.array([0.0, 0.0, -300.0, 0.0, 0.0, 0.0])  # N, its weight
NOISE = 1.0  # N


def recorded(forces: list[list[float]], offset: np.ndarray = UNBIASED) -> Readings:
    """Return a recording of one point with a pull along z at every step of every configuration, N."""
    rows = [(k, step, force) for k, steps in enumerate(forces) for step, force in enumerate(steps)]
    wrench = np.zeros((len(rows), 6))
    wrench[:, 2] = [-force for _, _, force in rows]
    wrench[:, :3] += NOISE * np.random.default_rng(0).standard_normal((len(rows), 3))
    return Readings(
        points=("p",),
        configuration=np.array([row[0] for row in rows]),
        step=np.array([row[1] for row in rows]),
        point=np.zeros(len(rows), dtype=int),
        q=np.zeros((len(rows), 6)),
        position=np.zeros((len(rows), 3)),
        wrench=wrench + offset,
        time=np.arange(len(rows), dtype=float),
        temperature=np.full(len(rows), 20.0),
        provenance=Provenance("simulated.csv", "csv", {}, {}),
    )


@pytest.mark.parametrize("offset", [UNBIASED, TOOL])
def test_a_reference_that_is_visited_without_load_is_no_loaded_configuration(offset: np.ndarray) -> None:
    found = recorded([[0.0] * 6, [0.0, 900.0, 1800.0], [0.0, 1200.0], [0.0]], offset)
    assert loaded_configurations(found) == [0, 1, 2]
    assert unloaded_visits(found) == [0]


@pytest.mark.parametrize("forces", [[[900.0, 900.0], [1800.0, 0.0]], [[900.0, 1800.0], [1800.0, 900.0]]])
def test_equal_loads_are_loads(forces: list[list[float]]) -> None:
    assert unloaded_visits(recorded(forces)) == []


def test_nothing_is_without_load_where_nothing_was_loaded_or_recorded() -> None:
    assert unloaded_visits(dataclasses.replace(recorded([[0.0], [0.0, 900.0]]), wrench=None)) == []
    still = recorded([[0.0, 0.0], [0.0, 0.0]])
    assert still.wrench is not None
    assert unloaded_visits(dataclasses.replace(still, wrench=np.zeros_like(still.wrench))) == []


def test_each_of_several_recordings_is_judged_by_its_own_force() -> None:
    two = recorded([[0.0, 0.0], [0.0, 2000.0], [5.0, 5.0], [5.0, 60.0]])
    assert unloaded_visits(two) == [0, 2]
    strong = np.isin(two.configuration, [0, 1])
    assert unloaded_visits(dataclasses.replace(two, recording=np.where(strong, 0, 1))) == [0]
