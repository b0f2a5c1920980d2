"""Kinds of recordings and their fingerprints."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from calibration_core.errors import RecordingError
from calibration_core.recording.source import digests_of_several, file_names, recording_kind, sha256_of


def test_kinds(tmp_path: Path) -> None:
    assert recording_kind(tmp_path) == "bag"
    for name, kind in (("a.mcap", "bag"), ("a.db3", "bag"), ("a.csv", "table"), ("A.CSV", "table")):
        (tmp_path / name).touch()
        assert recording_kind(tmp_path / name) == kind


@pytest.mark.parametrize("name", ["missing.csv", "photo.jpg", "a\x00b.csv", "x" * 5000 + ".csv"])
def test_neither(tmp_path: Path, name: str) -> None:
    (tmp_path / "photo.jpg").touch()
    with pytest.raises(RecordingError, match="expected a rosbag2 directory"):
        recording_kind(tmp_path / name)


def test_sha256(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"x" * 100_000)
    assert sha256_of(tmp_path / "a") == hashlib.sha256(b"x" * 100_000).hexdigest()
    with pytest.raises(RecordingError):
        sha256_of(tmp_path / "missing")


def test_files_of_several_inputs_are_named_with_their_input() -> None:
    given = [("a", {"x.csv": "1", "y.csv": "2"}), ("b", {"x.csv": "3"})]
    assert digests_of_several(given) == {"a: x.csv": "1", "a: y.csv": "2", "b: x.csv": "3"}


def test_inputs_of_one_name_are_distinguished() -> None:
    given = [("a", {"x.csv": "1"}), ("a", {"x.csv": "2"}), ("a", {"x.csv": "1"}), ("a", {"x.csv": "3"})]
    assert digests_of_several(given) == {"a: x.csv": "1", "a (2): x.csv": "2", "a (3): x.csv": "3"}


def test_files_are_named_by_their_paths_where_their_names_are_the_same() -> None:
    assert file_names([Path("day/a.csv"), Path("b.csv")]) == ("a.csv", "b.csv")
    assert file_names([Path("day/a.csv"), Path("night/a.csv"), Path("day/b.csv")]) == (
        "day/a.csv", "night/a.csv", "b.csv",
    )  # fmt: skip
