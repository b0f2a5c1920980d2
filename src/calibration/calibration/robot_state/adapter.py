"""What drivers say, in our own words: one engine, and a table for every driver (`config/drivers/*.yaml`).

A table names a driver's topics and services, how old their last message may be, and for each quantity of the robot's
state where it stands and what its values mean; `doc/nodes.md` describes the keys.  What is absent, too old or not in
the table is unknown, and the guard says no.  Message packages are loaded when a table is chosen; every field and
constant that it reads is looked up in them then.

Where the controller does not report the operating mode, or says no more than "manual", an operator's word fills it
in.  On makes where T1 and T2 look alike, nobody sees the key switch being turned and turned back.  A word therefore
holds for what the controller reported when it was given, and no longer than somebody may be thought to mind the switch.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, Any

from pydantic import Field, ValidationError, field_validator, model_validator

from calibration.robot_state import FOLDER, GENERIC, NAMES
from calibration.tables import Strict, read_table
from calibration.topics import NO_PACKAGE, load_type
from calibration_core.cell.values import FieldError
from calibration_core.errors import InputError, quoted
from calibration_core.motion.robot_status import Drives, OperatingMode, Reason, RobotStatus, SafetyState
from calibration_core.timeseries import NANOSECONDS

LONGEST_AGE = 10.0  # s: whoever has heard nothing for longer knows nothing
NEXT = "next"  # a rule's word: the rule after it decides
TRUTHS: Mapping[Any, Any] = {True: True, False: False}
WORDS: Mapping[str, Mapping[Any, Any]] = {
    "operating_mode": OperatingMode.__members__,
    "drives": {True: Drives.ON, False: Drives.OFF, **Drives.__members__},  # ON and OFF without quotes, truths in YAML
    "safety": SafetyState.__members__,
    **dict.fromkeys(("motion_possible", "in_motion", "in_error"), TRUTHS),
}
NUMBERS = ("speed_scaling", "speed_limit")
CODES = "vendor_codes"
STEP = re.compile(r"(\w+)(\[(?:(\d+)|(\w+)=(\w+))?\])?")
"""A field; of a list `a[]` is the only one, `a[2]` the third, `a[b=c]` the one where the list b beside it has c."""

Path_ = tuple[tuple[str, ...], ...]
Messages = Mapping[str, Any]  # source -> latest message, or answer; what is absent is not in it
Load = Callable[[str], Any]
Age = Annotated[float, Field(gt=0.0, le=LONGEST_AGE, strict=True)]
Text = Annotated[str, Field(min_length=1, max_length=1000)]


class Source(Strict):
    """A topic, or a service that is asked again and again and is missed by nobody.

    Attributes:
        name: Of the topic or service, in the cell's namespace.
        type: `package/msg/Name` or `package/srv/Name` -> where in it the state stands.  Several, where releases of a
            driver differ: the first that is installed.
        max_age: s, after which its last message counts no longer; None: sent at changes alone, and kept for latecomers.
        optional: Why a release may not have its type; empty if all have.
        evidence: Where the driver's source says so.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z_~][\w/]*$")]
    type: Annotated[dict[str, str], Field(min_length=1)]
    max_age: Age | None
    optional: str = ""
    evidence: str = ""

    @field_validator("type", mode="before")
    @classmethod
    def _types(cls, value: Any) -> Any:
        types = {value: ""} if isinstance(value, str) else value
        for name, state in types.items() if isinstance(types, dict) else ():
            if not re.fullmatch(r"\w+/(msg|srv)/\w+", name):
                raise FieldError("", quoted(name), "package/msg/Name or package/srv/Name")
            _path(str(state))
        return types

    @property
    def kind(self) -> str:
        """The first of its types; the only one, the one that is installed, of an adapter that is loaded."""
        return next(iter(self.type))

    @property
    def is_service(self) -> bool:
        """Whether it must be asked."""
        return "/srv/" in self.kind


class Rule(Strict):
    """Where a quantity stands, and what its values mean.

    Attributes:
        read: Key of the source and fields, with dots between; empty: the word of the empty text is stated, not read.
        means: Value as it prints, or name of a constant of the message -> word.
        times: What a number is multiplied with.
    """

    read: str
    means: dict[str, Any] = Field(default_factory=dict)
    times: float = 1.0


class Adapter(Strict):
    """How a driver is understood: its table.

    Attributes:
        name: As in the parameter `robot_state.adapter`.
        driver: Its repository.
        releases: Those that the table was held against, with their commits.
        sources: Key -> what is listened to or asked.
        state: Quantity -> rules, of which the first that has a word for what is said decides.
        in_motion_latency: s, for which `in_motion` may still be said after the robot has come to rest.
        remote: Whether `motion_possible` speaks of motion commanded from outside alone, not of jogging.
        notes: What a reason means with this driver, for a person.
    """

    name: str
    driver: str = ""
    releases: dict[str, Text] = Field(default_factory=dict)
    sources: dict[str, Source]
    state: dict[str, tuple[Rule, ...]]
    in_motion_latency: Annotated[float, Field(ge=0.0, le=LONGEST_AGE)] = 0.0
    remote: bool = True
    notes: dict[str, Text] = Field(default_factory=dict)

    @field_validator("state", mode="before")
    @classmethod
    def _rules(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        for needed in ("operating_mode", "drives", "safety"):
            if needed not in value:
                raise FieldError(needed, "nothing", "a rule")
        return {quantity: list(_read_rules(quantity, rules)) for quantity, rules in value.items()}

    @model_validator(mode="after")
    def _consistent(self) -> Adapter:
        for quantity, rules in self.state.items():
            for rule in rules:
                key, _, rest = rule.read.partition(".")
                if rule.read and (key not in self.sources or not rest):
                    expected = f"field of one of {', '.join(self.sources) or 'no source at all'}, as source.field"
                    raise FieldError(f"state.{quantity}", quoted(rule.read), expected)
                _path(rest)
        if self.sources and not self.awaited:
            raise FieldError("sources", "none that is sent steadily", "a topic with max_age, the driver's sign of life")
        for name in set(self.notes) - set(Reason.__members__):
            raise FieldError(f"notes.{name}", "an unknown reason", f"one of {', '.join(Reason.__members__)}")
        return self

    @property
    def awaited(self) -> dict[str, Source]:
        """Topics that are sent steadily: without one of them nothing is known."""
        return {key: one for key, one in self.sources.items() if one.max_age is not None and not one.is_service}

    def translate(self, messages: Messages) -> RobotStatus:
        """Return the state that the messages tell; never raises, whatever is absent or out of range."""
        known: dict[str, Any] = {}
        for quantity, rules in self.state.items():
            if quantity in WORDS:
                words = (self._word(rule, messages) for rule in rules)
                word = next((word for word in words if word != NEXT), None)
                known[quantity] = WORDS[quantity].get("UNKNOWN") if word is None else word
            elif quantity in NUMBERS:
                known[quantity] = _number(self._value(rules[0], messages)[1]) * rules[0].times
        return RobotStatus(**known)

    def codes(self, messages: Messages) -> tuple[int, ...]:
        """Return the error codes that the messages carry."""
        found = [self._value(rule, messages)[1] for rule in self.state.get(CODES, ())]
        return tuple(int(code) for codes in found if codes is not None for code in codes)

    def _word(self, rule: Rule, messages: Messages) -> Any:
        holder, value = self._value(rule, messages)
        return {_printed(_constant(holder, key)): word for key, word in rule.means.items()}.get(_printed(value))

    def _value(self, rule: Rule, messages: Messages) -> tuple[Any, Any]:
        """Return the message that holds the field that a rule reads, and the field's value; None: there is none."""
        if not rule.read:
            return None, ""
        return _found(messages.get(rule.read.partition(".")[0]), self._path(rule))

    def _path(self, rule: Rule) -> Path_:
        key, _, rest = rule.read.partition(".")
        source = self.sources[key]
        return _path(f"{source.type[source.kind]}.{rest}".lstrip("."))

    def loaded(self, load: Load = load_type) -> Adapter:
        """Return the adapter with those types of its sources that are installed.

        Args:
            load: Name of a type to its class; InputError where there is none.

        Raises:
            InputError: A package is not installed, or a message has no such field or constant.
        """
        sources = {}
        for key, source in self.sources.items():
            faults: list[InputError] = []
            for name, place in source.type.items():
                try:
                    load(name)
                except InputError as fault:
                    faults.append(fault)
                    continue
                sources[key] = source.model_copy(update={"type": {name: place}})
                break
            else:
                if not source.optional or faults[-1].found == NO_PACKAGE:
                    raise faults[-1]
        state = {
            quantity: tuple(rule for rule in rules if rule.read.partition(".")[0] in {"", *sources})
            for quantity, rules in self.state.items()
        }
        found = self.model_copy(update={"sources": sources, "state": state})
        for text in found.missing(load):
            raise InputError(
                f"driver {self.name}", "", text, f"an interface of {', '.join(self.releases) or 'its own'}"
            )
        return found

    def missing(self, load: Load = load_type) -> list[str]:
        """Return what the rules read and the types, loaded already, do not have."""
        found = []
        for quantity, rules in self.state.items():
            for rule in (one for one in rules if one.read):
                name = self.sources[rule.read.partition(".")[0]].kind
                kind = load(name).Response if "/srv/" in name else load(name)
                found += [f"{quantity}: {text}" for text in _lacks(kind, self._path(rule), rule, load)]
        return found


@dataclasses.dataclass(frozen=True)
class Received:
    """A message and when it arrived (ns)."""

    message: Any
    time: int


@dataclasses.dataclass(frozen=True)
class Report:
    """The robot's state as it is known from all sources of an adapter.

    Attributes:
        status: The state in our words.
        vendor_codes: Error codes as the controller gives them.
        source: Adapter, and what it listens to.
        source_time: ns, oldest stamp of the messages behind it; 0 where they have none.
        first: Name of the awaited topic that is the first to become too old; empty where none is awaited.
        received_time: ns, when its last message arrived, 0 if none has; the time of the report where none is awaited.
        max_age: s, how old it may become.
        operator: Who confirmed the mode by word; empty if the controller reported it.
    """

    status: RobotStatus
    vendor_codes: tuple[int, ...] = ()
    source: str = ""
    source_time: int = 0
    first: str = ""
    received_time: int = 0
    max_age: float = math.inf
    operator: str = ""


def assemble(adapter: Adapter, received: Mapping[str, Received], now: int) -> Report:
    """Return the state as it is known at `now` (ns)."""
    fresh = {
        key: received[key].message
        for key, source in adapter.sources.items()
        if key in received and now - received[key].time <= (source.max_age or math.inf) * NANOSECONDS
    }
    times = {key: received[key].time if key in received else 0 for key in adapter.awaited}
    ends = {key: times[key] + (source.max_age or 0.0) * NANOSECONDS for key, source in adapter.awaited.items()}
    first = min(ends, key=ends.__getitem__, default="")
    stamps = [stamp for message in fresh.values() if (stamp := stamp_of(message))]
    heard = ", ".join(source.name for source in adapter.sources.values())
    return Report(
        adapter.translate(fresh),
        vendor_codes=adapter.codes(fresh),
        source=f"{adapter.name} ({heard})" if heard else adapter.name,
        source_time=min(stamps, default=0),
        first=adapter.sources[first].name if first else "",
        received_time=times.get(first, now),
        max_age=(adapter.sources[first].max_age or math.inf) if first else math.inf,
    )


def stamp_of(message: Any) -> int:
    """Return the stamp of a message's header in ns, 0 where it has none."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0 if stamp is None else int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def load_adapter(name: str, own: str = "") -> Adapter:
    """Read a driver's table.

    Args:
        name: One of `NAMES`.
        own: File of the user's own table, for `generic`.

    Raises:
        InputError: There is none of this name, or the table cannot be used; with line and column.
    """
    if name not in NAMES:
        raise InputError("parameters", "robot_state.adapter", quoted(name), f"one of {', '.join(NAMES)}")
    if name == GENERIC and not own:
        raise InputError("parameters", "robot_state.table", "nothing", "the file of your driver's table")
    return read_table(own if name == GENERIC else FOLDER / f"{name}.yaml", Adapter, "a driver", name=name)


def _read_rules(quantity: str, rules: Any) -> Iterator[Rule]:
    """Yield the rules of one quantity as a table states them: a word, a rule, or several rules."""
    listed = rules if isinstance(rules, list) else [rules]
    for i, one in enumerate(listed):
        place = f"{quantity}.{i}" if isinstance(rules, list) else quantity
        if quantity not in (*WORDS, *NUMBERS, CODES):
            raise FieldError(quantity, "an unknown quantity", f"one of {', '.join((*WORDS, *NUMBERS, CODES))}")
        if not isinstance(one, dict):
            one = {"read": "", "means": {"": one}}
        means, words = one.get("means", {}), WORDS.get(quantity, {})
        if not isinstance(means, dict) or bool(means) != bool(words):
            raise FieldError(f"{place}.means", quoted(means), "words by values" if words else "nothing")
        for key, word in means.items():
            if isinstance(word, dict | list) or (word not in words and word != NEXT):
                names = {True: "ON", False: "OFF"} if quantity == "drives" else {True: "true", False: "false"}
                known = dict.fromkeys(str(names.get(name, name)) for name in words)
                expected = f"one of {', '.join(known)}, or {NEXT}"
                raise FieldError(f"{place}.means.{key}" if key else place, quoted(word), expected)
        try:
            yield Rule.model_validate({**one, "means": {key: words.get(word, NEXT) for key, word in means.items()}})
        except ValidationError as fault:
            raise FieldError(place, quoted(one), f"a rule: {fault.errors()[0]['msg']}") from None


@functools.cache
def _path(text: str) -> Path_:
    """Return fields with dots between as their parts.

    Raises:
        FieldError: One of them is none.
    """
    steps = []
    for part in filter(None, text.split(".")):
        step = STEP.fullmatch(part)
        if step is None:
            raise FieldError("", quoted(part), "a field: name, name[], name[2] or name[other=text]")
        steps.append(tuple(one or "" for one in step.groups()))
    return tuple(steps)


def _found(message: Any, path: Path_) -> tuple[Any, Any]:
    """Return the message that holds the last field of a path, and the field's value; None where there is none."""
    holder = value = message
    for name, element, index, names, key in path:
        holder, value = value, getattr(value, name, None)
        if element and value is not None:
            places = [int(index)] if index else list(range(len(value)))
            if names:
                places = [i for i, one in enumerate(getattr(holder, names, ())) if one == key]
            value = value[places[0]] if len(places) == 1 and places[0] < len(value) else None
    return holder, value


def _lacks(kind: Any, path: Path_, rule: Rule, load: Load) -> Iterator[str]:
    """Yield the fields and constants that a rule reads and a type does not have."""
    field = ""
    for name, _, _, names, _ in path:
        if field:
            package, _, of = re.sub(r"sequence<|[,\[>].*", "", field).partition("/")
            kind = load(f"{package}/msg/{of}")
        fields = kind.get_fields_and_field_types()
        for one in filter(None, (name, names)):
            if one not in fields:
                yield f"{kind.__name__} without field {one}"
                return
        field = fields[name]
    for key in rule.means:
        literal = key in ("true", "false") if field == "boolean" else key.lstrip("-").isdigit() or "string" in field
        if not literal and not (key.isupper() and hasattr(kind, key)):
            yield f"{kind.__name__} without constant {key} for {path[-1][0]} ({field})"


def _constant(holder: Any, key: str) -> Any:
    return getattr(type(holder), key, key) if key.isupper() else key


def _printed(value: Any) -> str:
    """Return a value as it stands in a table."""
    if isinstance(value, bool):
        return str(value).lower()
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)


def _number(value: Any) -> float:
    real = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if real else math.nan


LONGEST = 3600.0  # s, then somebody has to look at the key switch again
UNPOWERED = 60.0  # s, that the drives may not be on: a change of tool or target; in a longer pause the switch is free
MANUAL = frozenset({OperatingMode.MANUAL_REDUCED, OperatingMode.MANUAL_HIGH})
CONFIRMABLE: Mapping[OperatingMode, frozenset[OperatingMode]] = {  # by what the controller reports
    OperatingMode.UNKNOWN: MANUAL | {OperatingMode.AUTOMATIC, OperatingMode.EXTERNAL},
    OperatingMode.MANUAL_UNSPECIFIED: MANUAL,
}


@dataclasses.dataclass(frozen=True)
class Confirmation:
    """What an operator stated.

    Attributes:
        operator: Who answers for it.
        mode: What was stated.
        reported: The mode that the controller reported then.
        until: s, when it ends, or has ended, by the guard's clock.
        off_since: s, since when the drives are not known to be on; None: they are on.
    """

    operator: str
    mode: OperatingMode
    reported: OperatingMode
    until: float
    off_since: float | None = None

    def after(self, status: RobotStatus, now: float) -> Confirmation:
        """Return what is left of it at `now` (s), when the controller reports `status`; what has ended never returns.

        It ends with every change of the reported mode, silence included, and after `UNPOWERED` without drives.
        """
        since = now if self.off_since is None else self.off_since
        off_since = None if status.drives is Drives.ON else since
        ended = status.operating_mode is not self.reported or now - since >= UNPOWERED
        return dataclasses.replace(self, off_since=off_since, until=min(self.until, now) if ended else self.until)


def checked(operator: str, mode: int, valid_for: float, reported: OperatingMode, now: float) -> Confirmation:
    """Return a confirmation that begins at `now` (s); it lasts for an hour at most, whatever was asked for.

    Raises:
        InputError: Nobody answers for it, the controller reports a mode that leaves nothing to be confirmed, the mode
            is none that can be confirmed, or it is to last for no time.
    """
    place = "confirmation"
    if not operator.strip():
        raise InputError(place, "operator_name", quoted(operator), "the name of who answers for it")
    if reported not in CONFIRMABLE:
        expected = "a mode that it does not tell; where it is wrong, turn the key switch"
        raise InputError(place, "operating_mode", f"{reported.name}, reported by the controller", expected)
    if mode not in CONFIRMABLE[reported]:
        expected = ", ".join(f"{one.value} ({one.name})" for one in sorted(CONFIRMABLE[reported]))
        raise InputError(place, "operating_mode", str(mode), f"one of {expected}")
    if not 0.0 < valid_for < math.inf:
        raise InputError(place, "valid_for", f"{valid_for:g} s", f"above 0, at most {LONGEST:g} s")
    return Confirmation(operator.strip(), OperatingMode(mode), reported, now + min(valid_for, LONGEST))


def confirmed(report: Report, confirmation: Confirmation | None, now: float) -> Report:
    """Fill in the mode that an operator confirmed.

    An operator's word never overrules a mode that the controller reports; an ended one is kept in the report, so that
    the reason can be named.
    """
    reported = report.status.operating_mode
    if confirmation is None or confirmation.mode not in CONFIRMABLE.get(reported, frozenset()):
        return report
    status = dataclasses.replace(
        report.status,
        operating_mode=confirmation.mode if now < confirmation.until else reported,
        operator_confirmed=True,
        confirmed_until=confirmation.until,
    )
    return dataclasses.replace(report, status=status, operator=confirmation.operator)
