"""What place and form of an effect leave open: by the dense algebra of two models, and of one with more parameters."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.estimation.alternatives import (
    UNEQUAL,
    fuller_form,
    instead,
    left_open,
    neglected,
    shares,
)
from calibration_core.model.effects.candidate import Candidate, Parameter

ROWS, OTHERS = 60, 4
VARIANCE = 2.0


def _solved(columns: np.ndarray, precision: np.ndarray, data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    normal = columns.T @ columns + np.diag(precision)
    return np.linalg.solve(normal, columns.T @ data), VARIANCE * np.linalg.inv(normal)


@pytest.mark.parametrize("alias", [True, False])
def test_another_effect_in_the_stead_of_one_changes_the_others_as_a_fit_of_it_says(alias: bool) -> None:
    rng = np.random.default_rng(1)
    others, one = rng.normal(size=(ROWS, OTHERS)), rng.normal(size=(ROWS, 1))
    other = np.column_stack([one[:, 0] + others[:, 0], others[:, 1]]) if alias else rng.normal(size=(ROWS, 2))
    data = others @ [1.0, 2.0, 3.0, 4.0] + 5.0 * one[:, 0] + rng.normal(size=ROWS)
    columns = np.column_stack([others, one])
    precision = np.array([0.0] * OTHERS + [0.01])
    value, covariance = _solved(columns, precision, data)
    moved = one @ value[OTHERS:]
    ways = instead(
        columns.T @ columns + np.diag(precision),
        np.array([OTHERS]),
        columns.T @ moved,
        columns.T @ other,
        other.T @ other + 0.01 * np.eye(2),
        other.T @ (data - others @ value[:OTHERS]),
        VARIANCE,
    )
    swapped, wider = _solved(np.column_stack([others, other]), np.array([0.0] * OTHERS + [0.01] * 2), data)
    np.testing.assert_allclose(value[:OTHERS] + ways[:OTHERS, 0], swapped[:OTHERS], rtol=1e-5, atol=1e-5)
    assert not ways[OTHERS].any()
    more = ways[:OTHERS, 1:] @ ways[:OTHERS, 1:].T
    less_known = wider[:OTHERS, :OTHERS] - covariance[:OTHERS, :OTHERS]
    assert np.linalg.eigvalsh(more - less_known).min() > -1e-6 * np.abs(less_known).max()
    if alias:  # what the second column does, nothing can tell from the second parameter
        assert more[1, 1] == pytest.approx(VARIANCE / 0.01, rel=0.05)


def test_what_is_neglected_is_as_if_it_had_been_fitted_with_its_size() -> None:
    rng = np.random.default_rng(2)
    columns, more = rng.normal(size=(ROWS, OTHERS)), rng.normal(size=(ROWS, 2))
    more[:, 1] = columns[:, 1]
    data = columns @ [1.0, 2.0, 3.0, 4.0] + more[:, 0] + rng.normal(size=ROWS)
    value, covariance = _solved(columns, np.full(OTHERS, 1e-9), data)
    rest = data - columns @ value
    ways = left_open(
        columns.T @ columns + 1e-9 * np.eye(OTHERS), VARIANCE, columns.T @ more, more.T @ more, more.T @ rest
    )
    whole = np.column_stack([columns, more])
    fitted, wider = _solved(whole, np.array([1e-9] * OTHERS + [VARIANCE] * 2), data)
    off = fitted[:OTHERS] - value
    expected = wider[:OTHERS, :OTHERS] - covariance + np.outer(off, off)
    np.testing.assert_allclose(ways @ ways.T, expected, atol=1e-6 * np.abs(expected).max())


def test_one_size_stands_for_several_that_leave_their_sum_alone() -> None:
    rng = np.random.default_rng(3)
    x, y, xy = rng.normal(size=(3, ROWS))
    fuller = _form("before", 3)
    columns = neglected((x + y)[:, None], np.stack([x, y, xy], axis=1), _form("isotropic", 1), fuller, np.array([2.0]))
    assert columns.shape == (ROWS, 2)
    span = np.linalg.lstsq(columns, np.stack([x - y, xy], axis=1), rcond=None)[1]
    np.testing.assert_allclose(span, 0.0, atol=1e-20)
    assert np.linalg.norm(np.linalg.lstsq(columns, x - y, rcond=None)[0]) == pytest.approx(2**0.5 / (2 * UNEQUAL))


def test_the_fuller_form_is_that_of_the_same_place_and_kind() -> None:
    mine, fuller = _form("isotropic", 1), _form("before", 3)
    elsewhere, other_end = _form("before", 3, joint="b"), _form("before", 3, shape=True)
    assert fuller_form(mine, [mine, elsewhere, other_end, fuller]) is fuller
    assert fuller_form(mine, [mine, elsewhere]) is None
    assert fuller_form(fuller, [mine, fuller]) is None


def test_places_share_the_probability_and_none_is_more_probable_than_the_one_taken() -> None:
    np.testing.assert_allclose(shares([0.0, 3.0]), [1 / 3, 1 / 3])
    np.testing.assert_allclose(shares([-np.log(2.0)]), [1 / 3])
    assert len(shares([])) == 0


def _form(variant: str, sizes: int, joint: str = "a", *, shape: bool = False) -> Candidate:
    parameters = tuple(Parameter(f"compliance_{k}", "rad/(N*m)", 1e-7) for k in range(sizes))
    place = {"joint": joint}
    return Candidate("off_axis_compliance", "structure", place, variant, parameters, lambda _: None, shape=shape)
