"""Whose files stand in an output folder: a command replaces what it wrote itself, never an input or a file of others.

What a command wrote is known by the `result.json` beside it, which names the command.  A folder with such a result is
its own as a whole: every name of `WRITTEN` in it is replaced or removed by the next result.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from calibration_core.errors import OutputError
from calibration_core.report.writing.output import RESULT, WRITTEN, made_by


def require_own(directory: Path, command: str) -> None:
    """Refuse a folder in which a command would replace or remove what it did not write.

    Args:
        directory: Where its results are to stand; it need not exist.
        command: One of `WRITTEN`.

    Raises:
        OutputError: Files of these names stand there, and are not known to be results of the same command.
    """
    there = [name for name in sorted(WRITTEN[command]) if os.path.lexists(directory / name)]
    if not there:
        return
    maker = made_by(directory)
    if maker == command:
        return
    expected = f"another directory: calibration {command} replaces its own results alone"
    if maker is not None:
        raise OutputError(directory / RESULT, "", f"a result of calibration {maker}", expected)
    raise OutputError(directory / there[0], "", f"a file that calibration {command} did not write", expected)


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
    replaced = {home / name for name in WRITTEN[command]}
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
