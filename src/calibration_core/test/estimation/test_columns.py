"""Columns that are kept as levers and angles answer as the same columns written out."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.estimation.columns import Columns, Effects, Turns, rows_of_readings

READINGS = 12
PLACES = (np.array([3, 0]), np.array([1, 5, 2]), np.array([4]))  # of columns held as they are, and of two joints


@pytest.fixture(scope="module")
def example() -> tuple[Columns, np.ndarray, np.random.Generator]:
    rng = np.random.default_rng(1)
    turns = tuple(
        Turns(place, rng.standard_normal((READINGS, 3)), rng.standard_normal((READINGS, len(place))))
        for place in PLACES[1:]
    )
    flat, whole = rng.standard_normal((3 * READINGS, 4)), rng.standard_normal((3 * READINGS, 2))
    written = np.empty((3 * READINGS, 6))
    written[:, PLACES[0]] = whole
    for one in turns:
        written[:, one.place] = (one.lever[:, :, None] * one.angle[:, None]).reshape(3 * READINGS, -1)
    return Columns(flat, Effects(PLACES[0], whole, turns)), np.concatenate([flat, written], axis=1), rng


@pytest.mark.parametrize("readings", [slice(0, READINGS), slice(3, 7), np.array([8, 2, 5]), np.array([], dtype=int)])
def test_they_answer_as_if_they_were_written_out(
    example: tuple[Columns, np.ndarray, np.random.Generator], readings: slice | np.ndarray
) -> None:
    columns, whole, rng = example
    some, written = columns.rows(readings), rows_of_readings(whole, readings)
    value, rows = rng.standard_normal(10), rng.standard_normal((len(written), 5))
    assert np.allclose(some.moved(value), written @ value)
    assert np.allclose(some.against(rows[:, 0]), written.T @ rows[:, 0])
    assert np.allclose(some.against(rows), written.T @ rows)
    assert np.allclose(some.products(), written.T @ written)
    assert np.allclose(some.products(some.effects.products), written.T @ written)
