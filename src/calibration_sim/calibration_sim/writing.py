"""What a program of the simulator writes stands there as a whole, or not at all."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path

from calibration_core.errors import OutputError, storage_fault

NEW = "a path that does not exist yet"


def refuse_existing(*paths: Path | None) -> None:
    """Refuse to write over anything.

    Raises:
        OutputError: One of the paths exists.
    """
    for path in paths:
        if path is not None and os.path.lexists(path):
            raise OutputError(path, "", "something", NEW)


def write_all(*places: tuple[Path | None, Callable[[Path], object]]) -> None:
    """Make files and directories that do not exist yet: all of them, or none.

    Args:
        places: Where each is to stand, or None if it is not wanted, and what makes it there; the directories above are
            made.

    Raises:
        OutputError: One exists already, or cannot be written.
    """
    made: list[Path] = []
    try:
        for path, write in places:
            if path is None:
                continue
            refuse_existing(path)
            try:
                made += _make_folder(path.parent)
                made.append(path)
                write(path)
            except OSError as error:
                raise OutputError(path, "", *storage_fault(path, error, "a path that can be written")) from None
    except BaseException:
        for path in reversed(made):
            _remove(path)
        raise


def _make_folder(folder: Path) -> list[Path]:
    """Make a directory and those above it; return the ones that were missing, the uppermost first."""
    missing = [one for one in (folder, *folder.parents) if not os.path.lexists(one)][::-1]
    for k, one in enumerate(missing):
        try:
            one.mkdir()
        except OSError:
            for other in reversed(missing[:k]):
                other.rmdir()
            raise
    return missing


def _remove(path: Path) -> None:
    if os.path.isdir(path):  # noqa: PTH112 - false, not an error, for a name that cannot be
        shutil.rmtree(path, ignore_errors=True)
        return
    with contextlib.suppress(OSError):  # it was never made
        path.unlink()
