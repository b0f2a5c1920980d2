"""A disk that runs full while a session or a bag is written: one line names the file and the room that is left."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

CELL = Path(__file__).resolve().parents[3] / "config" / "cells" / "demo.cell.yaml"

SESSION = """
import sys
from pathlib import Path
from calibration_core.cell import load_cell
from calibration_core.errors import SessionError
from calibration_core.measurement.session import Session
from calibration_core.recording.session_values import Event
disk, cell = Path(sys.argv[1]), load_cell(sys.argv[2])
kept = 0
with Session.create(disk / "today", "schema: 1\\n", cell) as session:
    try:
        while True:
            session.note(Event(kept, "note", "x" * 500))
            kept += 1
    except SessionError as error:
        print(error)
with Session.look(disk / "today") as session:
    print(len(session.events) == kept)
"""

BEGIN = """
import sys
from pathlib import Path
from calibration_core.cell import load_cell
from calibration_core.errors import SessionError
from calibration_core.measurement.session import Session
disk, cell = Path(sys.argv[1]), load_cell(sys.argv[2])
with (disk / "filler").open("wb", buffering=0) as filler:
    try:
        while True:
            filler.write(bytes(4096))
    except OSError:
        pass
try:
    Session.create(disk / "today", "schema: 1\\n", cell)
except SessionError as error:
    print(error)
print(not (disk / "today" / "session.db").exists())
"""

BAG = """
import sys
from pathlib import Path
from calibration_core.errors import OutputError
from calibration_core.recording.bags.live_writer import LiveBag, LiveTopic
bag = LiveBag(Path(sys.argv[1]) / "bag")
topic = bag.add_topic(LiveTopic("/x", "std_msgs/msg/String"))
try:
    for time in range(10**6):
        bag.write(topic, time, bytes(1000))
        bag.sync()
except OutputError as error:
    print(error)
print((Path(sys.argv[1]) / "bag" / "metadata.yaml").is_file())
"""


def on_a_small_disk(program: str, disk: Path) -> list[str]:
    """Lines that a program prints whose first argument is a disk of 400 kB, its second a cell file."""
    mounted = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c"]
    mount = 'mount -t tmpfs -o size=400k none "$1" && shift && exec "$@"'
    if (
        shutil.which("unshare") is None
        or subprocess.run([*mounted, mount, "sh", str(disk), "true"], capture_output=True, check=False).returncode
    ):
        pytest.skip("no small disk can be made: mounting in a user namespace is not permitted here")
    answer = subprocess.run(
        [*mounted, mount, "sh", str(disk), sys.executable, "-c", textwrap.dedent(program), str(disk), str(CELL)],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert answer.returncode == 0, answer.stderr
    return answer.stdout.splitlines()


@pytest.mark.parametrize(
    ("program", "file"),
    [(SESSION, "today/session.db"), (BEGIN, "today"), (BAG, "bag/bag_0.mcap")],
    ids=["session", "session that begins", "bag"],
)
def test_path_and_room_are_named_and_nothing_is_lost(program: str, file: str, tmp_path: Path) -> None:
    said, kept = on_a_small_disk(program, tmp_path)
    words = (
        r"\S*: found a full disk: \S+ kB of 400 kB left(, less than is to be written)? \(.+\), expected room to write"
    )
    assert re.fullmatch(re.escape(str(tmp_path / file)) + words, said)
    assert kept == "True"
