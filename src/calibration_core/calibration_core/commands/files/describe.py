"""`calibration describe`: the lines that the terminal printed with a result."""

from __future__ import annotations

import argparse
import json

from calibration_core.errors import InputError, quoted
from calibration_core.files.regular import read_regular
from calibration_core.report.results.result import SCHEMA
from calibration_core.report.writing.output import MAX_RESULT, RESULT


def run(arguments: argparse.Namespace) -> str:
    """Return command, robot and summary of a result; nothing is written.

    Raises:
        InputError: There is no result.json, or it is none of this program's, or of a version that stored no summary.
    """
    path = arguments.result / RESULT if arguments.result.is_dir() else arguments.result
    expected = f"result.json of schema {SCHEMA}"
    try:
        content = json.loads(read_regular(path, MAX_RESULT, "result.json"))
    except json.JSONDecodeError as error:
        raise InputError(path, "", "no JSON", expected).at(error.lineno, error.colno) from None
    except (ValueError, RecursionError) as error:
        raise InputError(path, "", str(error).splitlines()[0], expected) from None
    known = content if isinstance(content, dict) else {}
    if known.get("schema") != SCHEMA or not isinstance(known.get("command"), str):
        raise InputError(path, "schema", quoted(known.get("schema", content)), expected)
    lines = known.get("summary")
    if not isinstance(lines, list):
        raise InputError(path, "summary", "none", "a list of lines: run the command again with this version")
    return "\n".join([f"{known['command']}: {known.get('robot', '')}".rstrip(": "), *map(str, lines)])
