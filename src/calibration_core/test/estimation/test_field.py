"""Rows and hypotheses: what two searches of the same rows have in common is taken over, and gives the same numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from calibration_core.estimation.blocks import Blocks
from calibration_core.estimation.field import Field
from calibration_core.estimation.hypotheses import offer
from calibration_core.estimation.likelihood.restricted import Sizes
from calibration_core.model.effects.candidate import Candidate, Parameter
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float2D, Float3D

READINGS, FLAT, USUAL, COUNTS = 60, 4, 2, (1, 3, 2, 1, 4, 2)


def _nothing(state: State) -> Float3D:
    return np.zeros((state.m, 3, 0))


def _candidates() -> list[Candidate]:
    return [
        Candidate("bending", "structure", {"joint": f"joint_{k}"}, "", (Parameter("p", "1", 1.0),) * count, _nothing)
        for k, count in enumerate(COUNTS)
    ]


@pytest.mark.parametrize(
    ("first", "then"),
    [((0, 1, 2, 3), (4, 0, 1, 2, 3)), ((0, 1, 2, 3, 4), (1, 2, 5, 4)), ((0, 1), (2, 3)), ((3, 1, 5), (5, 0, 1, 3))],
)
def test_a_field_that_offers_something_else_is_that_of_a_fresh_start(
    first: tuple[int, ...], then: tuple[int, ...]
) -> None:
    rng, candidates = np.random.default_rng(5), _candidates()
    residual, flat, usual = (rng.standard_normal((3 * READINGS, k)) for k in (1, FLAT, USUAL))
    columns = [rng.standard_normal((3 * READINGS, k)) for k in COUNTS]
    columns[3] = flat[:, :1] + 1e-4 * columns[3]  # which the null model takes up
    columns[4][:, 1] = flat[:, 1]
    partitions = (Blocks("time", np.arange(READINGS) // 6), Blocks("posture", np.arange(READINGS) % 10))

    def of(chosen: Sequence[Candidate]) -> Float2D:
        return np.column_stack([np.zeros((3 * READINGS, 0)), *(columns[candidates.index(one)] for one in chosen)])

    def field(chosen: Sequence[int]) -> Field:
        some = [candidates[k] for k in chosen]
        return Field.of(residual[:, 0], flat, usual, [of(some)], offer(some), partitions)

    fresh, found = field(then), field(first).offering(offer([candidates[k] for k in then]), of)
    assert np.array_equal(found.clear, fresh.clear)
    assert not found.clear.all() or not {3, 4} & set(then)
    np.testing.assert_allclose(found.wide, fresh.wide, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.gram.matrix, fresh.gram.matrix, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.gram.vector, fresh.gram.vector, rtol=0, atol=1e-10)
    assert found.gram.freedom == fresh.gram.freedom
    for accepted in ((0,), (1, 2)) if len(then) > 2 else ((0,), (1,)):
        sizes = Sizes(1.2, np.full(len(accepted), 0.7), 0.0)
        errors = (one.left_out(accepted, sizes).errors for one in (found, fresh))
        for taken, made in zip(*errors, strict=True):
            np.testing.assert_allclose(taken, made, rtol=0, atol=1e-10)


def test_products_of_columns_are_those_of_the_rows() -> None:
    rng, candidates = np.random.default_rng(6), _candidates()
    residual, flat = rng.standard_normal(3 * READINGS), rng.standard_normal((3 * READINGS, FLAT))
    columns = rng.standard_normal((3 * READINGS, sum(COUNTS)))
    columns[:, 0] = flat[:, 2]  # nothing of it is left
    offered = offer(candidates)
    partition = (Blocks("time", np.arange(READINGS) // 6),)
    field = Field.of(residual, flat, np.zeros((3 * READINGS, 0)), [columns], offered, partition)
    for own in (np.arange(1, 5), np.arange(4)):
        chosen = field.wide[:, [*range(FLAT), *(FLAT + own)]]
        np.testing.assert_allclose(field.products(chosen, own), chosen.T @ chosen, rtol=0, atol=1e-10)
