"""What a recording is, as a file: its kind and the fingerprint that ties a result to its input."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePath
from typing import Literal

from calibration_core.errors import RecordingError
from calibration_core.files.regular import open_regular

BAG_SUFFIXES = (".mcap", ".db3")
COMPRESSED = (".zst", ".zstd")
SESSION_DATABASE = "session.db"  # in the directory of a session
EXPECTED = "a rosbag2 directory, an .mcap or .db3 file, a measurement table (.csv), or a session (directory or .db)"


def storage_suffix(path: PurePath) -> str:
    """Return the ending of a file's name in small letters, that of compression left out."""
    named = PurePath(path.stem) if path.suffix.lower() in COMPRESSED else path
    return named.suffix.lower()


def ros1(path: Path) -> RecordingError:
    """Return the error for a bag of ROS 1, which says how it becomes one of ROS 2."""
    return RecordingError(path, "", "a bag of ROS 1", f"one of ROS 2: rosbags-convert --src {path.name} --dst FOLDER")


def recording_kind(path: Path) -> Literal["bag", "table", "session"]:
    """Tell bags, measurement tables and sessions apart by what the path names.

    Raises:
        RecordingError: The path does not exist, or is none of them.
    """
    path = Path(path)
    try:
        if path.is_dir():
            return "session" if (path / SESSION_DATABASE).exists() else "bag"
        exists = path.exists()
    except (OSError, ValueError) as error:
        raise RecordingError(path, "", getattr(error, "strerror", None) or str(error), EXPECTED) from None
    if not exists:
        raise RecordingError(path, "", "no such file or directory", EXPECTED)
    if not path.is_file():
        raise RecordingError(path, "", "no regular file", EXPECTED)
    suffix = storage_suffix(path)
    if suffix in BAG_SUFFIXES:
        return "bag"
    if ".bag" in path.suffixes:
        raise ros1(path)
    if suffix == ".csv":
        return "table"
    if suffix == Path(SESSION_DATABASE).suffix:
        return "session"
    raise RecordingError(path, "", f"a file that ends in {path.suffix.lower()!r}", EXPECTED)


def sha256_of(path: Path) -> str:
    """Return the SHA-256 hex digest of a file, read as a stream.

    Raises:
        RecordingError: The file cannot be read.
    """
    try:
        with open_regular(path) as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise RecordingError(path, "", error.strerror or str(error), "a readable file") from None


def file_names(paths: Sequence[Path]) -> tuple[str, ...]:
    """Return what input files are called in a result: their names, or their paths where two have the same name."""
    count = Counter(path.name for path in dict.fromkeys(paths))
    return tuple(path.name if count[path.name] == 1 else str(path) for path in paths)


def digests_of_several(inputs: Iterable[tuple[str, Mapping[str, str]]]) -> dict[str, str]:
    """Return the digests of all files of several inputs, each file named with its input.

    Args:
        inputs: Name of an input, and its file -> SHA-256; a later input of the same name with another content is
            numbered.
    """
    found: dict[str, str] = {}
    for name, files in inputs:
        title, number = name, 1
        while any(found.get(f"{title}: {file}", digest) != digest for file, digest in files.items()):
            number += 1
            title = f"{name} ({number})"
        found |= {f"{title}: {file}": digest for file, digest in files.items()}
    return found
