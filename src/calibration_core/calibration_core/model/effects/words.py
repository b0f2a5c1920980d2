"""Effects in the words of the people who read a report: `link bending at link_2` is "link 2 bends"."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from calibration_core.model.effects import catalogue

ALL = "every joint"
UNNAMED = {"empirical_law": "{place} follows a law that fits, without a known cause"}  # of no effect's file


def effect_sentence(effect: str, location: Mapping[str, str | Sequence[str]]) -> str:
    """Return an effect and its place as a sentence without full stop, for example `link 2 bends`."""
    within = location.get("recording")
    location = {key: value for key, value in location.items() if key != "recording"}
    places = [one for value in location.values() for one in ([value] if isinstance(value, str) else value)]
    named = [ALL if place == "all" else plain_name(place) for place in places]
    place = " and ".join(named) or "the robot"
    own = (known.sentence for known in catalogue() if known.name == effect)
    sentence = UNNAMED.get(effect) or next(own, "")
    if not sentence:
        return f"{effect_words(effect)} at {place}"
    return sentence.format(place=place) + ("" if within is None else f" in recording {within}")


def effect_words(effect: str) -> str:
    """Return the name of an effect or anomaly as one writes it: `off_axis_compliance` is off-axis compliance."""
    return effect.replace("off_axis", "off-axis").replace("pose_dependent", "pose-dependent").replace("_", " ")


def listed_location(location: Mapping[str, str | Sequence[str]]) -> str:
    """Return a place as result.json names it, several joints or links of one joined: `joint_2 and joint_3`."""
    return ", ".join(value if isinstance(value, str) else " and ".join(value) for value in location.values())


def plain_name(name: str) -> str:
    """Return a name of joints or links as one says it: `joint_2` is joint 2; others stay as they are."""
    words, _, number = name.rpartition("_")
    return f"{words.replace('_', ' ')} {number}" if number.isdigit() and words in {"joint", "link", "axis"} else name


def people_unit(unit: str) -> str:
    """Return a unit as people write it: `N*m/rad` is N·m/rad."""
    return unit.replace("*", "·")
