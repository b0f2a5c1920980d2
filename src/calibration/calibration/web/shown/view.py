"""What the page shows, from the state of the cell: a pure function of plain values, that decides nothing.

Every field is a number, a code or a text of a node; codes become words where they are shown, in the reader's language.
What a node has said is shown as current only while the node is heard.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calibration.health import FRESH
from calibration.web.shown.band import Pull, pull

Plain = Mapping[str, Any]

MOVES = ("moving", "loading", "settling", "reading", "unloading", "ready", "preparing")
WRENCH = "wrench"  # name of the stream of the force/torque sensor; the others are points of the tracker
STANDSTILL = 0.002  # m/s of the fastest monitored point, below which the robot counts as standing on the page
LEVELS = {"ok": 0, "warn": 1, "error": 2, "absent": 3, "silent": 3}


def view(state: Plain) -> dict[str, Any]:
    """Return what is shown of a state.

    Args:
        state: `calibration_interfaces/State` as plain values.
    """
    procedure = state["procedure"]
    load = load_of(state)
    return {
        "text": state["text"],
        "waiting": state["waiting"],
        "running": running(state),
        "known": bool(state["procedure_known"]),
        "procedure": _procedure(state),
        "permission": _permission(state),
        "robot": _robot(state),
        "load": _load(load, procedure),
        "confirm": confirm(state, load),
        "reading": _reading(procedure),
        "bars": _bars(state["progress"]),
        "progress": _progress(state["progress"]),
        "streams": [_stream(state, one) for one in state["streams"]],
        "conditions": [_condition(one) for one in state["conditions"]["conditions"]],
        "nodes": [
            {"name": one["name"], "level": LEVELS.get(one["level"], 3), "state": one["level"],
             "fresh": fresh(state, one["name"]), "text": one["text"]}
            for one in state["nodes"]
        ],
        "faults": [{key: one[key] for key in ("level", "code", "source", "text", "remedy")} for one in state["faults"]],
        "goal": procedure["goal"],
    }  # fmt: skip


def fresh(state: Plain, node: str) -> bool:
    """Whether a node is heard, so that what it has said is current; true where the state does not tell of the node."""
    ages = [one["age"] for one in state["nodes"] if one["name"] == node]
    return all(age is not None and age <= FRESH for age in ages)


def forgotten(state: Plain) -> dict[str, Any]:
    """Return a state of which nothing is current any more: whoever told it is silent."""
    nodes = [{**one, "age": None} for one in state["nodes"]]
    return {**state, "procedure_known": False, "permission_known": False, "nodes": nodes}


def running(state: Plain) -> bool:
    """Whether a plan is being measured, as far as the sequencer is heard."""
    return bool(state["procedure_known"]) and state["procedure"]["state"] in MOVES


def unfinished(state: Plain, root: Path, last: dict[str, str] | None) -> dict[str, str] | None:
    """Return the run that can be gone on with, as session and plan below the folder; None: there is none.

    Args:
        state: The state of the cell.
        root: Folder of sessions and plans.
        last: What was returned before: a sequencer that was started again knows nothing of a run.
    """
    one = state["procedure"]
    if not state["procedure_known"] or not one["session"]:
        return last
    session, plan = Path(one["session"]), Path(one["plan"])
    begun = one["configurations_done"] < one["configurations_total"]  # which is told once a run is under way
    if not begun or session.parent != root or not plan.is_relative_to(root):
        return None
    return {"session": session.name, "plan": plan.relative_to(root).as_posix()}


def load_of(state: Plain) -> Pull:
    """Return how the load of the present step stands."""
    procedure = state["procedure"]
    force = procedure["target"]["force"]
    known = procedure["load_felt_known"] and state["procedure_known"] and fresh(state, "force_torque")
    felt = procedure["load_felt"]["force"] if known else None
    return pull(
        [force["x"], force["y"], force["z"]],
        None if felt is None else [felt["x"], felt["y"], felt["z"]],
        procedure["band_force"],
        procedure["band_angle"],
        procedure["load_fault"],
    )


def confirm(state: Plain, load: Pull) -> dict[str, Any]:
    """Return whether the operator may confirm the load now, and what speaks against it, as codes.

    The sequencer judges again, and alone: this is what the button shows.
    """
    procedure = state["procedure"]
    against = []
    if not state["procedure_known"]:
        against.append("sequencer_silent")
    elif not procedure["load_awaited"] or procedure["waits_for"] != "operator":
        against.append("no_load_awaited")
    elif load.against:
        against.append(load.against)
    streams = [_stream(state, one)["problem"] for one in state["streams"]]
    against += ["stream_" + one for one in streams if one != "fine"]
    speed = state["permission"]["speed"]
    if state["permission_known"] and speed is not None and speed > STANDSTILL:
        against.append("robot_moves")
    return {"offered": not against, "against": list(dict.fromkeys(against)), "text": procedure["load_fault"],
            "by_itself": not against and load.by_itself}  # fmt: skip


def _procedure(state: Plain) -> dict[str, Any]:
    one = state["procedure"]
    keys = ("state", "waits_for", "text", "waiting", "question", "paused", "held", "moving", "session", "plan",
            "recording", "kind", "phase_name", "configuration", "attempt", "step", "steps", "share_done", "averaged",
            "seconds_left", "load_awaited", "readings")  # fmt: skip
    found = {key: one[key] for key in keys}
    found["done"], found["total"] = one["configurations_done"], one["configurations_total"]
    found["skipped"] = one["configurations_skipped"]
    if not (state["procedure_known"] and fresh(state, "tracker") and fresh(state, "force_torque")):
        found["averaged"] = None
    return found


def _permission(state: Plain) -> dict[str, Any]:
    one = state["permission"]
    known = bool(state["permission_known"])
    speed = one["speed"] if known else None
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


def _robot(state: Plain) -> dict[str, Any]:
    one = state["robot"] if state["permission_known"] else {"operating_mode": "unknown", "drives": "unknown"}
    return {key: one[key] for key in ("operating_mode", "drives")}


def _load(load: Pull, procedure: Plain) -> dict[str, Any]:
    force = procedure["target"]["force"]
    return {
        "awaited": procedure["load_awaited"],
        "left": "" if procedure["load_awaited"] else procedure["load_left"],
        "wanted": load.wanted,
        "force": [force["x"], force["y"], force["z"]],
        "direction": list(load.direction),
        "felt": load.felt,
        "along": list(load.along),
        "off_force": load.off_force,
        "off_angle": load.off_angle,
        "band_force": load.band_force,
        "band_angle": load.band_angle,
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


def _stream(state: Plain, one: Plain) -> dict[str, Any]:
    heard = fresh(state, "force_torque" if one["name"] == WRENCH else "tracker")
    return {"name": one["name"], "problem": one["problem"] if heard else "not_heard", "text": one["text"]}


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
    rows = [
        _row("node_" + one["name"], one["level"] < LEVELS["error"] if one["fresh"] else None, one["text"])
        for one in shown["nodes"]
    ]
    heard = {one["name"] for one in shown["nodes"] if one["fresh"]}
    if "recorder" not in heard and any(one["name"] == "recorder" for one in shown["nodes"]):
        recorder = None
    rows.append(_row("mode", {"manual_reduced": True, "unknown": None}.get(robot["operating_mode"], False),
                     robot["operating_mode"], code="mode"))  # fmt: skip
    rows.append(_row("drives", {"on": True, "unknown": None}.get(robot["drives"], False), robot["drives"], "drives"))
    unproven = permission["reasons"] == ["stop_unproven"]  # the sequencer proves it before the first motion
    permitted = (permission["permitted"] or unproven) if permission["known"] else None
    rows.append(_row("permission", permitted, permission["text"]))
    for one in shown["streams"]:
        seen = one["text"] if one["problem"] not in ("fine", "not_heard") else one["problem"]
        met = {"fine": True, "not_heard": None}.get(one["problem"], False)
        rows.append(_row("stream_" + one["name"], met, seen, "stream"))
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
