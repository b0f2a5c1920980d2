"""Which of several recordings differs from the others: drawn from their covariances, with a change that is known."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.outcomes.together.agreement import agreement

NAMES = tuple(f"compliance.joint_{k}" for k in range(1, 7))
TRUE = np.array([5e-7, 4e-7, 5e-7, 2e-6, 2.5e-6, 3e-6])  # rad/(N*m)
RELATIVE = 0.01  # standard deviation of a compliance, before correlation


def shown(rng: np.random.Generator, compliance: np.ndarray) -> GaussianEstimate:
    mixing = np.eye(6) + 0.4 * rng.normal(size=(6, 6))
    covariance = RELATIVE**2 * np.outer(TRUE, TRUE) * (mixing @ mixing.T)
    return GaussianEstimate(NAMES, ("rad/(N*m)",) * 6, rng.multivariate_normal(compliance, covariance), covariance)


def several(seed: int, count: int, changed: int | None = None) -> tuple[list[str], list[GaussianEstimate]]:
    rng = np.random.default_rng(seed)
    softer = TRUE * np.where(np.arange(6) == 1, 1.15, 1.0)
    files = [f"{k}.csv" for k in range(count)]
    return files, [shown(rng, softer if k == changed else TRUE) for k in range(count)]


@pytest.mark.parametrize("count", [2, 3, 4])
def test_recordings_of_one_robot_agree(count: int) -> None:
    said = [agreement(*several(seed, count))[1] for seed in range(40)]
    assert sum(map(bool, said)) <= 1


@pytest.mark.parametrize(("count", "changed"), [(2, 1), (3, 0), (3, 1), (4, 2)])
def test_the_recording_that_differs_is_named_and_no_other(count: int, changed: int) -> None:
    """Beside a common mean that one of them spoils, the others would differ, too."""
    inside = 0
    for seed in range(20):
        compared, differing = agreement(*several(seed, count, changed))
        assert compared == NAMES
        assert [(one.file, one.location) for one in differing] == [(f"{changed}.csv", "joint_2")]
        inside += differing[0].low <= 1 / 1.15 - 1 <= differing[0].high
    assert inside >= 16


def test_what_one_recording_alone_knows_is_not_compared() -> None:
    rng = np.random.default_rng(0)
    first, second = shown(rng, TRUE), shown(rng, TRUE).chosen([0, 1])
    compared, differing = agreement(["a.csv", "b.csv"], [first, second])
    assert compared == NAMES[:2]
    assert differing == ()
    assert agreement(["a.csv", "b.csv"], [first, GaussianEstimate.nothing()]) == ((), ())
