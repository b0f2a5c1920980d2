"""The traffic light of a result: whether it can be used, why, and what to do next (contract, section 7)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

BLOCKING = frozenset({
    "wrench_sign", "wrench_unit", "wrench_frame", "position_unit", "angle_unit", "joint_order", "point_order",
    "wrong_robot_file", "no_relation",
})  # fmt: skip


def with_light(content: dict[str, Any]) -> dict[str, Any]:
    """Return the content of result.json with `usable`, `reason` and `next_step`.

    An anomaly of the input leaves no stiffness, no finding and the verdict `unexplained`.

    Args:
        content: The contract's keys, and `preconditions` where there are some.
    """
    anomalies: Sequence[Mapping[str, Any]] = content["anomalies"]
    wrong = [anomaly for anomaly in anomalies if anomaly["kind"] in BLOCKING]
    if wrong:
        first = wrong[0]
        step = first.get("remedy") or "put the input right, or use the files that belong together, and run this again"
        emptied = {"stiffness": [], "findings": [], "verdict": "unexplained"}
        return {**content, **emptied, "usable": "no", "reason": first["text"], "next_step": step}
    reasons = list(_reservations(content, anomalies))
    if not reasons:
        return {**content, "usable": "yes", "reason": "the model explains the recording to its noise", "next_step": ""}
    step = next((step for _, step in reasons if step), "")
    reason = "; ".join(reason for reason, _ in reasons)
    return {**content, "usable": "with_reservations", "reason": reason, "next_step": step}


def _reservations(content: Mapping[str, Any], anomalies: Sequence[Mapping[str, Any]]) -> Sequence[tuple[str, str]]:
    """Return what speaks against using a result as it stands, each with what to do about it."""
    found: list[tuple[str, str]] = [
        (f"{anomaly['kind'].replace('_', ' ')}: {anomaly['text']}", anomaly.get("remedy", "")) for anomaly in anomalies
    ]
    if content["verdict"] != "consistent":
        step = "use the extended model, model.yaml" if content["findings"] else "look for what is left out: diagnose"
        if content["command"] == "diagnose" and not content["findings"]:
            step = "see where the rest is, and measure there again"
        found.append((f"the verdict is {content['verdict'].replace('_', ' ')}", step))
    unmet = [one for one in content.get("preconditions", ()) if one["shall"] and one["met"] is False]
    found += [
        (f"not as the standard demands ({one['clause']}): {one['requirement']}", f"measure with {one['requirement']}")
        for one in unmet
    ]
    unknown = [one["joint"] for one in content["stiffness"] if not one["identifiable"]]
    if unknown:
        words = ", ".join(unknown)
        found.append((f"not identifiable: {words}", f"measure configurations in which the load turns {words}"))
    return found
