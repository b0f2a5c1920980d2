"""Any controller that sends its mode as a topic of any type: configured by field paths and value maps, no code.

The parameters of the guard under `robot_state.generic` hold, for each quantity (`operating_mode`, `drives`, `safety`,
`motion_possible`, `in_motion`, `in_error`), a text `path = value: WORD, value: WORD, ...`:

    operating_mode: "status.mode.val = 1: MANUAL_REDUCED, 2: AUTOMATIC"
    drives: "power = true: ON, false: OFF"

Values are compared as they print (true and false for bools).  What the map does not list is UNKNOWN.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping
from typing import Any

from calibration.robot_state.adapter import Adapter, Messages, Source
from calibration_core.errors import InputError, quoted
from calibration_core.motion.robot_status import Drives, OperatingMode, RobotStatus, SafetyState

Word = enum.IntEnum | bool | None
TRI_STATES: Mapping[str, Word] = {"TRUE": True, "FALSE": False}
WORDS: Mapping[str, Mapping[str, Word]] = {
    "operating_mode": OperatingMode.__members__,
    "drives": Drives.__members__,
    "safety": SafetyState.__members__,
    "motion_possible": TRI_STATES,
    "in_motion": TRI_STATES,
    "in_error": TRI_STATES,
}


@dataclasses.dataclass(frozen=True)
class Rule:
    """Where one quantity stands in the message, and what its values mean.

    Attributes:
        path: Names of fields, outermost first; a number is an index into a list.
        words: Printed value -> word.
        unknown: For all other values.
    """

    path: tuple[str, ...]
    words: Mapping[str, Word]
    unknown: Word

    def read(self, message: Any) -> Word:
        """Return the word for what the message says."""
        value = message
        for name in self.path:
            if name.isdigit():
                value = value[int(name)] if value is not None and int(name) < len(value) else None
            else:
                value = getattr(value, name, None)
        return self.words.get(printed(value), self.unknown)


def printed(value: Any) -> str:
    """Return a value as it stands in a value map."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def parse_rule(quantity: str, text: str) -> Rule:
    """Read one rule, `path = value: WORD, ...`.

    Raises:
        InputError: It is malformed, or names a quantity or word that does not exist.
    """
    place = f"robot_state.generic.{quantity}"
    kind = WORDS.get(quantity)
    if kind is None:
        raise InputError("parameters", place, "an unknown quantity", f"one of {', '.join(WORDS)}")
    path, separator, values = text.partition("=")
    if not separator or not path.strip():
        raise InputError("parameters", place, quoted(text), "path = value: WORD, value: WORD")
    words: dict[str, Word] = {}
    for part in values.split(","):
        value, colon, word = part.partition(":")
        if not colon or word.strip() not in kind:
            raise InputError("parameters", place, quoted(part.strip()), f"value: one of {', '.join(kind)}")
        words[value.strip()] = kind[word.strip()]
    return Rule(tuple(path.strip().split(".")), words, kind.get("UNKNOWN"))


def adapter(topic: str, message_type: str, max_age: float, rules: Mapping[str, str]) -> Adapter:
    """Return an adapter for one topic.

    Args:
        topic: Its name.
        message_type: `package/msg/Name`.
        max_age: s.
        rules: Quantity -> rule as text; at least `operating_mode` and `drives` and `safety`.

    Raises:
        InputError: A rule is missing or malformed.
    """
    for needed in ("operating_mode", "drives", "safety"):
        if not rules.get(needed):
            raise InputError("parameters", f"robot_state.generic.{needed}", "nothing", "a rule")
    parsed = {name: parse_rule(name, text) for name, text in rules.items() if text}

    def translate(messages: Messages) -> RobotStatus:
        message = messages.get("state")
        if message is None:
            return RobotStatus()
        found: dict[str, Any] = {name: rule.read(message) for name, rule in parsed.items()}
        return RobotStatus(**found)

    return Adapter("generic", (Source("state", topic, message_type, max_age),), translate)
