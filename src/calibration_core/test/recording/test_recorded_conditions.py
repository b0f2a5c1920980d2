"""The standard's conditions in a bag, as the sequencer's messages carry them; bags without them, and broken ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from calibration_core.cell import Cell, load_cell
from calibration_core.errors import CellError, RecordingError
from calibration_core.observations.observe import worst
from calibration_core.recording.bags.bag import read_bag
from calibration_core.timeseries import Condition, Override

INTERFACES = Path(__file__).resolve().parents[3] / "calibration_interfaces" / "msg"
NAMES = ("ConditionOverride", "Condition", "Conditions")
START = 1_700_000_000_000_000_000
WHO = Override("temperature", "A. Smith", "no cooling today")
COLD = Condition("temperature", "5.1", "test temperature", "20 °C ± 2 °C", "25.0 °C", met=False, shall=True)
SERVO = Condition("servo", "5.1", "servos activated", "on", "unknown", met=None, shall=True)


@pytest.fixture(scope="module")
def types() -> Any:
    """Return the types of Jazzy and those of the suite, from their own files."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in NAMES:
        text = (INTERFACES / f"{name}.msg").read_text(encoding="utf-8")
        store.register(get_types_from_msg(text, f"calibration_interfaces/msg/{name}"))
    return store


def message(types: Any, conditions: tuple[Condition, ...]) -> Any:
    kinds = types.types
    rows = []
    for one in conditions:
        who = one.override or Override("", "", "")
        override = kinds["calibration_interfaces/msg/ConditionOverride"](who.condition, who.operator, who.reason)
        verdict = {None: 0, True: 1, False: 2}[one.met]
        words = (one.name, one.clause, one.requirement, one.limit, one.value)
        rows.append(kinds["calibration_interfaces/msg/Condition"](*words, one.shall, verdict, override))
    return kinds["calibration_interfaces/msg/Conditions"](header(types, 0), rows)


def header(types: Any, time: int) -> Any:
    stamp = types.types["builtin_interfaces/msg/Time"]((START + time) // 10**9, (START + time) % 10**9)
    return types.types["std_msgs/msg/Header"](stamp, "")


def write(path: Path, types: Any, told: list[Any], topic: str = "/calibration/conditions") -> Path:
    """Write a bag with joint states, two points and messages on the topic of conditions."""
    kinds = types.types
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        joints = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=types)
        points = [
            writer.add_connection(f"/tracker/{name}", "geometry_msgs/msg/PointStamped", typestore=types)
            for name in ("left", "right")
        ]
        names, none = ["shoulder", "elbow", "wrist"], np.empty(0)
        for k in range(3):
            time = k * 10**7
            state = kinds["sensor_msgs/msg/JointState"](header(types, time), names, np.zeros(3), none, none)
            writer.write(joints, START + time, types.serialize_cdr(state, "sensor_msgs/msg/JointState"))
            for point in points:
                place = kinds["geometry_msgs/msg/PointStamped"](
                    header(types, time), kinds["geometry_msgs/msg/Point"](1.0, 2.0, 3.0)
                )
                writer.write(point, START + time, types.serialize_cdr(place, "geometry_msgs/msg/PointStamped"))
        kind = "calibration_interfaces/msg/Conditions"
        watched = writer.add_connection(topic, kind, typestore=types)
        for k, one in enumerate(told):
            data = one if isinstance(one, bytes) else types.serialize_cdr(one, kind)
            writer.write(watched, START + k, data)
    return path


def test_what_was_told_is_read(tmp_path: Path, cell: Cell, types: Any) -> None:
    history = ((SERVO, COLD), (SERVO, Condition(**vars(COLD) | {"override": WHO})))
    read = read_bag(write(tmp_path / "bag", types, [message(types, one) for one in history]), cell)
    assert read.conditions == history
    summed = {one.name: one for one in worst(read.conditions)}
    assert summed["temperature"] == history[1][1]
    assert summed["servo"].met is None


def test_another_topic_can_be_named(tmp_path: Path, cell: Cell, types: Any) -> None:
    path, text = tmp_path / "other.yaml", cell.path.read_text()
    path.write_text(text + "topics: {conditions: /mine}\n")
    bag = write(tmp_path / "bag", types, [message(types, (SERVO,))], "/mine")
    assert read_bag(bag, load_cell(path)).conditions == ((SERVO,),)
    path.write_text(text + "topics: {conditions: /joint_states}\n")
    with pytest.raises(CellError, match="two streams"):
        read_bag(bag, load_cell(path))


def test_a_message_that_cannot_be_read_is_told(tmp_path: Path, cell: Cell, types: Any) -> None:
    whole = types.serialize_cdr(message(types, (SERVO, COLD)), "calibration_interfaces/msg/Conditions")
    read = read_bag(write(tmp_path / "bag", types, [bytes(whole)[:40], message(types, (COLD,))]), cell)
    assert read.conditions == ((COLD,),)
    assert [note.text for note in read.notes if note.kind == "malformed"] == ["a message of conditions cannot be read"]


def test_another_type_on_the_topic_is_refused(tmp_path: Path, cell: Cell, types: Any) -> None:
    path, text = tmp_path / "other.yaml", cell.path.read_text()
    path.write_text(text + "topics: {conditions: /tracker/other}\n")
    bag = write(tmp_path / "bag", types, [message(types, (SERVO,))])
    assert read_bag(bag, load_cell(path)).conditions == ()
    path.write_text(text + "topics: {step: /calibration/conditions, conditions: /else}\n")
    with pytest.raises(RecordingError, match="MeasurementStep"):
        read_bag(bag, load_cell(path))
