"""What the page shows, from the state of the cell: a pure function of plain values, that decides nothing.

Every field is a number, a code or a text of a node; codes become words where they are shown, in the reader's language.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from calibration.web.shown.band import Pull, pull

Plain = Mapping[str, Any]

MOVES = ("moving", "loading", "settling", "reading", "unloading", "ready", "preparing")
STANDSTILL = 0.002  # m/s of the fastest monitored point, below which the robot counts as standing on the page
LEVELS = {"ok": 0, "warn": 1, "error": 2, "absent": 3, "silent": 3}


def view(state: Plain) -> dict[str, Any]:
    """Return what is shown of a state.

    Args:
        state: `calibration_interfaces/State` as plain values.
    """
    procedure = state["procedure"]
    load = load_of(procedure)
    return {
        "text": state["text"],
        "waiting": state["waiting"],
        "running": running(state),
        "known": bool(state["procedure_known"]),
        "procedure": _procedure(procedure),
        "permission": _permission(state),
        "robot": _robot(state["robot"]),
        "load": _load(load, procedure),
        "confirm": confirm(state, load),
        "reading": _reading(procedure),
        "bars": _bars(state["progress"]),
        "progress": _progress(state["progress"]),
        "streams": [_stream(one) for one in state["streams"]],
        "conditions": [_condition(one) for one in state["conditions"]["conditions"]],
        "nodes": [
            {"name": one["name"], "level": LEVELS.get(one["level"], 3), "state": one["level"],
             "active": one["lifecycle"]["label"] == "active", "text": one["text"]}
            for one in state["nodes"]
        ],
        "faults": [{key: one[key] for key in ("level", "code", "source", "text", "remedy")} for one in state["faults"]],
        "goal": procedure["goal"],
    }  # fmt: skip


def running(state: Plain) -> bool:
    """Whether a plan is being measured, as far as the sequencer is heard."""
    return bool(state["procedure_known"]) and state["procedure"]["state"] in MOVES


def load_of(procedure: Plain) -> Pull:
    """Return how the load of the present step stands."""
    force = procedure["target"]["force"]
    felt = procedure["load_felt"]["force"] if procedure["load_felt_known"] else None
    return pull(
        [force["x"], force["y"], force["z"]],
        None if felt is None else [felt["x"], felt["y"], felt["z"]],
        procedure["band_force"],
        procedure["band_angle"],
    )


def confirm(state: Plain, load: Pull) -> dict[str, Any]:
    """Return whether the operator may confirm the load now, and what speaks against it, as codes.

    The sequencer judges again, and alone: this is what the button shows.
    """
    procedure = state["procedure"]
    against = []
    if not state["procedure_known"]:
        against.append("sequencer_silent")
    if not procedure["load_awaited"] or procedure["waits_for"] != "operator":
        against.append("no_load_awaited")
    elif load.felt is None and load.band_force is not None:
        against.append("load_not_felt")
    elif load.band_force is not None and load.off_force is not None and abs(load.off_force) > load.band_force:
        against.append("force_too_small" if load.off_force < 0.0 else "force_too_great")
    elif not load.fits:
        against.append("direction_off")
    against += ["stream_" + one["problem"] for one in state["streams"] if one["problem"] != "fine"]
    speed = state["permission"]["speed"]
    if state["permission_known"] and speed is not None and speed > STANDSTILL:
        against.append("robot_moves")
    return {"offered": not against, "against": list(dict.fromkeys(against)), "text": procedure["load_fault"]}


def _procedure(one: Plain) -> dict[str, Any]:
    keys = ("state", "waits_for", "text", "waiting", "question", "paused", "held", "moving", "session", "plan",
            "recording", "kind", "phase_name", "configuration", "attempt", "step", "steps", "share_done", "averaged",
            "seconds_left", "load_awaited", "readings")  # fmt: skip
    found = {key: one[key] for key in keys}
    found["done"], found["total"] = one["configurations_done"], one["configurations_total"]
    found["skipped"] = one["configurations_skipped"]
    return found


def _permission(state: Plain) -> dict[str, Any]:
    one = state["permission"]
    known = bool(state["permission_known"])
    speed = one["speed"]
    return {
        "known": known,
        "permitted": known and bool(one["permitted"]),
        "latched": bool(one["latched"]),
        "reasons": list(one["reasons"]) if known else ["guard_silent"],
        "text": state["not_permitted"],
        "speed": speed,
        "speed_point": one["speed_point"],
        "speed_limit": one["speed_limit"],
        "standing": None if speed is None else speed <= STANDSTILL,
        "stop": one["stop"],
    }


def _robot(one: Plain) -> dict[str, Any]:
    return {key: one[key] for key in ("operating_mode", "drives", "safety", "operator_name", "speed_scaling")}


def _load(load: Pull, procedure: Plain) -> dict[str, Any]:
    force = procedure["target"]["force"]
    return {
        "awaited": procedure["load_awaited"],
        "wanted": load.wanted,
        "force": [force["x"], force["y"], force["z"]],
        "direction": list(load.direction),
        "felt": load.felt,
        "along": list(load.along),
        "off_force": load.off_force,
        "off_angle": load.off_angle,
        "band_force": load.band_force,
        "band_angle": load.band_angle,
        "fits": load.fits,
    }


def _reading(one: Plain) -> dict[str, Any]:
    return {
        "verdict": one["reading_verdict"],
        "configuration": one["reading_configuration"],
        "step": one["reading_step"],
        "text": one["reading_text"],
    }


def _bars(one: Plain) -> list[dict[str, Any]]:
    """Return a bar for each joint: half of the 95 % interval over the value, now and as expected, and what is wanted.

    The bar is full where the joint has what is wanted, or, where nothing is, what is expected at the plan's end.
    """
    found = []
    rows = zip(one["joints"], one["stiffness"], one["accuracy"], one["expected"], strict=False)
    for joint, stiffness, accuracy, expected in rows:
        aim = one["wanted"] or expected
        share = None if not accuracy or not aim else min(1.0, aim / accuracy)
        found.append(
            {"joint": joint, "stiffness": stiffness, "accuracy": accuracy, "expected": expected, "share": share}
        )
    return found


def _progress(one: Plain) -> dict[str, Any]:
    keys = ("configuration", "text", "suspicious", "enough", "wanted", "next_configuration")
    return {key: one[key] for key in keys}


def _stream(one: Plain) -> dict[str, Any]:
    return {"name": one["name"], "problem": one["problem"], "age": one["age"], "text": one["text"]}


def _condition(one: Plain) -> dict[str, Any]:
    found = {key: one[key] for key in ("name", "clause", "requirement", "limit", "value", "shall", "verdict")}
    found["override"] = one["override"]["operator_name"]
    return found


def checklist(shown: Plain, disk_free: float | None, recorder: tuple[bool, str] | None) -> list[dict[str, Any]]:
    """Return what is to be in order before a run: a code, whether it is (None: not known), what was seen.

    Args:
        shown: What `view` returned.
        disk_free: Bytes that are free where sessions are; None: not known.
        recorder: Whether the recorder hears every instrument, and what it says; None: it does not answer.
    """
    permission, robot = shown["permission"], shown["robot"]
    rows = [_row("node_" + one["name"], one["active"] and one["level"] < 2, one["text"]) for one in shown["nodes"]]
    rows.append(_row("mode", {"manual_reduced": True, "unknown": None}.get(robot["operating_mode"], False),
                     robot["operating_mode"], code="mode"))  # fmt: skip
    rows.append(_row("drives", {"on": True, "unknown": None}.get(robot["drives"], False), robot["drives"], "drives"))
    unproven = permission["reasons"] == ["stop_unproven"]  # the sequencer proves it before the first motion
    rows.append(_row("permission", permission["permitted"] or unproven, permission["text"]))
    for one in shown["streams"]:
        fine = one["problem"] == "fine"
        rows.append(_row("stream_" + one["name"], fine, one["problem"] if fine else one["text"], "stream"))
    rows.append(_row("recorder_hears", None if recorder is None else recorder[0], recorder[1] if recorder else ""))
    enough = None if disk_free is None else disk_free >= DISK
    rows.append(_row("disk", enough, "" if disk_free is None else f"{disk_free / 1e9:.1f} GB"))
    return rows + [
        _row("condition_" + one["name"], {"met": True, "unknown": None}.get(one["verdict"], bool(one["override"])),
             f"{one['requirement']}: {one['value']} ({one['limit']})")
        for one in shown["conditions"]
    ]  # fmt: skip


DISK = 5e9  # bytes that a long session may take


def _row(name: str, met: bool | None, seen: str, code: str = "") -> dict[str, Any]:
    return {"name": name, "met": met, "seen": seen, "code": code}


def place_of(state: Plain) -> tuple[object, ...]:
    """Return which load is awaited: run, configuration, attempt, step, force; a release has its pull's step."""
    one = state["procedure"]
    force = one["target"]["force"]
    return (one["session"], one["configuration"], one["attempt"], one["step"], force["x"], force["y"], force["z"])
