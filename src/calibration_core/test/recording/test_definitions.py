"""Definitions from a bag are data: parsed with bounds, compared with the bundled ones, never evaluated."""

from __future__ import annotations

import builtins
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from calibration_core.errors import RecordingError
from calibration_core.recording.definitions.fields import MessageField
from calibration_core.recording.definitions.idl import parse_idl
from calibration_core.recording.definitions.msg import parse_msg
from calibration_core.recording.definitions.own import STEP_TYPE
from calibration_core.recording.definitions.streams import DEFINITIONS, stream_types
from calibration_core.recording.definitions.text import parse_definition
from calibration_core.recording.messages.cdr import read_message
from calibration_core.recording.messages.kinds import StreamKind
from calibration_core.recording.messages.typed import deserializer, is_standard, standard_types
from calibration_core.recording.storage.batch import Channel

NAME = "a_msgs/msg/A"
LINE = "=" * 80
INSTALLED = Path(sys.prefix) / "share"
ROOT = Path(__file__).parents[4]
SMALL = ROOT / "config" / "cells" / "small.cell.yaml"


def test_fields_of_msg() -> None:
    text = f"""# a comment
uint8 ONE=1
string NAME = it's "quoted" # not a comment
std_msgs/Header header  # with a comment
float64[9] matrix
float64[] more
string<=10[<=5] few "default"
B[2] inner
time stamp
char c 5
{LINE}
MSG: a_msgs/B
bool yes true
{LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
    types = parse_definition(text, NAME, "ros2msg")
    assert types[NAME] == (
        MessageField("header", "std_msgs/msg/Header"),
        MessageField("matrix", "float64", "array", 9),
        MessageField("more", "float64", "sequence", 0),
        MessageField("few", "string", "sequence", 0),
        MessageField("inner", "a_msgs/msg/B", "array", 2),
        MessageField("stamp", "builtin_interfaces/msg/Time"),
        MessageField("c", "uint8"),
    )
    assert set(types) == {NAME, "a_msgs/msg/B", "std_msgs/msg/Header", "builtin_interfaces/msg/Time"}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("float64 x\nnonsense nonsense nonsense!", "nonsense"),
        ("#" + "x" * 1_000_000, "1000001 characters"),
        ("string[300000] names", "an array of 300000"),
        ("uint8[0] none", "an array of 0"),
        ("uint8[99999999999] many", "the line"),
        ("\n".join(f"bool b{i}" for i in range(5000)), "5000 fields"),
        ("\n".join(f"bool b{i}" for i in range(60_000)), "characters"),
        ("a_msgs/A again", "holds itself"),
        (f"B b\n{LINE}\nMSG: a_msgs/B\nA a", "holds itself"),
        ("unknown_msgs/Unknown x", "no definition of 'unknown_msgs/msg/Unknown'"),
        ("wstring wide", "no definition of"),
        (f"bool a\n{LINE}\nMSG: b_msgs/B\nbool b" + f"\n{LINE}\nnonsense", "'nonsense' for the name of a type"),
        (f"bool a\n{LINE}\n" + f"\n{LINE}\n".join(f"MSG: b_msgs/B{i}\nbool b" for i in range(100)), "64 types"),
        ("uint8 x\x00y", "the line"),
        ("__import__('os').system('true') x", "the line"),
    ],
)
def test_msg_that_is_refused(text: str, found: str) -> None:
    begin = time.process_time()
    with pytest.raises(ValueError, match=r".") as caught:
        parse_definition(text, NAME, "ros2msg")
    assert found in str(caught.value)
    assert time.process_time() - begin < 1.0


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("module broken {", "an early end"),
        ("module a { const long X = 1<<30000000000; }; struct S { double x[1<<3]; };", "instead of ']'"),
        ("struct S { double x[99999999]; };", "an array of 99999999"),
        ("};", "a closing brace too many"),
        ("interface I {};", "the statement 'interface'"),
        ("struct S { sequence<sequence<double>> x; };", "'<' in a sequence"),
        ("struct S { double x;", "an early end"),
        ("/*" * 30_000, "* *"),
        ("@a(" * 20_000, "( ("),
        ("module a { " * 5_000, "an early end"),
        ("const " + "x" * 60_000, "without an end"),
    ],
)
def test_idl_that_is_refused(text: str, found: str) -> None:
    begin = time.process_time()
    with pytest.raises(ValueError, match=r".") as caught:
        parse_definition(text, NAME, "ros2idl")
    assert found in str(caught.value)
    assert time.process_time() - begin < 2.0


def test_idl_says_the_same_as_msg() -> None:
    """Every installed message type, from both of its definitions."""
    compared = 0
    for idl in sorted(INSTALLED.glob("*/msg/*.idl")):
        text = idl.with_suffix(".msg")
        if text.is_file():
            name = "/".join(idl.with_suffix("").parts[-3:])
            assert parse_idl(idl.read_text("utf-8"))[name] == parse_msg(text.read_text("utf-8"), name)[name]
            compared += 1
    if not compared:
        pytest.skip("no message types are installed as text")
    assert compared > 100


def test_every_bundled_type_is_read_field_by_field_as_generated_code_reads_it() -> None:
    types = standard_types()
    kind = StreamKind.WRENCH.value
    text, _ = types.generate_msgdef(kind, ros_version=2)
    payload = b"\x00\x01\x00\x00" + struct.pack("<iII4x6d", 1, 2, 1, *range(6))
    message = read_message(payload, parse_definition(text, kind, "ros2msg"), kind)
    assert (message.header.stamp.sec, message.header.stamp.nanosec, message.header.frame_id) == (1, 2, "")
    assert (message.wrench.force.x, message.wrench.torque.z) == (0.0, 5.0)
    big = b"\x00\x00\x00\x00" + struct.pack(">iII4x6d", 1, 2, 1, *range(6))
    assert read_message(big, parse_definition(text, kind, "ros2msg"), kind) == message


@pytest.mark.parametrize("name", sorted(DEFINITIONS))
def test_the_types_of_streams_are_those_of_ros(name: str) -> None:
    text, _ = standard_types().generate_msgdef(name, ros_version=2)
    assert stream_types(name) == parse_definition(text, name, "ros2msg")


def test_a_type_of_no_stream_is_not_among_them() -> None:
    assert stream_types("sensor_msgs/msg/Imu") == {}
    assert {kind.value for kind in StreamKind} | {STEP_TYPE} <= set(DEFINITIONS)


def test_reading_a_bag_imports_no_other_types() -> None:
    """To import all types of ROS 2 takes longer than to read a short recording."""
    code = (
        "import sys\nfrom calibration_core.cell import load_cell\n"
        "from calibration_core.recording.bags.bag import read_bag\n"
        f"read_bag({str(ROOT / 'bags' / 'small_loaded')!r}, load_cell({str(SMALL)!r}))\n"
        "print([one for one in sys.modules if one.startswith('rosbags.typesys.stores.')])"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert answer.stdout.strip() == "[]"


def test_arrays_and_texts() -> None:
    types = parse_definition(
        "string[] names\nfloat64[2] two\nuint16[] some\nB[] inner\nE e\n"
        f"{LINE}\nMSG: a_msgs/B\nint8 x\n{LINE}\nMSG: a_msgs/E",
        NAME, "ros2msg",
    )  # fmt: skip
    body = struct.pack("<II2sxxI3sx4x", 2, 2, b"a\0", 3, b"bc\0") + struct.pack("<2d", 1.5, 2.5)
    body += struct.pack("<I3H", 3, 7, 8, 9) + b"\0\0" + struct.pack("<Ibb", 2, -1, -2) + b"\0"
    message = read_message(b"\0\1\0\0" + body, types, NAME)
    assert message.names == ["a", "bc"]
    assert message.two.tolist() == [1.5, 2.5]
    assert message.some.tolist() == [7, 8, 9]
    assert [one.x for one in message.inner] == [-1, -2]


@pytest.mark.parametrize(
    "payload",
    [b"", b"\0\1", b"\0\7\0\0" + bytes(8), b"\0\1\0\0", b"\0\1\0\0\xff\xff\xff\xff", b"\0\1\0\0" + bytes(100)],
)
def test_messages_that_are_none(payload: bytes) -> None:
    with pytest.raises(ValueError, match=r"."):
        read_message(payload, parse_definition("string[] names", NAME, "ros2msg"), NAME)


def test_nothing_from_a_bag_is_executed(monkeypatch: pytest.MonkeyPatch) -> None:
    standard_types().get_msgdef(StreamKind.POINT.value)  # what is bundled is generated before

    def never(*_: object) -> None:
        pytest.fail("code was generated")

    monkeypatch.setattr(builtins, "exec", never)
    text, _ = standard_types().generate_msgdef(StreamKind.POINT.value, ros_version=2)
    own = Channel("/p", StreamKind.POINT.value, "cdr", "uint32 extra\n" + text, "ros2msg")
    assert is_standard(Channel("/p", StreamKind.POINT.value, "cdr", "# a comment\n" + text, "ros2msg"))
    assert not is_standard(own)
    message = deserializer("bag", own)(b"\0\1\0\0" + struct.pack("<IiIIc7x3d", 9, 1, 2, 1, b"\0", 1.0, 2.0, 3.0))
    assert (message.extra, message.point.z) == (9, 3.0)
    with pytest.raises(RecordingError, match="a definition of"):
        deserializer("bag", Channel("/p", "own_msgs/msg/Own", "cdr"))
    assert np.isfinite(message.point.x)
