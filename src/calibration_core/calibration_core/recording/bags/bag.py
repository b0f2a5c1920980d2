"""Bags to arrays."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import CellError, RecordingError
from calibration_core.recording.bags.conditions import read_conditions
from calibration_core.recording.bags.files import BagFiles, BagStorage, bag_files, type_error
from calibration_core.recording.bags.plan_hash import one_plan, plans_of_events
from calibration_core.recording.bags.streams import to_series
from calibration_core.recording.dates import iso_date
from calibration_core.recording.definitions.own import CONDITIONS_TYPE, EVENT_TOPIC, EVENT_TYPE, STEP_TYPE, TEXT_TYPE
from calibration_core.recording.messages.decode import Decoder
from calibration_core.recording.messages.kinds import Samples, StreamKind
from calibration_core.recording.messages.typed import FAULTS, deserializer, stamp_of
from calibration_core.recording.source import sha256_of, storage_suffix
from calibration_core.recording.storage.batch import Batch
from calibration_core.timeseries import Condition, Note, Provenance, StepMarkers, Streams, TimeSeries

MAX_MARKERS = 1_000_000


@dataclasses.dataclass(frozen=True)
class Contents:
    """What was read from a bag: decoded streams, markers and text, and what was lost.

    Attributes:
        streams: Topic -> samples, for every requested topic that is in the bag.
        markers: Rows of receive time, stamp, configuration, step, phase.
        text: The first message on the text topic, empty if there is none.
        topics: Topic -> type of everything in the bag.
        notes: What was lost.
        conditions: The standard's conditions as seen while measuring, one tuple per message.
        plans: SHA-256 of every plan that the events name.
    """

    streams: Mapping[str, Samples]
    markers: tuple[tuple[int, int, int, int, int], ...]
    text: str
    topics: Mapping[str, str]
    notes: tuple[Note, ...]
    conditions: tuple[tuple[Condition, ...], ...] = ()
    plans: frozenset[str] = frozenset()


def read_contents(
    bag: BagFiles,
    streams: Mapping[str, StreamKind],
    joints: tuple[str, ...] = (),
    *,
    step_topic: str = "",
    text_topic: str = "",
    conditions_topic: str = "",
    event_topic: str = "",
    fast: bool = True,
) -> Contents:
    """Read the given topics of a bag.

    Args:
        bag: The files.
        streams: Topic -> what its messages must be.
        joints: Names of the joints, in order.
        step_topic: Topic of the step markers, empty: none.
        text_topic: Topic of the robot description, empty: none.
        conditions_topic: Topic of the standard's conditions, empty: none.
        event_topic: Topic of the session's events, empty: none.
        fast: Whether fixed layouts are read without Python per message.

    Raises:
        RecordingError: A file cannot be used, or a topic carries another type.
    """
    storage = BagStorage(bag)
    decoders: dict[str, Decoder] = {}
    markers: list[tuple[int, int, int, int, int]] = []
    notes: list[Note] = []
    conditions: list[tuple[Condition, ...]] = []
    text = ""
    others = {
        step_topic: STEP_TYPE,
        text_topic: TEXT_TYPE,
        conditions_topic: CONDITIONS_TYPE,
        event_topic: EVENT_TYPE,
    }
    plans: set[str] = set()
    other_types: dict[str, str] = {}
    wanted = {*streams, *others} - {""}
    for batch in storage.batches(wanted):
        topic = batch.channel.topic
        kind = streams.get(topic)
        expected = kind.value if kind else others[topic]
        if batch.channel.type != expected:
            if kind is StreamKind.TEMPERATURE:  # what is not needed refuses nothing
                other_types[topic] = batch.channel.type
                continue
            raise type_error(bag.path, batch.channel, expected)
        if kind:
            if topic not in decoders:
                decoders[topic] = Decoder(str(bag.path), kind, joints, fast=fast)
            decoders[topic].add(batch)
        elif topic == step_topic:
            markers += _markers(bag, batch, notes, len(markers))
        elif topic == conditions_topic:
            conditions += read_conditions(str(bag.path), batch, notes)
        elif topic == event_topic:
            plans |= plans_of_events(str(bag.path), batch, notes)
        elif not text:
            text = _text(bag, batch, notes)
    samples = {topic: decoder.samples() for topic, decoder in decoders.items()}
    notes += [
        Note("other_type", topic, f"messages of type {name} instead of {streams[topic].value}: not read")
        for topic, name in other_types.items()
    ]
    every_note = (*storage.notes, *notes)
    return Contents(samples, tuple(markers), text, storage.topics, every_note, tuple(conditions), frozenset(plans))


def _markers(bag: BagFiles, batch: Batch, notes: list[Note], before: int) -> list[tuple[int, int, int, int, int]]:
    read = deserializer(str(bag.path), batch.channel)
    if before + len(batch) > MAX_MARKERS:
        raise RecordingError(bag.path, batch.channel.topic, "endless step markers", f"at most {MAX_MARKERS}")
    rows: list[tuple[int, int, int, int, int]] = []
    for row in range(len(batch)):
        try:
            message = read(batch.payload(row))
            change = (int(message.configuration), int(message.step), int(message.phase))
            rows.append((int(batch.received[row]), stamp_of(message.header), *change))
        except FAULTS:
            notes.append(Note("malformed", batch.channel.topic, "a step marker cannot be read"))
    return rows


def _text(bag: BagFiles, batch: Batch, notes: list[Note]) -> str:
    try:
        return str(deserializer(str(bag.path), batch.channel)(batch.payload(0)).data)
    except FAULTS:
        notes.append(Note("malformed", batch.channel.topic, "the robot description cannot be read"))
        return ""


def read_bag(path: Path, cell: Cell) -> Streams:
    """Read a bag: a rosbag2 directory, or a bare storage file.

    Read are `.mcap` and `.db3`, uncompressed or compressed (MCAP chunks in zstd or lz4; rosbag2's file and message
    compression in zstd), split or not, with or without metadata and index, and whatever is whole of a bag that was
    cut off.  Message types come from the definitions in the bag.

    Returns:
        Everything this software knows of in the bag; `notes` tell what was lost or repaired.

    Raises:
        RecordingError: The bag cannot be used, lacks joint states or measurement points, or mixes two plans.
        CellError: The cell file names one topic for two streams.
    """
    path = Path(path)
    bag = bag_files(path)
    topics = cell.topics
    contents = read_contents(
        bag,
        _streams(cell),
        cell.robot.joints,
        step_topic=topics.step,
        text_topic=topics.robot_description,
        conditions_topic=topics.conditions,
        event_topic=EVENT_TOPIC,
    )
    plan = one_plan(path, {bag.plan_sha256, *contents.plans})
    _require(path, cell, contents)
    files = [*bag.files, *([bag.metadata] if bag.metadata else [])]
    recording = _recording(path, bag, cell, contents, {file.name: sha256_of(file) for file in files})
    return dataclasses.replace(recording, provenance=dataclasses.replace(recording.provenance, plan_sha256=plan))


def _streams(cell: Cell) -> dict[str, StreamKind]:
    """Return topic -> what it must carry; raise CellError where one topic is named for two things."""
    topics = cell.topics
    named = [
        (topics.joint_states, StreamKind.JOINTS),
        (topics.wrench, StreamKind.WRENCH),
        (topics.temperature, StreamKind.TEMPERATURE),
        *((topics.point(name), StreamKind.POINT) for name in cell.points),
    ]
    every = [topics.step, topics.robot_description, topics.conditions, *(topic for topic, _ in named)]
    twice = next((topic for topic in every if every.count(topic) > 1), None)
    if twice is not None:
        raise CellError(cell.path, "topics", f"{twice} for two streams", "a topic for each")
    return dict(named)


def _recording(path: Path, bag: BagFiles, cell: Cell, contents: Contents, sha256: dict[str, str]) -> Streams:
    notes = [*contents.notes, *_unread_wrenches(cell, contents)]
    series: dict[str, TimeSeries] = {}
    efforts: TimeSeries | None = None
    for topic, samples in contents.streams.items():
        one, torque, found = to_series(samples, topic)
        notes += found
        if len(one):
            series[topic] = one
        if torque is not None:
            efforts = torque
    points = {name: series[cell.topics.point(name)] for name in cell.points if cell.topics.point(name) in series}
    if cell.topics.joint_states not in series or not points:
        place = "tracker" if cell.topics.joint_states in series else cell.topics.joint_states
        raise RecordingError(path, place, "no message that can be used", "finite positions")
    absent = [name for name in cell.points if name not in points]
    if absent:
        text = f"not in the recording: {', '.join(absent)}"
        notes.append(Note("missing_point", path.name, text, len(absent)))
    counts = {topic: len(one) for topic, one in series.items()}
    if contents.markers:
        counts[cell.topics.step] = len(contents.markers)
    start = min(int(one.time[0]) for one in series.values())
    kind = "db3" if any(storage_suffix(file) == ".db3" for file in bag.files) else "mcap"
    return Streams(
        joints=series[cell.topics.joint_states],
        points=points,
        wrench=series.get(cell.topics.wrench),
        temperature=series.get(cell.topics.temperature),
        steps=step_markers(contents.markers),
        robot_description=contents.text,
        provenance=Provenance(str(path), kind, sha256, counts, iso_date(start)),
        notes=tuple(notes),
        joint_efforts=efforts,
        conditions=contents.conditions,
    )


def _require(path: Path, cell: Cell, contents: Contents) -> None:
    """Raise unless there are joint states of this robot and at least one measurement point."""
    there = ", ".join(sorted(contents.topics)[:12]) or "no topics"
    joints = contents.streams.get(cell.topics.joint_states)
    if joints is None or not (len(joints.stamp) or joints.unusable or joints.malformed):
        expected = f"messages of type {StreamKind.JOINTS.value}"
        raise RecordingError(path, cell.topics.joint_states, f"no messages (in the bag: {there})", expected)
    if not len(joints.stamp):
        found = f"the joints {', '.join(joints.example)[:200]}" if joints.unusable else "messages that cannot be read"
        expected = f"positions of {', '.join(cell.robot.joints)}"
        raise RecordingError(path, cell.topics.joint_states, found, expected)
    names = [cell.topics.point(name) for name in cell.points]
    if not any(name in contents.streams and len(contents.streams[name].stamp) for name in names):
        expected = f"measurement points on {', '.join(names)}"
        raise RecordingError(path, "tracker", f"no messages (in the bag: {there})", expected)


def _unread_wrenches(cell: Cell, contents: Contents) -> list[Note]:
    """Return a note where the topic of the wrench is not in the bag, and wrenches stand on another."""
    kind, topic = StreamKind.WRENCH.value, cell.topics.wrench
    others = sorted(name for name, found in contents.topics.items() if found == kind)
    if topic in contents.topics or not others:
        return []
    text = f"no messages, but {kind} on {', '.join(others[:12])}: no load is read (topics of the cell file)"
    return [Note("other_topic", topic, text)]


def step_markers(rows: tuple[tuple[int, int, int, int, int], ...]) -> StepMarkers | None:
    """Sort markers by time: (receive time, stamp, configuration, step, phase); None if there are none."""
    if not rows:
        return None
    table = np.array(rows, np.int64)
    time = np.where(table[:, 1] == 0, table[:, 0], table[:, 1])
    order = np.argsort(time, kind="stable")
    return StepMarkers(time[order], table[order, 2], table[order, 3], table[order, 4])
