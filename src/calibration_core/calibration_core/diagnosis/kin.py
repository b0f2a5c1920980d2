"""Which hypotheses are forms of one cause: the same family at the same joint, or at neighbouring parts."""

from __future__ import annotations

from collections.abc import Mapping

from calibration_core.model.effects.candidate import Candidate

TOOL = 1 << 20  # beyond the last joint
MEMORY = frozenset({"hysteresis", "creep"})


def are_kin(first: Candidate, second: Candidate) -> bool:
    """Say whether two candidates could be one cause under two laws.

    Joint laws: the same joint, both with memory or both without.  Structure: the same or neighbouring parts.  Load
    chain and point chain: always.
    """
    if first.family != second.family:
        return False
    if first.family in {"load chain", "point chain"}:
        return True
    if first.family == "joint law" and (first.effect in MEMORY) != (second.effect in MEMORY):
        return False
    reach = 0 if first.family == "joint law" else 1
    return any(abs(i - j) <= reach for i in parts(first.location) for j in parts(second.location))


def parts(location: Mapping[str, str | tuple[str, ...]]) -> tuple[int, ...]:
    """Return the numbers of the joints between which a place lies; the base is before the first joint."""
    if "base" in location:
        return (0, 1)
    if "tool" in location:
        return (TOOL,)
    numbers = []
    for key, value in location.items():
        if key in {"joint", "link", "joints"}:
            numbers += [_number(name) for name in ((value,) if isinstance(value, str) else value)]
    if "link" in location:
        numbers += [number + 1 for number in numbers]
    return tuple(numbers)


def _number(name: str) -> int:
    digits = "".join(character for character in name if character.isdigit())
    return int(digits) if digits else 0
