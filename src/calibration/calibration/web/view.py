"""What the page shows, from the state of the cell: a pure function of plain values, that decides nothing.

Every field is a number, a code or a text of a node; codes become words where they are shown, in the reader's language.
What a node has said is shown as current only while the node is heard.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from calibration_interfaces.msg import (
    Condition,
    Fault,
    NodeHealth,
    Permission,
    ProcedureState,
    RobotState,
    SampleCheck,
    SessionEvent,
)

from calibration.node import FRESH

Plain = Mapping[str, Any]
Json = Any
"""What JSON can carry; a number that is not finite is None."""

STATES = ("NO_RUN", "PREPARING", "READY", "MOVING", "LOADING", "SETTLING", "READING", "UNLOADING", "FINISHED")
PARTIES = ("NOBODY", "OPERATOR", "GUARD", "ROBOT", "LOAD_DEVICE", "INSTRUMENTS", "NODES")
VERDICTS = ("NONE", "KEPT", "REPEATED", "GIVEN_UP")


def _words(message: Any, names: tuple[str, ...] | None = None, prefix: str = "") -> dict[int, str]:
    """Return the constants of a message by number, as words in lower case without their prefix."""
    found = names or tuple(name for name in dir(message) if name.isupper() and name.startswith(prefix))
    numbers = {name: getattr(message, name) for name in found}
    return {one: name.removeprefix(prefix).lower() for name, one in numbers.items() if isinstance(one, int)}


MODES = _words(RobotState, prefix="MODE_")
EVENT_KINDS = _words(SessionEvent)
CONSTANTS: Mapping[str, Mapping[str, Mapping[int, str]]] = {
    "ProcedureState": {
        "state": _words(ProcedureState, STATES),
        "waits_for": _words(ProcedureState, PARTIES),
        "reading_verdict": _words(ProcedureState, VERDICTS),
    },
    "Permission": {"reasons": _words(Permission)},
    "RobotState": {
        "operating_mode": MODES,
        "drives": _words(RobotState, prefix="DRIVES_"),
        "safety": _words(RobotState, prefix="SAFETY_"),
    },
    "Condition": {"verdict": _words(Condition)},
    "Fault": {"level": _words(Fault)},
    "NodeHealth": {"level": _words(NodeHealth)},
    "SampleCheck": {"problem": _words(SampleCheck)},
}
"""Name of the message, its field, number of the constant: the word."""


def plain(message: Any) -> dict[str, Json]:
    """Return a message as plain values."""
    words = CONSTANTS.get(type(message).__name__, {})
    return {name: _value(getattr(message, name), words.get(name)) for name in message.get_fields_and_field_types()}


def _value(value: Any, words: Mapping[int, str] | None) -> Json:
    if isinstance(value, bool | str):
        return value
    if isinstance(value, int):
        return words.get(value, str(value)) if words else value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if hasattr(value, "get_fields_and_field_types"):
        return plain(value)
    if isinstance(value, bytes | bytearray):
        return [words.get(one, str(one)) if words else one for one in value]
    return [_value(one, words) for one in (value.tolist() if hasattr(value, "tolist") else value)]


@dataclasses.dataclass(frozen=True)
class Pull:
    """A load that is to be on, and what is felt.

    Attributes:
        wanted: N, size of the force.
        direction: Unit vector of the force, base axes; empty where the load is to be released.
        felt: N, size of the force that is felt; None: not known.
        along: Unit vector of what is felt, base axes; empty where hardly anything is, or it is not known.
        off_force: N, by which the size is off; None: not known.
        off_angle: rad, by which the direction is off; None: not known, or there is none.
        band_force: N, by which it may be; None: not checked.
        band_angle: rad, likewise.
        against: Code of what speaks against it; empty: nothing, or nothing is checked.
    """

    wanted: float
    direction: tuple[float, ...]
    felt: float | None
    along: tuple[float, ...]
    off_force: float | None
    off_angle: float | None
    band_force: float | None
    band_angle: float | None
    against: str

    @property
    def fits(self) -> bool:
        """Whether the sensor feels the load that is wanted: what is not felt, or not checked, does not fit."""
        return self.felt is not None and self.band_force is not None and not self.against

    @property
    def by_itself(self) -> bool:
        """Whether it may be confirmed without a hand: a release never, for the robot moves after it."""
        return self.fits and bool(self.direction)


def pull(
    wanted: Sequence[float],
    felt: Sequence[float] | None,
    band_force: float | None,
    band_angle: float | None,
    fault: str,
) -> Pull:
    """Return how a load stands.

    Args:
        wanted: (3,) N, base axes.
        felt: (3,) N, base axes; None: not known.
        band_force: N; None: not checked.
        band_angle: rad; None: not checked.
        fault: What the sequencer finds wrong with it; empty: nothing.
    """
    size = float(np.linalg.norm(wanted))
    direction = tuple(float(one) / size for one in wanted) if size > 0.0 else ()
    if felt is None:
        against = "load_not_felt" if fault or (direction and band_force is not None) else ""
        return Pull(size, direction, None, (), None, None, band_force, band_angle, against)
    found = float(np.linalg.norm(felt))
    along = tuple(float(one) / found for one in felt) if found > 0.0 else ()
    off_angle = None
    if direction and along:
        off_angle = math.atan2(float(np.linalg.norm(np.cross(direction, along))), float(np.dot(direction, along)))
    one = Pull(size, direction, found, along, found - size, off_angle, band_force, band_angle, "")
    return dataclasses.replace(one, against=_advice(one)) if fault else one


def _advice(one: Pull) -> str:
    """Say what to do about a load that the sequencer finds wrong."""
    if not one.direction:
        return "not_released"
    if one.band_force is not None and one.off_force is not None and abs(one.off_force) > one.band_force:
        return "force_too_small" if one.off_force < 0.0 else "force_too_great"
    if one.band_angle is not None and one.off_angle is not None and one.off_angle > one.band_angle:
        return "direction_off"
    return "load_differs"


class Held:
    """Since when the load of one step has fitted without a break; times are s of a steady clock."""

    def __init__(self) -> None:
        self._place: tuple[object, ...] = ()
        self._since: float | None = None
        self._taken = False

    def look(self, place: tuple[object, ...], now: float, *, fits: bool) -> float:
        """Return for how long, s, the load of a place (run, configuration, attempt, step, force) has fitted."""
        if place != self._place or not fits:
            self._place, self._since, self._taken = place, now if fits else None, False
        elif self._since is None:
            self._since = now
        return 0.0 if self._since is None else now - self._since

    def take(self, now: float, seconds: float) -> bool:
        """Return, once, whether the load has fitted for so long; again only after `refused`, or a break."""
        if self._taken or self._since is None or not 0.0 < seconds <= now - self._since:
            return False
        self._taken = True
        return True

    def refused(self, now: float) -> None:
        """Begin anew: what was taken did not count."""
        self._since, self._taken = None if self._since is None else now, False


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
            "seconds_left", "load_awaited", "readings", "point", "points_left", "points_excluded")  # fmt: skip
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
