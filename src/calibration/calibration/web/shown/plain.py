"""Messages as plain values: dictionaries, lists, numbers and texts, with words in place of the numbers of constants."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

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

Plain = Any
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


def plain(message: Any) -> dict[str, Plain]:
    """Return a message as plain values."""
    words = CONSTANTS.get(type(message).__name__, {})
    return {name: _value(getattr(message, name), words.get(name)) for name in message.get_fields_and_field_types()}


def _value(value: Any, words: Mapping[int, str] | None) -> Plain:
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
