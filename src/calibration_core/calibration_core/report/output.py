"""Files appear whole or not at all."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

from calibration_core.errors import OutputError


def write_files(directory: Path, files: Mapping[str, bytes]) -> None:
    """Write a set of files into a directory, which is made if missing: all of them, or none.

    Each file is written under a temporary name beside its place and then renamed.  If anything fails, what was there
    before is put back.

    Args:
        directory: Where to.
        files: File name -> content.

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
            if target.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(target))
            if target.exists():
                saved[target] = temporary.with_suffix(".old")
                target.replace(saved[target])
            temporary.replace(target)
            placed.append(target)
    except OSError as error:
        _undo(staged, saved, placed)
        place = Path(str(error.filename)).name if error.filename else ""
        raise OutputError(directory, place, error.strerror or str(error), "a directory that can be written") from None
    except BaseException:
        _undo(staged, saved, placed)
        raise
    for backup in saved.values():
        backup.unlink()


def write_atomically(path: Path, content: bytes) -> None:
    """Write one file: afterwards it holds either its old or its new content.

    Raises:
        OutputError: It cannot be written.
    """
    write_files(path.parent, {path.name: content})


def _stage(directory: Path, name: str, content: bytes) -> Path:
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


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _undo(staged: Mapping[Path, Path], saved: Mapping[Path, Path], placed: list[Path]) -> None:
    for target in placed:
        target.unlink()
    for target, backup in saved.items():
        if backup.exists():
            backup.replace(target)
    for temporary in staged.values():
        temporary.unlink(missing_ok=True)
