"""What an adapter is, and how the latest messages of its sources become one state of the robot.

An adapter names its sources and translates their latest messages; it imports no message package (types stand as text
and are loaded when the adapter is chosen) and knows no clock.  A source that is silent for longer than it may be
counts as absent, and what is absent or not understood is UNKNOWN: the guard then says no.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from calibration_core.motion.robot_status import RobotStatus
from calibration_core.timeseries import NANOSECONDS

Messages = Mapping[str, Any]  # source key -> latest message; what is absent is not in it


@dataclasses.dataclass(frozen=True)
class Source:
    """A topic or a service that an adapter listens to.

    Attributes:
        key: By which the adapter finds its latest message.
        name: Of the topic or service, where the driver's defaults are used.
        type: `package/msg/Name`, or `package/srv/Name` for a service that is asked again and again.
        max_age: s, after which its last message counts no longer; None: sent at changes alone.
    """

    key: str
    name: str
    type: str
    max_age: float | None = 1.0

    @property
    def is_service(self) -> bool:
        """Whether it must be asked."""
        return "/srv/" in self.type


@dataclasses.dataclass(frozen=True)
class Adapter:
    """How one make of controller is understood.

    Attributes:
        name: As in the parameter `robot_state.adapter`.
        sources: What it listens to; at least one of them is sent steadily, or none at all (`manual_confirm`).
        translate: Messages to state; total: never raises, whatever is absent or out of range.
    """

    name: str
    sources: tuple[Source, ...]
    translate: Callable[[Messages], RobotStatus]


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
        received_time: ns, when the oldest steady message behind it arrived; 0: something is missing.
        operator: Who confirmed the mode by word; empty if the controller reported it.
    """

    status: RobotStatus
    vendor_codes: tuple[int, ...] = ()
    source: str = ""
    source_time: int = 0
    received_time: int = 0
    operator: str = ""


def assemble(adapter: Adapter, received: Mapping[str, Received], now: int) -> Report:
    """Return the state as it is known at `now` (ns)."""
    fresh: dict[str, Any] = {}
    oldest = now
    for source in adapter.sources:
        latest = received.get(source.key)
        if latest is None:
            oldest = oldest if source.max_age is None else 0
        elif source.max_age is None:
            fresh[source.key] = latest.message
        else:
            if now - latest.time <= source.max_age * NANOSECONDS:
                fresh[source.key] = latest.message
            oldest = min(oldest, latest.time)
    stamps = [stamp for message in fresh.values() if (stamp := stamp_of(message))]
    heard = ", ".join(source.name for source in adapter.sources)
    return Report(
        adapter.translate(fresh),
        vendor_codes=codes_of(fresh),
        source=f"{adapter.name} ({heard})" if heard else adapter.name,
        source_time=min(stamps, default=0),
        received_time=oldest,
    )


def codes_of(messages: Messages) -> tuple[int, ...]:
    """Return the error codes that the messages carry as `vendor_codes`, `error_codes` (lists) or `error_code`."""
    found: list[int] = []
    for message in messages.values():
        code = getattr(message, "error_code", 0)
        for codes in (
            getattr(message, "vendor_codes", ()),
            getattr(message, "error_codes", ()),
            [code] if code else [],
        ):
            found += [int(one) for one in codes if str(one).lstrip("-").isdigit()]
    return tuple(found)


def stamp_of(message: Any) -> int:
    """Return the stamp of a message's header in ns, 0 where it has none."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0 if stamp is None else int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def field(messages: Messages, key: str, *path: str) -> Any:
    """Return a field of a source's latest message, None where the message or the field is absent."""
    value = messages.get(key)
    for name in path:
        value = getattr(value, name, None)
    return value


def flag(value: Any) -> bool | None:
    """Return a driver's bool; None for anything else."""
    return bool(value) if isinstance(value, bool | int) else None
