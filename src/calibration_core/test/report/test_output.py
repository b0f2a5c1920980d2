"""A set of files appears whole or not at all."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from calibration_core.commands import NAMES, WITHOUT_RESULT
from calibration_core.errors import InputError, OutputError
from calibration_core.report.writing import output
from calibration_core.report.writing.output import write_files
from calibration_core.report.writing.ownership import require_directory


def contents(directory: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in directory.iterdir() if path.is_file()}


def everything(directory: Path) -> list[str]:
    return sorted(str(path.relative_to(directory)) for path in directory.rglob("*"))


def test_all_files_are_written_and_replaced(tmp_path: Path) -> None:
    target = tmp_path / "a" / "b"
    write_files(target, {"x": b"1", "y": b"2"})
    write_files(target, {"y": b"3", "z": b"4"})
    assert contents(target) == {"x": b"1", "y": b"3", "z": b"4"}


def test_nothing_changes_when_one_place_is_taken_by_a_directory(tmp_path: Path) -> None:
    write_files(tmp_path, {"x": b"old"})
    (tmp_path / "z" / "inside").mkdir(parents=True)
    with pytest.raises(OutputError) as caught:
        write_files(tmp_path, {"w": b"new", "x": b"new", "z": b"new"})
    assert contents(tmp_path) == {"x": b"old"}
    assert (tmp_path / "z" / "inside").is_dir()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("links", [False, True])
def test_nothing_changes_when_a_rename_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool) -> None:
    """As where another program holds a file open, which some systems forbid to replace; without hard links, too."""
    out = tmp_path / "out"
    write_files(out, {"result.json": result("identify"), "model.yaml": b"old", "table2.csv": b"old"})
    before = contents(out)
    replace = Path.replace

    def failing(self: Path, target: Path) -> Path:
        if Path(target) == out / "report.html" and self.parent.name == "new":
            raise OSError(13, "Permission denied", str(target))
        return replace(self, target)

    def unable(source: Path, target: Path) -> None:
        raise OSError(errno.EPERM, "Operation not permitted", str(target))

    monkeypatch.setattr(Path, "replace", failing)
    if not links:
        monkeypatch.setattr(os, "link", unable)
    with pytest.raises(OutputError, match="Permission denied"):
        write_files(out, {"model.yaml": b"new", "new.csv": b"1", "report.html": b"new", "result.json": result("plan")})
    assert contents(out) == before
    assert list(tmp_path.iterdir()) == [out]


def test_who_stands_in_the_folder_keeps_it(tmp_path: Path) -> None:
    """A shell, a file browser or a server in the folder sees the new result, and not a folder that is gone."""
    out = tmp_path / "out"
    write_files(out, {"result.json": result("identify"), "model.yaml": b"old"})
    handle = os.open(out, os.O_RDONLY)
    try:
        write_files(out, {"result.json": result("identify"), "model.yaml": b"new"})
        with os.fdopen(os.open("model.yaml", os.O_RDONLY, dir_fd=handle)) as file:
            assert file.read() == "new"
    finally:
        os.close(handle)


def test_nothing_is_left_when_writing_is_interrupted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stage = output._stage

    def interrupted(directory: Path, name: str, content: bytes) -> Path:
        if name == "b":
            raise KeyboardInterrupt
        return stage(directory, name, content)

    monkeypatch.setattr(output, "_stage", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_files(tmp_path, {"a": b"1", "b": b"2"})
    assert list(tmp_path.iterdir()) == []


def test_a_directory_that_was_made_in_vain_is_gone(tmp_path: Path) -> None:
    def fail(_: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    (tmp_path / "there").mkdir()
    for out in (tmp_path / "new" / "deep", tmp_path / "there"):
        with pytest.raises(OutputError, match=r"a full disk: .* left, less than is to be written"):
            write_files(out, {"model.yaml": b"x", "report.pdf": fail})
    assert everything(tmp_path) == ["there"]


def test_a_place_that_cannot_be_written_is_refused_before_anything_is_computed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Path] = []

    def access(place: Path, _: int) -> bool:
        asked.append(place)
        return place != tmp_path / "closed"

    (tmp_path / "closed").mkdir()
    monkeypatch.setattr(os, "access", access)
    require_directory(tmp_path / "open" / "deep")
    for out in (tmp_path / "closed", tmp_path / "closed" / "deep"):
        with pytest.raises(OutputError, match=r"found no permission to write in .*closed"):
            require_directory(out)
    assert asked == [tmp_path, tmp_path / "closed", tmp_path / "closed"]


def test_a_file_in_the_place_of_the_directory_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "out").write_bytes(b"mine")
    with pytest.raises(InputError, match="a directory that can be written"):
        write_files(tmp_path / "out", {"x": b"1"})
    assert (tmp_path / "out").read_bytes() == b"mine"


def test_what_is_made_in_place_appears_whole_under_its_own_name(tmp_path: Path) -> None:
    def bag(path: Path) -> None:
        path.mkdir()
        (path / f"{path.name}.mcap").write_bytes(b"1")

    for _ in range(2):  # the second one replaces the first
        write_files(tmp_path, {"recording": bag, "table.csv": lambda path: path.write_bytes(b"2") and None, "x": b"3"})
        assert contents(tmp_path) == {"table.csv": b"2", "x": b"3"}
        assert contents(tmp_path / "recording") == {"recording.mcap": b"1"}
        assert len(list(tmp_path.iterdir())) == 3


def test_a_maker_that_fails_leaves_everything_as_it_was(tmp_path: Path) -> None:
    def broken(path: Path) -> None:
        path.mkdir()
        raise OSError(28, "No space left on device", str(path))

    (tmp_path / "recording").mkdir()
    (tmp_path / "recording" / "a.mcap").write_bytes(b"old")
    with pytest.raises(OutputError, match="No space left on device"):
        write_files(tmp_path, {"x": b"new", "recording": broken})
    assert contents(tmp_path / "recording") == {"a.mcap": b"old"}
    assert [path.name for path in tmp_path.iterdir()] == ["recording"]


def test_a_directory_never_replaces_a_file(tmp_path: Path) -> None:
    (tmp_path / "recording").write_bytes(b"mine")
    with pytest.raises(OutputError):
        write_files(tmp_path, {"recording": Path.mkdir})
    assert contents(tmp_path) == {"recording": b"mine"}


def result(command: str) -> bytes:
    return json.dumps({"schema": 1, "command": command}).encode()


def test_a_new_result_takes_the_place_of_the_whole_earlier_one(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write_files(out, {"result.json": result("identify"), "report.html": b"A", "model.yaml": b"A", "table2.csv": b"A"})
    (out / "notes.txt").write_bytes(b"mine")
    (out / "measurements.csv").write_bytes(b"mine")  # a result of another command would have it
    (out / "recording").mkdir()
    (out / "recording" / "a.mcap").write_bytes(b"mine")
    write_files(out, {"result.json": result("predict"), "predictions.csv": b"B"})
    mine = ["measurements.csv", "notes.txt", "recording", "recording/a.mcap"]
    assert everything(out) == sorted([*mine, "predictions.csv", "result.json"])
    assert contents(out)["notes.txt"] == b"mine"
    write_files(out, {"report.html": b"B"})  # no result: it is added to the one that stands
    assert everything(out) == sorted([*mine, "predictions.csv", "report.html", "result.json"])
    assert everything(tmp_path)[0] == "out"
    assert list(tmp_path.iterdir()) == [out]


def test_every_command_says_what_it_writes() -> None:
    assert set(output.WRITTEN) == set(NAMES) - set(WITHOUT_RESULT)
    assert all(output.RESULT in names for names in output.WRITTEN.values())


WRITER = """
import json, sys
from pathlib import Path
from calibration_core.report.writing.output import write_files
out, name, count = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
for i in range(count):
    mark = f"{name}{i}".encode()
    result = json.dumps({"command": "identify", "mark": mark.decode()}).encode()
    write_files(out, {"result.json": result, "report.html": mark, "model.yaml": mark, "table1.csv": b"x" * 100_000})
print("done")
"""


def started(out: Path, name: str, count: int) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-c", WRITER, str(out), name, str(count)], stdout=subprocess.PIPE)


@pytest.mark.parametrize("seed", range(3))
def test_a_killed_writer_leaves_whole_files_and_the_next_result_is_whole(tmp_path: Path, seed: int) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_bytes(b"mine")
    writer = started(out, "A", 100_000)
    while not (out / "result.json").exists():
        time.sleep(0.01)
    time.sleep(0.1 + 0.05 * seed)
    writer.kill()
    writer.wait()
    for name in ("report.html", "model.yaml"):
        assert (out / name).read_bytes().startswith(b"A")
    assert len((out / "table1.csv").read_bytes()) == 100_000
    write_files(out, {"result.json": result("identify"), "model.yaml": b"B"})
    assert contents(out) == {"result.json": result("identify"), "model.yaml": b"B", "notes.txt": b"mine"}


def test_a_link_to_a_folder_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "out").symlink_to("real")
    write_files(tmp_path / "out", {"result.json": b"1"})
    assert (tmp_path / "out").is_symlink()
    assert contents(tmp_path / "real") == {"result.json": b"1"}


@pytest.mark.parametrize("name", ["x" * 5000, "a\x00b", "file/below"])
def test_folders_that_cannot_be(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_bytes(b"mine")
    with pytest.raises(OutputError) as caught:
        write_files(tmp_path / name, {"x": b"1"})
    assert len(str(caught.value)) < 600
    assert len(str(caught.value).splitlines()) == 1
    assert everything(tmp_path) == ["file"]
