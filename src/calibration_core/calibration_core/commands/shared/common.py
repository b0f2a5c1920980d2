"""What several commands share: where the results stand, and what a plan's configurations look like in space."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Callable
from pathlib import Path

from calibration_core.report.writing.output import REPORT_HTML, REPORT_PDF, RESULT


def report_progress(arguments: argparse.Namespace, share: float, text: str) -> None:
    """Tell who started the command, and wants to know (`arguments.report_progress`), what it does next.

    Args:
        arguments: Options of the command.
        share: Share of the command's stages that are done, 0 to 1.
        text: What is done next.
    """
    listener: Callable[[float, str], None] | None = getattr(arguments, "report_progress", None)
    if listener is not None:
        listener(share, text)


def report_line(arguments: argparse.Namespace) -> str:
    """Return the last line of a summary: where to look."""
    if not arguments.report:
        return f"result: {arguments.out / RESULT}"
    return f"report: {arguments.out / REPORT_HTML} and {arguments.out / REPORT_PDF}"


def typed(*words: str | Path) -> str:
    """Return a command as it is typed; words are quoted as a shell needs it."""
    return shlex.join(["calibration", *map(str, words)])
