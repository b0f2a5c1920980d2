"""Hostile inputs: each makes a cell file and a recording; `prepare` writes them into a folder."""

from __future__ import annotations

import os
import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import mcap.writer
import numpy as np
import zstandard

from calibration_core.cell import load_cell
from calibration_core.recording.bags.writer import write_bag
from calibration_core.timeseries import Provenance, Streams, TimeSeries

CELL = """name: a cell
robot:
  name: a robot
  dh: [{a: 0.05, alpha: -1.5708, d: 0.4}, {a: 0.45, alpha: 0, d: 0}, {a: 0.04, alpha: 0.3, d: 0.2}]
  joints: [j1, j2, j3]
  joint_limits: [[-3, 3], [-3, 3], [-3, 3]]
  rated_load: 10
frames:
  tracker: {xyz: [2, 0, 1], rpy: [0, 0, 0]}
  force_torque: {xyz: [0, 0, 0], rpy: [0, 0, 0]}
  wrench_point: [0, 0, 0.1]
  measurement_points: {mp1: [0.1, 0, 0], mp2: [0, 0.1, 0]}
instruments:
  tracker: {sigma: 2.0e-5}
  force_torque: {sigma_force: 1.0, sigma_torque: 0.5}
"""
HEADER = "configuration,step,q1,q2,q3,fx,fy,fz,tx,ty,tz,point,x,y,z"
ROW = "1,0,0.1,0.2,0.3,0,0,0,0,0,0,mp1,1.0,0.5,0.2"
MAGIC = b"\x89MCAP0\r\n"
Case = Callable[[Path], Path]
CASES: dict[str, tuple[str, Case]] = {}


def case(name: str, make: Case, cell: str = CELL) -> None:
    """Register a case: a cell file's text and a function that makes the recording in a folder."""
    assert name not in CASES
    CASES[name] = (cell, make)


def table(text: str | bytes) -> Case:
    def make(folder: Path) -> Path:
        path = folder / "table.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return make


def file(name: str, content: bytes) -> Case:
    def make(folder: Path) -> Path:
        (folder / name).write_bytes(content)
        return folder / name

    return make


def sparse(name: str, size: int, head: bytes = b"") -> Case:
    def make(folder: Path) -> Path:
        with (folder / name).open("wb") as stream:
            stream.write(head)
            stream.truncate(size)
        return folder / name

    return make


# Cell files; what a single value may not be: src/calibration_core/test/test_cell.py
GOOD = table(f"{HEADER}\n{ROW}\n")
for name, old, new in [
    ("a missing key", "  rated_load: 10\n", ""),
    ("no load at all", "rated_load: 10", "rated_load: 0"),
    ("negative uncertainty", "sigma: 2.0e-5", "sigma: -2.0e-5"),
    ("uncertainty of zero", "sigma: 2.0e-5", "sigma: 0"),
    ("two kinds of uncertainty", "sigma: 2.0e-5", "sigma: 2.0e-5, sigma_range: 1.0e-5, sigma_angle: 1.0e-6"),
    ("a bracket that is never closed", "[j1, j2, j3]", "[j1, j2, j3"),
    ("code in YAML", "name: a cell", "name: !!python/object/apply:os.system ['true']"),
]:
    assert old in CELL
    case(f"cell: {name}", GOOD, CELL.replace(old, new, 1))
for name, new in [
    ("a truth that is none", "!!bool foo"),
    ("a time that is none", "!!timestamp foo"),
    ("an integer that is none", "!!int ''"),
    ("an integer of 400 digits", "9" * 400),
    ("numbers to base 60", "1:59" * 2000),
    ("5,000 digits to base 16", "0x" + "F" * 5000),
    ("a load beyond everything", "1.0e+300"),
]:
    case(f"cell: {name}", GOOD, CELL.replace("rated_load: 10", f"rated_load: {new}"))
case("cell: an uncertainty beyond everything", GOOD, CELL.replace("sigma: 2.0e-5", "sigma: 1.0e+300"))
case("cell: an alias", GOOD, CELL.replace("name: a cell", "name: &name a cell\nnote: *name"))
MERGES = "a0: &a0 {x: 1}\n" + "".join(f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}], y{i}: 1}}\n" for i in range(1, 30))
case("cell: merge keys on merge keys", GOOD, MERGES + CELL)
BOMB = "a0: &a0 [x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 13))
case("cell: empty", GOOD, "")
case("cell: a list", GOOD, "[1, 2, 3]")
case("cell: nested without end", GOOD, "[" * 50_000)
case("cell: nested in lines", GOOD, "- " * 50_000)
case("cell: aliases that multiply", GOOD, BOMB + CELL)
case("cell: larger than any", GOOD, CELL + "#" * (2 << 20))
case("cell: zero bytes", GOOD, "\x00" * 100)
case("cell: missing", GOOD, "missing")

# Tables; what a single field may not be: src/calibration_core/test/recording/test_table.py
for name, text in [
    ("empty", ""),
    ("zero bytes", "\x00" * 4096),
    ("decimal commas", f"{HEADER}\n{ROW.replace('0.1', '0,1')}\n"),
    ("text for a number", f"{HEADER}\n{ROW.replace('0.2', 'zero')}\n"),
    ("nan", f"{HEADER}\n{ROW.replace('0.2', 'nan')}\n"),
    ("a reading twice", f"{HEADER}\n{ROW}\n{ROW}\n"),
    ("a quotation that never ends", f'{HEADER}\n"{ROW}\n' + f"{ROW}\n" * 5000),
    ("a line without end", f"{HEADER}\n{'1,' * 100_000}\n"),
]:
    case(f"table: {name}", table(text))
case("table: another encoding", table(f"{HEADER}\n{ROW}\n".encode("utf-16")))
case("table: 2 GB of rubbish", sparse("table.csv", 2 << 30))
case("table: rubbish below the limit", sparse("table.csv", 1 << 29))
case("table: a header and rubbish", sparse("table.csv", 1 << 29, f"{HEADER}\n{ROW}\n".encode()))
case("recording: missing", lambda folder: folder / "missing.csv")
case("recording: another kind of file", file("photo.jpg", b"\xff\xd8"))
case("recording: an empty folder", lambda folder: folder)


# Bags
def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def chunk(data: bytes, compression: str, size: int) -> bytes:
    name = compression.encode()
    head = struct.pack("<QQQII", 0, 1, size, 0, len(name)) + name + struct.pack("<Q", len(data))
    return record(6, head + data)


START = MAGIC + record(1, struct.pack("<I4sI", 4, b"ros2", 0))
ZSTD = zstandard.ZstdCompressor(level=1)
ZEROS = bytes(32 << 20)
for name, content in [
    ("empty", b""),
    ("nothing but zeros", bytes(4096)),
    ("text", b"this is no bag\n" * 100),
    ("a start and no more", MAGIC),
    ("a header and no more", START),
    ("a chunk that claims 2^60 bytes", START + chunk(b"x" * 100, "zstd", 2**60)),
    ("a record that claims 2^63 bytes", START + struct.pack("<BQ", 6, 2**63) + bytes(100)),
    ("a message that claims 2^60 bytes", START + struct.pack("<BQ", 5, 2**60) + bytes(100)),
    ("an unknown compression", START + chunk(b"x" * 100, "rar", 100)),
    ("a bomb in zstd", START + chunk(ZSTD.compress(ZEROS), "zstd", len(ZEROS)) * 500),
    ("a bomb in lz4", START + chunk(lz4.frame.compress(ZEROS), "lz4", len(ZEROS)) * 20),
    ("a bomb that claims little", START + chunk(ZSTD.compress(ZEROS), "zstd", 1000)),
    ("endless empty records", START + record(0x7F, b"") * 1_100_000),
    ("topics without messages", START + record(3, bytes(14)) + record(4, bytes(16))),
    ("damaged declarations", START + record(3, b"\xff" * 20) + record(4, b"\xff" * 20)),
]:
    case(f"mcap: {name}", file("bag.mcap", content))
case("mcap: 2 GB of rubbish", sparse("bag.mcap", 2 << 30))
case("mcap: a start and 2 GB of rubbish", sparse("bag.mcap", 2 << 30, START))


def recording(joints: tuple[str, ...] = ("j1", "j2", "j3"), *, finite: bool = True, still: bool = True) -> Streams:
    time = 10**18 + np.arange(200) * 10_000_000
    angles = np.zeros((200, len(joints))) if still else np.cumsum(np.full((200, len(joints)), 0.01), axis=0)
    points = np.ones((200, 3)) if finite else np.full((200, 3), np.nan)
    series = TimeSeries(time, points, time)
    joint_states = TimeSeries(time, angles, time)
    return Streams(joint_states, {"mp1": series}, None, None, None, "", Provenance("", "", {}, {}))


def bag(change: Callable[[Path], None] | None = None, names: str = "[j1, j2, j3]", **options: object) -> Case:
    """Write a bag, with joints of other names if so wanted, and change something in its folder."""
    storage = str(options.pop("storage", "mcap"))

    def make(folder: Path) -> Path:
        text = CELL.replace("[j1, j2, j3]", names)
        (folder / "writer.yaml").write_text(text)
        write_bag(folder / "bag", recording(**options), load_cell(folder / "writer.yaml"), storage=storage)
        if change is not None:
            change(folder / "bag")
        return folder / "bag"

    return make


def metadata(old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        text = (folder / "metadata.yaml").read_text()
        assert old in text
        (folder / "metadata.yaml").write_text(text.replace(old, new))

    return change


def sql(*statements: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        database = sqlite3.connect(folder / "bag.db3")
        for statement in statements:
            database.execute(statement)
        database.commit()
        database.close()

    return change


case("bag: joints of another robot", bag(names="[a1, a2, a3]"))
case("bag: positions that are not finite", bag(finite=False))
case("bag: a robot that never stands still", bag(still=False))
case("bag: another topic", bag(), CELL + "topics: {joint_states: /other}\n")
case("bag: one topic for two streams", bag(), CELL + "topics: {joint_states: /tracker/mp1}\n")
case("bag: another type", bag(), CELL + "topics: {joint_states: /tracker/mp1, /tracker/mp1: /other}\n")
case(
    "bag: metadata nested without end", bag(lambda folder: (folder / "metadata.yaml").write_text("[" * 90_000) and None)
)
case("bag: metadata without meaning", bag(lambda folder: (folder / "metadata.yaml").write_text("[1, 2]") and None))
case("bag: metadata that is no YAML", bag(lambda folder: (folder / "metadata.yaml").write_text("{: [") and None))
case("bag: metadata names a file elsewhere", bag(metadata("bag.mcap", "../../etc/passwd")))
case("bag: metadata names a missing file", bag(lambda folder: (folder / "bag.mcap").unlink()))
case("bag: compressed in an unknown way", bag(metadata("compression_mode: ''", "compression_mode: MAGIC")))
case("bag: compressed it says and is not", bag(metadata("compression_mode: ''\n", "compression_mode: MESSAGE\n")))
case("db3: empty", file("bag.db3", b""))
case("db3: another kind of file", file("bag.db3", MAGIC))
case("db3: a header and no more", file("bag.db3", b"SQLite format 3\x00" + bytes(84)))
case("db3: a header and 2 GB of rubbish", sparse("bag.db3", 2 << 30, b"SQLite format 3\x00\x10\x00\x01\x01\x00"))
case("db3: tables of something else", bag(sql("DROP TABLE messages"), storage="sqlite3"))
case("db3: no messages", bag(sql("DELETE FROM messages"), storage="sqlite3"))
case("db3: text for messages", bag(sql("UPDATE messages SET data = 'text'"), storage="sqlite3"))
case("db3: nothing for messages", bag(sql("UPDATE messages SET data = x''"), storage="sqlite3"))
case("db3: noise for messages", bag(sql("UPDATE messages SET data = randomblob(80)"), storage="sqlite3"))
case("db3: times that are no numbers", bag(sql("UPDATE messages SET timestamp = 'now'"), storage="sqlite3"))
ENDLESS = (
    "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS id FROM n"
)
case("db3: a table without end", bag(sql("DROP TABLE messages", ENDLESS), storage="sqlite3"))
for form, packed in (("zstd", ZSTD.compress(bytes(256 << 20))), ("nothing", b"no zstd")):
    case(
        f"bag: a folder with a file of {form}",
        lambda folder, packed=packed: file("bag.mcap.zstd", packed)(folder).parent,
    )


def replaced(table: str, columns: str) -> list[str]:
    """Return statements that put a table of these columns, without constraints, in the place of another."""
    select = f"CREATE TABLE other AS SELECT {columns} FROM {table}"
    return [select, f"DROP TABLE {table}", f"ALTER TABLE other RENAME TO {table}"]


COMPUTED = "id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data AS (zeroblob(60000000))"
COUNTED = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 1000) SELECT 1, i FROM n"
for name, statements in {
    "NULL for messages": replaced("messages", "id, topic_id, timestamp, NULL AS data"),
    "NULL for some messages": replaced("messages", "id, topic_id, timestamp, iif(id % 7, data, NULL) AS data"),
    "NULL for topics": replaced("topics", "id, NULL AS name, type, serialization_format"),
    "NULL for ids of topics": replaced("topics", "NULL AS id, name, type, serialization_format"),
    "NULL for ids of messages": replaced("messages", "NULL AS id, topic_id, timestamp, data"),
    "messages that are computed": [
        "DROP TABLE messages",
        f"CREATE TABLE messages ({COMPUTED})",
        f"INSERT INTO messages (topic_id, timestamp) {COUNTED}",
    ],
    "messages of 60 MB": ["UPDATE messages SET data = zeroblob(60000000) WHERE id < 4"],
    "a view for topics": ["ALTER TABLE topics RENAME TO other", "CREATE VIEW topics AS SELECT * FROM other"],
    "no column for times": ["ALTER TABLE messages RENAME COLUMN timestamp TO time"],
}.items():
    case(f"db3: {name}", bag(sql(*statements), storage="sqlite3"))
PATHS = "  - bag.mcap\n"
for name, new in {
    "the same file 10,000 times": PATHS * 10_000,
    "a name of 5,000 characters": f"  - {'x' * 5000}.mcap\n",
    "a name with a zero byte": '  - "a\\0.mcap"\n',
    "a name with line ends": '  - "a\\n\\n.mcap"\n',
}.items():
    case(f"bag: metadata with {name}", bag(metadata(PATHS, new)))


def defined(text: str) -> Case:
    """Write a bag in which joint states are defined in another way."""

    def make(folder: Path) -> Path:
        with (folder / "bag.mcap").open("wb") as stream:
            writer = mcap.writer.Writer(stream)
            writer.start("ros2", "test")
            schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", text.encode())
            channel = writer.register_channel("/joint_states", "cdr", schema)
            for i in range(100):
                writer.add_message(channel, i, bytes(200), i)
            writer.finish()
        return folder / "bag.mcap"

    return make


for name, text in {
    "300,000 texts": "string[300000] names",
    "an endless constant": "int64 X=1<<30000000000\nfloat64[1<<30] x",
    "1 MB of comments": "#" * 1_000_000 + "\nfloat64 x",
    "60,000 fields": "\n".join(f"bool b{i}" for i in range(60_000)),
    "itself": "JointState again",
    "code": "float64 x=__import__('os').system('true')\n@exec float64 y",
}.items():
    case(f"mcap: a type defined by {name}", defined(text))
case("recording: a pipe", lambda folder: os.mkfifo(folder / "pipe.csv") or folder / "pipe.csv")
case("recording: a name of 5,000 characters", lambda folder: folder / ("x" * 5000 + ".csv"))
case("recording: a name with line ends", lambda folder: folder / "a\n\nb.csv")
case("table: 200 MB", sparse("table.csv", 200_000_000, f"{HEADER}\n{ROW}\n".encode()))

# What can be read, but identifies nothing
UNIDENTIFIED = {
    "one configuration": f"{HEADER}\n{ROW}\n",
    "one loaded configuration": f"{HEADER}\n{ROW}\n{ROW.replace('1,0', '1,1', 1)}\n",
    "positions on one line": HEADER + "\n" + "".join(
        f"{c},0,0.{c},0.2,0.{c},0,0,0,0,0,0,mp1,1.{c},0.5,0.2\n" for c in range(1, 9)
    ),
    "one place": HEADER + "\n" + "".join(f"{ROW.replace('1,0', f'{i},0', 1)}\n" for i in range(40)),
    "no load that changes": HEADER + "\n" + "".join(
        f"{c},{s},0.{c},0.2,0.3,5,0,0,0,0,0,mp1,1.{c},0.5,0.2\n" for c in range(1, 9) for s in range(3)
    ),
}  # fmt: skip


def prepare(name: str, folder: Path) -> tuple[Path, Path]:
    """Make the files of a case; return the cell file and the recording."""
    text, make = CASES[name] if name in CASES else (CELL, table(UNIDENTIFIED[name]))
    folder.mkdir()
    cell = folder / "cell.yaml"
    if text != "missing":
        cell.write_text(text)
    data = folder / "data"
    data.mkdir()
    return cell, make(data)
