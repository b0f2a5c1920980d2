"""Effects that the diagnoses named: what a type has in common, and what one robot alone has."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from calibration_core.fleet.recordings.rows import Row
from calibration_core.model.effects import effects_with
from calibration_core.model.effects.candidate import Trait
from calibration_core.model.effects.words import effect_sentence

COMMON = 0.25  # share of a type's robots: an effect of more of them is how the type is, and no damage
EARLIER_EVIDENCE = 10.0  # log Bayes factor: of an earlier recording whose finding the last one does not show
SMALLER = 2.0  # standard deviations by which a backlash or hysteresis has to be smaller to be called gone
LEAST_EVIDENCE = 5.0  # log Bayes factor: decisive; the diagnosis has tested it against chance already


def effect_shares(rows: Iterable[Row]) -> dict[str, dict[str, float]]:
    """Return type -> effect and place -> share of its robots whose last usable recording shows it."""
    last: dict[tuple[str, str], Row] = {}
    for row in sorted(rows, key=lambda row: (row.date, row.recording)):
        shares_of = (row.type, row.robot)
        if row.measured and row.usable != "no":
            last[shares_of] = row
    counts: dict[str, dict[str, int]] = {}
    robots: dict[str, int] = {}
    for (kind, _), row in last.items():
        robots[kind] = robots.get(kind, 0) + 1
        names = counts.setdefault(kind, {})
        for name in {effect_name(effect, place) for effect, place in zip(row.effects, row.locations, strict=True)}:
            names[name] = names.get(name, 0) + 1
    return {
        kind: {name: count / robots[kind] for name, count in sorted(names.items())} for kind, names in counts.items()
    }


def found_in(rows: Sequence[Row], shares: Mapping[str, float]) -> list[tuple[str, float]]:
    """Return the effects of a robot that are not common in its type: in words, with their log Bayes factors.

    What sensors, targets and tracker do says nothing about a robot.  A damage does not mend itself: what an earlier
    recording showed clearly counts although the last one does not show it, unless the last one measures that backlash
    or hysteresis, and finds significantly less.
    """
    found: dict[str, tuple[str, float]] = {}
    damages = effects_with(Trait.DAMAGE)
    for row in reversed(rows):
        is_last = row is rows[-1]
        least, when = (LEAST_EVIDENCE, "its last recording") if is_last else (EARLIER_EVIDENCE, f"seen on {row.date}")
        for effect, place, evidence in zip(row.effects, row.locations, row.evidence, strict=True):
            name = effect_name(effect, place)
            rare = effect in damages and shares.get(name, 0.0) <= COMMON
            if (
                rare
                and evidence >= least
                and name not in found
                and (is_last or not _gone(effect, place, row, rows[-1]))
            ):
                words = effect_sentence(effect, {"at": place.split(" and ")} if place else {})
                found[name] = (f"{words} ({when})", evidence)
    return list(found.values())


def _gone(effect: str, place: str, before: Row, last: Row) -> bool:
    """Tell whether the last recording measures significantly less of a joint's law than an earlier one."""
    name = f"{effect}.{place}"
    if name not in before.law_names or name not in last.law_names:
        return False
    (old, old_std), (new, new_std) = (
        (row.law_values[row.law_names.index(name)], row.law_stds[row.law_names.index(name)]) for row in (before, last)
    )
    return old - new > SMALLER * math.hypot(old_std, new_std)


def effect_name(effect: str, place: str) -> str:
    """Return what an effect at a place is called where effects are counted."""
    return f"{effect} {place}".rstrip()
