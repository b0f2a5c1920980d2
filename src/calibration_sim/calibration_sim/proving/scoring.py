"""Holds what a diagnosis said against what was in the recording; one recording at a time.

An effect is right if its name is that of a label or of a label's exact alias.  A place is right if it is the label's,
an exact alias's, or if the label's own effect and place stand among what the finding is confounded with.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

PLACES = ("joint", "joints", "link", "point")  # an effect of sensor, tracker, tool, base or robot has but one place
ALL = {"joints": "all"}
PRACTICAL = 1e-5  # m at the measured point
MORE_THAN_NOISE = 1.1  # rms that is left, over the noise that was there
COVERED = 1.959964  # standard deviations, 95 percent
NOTED = {"frames.tracker": "tracker_frame_misalignment", "frames.measurement_points": "measurement_point_offset"}


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What came of one recording.

    Attributes:
        named: Effects found that no label holds and that are not true anyway, in the order of the findings.
        large: How many findings are larger than `PRACTICAL`.
        found: How many findings there are.
        effect_right: Per label: some finding names it.
        place_right: Per label: and places it; None: nothing names it, or the effect has but one place.
        first_right: Whether the first finding names a label; None: no finding.
        aliases_named: Whether every label's exact aliases stand beside it in one finding.
        flagged: Whether the verdict or an anomaly says that something is left.
        anomaly_right: Per label: kind and place of an anomaly.
        covered: Per parameter that can be compared: whether the 95 percent interval holds it.
        stiffness_covered: Per identifiable joint: whether the 95 percent interval holds the true stiffness.
        held_out_ratio: Held-out rms after, over noise; None: not stated.
        verdict: As stated.
        kind_right: Whether a law of another shape is named by its kind at its joint and nothing else is named, or
            nothing is named and the rest is called unexplained; and no more than the noise is called noise.
        beside_first: Whether what was planted is the first finding, or named as what cannot be told from it.
        left_ratio: Rms that is left, over the noise that was there; None: not known, or there are gross errors.
    """

    named: tuple[str, ...]
    large: int
    found: int
    effect_right: tuple[bool, ...]
    place_right: tuple[bool | None, ...]
    first_right: bool | None
    aliases_named: bool
    flagged: bool
    anomaly_right: tuple[bool, ...]
    covered: tuple[bool, ...]
    stiffness_covered: tuple[bool, ...]
    held_out_ratio: float | None
    verdict: str
    kind_right: bool = False
    beside_first: bool = False
    left_ratio: float | None = None


Item = Mapping[str, Any]


def score(label: Item, result: Item) -> Outcome:
    """Compare a label with a result."""
    physics = [item for item in result.get("findings", ()) if item.get("family") != "empirical"]
    findings = [item for item in physics if item["effect"] not in label["true_anyway"] or _names_any(item, label)]
    effects, noted = label["effects"], [_noted(note) for note in result.get("notes", ()) if note["kind"] == "frames"]
    named = [*findings, *noted]
    hits = [next((f for f in named if _names(f, effect)), None) for effect in effects]
    placed = [next((f for f in named if _names(f, effect) and _places(f, effect)), None) for effect in effects]
    fit = result.get("fit", {})
    after, noise = fit.get("held_out_rms_after"), fit.get("noise")
    return Outcome(
        named=tuple(str(f["effect"]) for f in findings if not _names_any(f, label)),
        large=sum(_size(f) >= PRACTICAL for f in findings),
        found=len(findings),
        effect_right=tuple(hit is not None for hit in hits),
        place_right=tuple(
            None if hit is None or not _has_place(effect) else place is not None
            for hit, place, effect in zip(hits, placed, effects, strict=True)
        ),
        first_right=_names_any(findings[0], label) if findings else (True if any(hits) else None),
        aliases_named=all(_aliases_named(findings, effect) for effect in effects),
        flagged=result.get("verdict") in {"partly_explained", "unexplained"} or bool(result.get("anomalies")),
        anomaly_right=tuple(_anomaly(result, effect) for effect in effects),
        covered=tuple(
            good
            for hit, effect in zip(placed, effects, strict=True)
            if hit is not None and effect["same_law"] and hit["effect"] == effect["effect"]
            for good in _covered(hit, effect)
        ),
        stiffness_covered=_stiffness(label, result),
        held_out_ratio=None if not after or not noise else float(after) / float(noise),
        verdict=str(result.get("verdict", "")),
        kind_right=all(_kind_right(label, effect, physics, result) for effect in effects if "kinds" in effect),
        beside_first=bool(findings) and any(_listed(findings[0], effect) for effect in effects),
        left_ratio=_left_ratio(label, result),
    )


def _noted(note: Item) -> dict[str, Any]:
    """Return a note on frames as the finding that it would be; it begins with the name of the target."""
    return {
        "effect": NOTED[note["place"].split(": ")[-1]],
        "location": {"point": str(note["text"]).split(maxsplit=1)[0]},
        "parameters": [],
    }


def _left_ratio(label: Item, result: Item) -> float | None:
    """Return the rms that is left over the noise that was there; gross errors would be part of it."""
    after, noise = result.get("fit", {}).get("rms_after"), label.get("noise_seen")
    if after is None or noise is None or label["noise"]["outlier_rate"] > 0.0:
        return None
    return float(after) / float(noise)


def _kind_right(label: Item, effect: Item, physics: list[Any], result: Item) -> bool:
    """Say whether a law of another shape is told for what it is; see `Outcome.kind_right`."""
    flagged = result.get("verdict") in {"partly_explained", "unexplained"}
    if not flagged and (_left_ratio(label, result) or 0.0) > MORE_THAN_NOISE:
        return False
    if not physics:
        return flagged
    kinds, place = effect["kinds"], effect["location"]
    return all(f["effect"] in kinds and same_place(f.get("location", {}), place) for f in physics)


def same_place(one: Item, other: Item) -> bool:
    """Return whether two locations are the same; those without a joint, link or point always are."""
    for key in PLACES:
        a, b = one.get(key), other.get(key)
        if a is not None or b is not None:
            return a is not None and b is not None and _plain(a) == _plain(b)
    return True


def _plain(value: Any) -> frozenset[str]:
    return frozenset([value]) if isinstance(value, str) else frozenset(map(str, value))


def _has_place(effect: Item) -> bool:
    return any(key in effect["location"] for key in PLACES)


def _accepted(effect: Item) -> list[Item]:
    return [effect, *effect["equivalent"]]


def _names(finding: Item, effect: Item) -> bool:
    return any(finding["effect"] == item["effect"] for item in _accepted(effect))


def _names_any(finding: Item, label: Item) -> bool:
    return any(_names(finding, effect) for effect in label["effects"])


def _is(finding: Item, item: Item) -> bool:
    if finding["effect"] != item["effect"]:
        return False
    if item["location"] == ALL:  # every joint has it: each may be found by itself
        return "joint" in finding.get("location", {}) or finding.get("location", {}) == ALL
    return same_place(finding.get("location", {}), item["location"])


def _listed(finding: Item, effect: Item) -> bool:
    return _names(finding, effect) or any(_is(other, effect) for other in finding.get("cannot_be_told_from", ()))


def _places(finding: Item, effect: Item) -> bool:
    beside = finding.get("cannot_be_told_from", ())
    return any(_is(finding, item) for item in _accepted(effect)) or any(_is(other, effect) for other in beside)


def _aliases_named(findings: list[Item], effect: Item) -> bool:
    for finding in findings:
        alternatives = [finding, *finding.get("cannot_be_told_from", ())]
        if all(any(_is(one, item) for one in alternatives) for item in _accepted(effect)):
            return True
    return False


def _size(finding: Item) -> float:
    return float(finding.get("evidence", {}).get("magnitude") or 0.0)


def _anomaly(result: Item, effect: Item) -> bool:
    """Return whether an anomaly of this kind was found at its point, and its first configuration within one."""
    if effect["family"] != "anomaly":
        return False
    for anomaly in result.get("anomalies", ()):
        if anomaly["kind"] != effect["effect"] or not same_place(anomaly.get("location", {}), effect["location"]):
            continue
        begins, stated = effect["configurations"], anomaly.get("configurations") or ()
        if effect["effect"] not in {"target_moved", "tracker_moved"} or not begins:
            return True
        if stated and _boundary_right(begins, stated):
            return True
    return False


def _boundary_right(true: Any, stated: Any) -> bool:
    """Return whether the stated range begins where the true one does, or ends before it (moved until then)."""
    first = int(true[0])
    low, high = int(min(stated)), int(max(stated))
    return abs(low - first) <= 1 or (low == 1 and abs(high + 1 - first) <= 1)


def _covered(finding: Item, effect: Item) -> list[bool]:
    stated = {str(p["name"]): p for p in finding.get("parameters", ())}
    return [
        abs(float(stated[name]["value"]) - true) <= COVERED * float(stated[name]["std"])
        for name, true in effect["parameters"].items()
        if name in stated and stated[name].get("std") is not None
    ]


def _stiffness(label: Item, result: Item) -> tuple[bool, ...]:
    rows = result.get("stiffness", ())
    if len(rows) != len(label["stiffness"]):
        return ()
    return tuple(
        abs(float(row["value"]) - true) <= COVERED * float(row["std"])
        for row, true in zip(rows, label["stiffness"], strict=True)
        if row.get("identifiable") and row.get("std") is not None
    )
