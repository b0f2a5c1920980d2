"""What a recording that was not fitted says of two models."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration_core.identification.checks.noise_audit import overstated
from calibration_core.identification.result.estimate import NoiseAudit, NoiseCheck
from calibration_core.identification.result.tested import TestPart, TestResult

NOISE = 2e-5  # m
READINGS = 120


def judged(*errors: NDArray[np.float64]) -> TestResult:
    """Return the figures of a test under load whose errors are these, (m, 3) m each."""
    whole = np.concatenate(errors)
    parts = tuple(TestPart.of("loaded", 10, one, one) for one in errors)
    figures = {key: getattr(parts[0], key) for key in ("rms", "mean", "maximum", "rms_before", "mean_before")}
    return TestResult("other.csv", len(whole), **figures, parts=parts)


def drawn(seed: int, size: float) -> NDArray[np.float64]:
    return size * np.random.default_rng(seed).standard_normal((READINGS, 3))


def test_an_error_beyond_the_noise_is_told_of_the_parts_that_count() -> None:
    assert judged(drawn(1, 2 * NOISE)).beyond(NOISE, ("loaded",)) is not None
    assert judged(drawn(1, 2 * NOISE)).beyond(NOISE, ("at_rest",)) is None
    assert judged(drawn(1, NOISE)).beyond(NOISE, ("loaded",)) is None


@pytest.mark.parametrize("seed", range(20))
def test_a_model_is_called_worse_beyond_the_noise_alone(seed: int) -> None:
    noise = drawn(seed, NOISE)
    standard, alike, worse = (judged(noise + drawn(seed + 100, more * NOISE)) for more in (0.0, 0.1, 1.0))
    assert alike.worse(standard, NOISE) is None
    assert worse.worse(standard, NOISE) is not None
    assert standard.worse(worse, NOISE) is None


@pytest.mark.parametrize(("left", "words"), [(0.0, "computed"), (0.2, "share their noise"), (0.9, "")])
def test_positions_at_rest_that_scatter_less_than_is_claimed_are_told(left: float, words: str) -> None:
    """Noise that lasts is no computation: what is computed leaves nothing."""
    audit = NoiseAudit(NOISE, (NoiseCheck("residual", left * NOISE, 300),), 1.0, False, "")
    texts = [one.text for one in overstated(audit)]
    assert len(texts) == bool(words)
    assert all(words in text for text in texts)
