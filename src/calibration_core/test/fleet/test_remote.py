"""Recordings that lie where fsspec reads: in memory, behind file://, and behind HTTP on this machine."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import json
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("fsspec")
pytest.importorskip("distributed")
pytest.importorskip("pyarrow")

import fsspec

from calibration_core.cli import main
from calibration_core.fleet.recordings.inputs import input_file, is_unchanged
from calibration_core.fleet.recordings.manifest import Entry
from calibration_core.fleet.recordings.rows import Row
from calibration_core.fleet.recordings.store import read_dataset
from calibration_core.fleet.recordings.task import measure

CONFIG = Path(__file__).parents[4] / "config"
BIN = Path(sys.executable).parent
APART = {"recording", "cell", "key", "inputs", "seconds", "megabytes", "host"}  # of the same recording elsewhere


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording and a cell file that names a robot description in another folder."""
    found = tmp_path_factory.mktemp("remote")
    shutil.copytree(CONFIG / "robots", found / "robots")
    cell = found / "cells" / "demo.cell.yaml"
    cell.parent.mkdir()
    shutil.copy(CONFIG / "cells" / "demo.cell.yaml", cell)
    out = found / "made"
    assert main(["simulate", "--cell", str(cell), "--seed", "1", "--no-report", "-q", "--out", str(out)]) == 0
    shutil.copy(out / "measurements.csv", found / "measured.csv")
    shutil.rmtree(out)
    return found


@pytest.fixture(scope="module")
def local(folder: Path) -> Row:
    row = measure(entry_at(str(folder))).row
    assert row.measured, row.error
    return row


def entry_at(place: str) -> Entry:
    return Entry("kr", "r1", "2026-01-01", f"{place}/measured.csv", f"{place}/cells/demo.cell.yaml")


def said(row: Row) -> dict[str, Any]:
    return {name: value for name, value in dataclasses.asdict(row).items() if name not in APART}


@pytest.fixture
def memory(folder: Path) -> Iterator[str]:
    system = fsspec.filesystem("memory")
    for path in folder.rglob("*"):
        if path.is_file():
            system.pipe(f"/plant/{path.relative_to(folder)}", path.read_bytes())
    yield "memory://plant"
    system.rm("/plant", recursive=True)


def test_what_lies_elsewhere_says_the_same(memory: str, local: Row) -> None:
    entry = entry_at(memory)
    outcome = measure(entry)
    assert said(outcome.row) == said(local)
    assert json.loads(outcome.result)["recording"]["file"] == entry.recording
    names = {one.path for one in outcome.row.inputs}
    assert names == {entry.recording, entry.cell, f"{memory}/robots/kr240.urdf"}
    assert is_unchanged(entry, outcome.row.inputs)


@pytest.mark.parametrize("name", ["measured.csv", "cells/demo.cell.yaml", "robots/kr240.urdf"])
def test_what_has_changed_elsewhere_is_seen(memory: str, name: str) -> None:
    entry = entry_at(memory)
    noted = measure(entry).row.inputs
    fsspec.filesystem("memory").pipe(f"/plant/{name}", b"something else")
    assert not is_unchanged(entry, noted)


@pytest.mark.parametrize(("place", "says"), [
    ("memory://nowhere", "expected"), ("nonsense://plant", "Protocol not known: nonsense"),
])  # fmt: skip
def test_what_cannot_be_read_elsewhere_is_a_row(place: str, says: str) -> None:
    row = measure(entry_at(place)).row
    assert not row.measured
    assert place in row.error
    assert says in row.error
    assert len(row.error.splitlines()) == 1
    assert "defect" not in row.error


class Handler(SimpleHTTPRequestHandler):
    """Serves files without a word on stderr, and without saying when a file was last changed where asked to."""

    silent = False

    def log_message(self, *_: object) -> None:
        pass

    def send_header(self, keyword: str, value: str) -> None:
        if not (self.silent and keyword == "Last-Modified"):
            super().send_header(keyword, value)


class Silent(Handler):
    """Says nothing by which a change could be seen but the content."""

    silent = True


@contextlib.contextmanager
def served(folder: Path, handler: type[Handler]) -> Iterator[str]:
    with ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(handler, directory=str(folder))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()


def test_the_command_reads_through_file_and_http(folder: Path, local: Row, tmp_path: Path) -> None:
    """Workers fetch what they need; what is done is not fetched again, what could not be fetched is tried again."""
    pytest.importorskip("aiohttp")
    with served(folder, Handler) as url:
        entries = {"r1": entry_at(f"file://{folder}"), "r2": entry_at(url), "r3": entry_at(f"{url}/nowhere")}
        lines = [f"{entry.recording},{entry.cell},{robot},kr,2026-01-01" for robot, entry in entries.items()]
        found = fleet(tmp_path, lines, "--jobs", "1")
        assert [said(dataclasses.replace(found[robot], robot="r1")) for robot in ("r1", "r2")] == [said(local)] * 2
        assert "nowhere" in found["r3"].error
        nobody = ("--cluster", "tcp://127.0.0.1:9")
        assert fleet(tmp_path, lines[:2], *nobody) == {robot: found[robot] for robot in ("r1", "r2")}


def fleet(folder: Path, lines: list[str], *options: str) -> dict[str, Row]:
    """Rows of the data set by robot."""
    manifest, out = folder / "plant.csv", folder / "out"
    manifest.write_text("\n".join(["recording,cell,robot,type,date", *lines]) + "\n")
    command = [BIN / "calibration", "fleet", manifest, "--out", out, "--no-report", "-q", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=240)
    assert (done.returncode, done.stderr) == (0, "")
    return {row.robot: row for row in read_dataset(out / "fleet.parquet")}


@pytest.mark.parametrize("handler", [Handler, Silent])
def test_a_change_behind_http_is_seen(handler: type[Handler], tmp_path: Path) -> None:
    pytest.importorskip("aiohttp")
    path = tmp_path / "measured.csv"
    path.write_text("first")
    with served(tmp_path, handler) as url:
        before = input_file(f"{url}/measured.csv")
        assert input_file(f"{url}/measured.csv") == before
        path.write_text("other")  # as long as the first
        later = path.stat().st_mtime + 2.0
        os.utime(path, (later, later))
        assert input_file(f"{url}/measured.csv").digest != before.digest
