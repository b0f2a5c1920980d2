"""What a log Bayes factor is called."""

from __future__ import annotations

import pytest

from calibration_core.diagnosis.result.finding import evidence_words, odds_words


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (-2.0, "hardly any evidence"),
        (1.5, "positive evidence"),
        (3.0, "strong evidence"),
        (12.3, "very strong evidence"),
        (7489.0, "overwhelming evidence"),
    ],
)
def test_words(value: float, words: str) -> None:
    assert evidence_words(value) == words


@pytest.mark.parametrize(
    ("value", "words"),
    [(-1.0, "0.4-fold"), (0.0, "1.0-fold"), (2.5, "12-fold"), (6.9, "992-fold"), (800.0, "more than 1,000-fold")],
)
def test_odds(value: float, words: str) -> None:
    assert odds_words(value) == words
