"""Evidence in words: what a log Bayes factor is called (Kass and Raftery, 1995, on their scale of twice its value)."""

from __future__ import annotations

import math

SCALE = ((100.0, "overwhelming"), (5.0, "very strong"), (3.0, "strong"), (1.0, "positive"))
UNSETTLED = " The joint and the kind of cause are settled, the form of its law is not: another law remains beside it."
OF_ANY_LAW = (
    " The joint and the kind of cause are settled, the form of its law is not: it is none of the catalogue's, or an "
    "error of the joint's gear is part of it."
)
MOST = 1_000  # of odds, of which nobody needs the number


def evidence_words(log_bayes_factor: float) -> str:
    """Return for example `very strong evidence`."""
    return next((word for least, word in SCALE if log_bayes_factor >= least), "hardly any") + " evidence"


def odds_words(log_bayes_factor: float) -> str:
    """Return by what a log Bayes factor, nats, changes the odds of two explanations, for example `12-fold`."""
    if log_bayes_factor > math.log(MOST):
        return f"more than {MOST:,}-fold"
    factor = math.exp(log_bayes_factor)
    return f"{factor:.0f}-fold" if factor >= 10.0 else f"{factor:.1f}-fold"
