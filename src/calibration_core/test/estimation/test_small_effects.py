"""Small effects as part of the noise, against the dense covariance."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.estimation.blocks import Blocks
from calibration_core.estimation.comparisons import STEPS
from calibration_core.estimation.field import Field
from calibration_core.estimation.hypotheses import offer
from calibration_core.estimation.likelihood.gains import (
    LEVELS,
    Grouped,
    SmallEffects,
    best_gains,
    likelihood_at,
    most_probable,
    shared_power,
    visible,
)
from calibration_core.estimation.likelihood.restricted import Sizes, price
from calibration_core.estimation.search import Search
from calibration_core.model.effects.candidate import Candidate, Parameter
from calibration_core.model.effects.state import State
from calibration_core.timeseries import Float1D, Float3D

READINGS, PLACES, FLAT = 60, 8, 3


def nothing(state: State) -> Float3D:
    return np.zeros((state.m, 3, 0))


def candidate(number: int, variant: str, count: int) -> Candidate:
    parameters = tuple(Parameter(f"p{k}", "1", 1.0) for k in range(count))
    return Candidate(f"effect_{number}", "structure", {"joint": f"joint_{number}"}, variant, parameters, nothing)


def field(seed: int, truth: dict[int, float], crowd: float = 0.0, places: int = PLACES) -> Field:
    """Return random rows; the crowd moves them by a signal-to-noise ratio at every place."""
    rng = np.random.default_rng(seed)
    offered = offer([candidate(k, form, n) for k in range(places) for form, n in (("short", 1), ("long", 2))])
    flat, columns = rng.standard_normal((3 * READINGS, FLAT)), rng.standard_normal((3 * READINGS, offered.count))
    residual = rng.standard_normal(3 * READINGS)
    unit = shared_power(np.einsum("ij,ij->j", columns, columns), offered.candidates, offered.blocks)
    residual = residual + columns @ (crowd * unit * rng.standard_normal(offered.count))
    for column, value in truth.items():
        residual = residual + value * columns[:, column]
    blocks = Blocks("time", np.arange(READINGS) * 10 // READINGS)
    return Field.of(residual, flat, np.zeros((len(residual), 0)), [columns], offered, (blocks,))


def dense(rows: Field, sizes: Sizes, several: list[np.ndarray], weight: Float1D) -> float:
    """Return the restricted log likelihood from the covariance of all contrasts (Patterson and Thompson 1971)."""
    flat, columns = rows.wide[:, :FLAT], rows.wide[:, FLAT:]
    contrast = np.linalg.svd(flat)[0][:, FLAT:]
    covariance = np.eye(len(flat)) + (columns * weight**2) @ columns.T
    covariance = sizes.variance * covariance
    for size, block in zip(sizes.size, several, strict=True):
        own = columns[:, block]
        covariance = covariance + size**2 * own @ own.T
    seen, inner = contrast.T @ rows.residual, contrast.T @ covariance @ contrast
    return float(-0.5 * (np.linalg.slogdet(inner)[1] + seen @ np.linalg.solve(inner, seen)) - price(sizes.size).sum())


@pytest.mark.parametrize("crowd", [0.0, 4.0])
def test_levels_are_compared_by_the_dense_likelihood(crowd: float) -> None:
    rows = field(1, {2: 1.0}, crowd)
    blocks = rows.blocks((1,))
    fits = SmallEffects(rows.gram, rows.offered, LEVELS).fits(blocks, None)
    assert [fit.level for fit in fits] == list(LEVELS[: len(fits)])
    unit = shared_power(np.diag(rows.gram.matrix), rows.offered.candidates, rows.offered.blocks)
    for fit in fits:
        weight = np.minimum(fit.level * unit, 1.0)
        assert fit.sizes.value == pytest.approx(dense(rows, fit.sizes, blocks, weight), abs=1e-4)
    best = most_probable(fits)
    assert best.sizes.value == max(fit.sizes.value for fit in fits)
    assert best.level <= 1.0 if crowd == 0 else 2.0 <= best.level <= 6.5


def test_a_gain_is_by_how_much_the_best_level_with_it_is_above_the_best_without() -> None:
    rows = field(2, {2: 0.8, 7: 0.3}, 2.0)
    fits = SmallEffects(rows.gram, rows.offered, LEVELS).fits(rows.blocks((0,)), None)
    found = best_gains(fits, Grouped.of(rows.blocks((1, 5))))
    unit = shared_power(np.diag(rows.gram.matrix), rows.offered.candidates, rows.offered.blocks)
    known = most_probable(fits).sizes
    for k, index in enumerate((1, 5)):
        size = found.size[k] * np.sqrt(found.left[k])
        values = []
        for fit in fits:
            weight = np.minimum(fit.level * unit, 1.0)
            for variance in known.variance * found.left[k] * np.linspace(0.9, 1.1, 21):
                shrunk = fit.sizes.size * np.sqrt(variance / fit.sizes.variance)
                both = Sizes(float(variance), np.append(shrunk, size), 0.0)
                values.append(dense(rows, both, rows.blocks((0, index)), weight))
        assert found.nats[k] == pytest.approx(max(values) - known.value, abs=0.5)  # sizes lie on a grid


def test_what_is_visible_is_the_movement_beyond_the_small_effects() -> None:
    rows = field(3, {2: 2.0})
    fits = SmallEffects(rows.gram, rows.offered, LEVELS).fits([], None)
    level, seen = visible(fits, rows.blocks((1,))[0])
    assert level == 0.0
    own = np.linalg.norm(rows.wide[:, FLAT + 2] * 2.0)
    assert seen == pytest.approx(own, rel=0.1)


def test_of_equal_explanations_the_usual_size_is_the_more_probable() -> None:
    """The same movement of the points, in columns for which it is large, and in others for which it is tiny."""
    rows = field(4, {2: 2.0})
    fits = SmallEffects(rows.gram, rows.offered, LEVELS).fits([], None)
    wide = rows.wide.copy()
    wide[:, FLAT + 5] = 30.0 * wide[:, FLAT + 2]
    other = Field.of(
        rows.residual, wide[:, :FLAT], np.zeros((len(wide), 0)), [wide[:, FLAT:]], rows.offered, rows.partitions
    )
    fits = SmallEffects(other.gram, other.offered, LEVELS).fits([], None)
    assert likelihood_at(fits, np.array([2]), 3.0) > likelihood_at(fits, np.array([5]), 3.0) + 2.0


def test_one_large_effect_stands_out_and_a_crowd_does_not() -> None:
    for seed in range(10):
        rows = field(seed, {5: 3.0})
        alone = Search(rows, lambda _: "", STEPS).run()
        assert [rows.offered.hypotheses[i].location for i in alone.accepted] == [{"joint": "joint_1"}]
        assert alone.level <= 1.0
        assert Search(field(seed, {}, 3.0), lambda _: "", STEPS).run().accepted == ()


def test_two_large_effects_that_hide_each_other_are_found_together() -> None:
    found = 0
    for seed in range(10):
        rows = field(20 + seed, {2: 1.0, 11: 1.0, 17: 1.0}, places=30)
        selection = Search(rows, lambda _: "", STEPS).run()
        places = {rows.offered.hypotheses[i].location["joint"] for i in selection.accepted}
        found += places == {"joint_0", "joint_3", "joint_5"}
    assert found >= 9
