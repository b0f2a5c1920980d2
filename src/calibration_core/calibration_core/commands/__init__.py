"""What each command does: read, call the core, write the whole set of results, and say in short what came out.

One module per command, loaded only when it is asked for; each has `run(arguments) -> str`.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable
from pathlib import Path

from calibration_core.errors import CalibrationError

WITHOUT_RESULT = ("describe", "completion")  # they write nothing
FAMILIES = {
    "planning": ("plan",),
    "evaluation": ("simulate", "identify", "diagnose", "predict"),
    "application": ("export", "deflect", "compensate"),
    "files": ("init", "check", "describe"),
    "terminal": ("completion",),
    "acceptance": ("verify", "compare"),
    "fleet": ("fleet",),
}
MODULES = {name: f"{family}.{name}" for family, names in FAMILIES.items() for name in names}
MODULES["import"] = "files.import_tables"
NAMES = tuple(MODULES)


def command(name: str) -> Callable[[argparse.Namespace], str]:
    """Return what runs the command of this name: arguments in, summary out.

    Raises:
        CalibrationError: There is no such command.
    """
    if name not in NAMES:
        msg = f"no command {name!r}, choose one of {', '.join(NAMES)}"
        raise CalibrationError(msg)
    run: Callable[[argparse.Namespace], str] = importlib.import_module(f"{__name__}.{MODULES[name]}").run
    return run


def result_of(options: argparse.Namespace) -> str:
    """Return the result.json that a command wrote, or was asked to describe."""
    from calibration_core.report.writing.output import RESULT

    place: Path = options.result if options.command in WITHOUT_RESULT else options.out
    return (place / RESULT if place.is_dir() else place).read_text(encoding="utf-8").rstrip()
