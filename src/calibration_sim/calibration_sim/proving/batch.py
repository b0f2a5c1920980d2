"""`python -m calibration_sim.proving.batch MODULE:FUNCTION`: calls a program's main function once per line of stdin.

Each line is a JSON list of arguments; each answer a JSON object with exit code, memory and the last line on stderr.
What the function prints is dropped.
"""

from __future__ import annotations

import contextlib
import io
import json
import pkgutil
import resource
import sys
import traceback
from collections.abc import Callable, Sequence
from typing import Any, TextIO


def serve(call: Callable[[list[str]], Any], requests: TextIO, answers: TextIO) -> None:
    """Answer requests until there are no more."""
    for line in requests:
        code, error = _called(call, json.loads(line))
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        answers.write(json.dumps({"exit": code, "megabytes": memory, "error": error}) + "\n")
        answers.flush()


def _called(call: Callable[[list[str]], Any], arguments: list[str]) -> tuple[int, str]:
    said = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        try:
            code = int(call(arguments) or 0)
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
        except Exception:  # noqa: BLE001  the process serves on; the defect is reported with exit code 1
            said.write(traceback.format_exc())
            code = 1
    lines = said.getvalue().strip().splitlines()
    return code, lines[-1][:300] if lines else ""


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve one function."""
    (entry,) = sys.argv[1:] if arguments is None else arguments
    answers = sys.stdout
    serve(pkgutil.resolve_name(entry), sys.stdin, answers)
    return 0


if __name__ == "__main__":
    sys.exit(main())
