"""What findings of every kind are made of: parameters in their units, what they are confounded with, what separates."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from calibration_core.diagnosis.result.finding import Alternative, FoundParameter, Location
from calibration_core.model.effects import effect_named
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.words import effect_sentence, effect_words
from calibration_core.timeseries import Float1D, Float2D


def found_parameters(
    candidate: Candidate, value: Float1D, covariance: Float2D, suffix: str = ""
) -> tuple[FoundParameter, ...]:
    """Return the parameters of an effect.

    Args:
        candidate: The effect.
        value: (k,) in the units of its parameters.
        covariance: (k, k).
        suffix: Of their names.
    """
    std = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    return tuple(
        FoundParameter(p.name + suffix, float(v), float(s), p.unit, 0.0 if p.positive else -math.inf)
        for p, v, s in zip(candidate.parameters, value, std, strict=True)
    )


def opening(effect: str, location: Location, more: str = "") -> str:
    """Return an effect and its place as the beginning of a sentence."""
    words = effect_sentence(effect, location) + more
    return words[0].upper() + words[1:]


def confounded_with(alternatives: Sequence[Alternative]) -> str:
    """Return what the recording cannot distinguish from a finding, as a further sentence; empty where nothing is."""
    if not alternatives:
        return ""
    names = "; ".join(effect_sentence(one.effect, one.location) for one in alternatives)
    return f" This recording cannot distinguish it from: {names}."


def separating(effects: Iterable[str]) -> str:
    """Return the measurements that would decide between effects, by name."""
    return "; ".join(f"{effect_words(name)}: {effect_named(name).reveal}" for name in dict.fromkeys(effects))
