"""The traffic light of a result: whether it can be used, why, and what to do next."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from calibration_core.diagnosis.result.finding import HANDED_OUT
from calibration_core.identification.result.estimate import DECLARED_RIGID
from calibration_core.identification.result.observability import DETERMINED
from calibration_core.model.effects import catalogue
from calibration_core.model.effects.words import effect_sentence
from calibration_core.report.rounding import counted

BLOCKING = frozenset({
    "wrench_sign", "wrench_unit", "wrench_frame", "position_unit", "angle_unit", "joint_order", "point_order",
    "joint_coupling", "wrong_robot_file", "no_relation",
})  # fmt: skip

EQUAL_CAUSES = 2  # that are named beside a finding, if the recording cannot tell them from it
EXPLAINED = "the model explains the recording to its noise"
WORDS = {
    "yes": "Usable",
    "with_reservations": "Usable with reservations",
    "no": "Not usable: the input has to be put right first",
}


@dataclasses.dataclass(frozen=True)
class Light:
    """The traffic light.

    Attributes:
        usable: `yes`, `with_reservations` or `no`.
        reason: Why, in words.
        next_step: What to do next; empty where there is nothing to do.
        reasons: The single reasons, the first of which the terminal names.
    """

    usable: str
    reason: str
    next_step: str
    reasons: tuple[str, ...]

    @property
    def headline(self) -> str:
        """The first line of a report."""
        return WORDS[self.usable]

    @property
    def rows(self) -> tuple[tuple[str, str], ...]:
        """Reason and next step as labelled lines, as far as there are some."""
        rows = (("Why", self.reason), ("Next step", self.next_step))
        return tuple((label, text[0].upper() + text[1:]) for label, text in rows if text)

    @property
    def lines(self) -> list[str]:
        """The first lines on a terminal: whether it can be used and why, and what next."""
        if self.usable == "no":
            return [f"not usable: {self.next_step}"]
        more = len(self.reasons) - 1
        further = f" (and {counted(more, 'further reservation')}, in the report)" if more else ""
        step = [f"next: {self.next_step}"] if self.next_step else []
        return [f"{self.headline.lower()}: {self.reasons[0]}{further}", *step]


def light_of(content: Mapping[str, Any]) -> Light:
    """Return the light of the content of a result.json."""
    reason = content["reason"]
    return Light(content["usable"], reason, content["next_step"], tuple(content.get("reasons") or [reason]))


def with_light(
    content: dict[str, Any],
    good: str = EXPLAINED,
    residual: tuple[str, str] | None = None,
    further: Sequence[tuple[str, str]] = (),
) -> dict[str, Any]:
    """Return the content of result.json with `usable`, `reason` and `next_step`.

    An anomaly of the input leaves no stiffness, no finding and the verdict `unexplained`.

    Args:
        content: The fixed keys, and `preconditions` where there are some.
        good: Why it is usable, where nothing speaks against it.
        residual: What a verdict other than `consistent` means, and what to do then; None: what the findings say.
        further: What else speaks against using it, each with what to do about it.
    """
    anomalies: Sequence[Mapping[str, Any]] = content["anomalies"]
    wrong = [anomaly for anomaly in anomalies if anomaly["kind"] in BLOCKING]
    if wrong:
        first = wrong[0]
        step = first.get("remedy") or "put the input right, or use the files that belong together, and run this again"
        emptied = {"stiffness": [], "findings": [], "verdict": "unexplained"}
        return {**content, **emptied, "usable": "no", "reason": first["text"], "next_step": step}
    reasons = [*further, *_reservations(content, anomalies, residual)]
    if not reasons:
        return {**content, "usable": "yes", "reason": good, "next_step": ""}
    step = next((step for _, step in reasons if step), "")
    each = [reason for reason, _ in reasons]
    judged = {"usable": "with_reservations", "reason": "; ".join(each), "next_step": step, "reasons": each}
    return {**content, **judged}


def _reservations(
    content: Mapping[str, Any], anomalies: Sequence[Mapping[str, Any]], residual: tuple[str, str] | None
) -> Sequence[tuple[str, str]]:
    """Return what speaks against using a result as it stands, each with what to do about it."""
    found: list[tuple[str, str]] = [
        (f"{anomaly['kind'].replace('_', ' ')}: {anomaly['text'].rstrip('.')}", anomaly.get("remedy", ""))
        for anomaly in anomalies
    ]
    if content["verdict"] != "consistent":
        found.append(_missing(content) if residual is None else residual)
    unmet = [one for one in content.get("preconditions", ()) if one["shall"] and one["met"] is False]
    found += [
        (f"not as the standard demands ({one['clause']}): {one['requirement']}", f"measure with {one['requirement']}")
        for one in unmet
    ]
    unknown = [
        one["joint"] for one in content["stiffness"] if not _determined(one) and one.get("reason") != DECLARED_RIGID
    ]
    if unknown:
        words = ", ".join(unknown)
        found.append((f"not identifiable: {words}", f"measure configurations in which the load turns {words}"))
    return found


def _determined(joint: Mapping[str, Any]) -> bool:
    """Say whether a joint's stiffness is known, of the extended model at the least: `identify` and `diagnose` agree."""
    extended = joint.get("extended")
    return joint["identifiable"] or (extended is not None and extended["value"] > DETERMINED * extended["std"])


def _missing(content: Mapping[str, Any]) -> tuple[str, str]:
    """Return what the standard's model leaves out, and what to do about it."""
    findings: Sequence[Mapping[str, Any]] = content["findings"]
    if not findings:
        text = "the residual is more than noise, and nothing in the catalogue explains it"
        first = "" if content["command"] == "diagnose" else "run diagnose, "
        return text, f"{first}see where the residual is largest, and measure there again"
    names = "; ".join(dict.fromkeys(map(_sentence, findings)))
    rest = ", and a part of the residual stays unexplained" if content["verdict"] == "partly_explained" else ""
    step = "use the extended model that diagnose writes (model.yaml)"
    if any(note["kind"] == HANDED_OUT for note in content.get("notes", ())):
        step = "measure more: what was found predicts readings that were not fitted no better than the standard's model"
    several = {one["effect"] for finding in findings for one in _alike(finding)}
    stated: dict[str, str] = {}  # field -> which one it is otherwise
    for effect in catalogue():
        if effect.stated and effect.name in several:
            stated[effect.stated] = stated.get(effect.stated) or effect.stated_otherwise
    if stated:
        fields = [f"{field} ({other})" if other else field for field, other in stated.items()]
        step = f"hold {' and '.join(fields)} of the cell file against what is mounted, and correct it; else {step}"
    return f"the standard's model leaves something out ({names}){rest}", step


def _sentence(finding: Mapping[str, Any]) -> str:
    """Return what a finding says, or else what the recording cannot tell from it."""
    several = _alike(finding)
    return " or ".join(dict.fromkeys(effect_sentence(one["effect"], one["location"]) for one in several))


def _alike(finding: Mapping[str, Any]) -> tuple[Mapping[str, Any], ...]:
    """Return a finding and what the recording cannot tell from it, as far as it is named."""
    return finding, *finding["cannot_be_told_from"][:EQUAL_CAUSES]
