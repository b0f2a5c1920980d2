"""What each command does: read, call the core, write the whole set of results, and say in short what came out.

One module per command, loaded only when it is asked for; each has `run(arguments) -> str`.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable

from calibration_core.errors import CalibrationError

MODULES = {name: name for name in ("plan", "simulate", "identify", "diagnose", "predict")} | {"import": "import_tables"}
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
