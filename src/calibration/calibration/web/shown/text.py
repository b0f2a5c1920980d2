"""What the terminal shows of a view: lines of text, in the reader's language."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from calibration.web.shown.words import Words

WIDTH = 30  # characters of a bar
PHASES = ("moving", "loading", "settling", "reading", "unloading")


def status(shown: Mapping[str, Any], w: Words) -> list[str]:
    """Return what is being done, waited for, and how far it is."""
    procedure = shown["procedure"]
    if not shown["known"]:
        doing = w("sequencer_silent")
    else:
        state = "paused" if procedure["paused"] and procedure["state"] == "ready" else procedure["state"]
        place = {"configuration": procedure["configuration"], "step": procedure["step"] + 1}
        doing = w(f"state_{state}", steps=procedure["steps"], **place)
        if procedure["kind"] in ("startup", "reference") and state in PHASES:
            doing = f"{w(procedure['kind'])}: {w(f'phase_{state}')}"
        if procedure["paused"] and procedure["state"] != "ready":
            doing += f" · {w('paused_after')}"
    lines = [doing]
    if shown["waiting"]:
        lines.append(f"{w('waits_for')}: {shown['waiting']}")
    if procedure["total"]:
        done = {"n": procedure["configuration"], "done": procedure["done"], "total": procedure["total"]}
        lines.append(f"{w('configuration_of', **done)}  {bar(procedure['share_done'])}")
    if procedure["averaged"] is not None:
        share = procedure["averaged"]
        lines.append(f"{w('averaging', share=f'{100 * share:.0f}')}  {bar(share)}")
    return lines


def permission(shown: Mapping[str, Any], w: Words) -> list[str]:
    """Return whether the robot may move, and why it may not."""
    one = shown["permission"]
    lines = [w("permission_unknown" if not one["known"] else "permitted" if one["permitted"] else "not_permitted")]
    if not one["permitted"]:
        lines.append(" · ".join(w(f"reason_{reason}") for reason in one["reasons"]))
    if one["known"] and one["speed"] is not None and one["speed_limit"] is not None:
        speed = {"speed": f"{1e3 * one['speed']:.0f}", "limit": f"{1e3 * one['speed_limit']:.0f}"}
        lines.append(w("speed", point=one["speed_point"], **speed))
    return lines


def load(shown: Mapping[str, Any], w: Words) -> list[str]:
    """Return what is to be pulled, what is felt, and what speaks against a confirmation; empty where no load is due."""
    one = shown["load"]
    if one["left"]:
        felt = w("load_left_unknown") if one["felt"] is None else w("load_left", n=f"{one['felt']:.0f}")
        return [f"{felt} {one['left']}"]
    if not one["awaited"]:
        return []
    axes = dict(zip("xyz", (f"{value:.0f}" for value in one["force"]), strict=True))
    pulling = one["wanted"] > 0.0
    lines = [w("pull_with", n=f"{one['wanted']:.0f}"), w("pull_axes", **axes)] if pulling else [w("release")]
    if one["felt"] is None:
        lines.append(w("felt_unknown"))
    else:
        band = "–" if one["band_force"] is None else f"{one['band_force']:.0f}"
        lines.append(w("felt", n=f"{one['felt']:.0f}", off=f"{one['off_force']:+.0f}", band=band))
    if pulling and one["off_angle"] is not None:
        band = "–" if one["band_angle"] is None else f"{math.degrees(one['band_angle']):.1f}"
        lines.append(w("angle", off=f"{math.degrees(one['off_angle']):.1f}", band=band))
    lines += [w(f"against_{code}") for code in shown["confirm"]["against"]]
    return lines


def faults(shown: Mapping[str, Any], w: Words) -> list[str]:
    """Return what is wrong, with the way out."""
    return [f"{one['text']}\n  → {one['remedy']}" for one in shown["faults"]] or [w("check_fine")]


def bars(shown: Mapping[str, Any], w: Words) -> list[str]:
    """Return the precision of each joint."""
    lines = []
    for one in shown["bars"]:
        now = w("accuracy_none")
        if one["accuracy"] is not None:
            expected = "–" if one["expected"] is None else f"{100 * one['expected']:.1f}"
            now = w("accuracy_now", now=f"{100 * one['accuracy']:.1f}", expected=expected)
        lines.append(f"{one['joint']:12s} {bar(one['share'] or 0.0)} {now}")
    return lines or [w("accuracy_later")]


def bar(share: float) -> str:
    """Return a bar."""
    full = round(WIDTH * min(max(share, 0.0), 1.0))
    return "█" * full + "░" * (WIDTH - full)
