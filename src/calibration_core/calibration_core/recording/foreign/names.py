"""Configuration, step and point out of one name: `C03_S2_mp1`, `Pose 3 - MP1`, `conf3::step2::mp1`."""

from __future__ import annotations

import re
from collections.abc import Sequence

FLAGS = re.IGNORECASE
_SPLIT = re.compile(r"[\s_\-.:/|]+")
_TOKEN = {
    "configuration": re.compile(
        r"(?:c|k|conf|config|cfg|configuration|konfiguration|pose|posture|stellung)(\d+)", FLAGS
    ),
    "step": re.compile(r"(?:s|l|ls|step|schritt|load|laststufe|level)(\d+)", FLAGS),
}
_WORD = {
    "configuration": re.compile(r"c|k|conf|config|cfg|configuration|konfiguration|pose|posture|stellung", FLAGS),
    "step": re.compile(r"s|l|ls|step|schritt|load|laststufe|level", FLAGS),
}


def split_names(names: Sequence[str]) -> tuple[list[int], list[int] | None, list[str]] | None:
    """Return configuration, step (None where no name has one) and point of each name; None unless all names have one.

    A name's parts are separated by blanks, `_`, `-`, `.`, `:` or `/`.  The part that begins with `c`, `conf` or `pose`
    and ends in a number is the configuration, the one with `s`, `step` or `load` the step; the others are the point.
    """
    found = [_split(name) for name in names]
    if any(one is None for one in found):
        return None
    parts = [one for one in found if one is not None]
    steps = [step for _, step, _ in parts]
    if any(step is None for step in steps) and any(step is not None for step in steps):
        return None
    whole = None if steps and steps[0] is None else [step for step in steps if step is not None]
    return [configuration for configuration, _, _ in parts], whole, [point for _, _, point in parts]


def split_by(pattern: re.Pattern[str], names: Sequence[str]) -> tuple[dict[str, list[str]], int | None]:
    """Return the named groups of a pattern for every name, and the index of the first name that does not match."""
    groups: dict[str, list[str]] = {name: [] for name in pattern.groupindex}
    for index, name in enumerate(names):
        match = pattern.fullmatch(name)
        if match is None:
            return groups, index
        for group, value in match.groupdict().items():
            groups[group].append(value or "")
    return groups, None


def _split(name: str) -> tuple[int, int | None, str] | None:
    parts = [part for part in _SPLIT.split(name.strip()) if part]
    numbers: dict[str, int | None] = {"configuration": None, "step": None}
    left: list[str] = []
    index = 0
    while index < len(parts):
        part = parts[index]
        following = parts[index + 1] if index + 1 < len(parts) else ""
        for what in [name for name, number in numbers.items() if number is None]:
            whole = _TOKEN[what].fullmatch(part)
            if whole is not None:
                numbers[what] = int(whole.group(1))
                break
            if _WORD[what].fullmatch(part) and following.isdecimal():
                numbers[what] = int(following)
                index += 1
                break
        else:
            left.append(part)
        index += 1
    configuration = numbers["configuration"]
    return None if configuration is None or not left else (configuration, numbers["step"], "_".join(left))
