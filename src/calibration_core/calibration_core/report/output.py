"""Files appear whole or not at all."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from calibration_core.errors import OutputError, storage_fault

RESULT, REPORT_HTML, REPORT_PDF = "result.json", "report.html", "report.pdf"

Content = bytes | Callable[[Path], None]
"""What a file holds, or a function that makes a file or directory at the path that it is given."""


def write_files(directory: Path, files: Mapping[str, Content]) -> None:
    """Write a set of files into a directory, which is made if missing: all of them, or none.

    Each is made under a temporary name beside its place and then renamed.  If anything fails, what was there before is
    put back.

    Args:
        directory: Where to.
        files: Name -> content; a name that stands already is replaced, but a directory only by a directory.

    Raises:
        OutputError: The directory cannot be made or a file cannot be written.
    """
    staged: dict[Path, Path] = {}
    saved: dict[Path, Path] = {}
    placed: list[Path] = []
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            staged[directory / name] = _stage(directory, name, content)
        for target, temporary in staged.items():
            if target.exists():
                _require_alike(target, temporary)
                saved[target] = temporary.with_suffix(".old")
                target.replace(saved[target])
            temporary.replace(target)
            placed.append(target)
    except OSError as error:
        _undo(staged, saved, placed)
        place = Path(str(error.filename)).name if error.filename else ""
        raise OutputError(
            directory, place, *storage_fault(directory, error, "a directory that can be written")
        ) from None
    except BaseException:
        _undo(staged, saved, placed)
        raise
    for backup in saved.values():
        _remove(backup)


def write_atomically(path: Path, content: bytes) -> None:
    """Write one file: afterwards it holds either its old or its new content.

    Raises:
        OutputError: It cannot be written.
    """
    write_files(path.parent, {path.name: content})


def _stage(directory: Path, name: str, content: Content) -> Path:
    if not isinstance(content, bytes):
        return _stage_made(directory, name, content)
    handle, temporary = tempfile.mkstemp(prefix=f".{name}.", suffix=".tmp", dir=directory)
    path = Path(temporary)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        path.chmod(0o666 & ~_umask())
    except BaseException:
        path.unlink()
        raise
    return path


def _stage_made(directory: Path, name: str, make: Callable[[Path], None]) -> Path:
    """Let something be made under its own name (which may be written into it), then take it out."""
    folder = Path(tempfile.mkdtemp(prefix=f".{name}.", suffix=".tmp", dir=directory))
    try:
        make(folder / name)
        path = folder.with_suffix(".made")
        (folder / name).replace(path)
    finally:
        shutil.rmtree(folder)
    return path


def _require_alike(target: Path, temporary: Path) -> None:
    if target.is_dir() and not temporary.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(target))
    if temporary.is_dir() and not target.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(target))


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _undo(staged: Mapping[Path, Path], saved: Mapping[Path, Path], placed: list[Path]) -> None:
    for target in placed:
        _remove(target)
    for target, backup in saved.items():
        if backup.exists():
            backup.replace(target)
    for temporary in staged.values():
        _remove(temporary)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
