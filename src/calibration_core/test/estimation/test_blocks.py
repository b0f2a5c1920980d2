"""Blocks of configurations: contiguous in time, or clusters of postures, whatever the configurations are called."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.estimation.blocks import STAYS, posture_blocks, time_blocks
from calibration_core.timeseries import in_time, numbers_in_time

CONFIGURATIONS, EACH = 60, 3


@pytest.fixture(params=[None, 4], ids=["numbers that grow", "numbers in any order"])
def configuration(request: pytest.FixtureRequest) -> np.ndarray:
    """Return the configuration of every reading, in the order of time."""
    numbers = np.arange(1, CONFIGURATIONS + 1)
    if request.param is not None:
        numbers = np.random.default_rng(request.param).permutation(5 * numbers)
    return np.repeat(numbers, EACH)


def test_configurations_are_counted_as_they_were_read(configuration: np.ndarray) -> None:
    np.testing.assert_array_equal(in_time(configuration), np.repeat(np.arange(CONFIGURATIONS), EACH))
    np.testing.assert_array_equal(numbers_in_time(configuration), configuration[::EACH])
    np.testing.assert_array_equal(in_time(np.array([7, 7, 2, 7, 2, 5])), [0, 0, 1, 0, 1, 2])


@pytest.mark.parametrize("most", [7, 10, CONFIGURATIONS, 100])
def test_blocks_in_time_are_contiguous_and_of_one_size(configuration: np.ndarray, most: int) -> None:
    blocks = time_blocks(configuration, most)
    assert blocks.count == min(most, CONFIGURATIONS)
    assert np.all(np.diff(blocks.label) >= 0)
    assert np.ptp(np.bincount(blocks.label)) <= EACH


def test_blocks_of_postures_are_those_that_stand_near_each_other(configuration: np.ndarray) -> None:
    """Four places in turn, so that no block is contiguous in time."""
    place = np.arange(CONFIGURATIONS) % 4
    near = np.random.default_rng(1).normal(0.0, 0.05, (CONFIGURATIONS, 6))
    q = np.repeat(np.array([[-1.5], [0.0], [1.2], [2.6]])[place] + near, EACH, axis=0)
    blocks = posture_blocks(q, configuration, 4)
    assert blocks.kind == "posture"
    pairs = np.unique(np.column_stack([np.repeat(place, EACH), blocks.label]), axis=0)
    assert len(pairs) == blocks.count == 4


def test_readings_that_stay_are_in_no_block_and_none_is_empty(configuration: np.ndarray) -> None:
    blocks = time_blocks(configuration, 10)
    stay = (blocks.label == 3) | (np.arange(len(configuration)) == 0)
    kept = blocks.keeping(stay)
    assert np.all(kept.label[stay] == STAYS)
    assert kept.count == 9
    assert np.all(np.bincount(kept.label[~stay]) > 0)
    together = kept.label[~stay][:, None] == kept.label[~stay]
    np.testing.assert_array_equal(together, blocks.label[~stay][:, None] == blocks.label[~stay])
