"""Physics beyond the joint springs: effects stand in files by family, and adding a file registers those in it."""

from __future__ import annotations

import functools
import importlib
import pkgutil

from calibration_core.model.effects.candidate import Candidate, Effect, Trait
from calibration_core.model.effects.recordings import in_each_recording
from calibration_core.model.effects.state import State


@functools.cache
def catalogue() -> tuple[Effect, ...]:
    """Return every effect that a file of this folder or below defines, by name."""
    names = [info.name for info in pkgutil.walk_packages(__path__, f"{__name__}.")]
    every = (value for name in names for value in vars(importlib.import_module(name)).values())
    found = {effect.name: effect for effect in every if isinstance(effect, Effect)}
    return tuple(found[name] for name in sorted(found))


def effect_named(name: str) -> Effect:
    """Return the effect of the catalogue with this name; raises StopIteration where there is none."""
    return next(effect for effect in catalogue() if effect.name == name)


@functools.cache
def effects_with(trait: Trait) -> frozenset[str]:
    """Return the names of the effects of the catalogue that have a property."""
    return frozenset(effect.name for effect in catalogue() if effect.has(trait))


def sizes_are_relative(candidate: Candidate, state: State) -> bool:
    """Say whether sizes are relative: what the weight alone drives, while masses are guesses or not known."""
    known = state.chain.mass is not None and state.chain.inertials_known
    return not known and not state.loaded and candidate.effect in effects_with(Trait.BY_WEIGHT)


def candidates(state: State) -> tuple[Candidate, ...]:
    """Return every hypothesis that this recording could test, in the order of the catalogue."""
    usable = [effect for effect in catalogue() if (effect.loaded if state.loaded else effect.absolute)]
    found = [candidate for effect in usable for candidate in effect.candidates(state)]
    return in_each_recording(found, state)
