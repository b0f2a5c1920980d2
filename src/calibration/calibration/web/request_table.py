"""What a page may ask for: each request with its fields, their kinds and limits, and who may ask.

A request that is not in the table, or has a field that is missing, unknown, of the wrong kind or beyond its limit, is
refused in one line before anything else hears of it.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping

from calibration_core.errors import InputError, quoted

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,59}")
CONTROL_CHARACTERS = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")

Value = str | float | int | bool


class RequestError(InputError):
    """A page asks for something that cannot be: unknown, malformed, or not now."""


@dataclasses.dataclass(frozen=True)
class Field:
    """One field of a request.

    Attributes:
        kind: `text`, `name` (a file or folder: letters, digits, `_`, `-`, `.`), `number`, `integer` or `flag`.
        low: Least number, or least length of a text.
        high: Greatest number, or greatest length of a text.
        default: Taken where the field is not given; None: it must be given.
        choices: The texts allowed; empty: any.
    """

    kind: str = "text"
    low: float = 0
    high: float = 200
    default: Value | None = None
    choices: tuple[str, ...] = ()

    def read(self, name: str, field: str, given: object) -> Value:
        """Return a field's value.

        Raises:
            RequestError: It is of another kind, or beyond its limits.
        """
        fault = self._fault(given)
        if fault:
            raise RequestError(f"request {name}", field, quoted(given), fault)
        assert isinstance(given, str | float | int | bool)  # noqa: S101 - or there would be a fault
        return given.strip() if isinstance(given, str) else given

    def _fault(self, given: object) -> str:
        """Say what was expected instead; empty if nothing was."""
        if self.kind == "flag":
            return "" if isinstance(given, bool) else "true or false"
        if self.kind in ("number", "integer"):
            kind = (int,) if self.kind == "integer" else (int, float)
            if not isinstance(given, kind) or isinstance(given, bool) or not math.isfinite(float(given)):
                return f"a finite {self.kind}"
            return "" if self.low <= given <= self.high else f"{self.low:g} to {self.high:g}"
        if not isinstance(given, str):
            return "a text"
        if self.choices:
            return "" if given in self.choices else f"one of {', '.join(self.choices)}"
        if self.kind == "name":
            return "" if NAME.fullmatch(given) else "letters, digits, _, - and ., at most 60"
        if not self.low <= len(given.strip()) <= self.high:
            return f"{self.low:g} to {self.high:g} characters"
        return "a text without control characters" if CONTROL_CHARACTERS.search(given) else ""


@dataclasses.dataclass(frozen=True)
class Kind:
    """One kind of request.

    Attributes:
        fields: By name.
        control: Whether it takes control; what does not may be asked by every page that has entered.
    """

    fields: Mapping[str, Field] = dataclasses.field(default_factory=dict)
    control: bool = True


OPERATOR = Field(low=1, high=80)
REASON = Field(low=3, high=500)
COUNT = Field("integer", 0, 2**32 - 1)
FOLDER = Field("name")

KINDS: Mapping[str, Kind] = {
    # at any time, by every page that has entered: a stop is never refused for want of control
    "stop": Kind(control=False),
    "control_ask": Kind(control=False),
    "control_release": Kind(control=False),
    "control_answer": Kind({"give": Field("flag")}),
    "operator": Kind({"name": OPERATOR}, control=False),
    # the run
    "run": Kind(
        {
            "plan": Field(high=300, low=1),
            "session": FOLDER,
            "resume": Field("flag"),
            "wanted_accuracy": Field("number", 0.0, 1.0, 0.0),
            "stop_when_enough": Field("flag", default=False),
        }
    ),
    "pause": Kind(),
    "resume": Kind(),
    "resume_motion": Kind(),
    "repeat": Kind(),
    "skip": Kind(),
    "point": Kind(
        {
            "what": Field(choices=("skip", "repeat", "exclude")),
            "point": Field("name"),
            "reason": Field(high=500, default=""),
        }
    ),
    "load_applied": Kind(
        {
            "configuration": COUNT,
            "step": COUNT,
            "override": Field("flag", default=False),
            "reason": Field(high=500, default=""),
        }
    ),
    "hold_time": Kind({"seconds": Field("number", 0.0, 30.0)}),
    "override_condition": Kind({"condition": Field(low=1, high=100), "reason": REASON}),
    # the guard and the instruments
    "guard_reset": Kind(),
    "confirm_mode": Kind({"valid_for": Field("number", 60.0, 3600.0)}),
    "tare": Kind({"clear": Field("flag", default=False)}),
    "self_test": Kind({"step": Field(choices=("add", "evaluate", "clear")), "mass": Field("number", 0.0, 5000.0, 0.0)}),
    # evaluation
    "identify": Kind({"what": Field(choices=("stiffness", "diagnosis")), "session": FOLDER}),
    "cancel_evaluation": Kind(),
}


def read(name: str, given: object) -> dict[str, Value]:
    """Return the fields of a request, what is not given by default.

    Args:
        name: Of the request.
        given: What came, parsed.

    Raises:
        RequestError: There is no such request, or its fields are not as they should be.
    """
    kind = KINDS.get(name)
    if kind is None:
        raise RequestError("request", "", quoted(name), f"one of {', '.join(KINDS)}")
    if not isinstance(given, dict):
        raise RequestError(f"request {name}", "", type(given).__name__, "an object of fields")
    unknown = sorted(str(one) for one in given if one not in kind.fields)
    if unknown:
        raise RequestError(f"request {name}", "", quoted(unknown[0]), f"one of {', '.join(kind.fields) or 'no field'}")
    values: dict[str, Value] = {}
    for field, one in kind.fields.items():
        if field in given:
            values[field] = one.read(name, field, given[field])
        elif one.default is None:
            raise RequestError(f"request {name}", field, "nothing", f"a {one.kind}")
        else:
            values[field] = one.default
    return values
