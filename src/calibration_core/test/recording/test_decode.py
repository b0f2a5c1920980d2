"""Fixed layouts give exactly what the typed reader gives, whatever the layout."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calibration_core.errors import RecordingError
from calibration_core.recording.messages import decode
from calibration_core.recording.messages.decode import Decoder
from calibration_core.recording.messages.kinds import Samples, StreamKind
from calibration_core.recording.messages.typed import standard_types
from calibration_core.recording.storage.batch import Batch, Channel

JOINTS = ("a", "bb", "joint_3")
numbers = st.floats(width=64, allow_nan=True, allow_infinity=True)
frames = st.sampled_from(["", "w", "tool0", "tracker", "größe", "a rather long name of a frame"])


def header(sec: int, nanosec: int, frame: str) -> object:
    types = standard_types().types
    stamp = types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


headers = st.builds(header, st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1), frames)


def message(
    kind: StreamKind, head: object, values: list[float], names: list[str], sizes: tuple[int, int, int]
) -> object:
    types = standard_types().types
    make = {name.split("/")[-1]: cls for name, cls in types.items()}
    if kind is StreamKind.POINT:
        return make["PointStamped"](header=head, point=make["Point"](*values[:3]))
    if kind is StreamKind.WRENCH:
        wrench = make["Wrench"](force=make["Vector3"](*values[:3]), torque=make["Vector3"](*values[3:6]))
        return make["WrenchStamped"](header=head, wrench=wrench)
    if kind is StreamKind.TEMPERATURE:
        return make["Temperature"](header=head, temperature=values[0], variance=values[1])
    arrays = [np.resize(np.array(values), size) for size in sizes]
    return make["JointState"](header=head, name=names, position=arrays[0], velocity=arrays[1], effort=arrays[2])


@st.composite
def messages(draw: st.DrawFn, kind: StreamKind) -> bytes:
    names = draw(
        st.sampled_from([list(JOINTS), ["joint_3", "a", "bb"], ["gripper", *JOINTS], ["a", "bb"], [], ["bb", "a", "q"]])
    )
    n = len(names)
    sizes = draw(st.sampled_from([(n, n, n), (n, 0, 0), (n, n, 0), (n, 0, n), (0, 0, n), (n, 2, 1)]))
    values = draw(st.lists(numbers, min_size=8, max_size=8))
    little = draw(st.sampled_from([True, True, True, False]))
    data = bytes(
        standard_types().serialize_cdr(message(kind, draw(headers), values, names, sizes), kind.value,
                                       little_endian=little)
    )  # fmt: skip
    change = draw(st.sampled_from(["none"] * 6 + ["pad", "options", "short", "long", "encapsulation", "flip"]))
    if change == "pad":
        data += bytes(draw(st.integers(1, 3)))
    elif change == "options":
        data = data[:3] + b"\x02" + data[4:]
    elif change == "short":
        data = data[: draw(st.integers(0, len(data)))]
    elif change == "long":
        data += bytes(9)
    elif change == "encapsulation":
        data = b"\x00\x03" + data[2:]
    elif change == "flip":
        at = draw(st.integers(0, len(data) - 1))
        data = data[:at] + bytes([data[at] ^ draw(st.integers(1, 255))]) + data[at + 1 :]
    return data


def batch_of(kind: StreamKind, rows: list[bytes], gap: int = 0) -> Batch:
    """Lay messages into a buffer, `gap` bytes apart."""
    length = np.array([len(row) for row in rows], np.int64)
    start = gap + np.cumsum(length + gap) - (length + gap)
    buffer = np.frombuffer(b"\xaa" * gap + b"".join(row + b"\xaa" * gap for row in rows), np.uint8)
    return Batch(Channel("/topic", kind.value), buffer, start, length, np.arange(len(rows)) + 5)


def decoded(kind: StreamKind, batches: list[Batch], *, fast: bool) -> Samples:
    decoder = Decoder("file", kind, JOINTS if kind is StreamKind.JOINTS else (), fast=fast)
    for batch in batches:
        decoder.add(batch)
    return decoder.samples()


def assert_same(a: Samples, b: Samples) -> None:
    assert np.array_equal(a.stamp, b.stamp)
    assert np.array_equal(a.received, b.received)
    assert a.values.shape == b.values.shape
    assert a.values.tobytes() == b.values.tobytes()
    assert (a.efforts is None) == (b.efforts is None)
    if a.efforts is not None and b.efforts is not None:
        assert np.array_equal(a.efforts, b.efforts, equal_nan=True)
    assert (a.frames, a.malformed, a.unusable) == (b.frames, b.malformed, b.unusable)


@pytest.mark.parametrize("kind", list(StreamKind))
@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_equal_to_the_typed_reader(kind: StreamKind, data: st.DataObject) -> None:
    pool = data.draw(st.lists(messages(kind), min_size=1, max_size=5))
    rows = data.draw(st.lists(st.sampled_from(pool), min_size=1, max_size=25))
    batches = [batch_of(kind, rows, data.draw(st.integers(0, 9))), batch_of(kind, rows[::-1])]
    assert_same(decoded(kind, batches, fast=True), decoded(kind, batches, fast=False))


def wrench_rows(count: int, frame: str = "tool0") -> list[bytes]:
    rng = np.random.default_rng(3)
    return [
        bytes(standard_types().serialize_cdr(
            message(StreamKind.WRENCH, header(i, i, frame), list(rng.normal(size=6)), [], (0, 0, 0)),
            StreamKind.WRENCH.value))
        for i in range(count)
    ]  # fmt: skip


def test_constant_layouts_never_reach_the_typed_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(decode, "read_typed", refuse)
    rows = wrench_rows(50) + wrench_rows(50, "another frame")
    samples = decoded(StreamKind.WRENCH, [batch_of(StreamKind.WRENCH, rows)], fast=True)
    assert len(samples.stamp) == 100
    assert samples.frames == {"tool0": 50, "another frame": 50}


@pytest.mark.parametrize("offset", [0, 12, 16, 17, 20])
def test_one_changed_byte_that_fixes_the_layout_is_seen(offset: int) -> None:
    """Encapsulation, length of the frame and its bytes: a row that differs there is read by itself."""
    rows = wrench_rows(40)
    bad = bytearray(rows[7])
    bad[offset] ^= 1
    rows[7] = bytes(bad)
    batch = batch_of(StreamKind.WRENCH, rows)
    fast, typed = (decoded(StreamKind.WRENCH, [batch], fast=flag) for flag in (True, False))
    assert_same(fast, typed)
    assert fast.frames.get("tool0") == 39


def test_a_definition_of_their_own_is_obeyed() -> None:
    """A bag may define the type otherwise; then offsets of the standard definition mean nothing."""
    definition = "uint32 extra\nstd_msgs/Header header\nfloat64 temperature\n" + "\n".join(
        ["=" * 80, "MSG: std_msgs/Header", "builtin_interfaces/Time stamp", "string frame_id",
         "=" * 80, "MSG: builtin_interfaces/Time", "int32 sec", "uint32 nanosec", ""]
    )  # fmt: skip
    channel = Channel("/t", StreamKind.TEMPERATURE.value, "cdr", definition, "ros2msg")
    payload = b"\x00\x01\x00\x00" + struct.pack("<IiIIc7xd", 9, 1, 2, 1, b"\x00", 21.5)
    buffer = np.frombuffer(payload, np.uint8)
    decoder = Decoder("file", StreamKind.TEMPERATURE)
    decoder.add(Batch(channel, buffer, np.array([0]), np.array([len(payload)]), np.array([3])))
    samples = decoder.samples()
    assert samples.values.tolist() == [[21.5]]
    assert samples.stamp.tolist() == [1_000_000_002]


@pytest.mark.parametrize(
    "channel",
    [
        Channel("/t", StreamKind.POINT.value, "cdr", "float64 x\nnonsense nonsense nonsense", "ros2msg"),
        Channel("/t", StreamKind.POINT.value, "json"),
        Channel("/t", StreamKind.POINT.value, "cdr", "unknown_msgs/Unknown x\n", "ros2msg"),
        Channel("/t", StreamKind.POINT.value, "cdr", "module broken {", "ros2idl"),
    ],
)
def test_definitions_that_cannot_be_used(channel: Channel) -> None:
    decoder = Decoder("some.mcap", StreamKind.POINT)
    batch = Batch(channel, np.zeros(8, np.uint8), np.array([0]), np.array([8]), np.array([0]))
    with pytest.raises(RecordingError, match=r"some\.mcap: /t: found"):
        decoder.add(batch)
