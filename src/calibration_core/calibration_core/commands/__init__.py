"""What each command does: read, call the core, write the whole set of results, and say in short what came out.

One module per command, loaded only when it is asked for; each has `run(arguments) -> str`.  None of them begins where
its results would take the place of an input, or of a file that it did not write.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable
from pathlib import Path

from calibration_core.errors import CalibrationError

WITHOUT_RESULT = ("describe", "completion")  # they write nothing
FAMILIES = {
    "planning": ("plan", "pendant"),
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
    """Return what runs the command of this name: arguments in, summary out; it begins with `require_place`.

    Raises:
        CalibrationError: There is no such command.
    """
    if name not in NAMES:
        msg = f"no command {name!r}, choose one of {', '.join(NAMES)}"
        raise CalibrationError(msg)
    run: Callable[[argparse.Namespace], str] = importlib.import_module(f"{__name__}.{MODULES[name]}").run
    if name in WITHOUT_RESULT:
        return run

    def run_beside(options: argparse.Namespace) -> str:
        require_place(options, name)
        return run(options)

    return run_beside


def require_place(options: argparse.Namespace, name: str) -> None:
    """Refuse an output folder that is none, or in which a command would replace an input or what it did not write.

    Raises:
        OutputError: It would.
    """
    from calibration_core.report.writing.ownership import refuse_inputs, require_directory, require_own

    require_directory(options.out)
    refuse_inputs(options.out, name, inputs_of(options))
    require_own(options.out, name)


def inputs_of(options: argparse.Namespace) -> tuple[Path, ...]:
    """Return every file and directory that the options of a command name, but the output folder."""
    values = [value for name, value in vars(options).items() if name != "out"]
    each = [one for value in values for one in (value if isinstance(value, list) else [value])]
    robot = [Path(options.robot)] if getattr(options, "robot", None) else []  # a file, or a name of the library
    return (*(one for one in each if isinstance(one, Path)), *robot)


def result_of(options: argparse.Namespace) -> str:
    """Return the result.json that a command wrote, or was asked to describe."""
    from calibration_core.report.writing.output import RESULT

    place: Path = options.result if options.command in WITHOUT_RESULT else options.out
    return (place / RESULT if place.is_dir() else place).read_text(encoding="utf-8").rstrip()
