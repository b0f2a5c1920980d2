"""Where the inputs of a recording lie, and whether they are those that a result was made from.

A file that has the size and the time of change that a result noted is taken as unchanged, as `make` and `git` do; where
these differ, its content decides.  Of what fsspec reads, all that the file system says of a file takes the place of its
content, if a change shows in that.  What could not be fetched is tried again by the next run.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from calibration_core.errors import RecordingError, quoted
from calibration_core.files.regular import open_regular
from calibration_core.fleet.recordings.manifest import Entry

ABSENT = "absent"
# Names under which fsspec's file systems say when a file was last changed, or what stands for its content.
STAMPS = {
    "ETag", "etag", "md5Hash", "content_md5", "Content-MD5", "Digest", "hex", "sha", "generation",
    "Last-Modified", "LastModified", "last_modified", "mtime", "modified", "modify", "updated", "created", "date_time",
}  # fmt: skip
EXPECTED = "a recording or cell file that can be read there"


@dataclasses.dataclass(frozen=True)
class InputFile:
    """One file that a result was made from.

    Attributes:
        path: Absolute path or URL.
        size: Bytes; -1 where it is absent, or the file system does not say.
        changed: ns, time of the last change; 0 where the file system does not say.
        digest: SHA-256 of the content, or the file system's fingerprint; `absent` where there is none.
    """

    path: str
    size: int
    changed: int
    digest: str


def is_remote(place: str) -> bool:
    """Say whether a place is a URL."""
    return "://" in place


def files_of(place: str) -> tuple[str, ...]:
    """Return the files of a recording or cell file: those of a folder, or the place itself, absent or not.

    Raises:
        RecordingError: The place cannot be looked at.
    """
    try:
        if is_remote(place):
            system, path = _remote(place)
            if not _is_folder(system, path):
                return (place,)
            return tuple(sorted(system.unstrip_protocol(name) for name in system.find(path)))
        local = Path(place)
        if not local.is_dir():
            return (place,)
        return tuple(sorted(str(child) for child in local.rglob("*") if child.is_file()))
    except (OSError, ValueError, ImportError) as error:
        raise RecordingError(place, "", quoted(str(error), 120), EXPECTED) from None


def input_file(path: str) -> InputFile:
    """Return a file as it is now.

    Raises:
        RecordingError: It is there and cannot be read.
    """
    try:
        if is_remote(path):
            system, name = _remote(path)
            known = system.info(name)
            size = known.get("size")
            return InputFile(path, -1 if size is None else int(size), 0, _fingerprint(system, name, known))
        with open_regular(Path(path)) as stream:
            status = Path(path).stat()
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
            return InputFile(path, status.st_size, status.st_mtime_ns, digest)
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        return InputFile(path, -1, 0, ABSENT)
    except (OSError, ValueError, ImportError) as error:
        reason = getattr(error, "strerror", None) or quoted(str(error), 120)
        raise RecordingError(path, "", reason, EXPECTED) from None


def is_unchanged(entry: Entry, noted: Sequence[InputFile]) -> bool:
    """Say whether the inputs of an entry are those that were noted.

    Args:
        entry: The recording and its cell file.
        noted: Every file that the result was made from, a robot's description that the cell file names among them.
    """
    known = {one.path: one for one in noted}
    try:
        now = {*files_of(entry.recording), *files_of(entry.cell)}
        return now <= known.keys() and all(_is_the_same(one) for one in noted)
    except RecordingError:
        return False


def _is_the_same(noted: InputFile) -> bool:
    if not is_remote(noted.path) and noted.digest != ABSENT:
        try:
            status = Path(noted.path).stat()
        except OSError:
            return False
        if (status.st_size, status.st_mtime_ns) == (noted.size, noted.changed):
            return True
    return input_file(noted.path).digest == noted.digest


def digest_of(files: Sequence[InputFile], version: str) -> str:
    """Return the SHA-256 of all inputs and the version that evaluated them: the key of a result."""
    lines = [f"{one.path}\t{one.digest}" for one in sorted(files, key=lambda one: one.path)]
    return hashlib.sha256("\n".join([version, *lines]).encode()).hexdigest()


@contextlib.contextmanager
def local_copies(entry: Entry) -> Iterator[tuple[Path, Path]]:
    """Yield local paths of the recording and the cell file; what lies elsewhere is copied, and removed afterwards.

    Raises:
        RecordingError: It cannot be copied.
    """
    if not is_remote(entry.recording) and not is_remote(entry.cell):
        yield Path(entry.recording), Path(entry.cell)
        return
    with tempfile.TemporaryDirectory(prefix="calibration-fleet-") as folder:
        recording = _copied(entry.recording, Path(folder) / "recording")
        cell = _copied(entry.cell, Path(folder) / "cell")
        if is_remote(entry.cell):
            _copy_description(entry.cell, cell)
        yield recording, cell


def description_of(cell: str, document: object) -> str | None:
    """Return where the robot description lies that a cell file names; None where it names none."""
    robot = document.get("robot") if isinstance(document, Mapping) else None
    urdf = robot.get("urdf") if isinstance(robot, Mapping) else None
    if not isinstance(urdf, str) or "\0" in urdf:
        return None
    if not is_remote(cell):
        return str(Path(cell).parent / urdf)
    scheme, _, rest = cell.partition("://")
    parts: list[str] = []
    for part in (PurePosixPath(rest).parent / urdf).parts:
        if part == ".." and parts and parts[-1] != "..":
            parts.pop()
        else:
            parts.append(part)
    return f"{scheme}://{PurePosixPath(*parts)}"


def _copy_description(url: str, cell: Path) -> None:
    from calibration_core.files.yaml_file import read_yaml

    document = read_yaml(cell, 1 << 20, "cell file (YAML)").data
    source = description_of(url, document)
    if source is not None:
        # One folder up is as far as a description may lie: the copy has no more above it.
        target = (cell.parent / str(document["robot"]["urdf"])).resolve()
        if cell.parents[1].resolve() in target.parents:
            target.parent.mkdir(parents=True, exist_ok=True)
            _fetch(source, target)


def _copied(place: str, folder: Path) -> Path:
    if not is_remote(place):
        return Path(place)
    folder.mkdir(parents=True)
    target = folder / (PurePosixPath(place.partition("://")[2]).name or "recording")
    _fetch(place, target)
    return target


def _fetch(url: str, target: Path) -> None:
    try:
        system, path = _remote(url)
        system.get(path, str(target), recursive=_is_folder(system, path))
    except (OSError, ValueError, ImportError) as error:
        raise RecordingError(url, "", quoted(str(error), 120), EXPECTED) from None


def _is_folder(system: Any, path: str) -> bool:
    """Say whether a place is a folder; HTTP knows none, and what is absent is none."""
    with contextlib.suppress(FileNotFoundError):
        return bool(system.info(path).get("type") == "directory")
    return False


def _fingerprint(system: Any, path: str, known: Mapping[str, Any]) -> str:
    """Return what changes with a file: what its file system says of it if a stamp is among that, or its content."""
    if STAMPS & known.keys():
        return hashlib.sha256(repr(sorted(known.items(), key=lambda one: one[0])).encode()).hexdigest()
    with system.open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _remote(url: str) -> tuple[Any, str]:
    from fsspec.core import url_to_fs

    system, path = url_to_fs(url)
    return system, str(path)
