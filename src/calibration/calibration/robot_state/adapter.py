"""What an adapter is, and how the latest messages of its sources become one state of the robot.

An adapter names its sources and translates their latest messages; it imports no message package (types stand as text
and are loaded when the adapter is chosen) and knows no clock.  A source that is silent for longer than it may be
counts as absent, and what is absent or not understood is UNKNOWN: the guard then says no.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from calibration_core.procedure.robot_state import RobotState, Tri
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
    translate: Callable[[Messages], RobotState]


@dataclasses.dataclass(frozen=True)
class Received:
    """A message and when it arrived (ns)."""

    message: Any
    time: int


def assemble(adapter: Adapter, received: Mapping[str, Received], now: int) -> RobotState:
    """Return the state as it is known at `now` (ns).

    `received_time` is that of the oldest steady source; zero while one of them is absent or too old.
    """
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
    state = adapter.translate(fresh)
    stamps = [stamp for message in fresh.values() if (stamp := stamp_of(message))]
    heard = ", ".join(source.name for source in adapter.sources)
    return dataclasses.replace(
        state,
        source=f"{adapter.name} ({heard})" if heard else adapter.name,
        source_time=min(stamps, default=0),
        received_time=oldest,
    )


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


def flag(value: Any) -> Tri:
    """Return a driver's bool as true, false or not said."""
    return Tri.of(bool(value)) if isinstance(value, bool | int) else Tri.UNDECIDED
