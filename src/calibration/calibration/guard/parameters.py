"""Parameters of the guard, and the rules and the adapter that they make."""

from __future__ import annotations

import dataclasses
import math

from calibration.conversions import mode_names
from calibration.motion.arrival import ArrivalRules
from calibration.motion.backends import MOTION_INTERFACE
from calibration.node import CalibrationNode, Declared
from calibration.robot_state import NAMES
from calibration.robot_state.adapter import LONGEST_AGE, Adapter, load_adapter
from calibration_core.cell import Cell
from calibration_core.errors import InputError, quoted
from calibration_core.motion.guard import GuardRules
from calibration_core.motion.robot_status import OperatingMode, Reason

RULES = GuardRules()
MODES = tuple(mode.name for mode in OperatingMode if mode is not OperatingMode.UNKNOWN)

PARAMETERS = (
    Declared("cell", "", "The cell file.", required=True),
    Declared("rate", 50.0, "Hz, of the permission.", low=20.0, high=500.0),
    Declared("allowed_modes", ["MANUAL_REDUCED"], f"Operating modes in which motion is permitted: {', '.join(MODES)}."),
    Declared("speed_limit", RULES.speed_limit, "m/s, of every monitored point.", low=0.01, high=0.25),
    Declared("joint_error", RULES.joint_error, "rad or m, of the difference of two joint states.", low=0.0, high=1e-3),
    Declared("time_error", RULES.time_error, "s, likewise of their stamps.", low=0.0, high=0.01),
    Declared(
        "tracking_error",
        RULES.tracking_error,
        "rad or m, a standing joint lies beside its command; a cancelled goal holds it where it is measured.",
        low=0.0,
        high=ArrivalRules().tolerance,  # a robot that lies farther off never arrives
    ),
    Declared("max_joints_age", RULES.max_joints_age, "s, of the joint states.", low=0.01, high=1.0),
    Declared(
        "freeze_time",
        RULES.freeze_time,
        "s, joint states repeat while in motion, beyond the driver's latency.",
        low=0.02,
        high=5.0,
    ),
    Declared("max_pause", RULES.max_pause, "s, between two decisions, and between stamps of joint states.", low=0.1),
    *MOTION_INTERFACE,
    Declared("sequencer_age", 0.1, "s, of the sequencer's sign of life while it moves the robot.", low=0.05, high=5.0),
    Declared("trace", "", "File for the monotonic clock's ns of what it stops; empty: none."),
    Declared("clock_jump", 2.0, "s, the clock of messages may advance in a second.", low=0.1, high=3600.0),
    Declared("robot_state.adapter", "native", "How the controller's state is understood.", choices=NAMES),
    Declared("robot_state.topics", [], "Names of topics other than the driver's defaults, as key=name."),
    Declared(
        "robot_state.max_ages", [], "s, that a source's last message counts, other than the driver's, as key=seconds."
    ),
    Declared("robot_state.table", "", "File of your driver's own table, for the adapter `generic`."),
)


def guard_rules(node: CalibrationNode, cell: Cell, adapter: Adapter) -> GuardRules:
    """Return the limits, with what the driver makes of them.

    Raises:
        InputError: A mode is unknown.
    """
    try:
        modes = mode_names(node.value("allowed_modes"))
    except KeyError as error:
        raise InputError("guard", "allowed_modes", quoted(error.args[0]), f"some of {', '.join(MODES)}") from None
    declared = None if cell.safety is None else cell.safety.speed_limit
    table = {one.name for one in PARAMETERS}
    names = {field.name for field in dataclasses.fields(GuardRules)} - {"allowed_modes", "declared_limit"}
    given = {name: node.value(name) for name in names & table}
    given["freeze_time"] += adapter.in_motion_latency
    awaited = ", ".join(source.name for source in adapter.awaited.values())
    notes = {Reason.STATE_ABSENT: f"awaited: {awaited}"} if awaited else {}
    notes |= {Reason[name]: text for name, text in adapter.notes.items()}
    return GuardRules(allowed_modes=modes, declared_limit=declared, remote=adapter.remote, notes=notes, **given)


def configured_adapter(node: CalibrationNode) -> Adapter:
    """Return the adapter with the topics and ages that are given.

    Raises:
        InputError: One of them cannot be used, or a message package is not installed.
    """
    adapter = load_adapter(node.value("robot_state.adapter"), node.value("robot_state.table"))
    topics, ages = _by_key(node, adapter, "robot_state.topics"), _by_key(node, adapter, "robot_state.max_ages")
    sources = dict(adapter.sources)
    for key, name in topics.items():
        sources[key] = sources[key].model_copy(update={"name": name})
    for key, text in ages.items():
        sources[key] = sources[key].model_copy(update={"max_age": _seconds("robot_state.max_ages", text)})
    return adapter.model_copy(update={"sources": sources}).loaded()


def _by_key(node: CalibrationNode, adapter: Adapter, name: str) -> dict[str, str]:
    known = adapter.sources
    found = {}
    for entry in node.value(name):
        key, _, text = entry.partition("=")
        if key not in known or not text:
            expected = f"key=value with a key of {', '.join(sorted(known)) or 'no topic at all'}"
            raise InputError("guard", name, quoted(entry), expected)
        found[key] = text
    return found


def _seconds(name: str, text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not 0.0 < seconds <= LONGEST_AGE:
        raise InputError("guard", name, quoted(text), f"above 0, at most {LONGEST_AGE:g} s")
    return seconds
