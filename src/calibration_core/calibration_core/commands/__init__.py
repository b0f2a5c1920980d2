"""What each command does: read, call the core, write the whole set of results, and say in short what came out.

One module per command, loaded only when it is asked for; each has `run(arguments) -> str`.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable
from pathlib import Path

from calibration_core.errors import CalibrationError

WITHOUT_RESULT = ("describe",)  # writes nothing
MODULES = {name: name for name in ("plan", "simulate", "identify", "diagnose", "predict", *WITHOUT_RESULT)}
MODULES["import"] = "import_tables"
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
    from calibration_core.report.output import RESULT

    place: Path = options.result if options.command in WITHOUT_RESULT else options.out
    return (place / RESULT if place.is_dir() else place).read_text(encoding="utf-8").rstrip()
