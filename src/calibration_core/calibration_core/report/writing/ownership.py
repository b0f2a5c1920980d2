"""Whose files stand in an output folder: a command replaces what it wrote itself, never an input or a file of others.

What the program wrote is known by the `result.json` beside it, which names the command.  A folder with such a result
is the program's own: every name of `WRITTEN` in it is replaced or removed by the next result, of whatever command.
Recordings alone, which are data, are replaced only by the command that made them.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from calibration_core.errors import OutputError
from calibration_core.report.writing.output import RESULT, WRITTEN, made_by

RECORDING = frozenset({"simulate", "import"})  # commands whose results are recordings


def require_own(directory: Path, command: str) -> None:
    """Refuse a folder in which a command would replace or remove what it did not write.

    Args:
        directory: Where its results are to stand; it need not exist.
        command: One of `WRITTEN`.

    Raises:
        OutputError: Files of these names stand there that no result of the program holds, or recordings that another
            command made.
    """
    maker = made_by(directory)
    expected = f"another directory for the results of calibration {command}"
    if maker in RECORDING and maker != command:
        raise OutputError(directory / RESULT, "", f"recordings of calibration {maker} beside it", expected)
    foreign = WRITTEN[command] - WRITTEN.get(maker or "", frozenset()) - {RESULT}  # which may be an earlier one's rest
    there = [name for name in sorted(foreign) if os.path.lexists(directory / name)]
    if there:
        raise OutputError(directory / there[0], "", f"a file that calibration {command} did not write", expected)


def require_directory(directory: Path) -> None:
    """Refuse, before anything is computed, a place for results where no directory is or can be made.

    Raises:
        OutputError: It is, or lies below, something other than a directory, or one that cannot be written.
    """
    for place in (directory, *directory.parents):
        try:
            there, is_directory = place.exists(), place.is_dir()
        except (OSError, ValueError):  # no place at all: whoever writes says so
            return
        if there and not is_directory:
            found = "a file" if place == directory else f"a file, {place}, above it"
            raise OutputError(directory, "", found, "a directory for the results")
        if there:
            if not os.access(place, os.W_OK | os.X_OK):
                found = f"no permission to write in {place}, or a read-only file system"
                raise OutputError(directory, "", found, "a directory that can be written")
            return


def refuse_inputs(directory: Path, command: str, inputs: Iterable[Path]) -> None:
    """Refuse a folder in which the results of a command would take the place of what it reads.

    Args:
        directory: Where its results are to stand; it need not exist.
        command: One of `WRITTEN`.
        inputs: Files and directories that it reads; they need not exist.

    Raises:
        OutputError: One of them is, or lies in, something that the command replaces or removes there.
    """
    try:
        home = directory.resolve()
    except (OSError, ValueError, RuntimeError):
        return  # no place at all: whoever writes says so
    replaced = {home / name for name in WRITTEN[command] | WRITTEN.get(made_by(directory) or "", frozenset())}
    for given in inputs:
        if any(replaced & {place, *place.parents} for place in _places(given)):
            expected = f"another directory than {directory} for the results: they would take its place"
            raise OutputError(given, "", "an input of this command", expected)


def _places(given: Path) -> tuple[Path, ...]:
    """Return where an input stands: as it is named, and with every link followed."""
    try:
        return given.parent.resolve() / given.name, given.resolve()
    except (OSError, ValueError, RuntimeError):  # no place at all: whoever reads it says so
        return ()
