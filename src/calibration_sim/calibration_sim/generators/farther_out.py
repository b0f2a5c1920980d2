"""Effects of an arm that stands on further axes: the same effects, joints and links counted from there."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from calibration_sim.effect_models.effect import Effect

INDICES = frozenset({"joint", "link", "other", "driver", "last"})  # attributes of laws that count joints or links


def farther_out(effect: Effect, by: int) -> Effect:
    """Return an effect of a six-axis arm with all its joints and links counted `by` farther from the base.

    Exact aliases are those of an arm on the ground, and are left out.
    """
    moved: dict[str, Any] = {}
    for field in dataclasses.fields(effect):
        value = getattr(effect, field.name)
        if field.name in INDICES:
            moved[field.name] = value + by
        elif field.name == "joints":
            moved[field.name] = tuple(index + by for index in value)
    location = {key: _renamed(value, by) for key, value in effect.label.location.items()}
    label = dataclasses.replace(effect.label, location=location, equivalent=())
    return dataclasses.replace(effect, label=label, **moved)


def _renamed(value: str | list[str], by: int) -> str | list[str]:
    if not isinstance(value, str):
        return [str(_renamed(item, by)) for item in value]
    names: Mapping[str, str] = {f"{part}_{k}": f"{part}_{k + by}" for part in ("joint", "link") for k in range(1, 7)}
    return names.get(value, value)
