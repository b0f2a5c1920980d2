"""Which of a recording's topics, joints and clocks match a cell file, before anything is measured in it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from calibration_core.cell import Cell
from calibration_core.recording.bags.bag import Contents, read_contents
from calibration_core.recording.bags.files import bag_files
from calibration_core.recording.messages.kinds import Samples, StreamKind

LATE = 1.0  # s between a stamp and its receipt, or between the clocks of two topics, that is worth a remark


@dataclasses.dataclass(frozen=True)
class TopicMatch:
    """One stream of a recording.

    Attributes:
        role: What the cell file wants there.
        topic: Its name.
        state: `read`, `optional` (not there, and not needed), `missing` or `unusable`.
        text: How much is there, or what is wrong and how it is mended.
    """

    role: str
    topic: str
    state: str
    text: str


def match_bag(path: Path, cell: Cell) -> tuple[TopicMatch, ...]:
    """Return how the topics of a bag answer to those that a cell file names.

    Raises:
        RecordingError: The bag cannot be read at all.
    """
    topics = cell.topics
    roles: list[tuple[str, str, StreamKind, bool]] = [("joint states", topics.joint_states, StreamKind.JOINTS, True)]
    roles += [(f"target {name}", topics.point(name), StreamKind.POINT, True) for name in cell.points]
    roles += [
        ("wrench", topics.wrench, StreamKind.WRENCH, False),
        ("temperature", topics.temperature, StreamKind.TEMPERATURE, False),
    ]
    types = read_contents(bag_files(path), {}).topics
    wanted = {topic: kind for _, topic, kind, _ in roles if types.get(topic) == kind.value}
    contents = read_contents(bag_files(path), wanted, cell.robot.joints)
    taken = {topic for _, topic, _, _ in roles}
    found = [_match(contents, taken, role, topic, kind, needed) for role, topic, kind, needed in roles]
    marked = topics.step in types
    text = "step markers" if marked else "none: plateaus are found from standstill and wrench"
    return (*found, TopicMatch("steps", topics.step, "read" if marked else "optional", text))


def _match(contents: Contents, taken: set[str], role: str, topic: str, kind: StreamKind, needed: bool) -> TopicMatch:
    type_name = contents.topics.get(topic)
    if type_name != kind.value:
        others = [name for name, what in contents.topics.items() if what == kind.value and name not in taken]
        wrong = "not in the recording" if type_name is None else f"carries {type_name} instead of {kind.value}"
        hint = (
            f"; of that type there: {', '.join(others[:6])} (topics: {{{topic}: ...}} in the cell file)"
            if others
            else ""
        )
        return TopicMatch(role, topic, "missing" if needed or others else "optional", wrong + hint)
    samples = contents.streams.get(topic)  # none where a topic was declared and never written
    if samples is None:
        return TopicMatch(role, topic, "missing" if needed else "optional", "holds no message")
    if samples.unusable and not len(samples.stamp):
        names = ", ".join(samples.example)
        text = f"names {names}; the cell file has other joints: write these names in robot.joints"
        return TopicMatch(role, topic, "unusable", text)
    if not len(samples.stamp):
        return TopicMatch(role, topic, "missing" if needed else "optional", "holds no message that can be read")
    return TopicMatch(role, topic, "read", _extent(samples))


def _extent(samples: Samples) -> str:
    stamped = samples.stamp > 0
    text = f"{len(samples.stamp):,} messages over {(samples.received[-1] - samples.received[0]) / 1e9:.0f} s"
    if not stamped.all():
        return f"{text}; without stamps: the time of receipt counts"
    late = float(np.median(samples.received - samples.stamp)) / 1e9
    return f"{text}; its clock is {late:+.3g} s off the recorder's" if abs(late) > LATE else text
