"""`python -m calibration_sim.proving.batch MODULE:FUNCTION`: calls a program's main function once per line of stdin.

Each line is a JSON list of arguments; each answer a JSON object with exit code, processor time, memory and the
last line on stderr.  What the function prints is dropped.
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
        begun = _processor_time()
        code, error = _called(call, json.loads(line))
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        answer = {"exit": code, "processor": _processor_time() - begun, "megabytes": memory, "error": error}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def _processor_time() -> float:
    """Return user and system time of this process and of those it has waited for, s."""
    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def _called(call: Callable[[list[str]], Any], arguments: list[str]) -> tuple[int, str]:
    printed = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(printed):
        try:
            code = int(call(arguments) or 0)
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
        except Exception:  # noqa: BLE001  the process serves on; the defect is reported with exit code 1
            printed.write(traceback.format_exc())
            code = 1
    lines = printed.getvalue().strip().splitlines()
    return code, lines[-1][:300] if lines else ""


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve one function."""
    (entry,) = sys.argv[1:] if arguments is None else arguments
    answers = sys.stdout
    serve(pkgutil.resolve_name(entry), sys.stdin, answers)
    return 0


if __name__ == "__main__":
    sys.exit(main())
