"""A set of files appears whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from calibration_core.errors import InputError, OutputError
from calibration_core.report import output
from calibration_core.report.output import write_atomically, write_files


def contents(directory: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in directory.iterdir() if path.is_file()}


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


def test_nothing_changes_when_a_rename_fails_half_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_files(tmp_path, {"x": b"old", "y": b"old"})
    replace = Path.replace

    def failing(self: Path, target: Path) -> Path:
        if Path(target).name == "y" and self.suffix == ".tmp":
            raise OSError(28, "No space left on device", str(target))
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", failing)
    with pytest.raises(OutputError, match="No space left on device"):
        write_files(tmp_path, {"w": b"new", "x": b"new", "y": b"new"})
    assert contents(tmp_path) == {"x": b"old", "y": b"old"}


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


def test_a_file_in_the_place_of_the_directory_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "out").write_bytes(b"mine")
    with pytest.raises(InputError, match="a directory that can be written"):
        write_files(tmp_path / "out", {"x": b"1"})
    assert (tmp_path / "out").read_bytes() == b"mine"


def test_one_file(tmp_path: Path) -> None:
    write_atomically(tmp_path / "new" / "model.yaml", b"a: 1\n")
    assert contents(tmp_path / "new") == {"model.yaml": b"a: 1\n"}


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
