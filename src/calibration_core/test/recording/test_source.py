"""Kinds of recordings and their fingerprints."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from calibration_core.errors import RecordingError
from calibration_core.recording.source import recording_kind, sha256_of


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
