"""`calibration import`: tables of tracker software and robot controllers become a measurement table."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from calibration_core.commands.shared.common import typed
from calibration_core.errors import RecordingError, quoted
from calibration_core.files.written import json_bytes
from calibration_core.files.yaml_file import read_yaml
from calibration_core.recording.foreign.join import Imported, import_files
from calibration_core.recording.foreign.mapping import ImportMap, import_map
from calibration_core.recording.foreign.source import Source
from calibration_core.recording.source import file_names, sha256_of
from calibration_core.recording.tables.table import write_table
from calibration_core.report.results.provenance import software
from calibration_core.report.results.result import SCHEMA
from calibration_core.report.writing.output import RESULT, write_files

TABLE = "measurements.csv"
MAX_MAP = 1 << 20  # bytes


def run(arguments: argparse.Namespace) -> str:
    """Read the files, join them, write the measurement table, and say what was taken for what.

    Raises:
        RecordingError: A file or the map cannot be used, or can be read in more than one way.
        OutputError: The results cannot be written.
    """
    imported = import_files(arguments.files, _map(arguments.map, arguments.files))
    table = arguments.out / TABLE
    lines = [*summary(imported), f"table: {table}", f"next: {typed('identify', table, '--cell', 'CELL.yaml')}"]
    result = json_bytes({**_result(imported, arguments), "summary": lines})
    write_files(
        arguments.out,
        {TABLE: lambda path: write_table(path, imported.readings), RESULT: result},
    )
    return "\n".join(lines)


def summary(imported: Imported) -> list[str]:
    """Return what was taken for what, a line each."""
    lines = []
    for source in imported.sources:
        lines.append(f"{source.path}: {len(source)} rows, {source.form}")
        lines.extend(f"  {line}" for line in _columns(source))
    return [*lines, *imported.account]


def _columns(source: Source) -> list[str]:
    lines = []
    for one in source.taken:
        unit = f", {one.unit}" if one.unit else ""
        why = f" ({one.how})" if one.how not in ("", "stated") else ""
        lines.append(f"{quoted(one.column)} is {one.meaning}{unit}{why}")
    if source.ignored:
        lines.append("not used: " + ", ".join(map(quoted, source.ignored)))
    return lines


def _map(path: Path | None, files: Sequence[Path]) -> ImportMap | None:
    if path is None:
        return None
    file = read_yaml(path, MAX_MAP, "map (YAML)", RecordingError)
    with file.locating():
        how = import_map(file.path, file.data)
        how.check_used(file.path, files)
    return how


def _result(imported: Imported, arguments: argparse.Namespace) -> dict[str, Any]:
    readings, paths = imported.readings, [source.path for source in imported.sources]
    return {
        "schema": SCHEMA,
        "command": "import",
        "recording": {
            "file": str(arguments.out / TABLE),
            "configurations": len(set(readings.configuration.tolist())),
            "steps": len(set(zip(readings.configuration.tolist(), readings.step.tolist(), strict=True))),
            "points": list(readings.points),
            "loaded": readings.wrench is not None,
        },
        "sources": [
            {
                "file": str(source.path),
                "rows": len(source),
                "form": source.form,
                "columns": [dataclasses.asdict(one) for one in source.taken],
                "ignored": list(source.ignored),
            }
            for source in imported.sources
        ],
        "account": list(imported.account),
        "sha256": [
            {"role": "source", "file": name, "sha256": sha256_of(path)}
            for name, path in zip(file_names(paths), paths, strict=True)
        ],
        "software": software(),
    }
