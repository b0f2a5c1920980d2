"""What is done, on disk: a folder per recording with its row and result.json, and the data set made of all rows.

OUT/results/TYPE/ROBOT/DATE/NAME/{row.json, result.json}    written as one unit, at once
OUT/fleet.parquet/type=TYPE/date=DATE/part-0.parquet          made of all rows at the end, sorted by recording
"""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from calibration_core.errors import InputError, OutputError, storage_fault
from calibration_core.files.regular import read_regular
from calibration_core.fleet.recordings.inputs import is_unchanged
from calibration_core.fleet.recordings.manifest import Entry
from calibration_core.fleet.recordings.rows import Row, row_of
from calibration_core.report.writing.output import RESULT, UNFINISHED, write_files

RESULTS, DATASET, ROW, LOCK = "results", "fleet.parquet", "row.json", ".fleet.lock"
MAX_ROW = 1 << 24
SHORT = 12  # characters of the digest that tells recordings of one robot and day apart


@contextlib.contextmanager
def claimed(out: Path) -> Iterator[None]:
    """Hold the output folder: no other run of a fleet writes into it meanwhile.

    Raises:
        OutputError: It cannot be made, or another run holds it.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        handle = os.open(out / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except (OSError, ValueError) as error:
        fault = storage_fault(out, error, "a directory that can be written") if isinstance(error, OSError) else None
        raise OutputError(out, "", *(fault or (str(error), "a directory that can be written"))) from None
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise OutputError(out, LOCK, "another run at work", "an output folder that nobody else writes to") from None
        for left in (out / RESULTS).rglob(f"{UNFINISHED}*"):  # by a run that was killed while it wrote
            shutil.rmtree(left)
        yield
    finally:
        os.close(handle)


def folder_of(out: Path, entry: Entry) -> Path:
    """Return where the results of a recording stand."""
    name = hashlib.sha256(entry.recording.encode()).hexdigest()[:SHORT]
    return out / RESULTS / _part(entry.type) / _part(entry.robot) / entry.date / name


def _part(name: str) -> str:
    """Return a name that is one part of a path on every file system."""
    return quote(name, safe=" ").replace(".", "%2E") if set(name) <= {"."} else quote(name, safe=" ")


def keep(out: Path, entry: Entry, row: Row, result: bytes) -> None:
    """Write row and result of a recording: both, or none.

    Raises:
        OutputError: They cannot be written.
    """
    text = json.dumps(row.to_dict(), allow_nan=True) + "\n"
    content = result or (json.dumps({"schema": 1, "command": "fleet", "error": row.error}, indent=2) + "\n").encode()
    write_files(folder_of(out, entry), {ROW: text.encode(), RESULT: content})


def kept(out: Path, entry: Entry, version: str) -> Row | None:
    """Return the row of a recording that is done and unchanged; None: it is to be done."""
    from calibration_core.fleet.recordings.inputs import digest_of

    path = folder_of(out, entry) / ROW
    if not (path.is_file() and path.with_name(RESULT).is_file()):
        return None
    try:
        row = row_of(json.loads(read_regular(path, MAX_ROW, "row of a fleet")))
    except (InputError, ValueError, TypeError, RecursionError):
        return None  # of another version, or damaged: done again
    same = (row.recording, row.cell, row.date) == (entry.recording, entry.cell, entry.date)
    fresh = row.key != "" and row.key == digest_of(row.inputs, version)
    return row if same and fresh and is_unchanged(entry, row.inputs) else None


def write_dataset(rows: Sequence[Row], folder: Path) -> None:
    """Write all rows as a Parquet data set, partitioned by type and date (Hive's names), sorted by recording."""
    import pyarrow.parquet as pq

    parts: dict[tuple[str, str], list[Row]] = {}
    for row in sorted(rows, key=lambda row: row.recording):
        parts.setdefault((row.type, row.date), []).append(row)
    for (kind, date), members in sorted(parts.items()):
        place = folder / f"type={_part(kind)}" / f"date={date}"
        place.mkdir(parents=True)
        records = [{k: v for k, v in row.to_dict().items() if k not in {"type", "date"}} for row in members]
        pq.write_table(_table(records), place / "part-0.parquet")


def _table(records: list[dict[str, Any]]) -> Any:
    import pyarrow as pa

    return pa.Table.from_pylist(records, schema=_schema(pa))


def _schema(pa: Any) -> Any:
    """Return the schema of a row, from the types of its fields."""
    texts, numbers = pa.list_(pa.string()), pa.list_(pa.float64())
    inputs = pa.list_(
        pa.struct([("path", pa.string()), ("size", pa.int64()), ("changed", pa.int64()), ("digest", pa.string())])
    )
    kinds = {
        "str": pa.string(), "int": pa.int64(), "float": pa.float64(), "tuple[str, ...]": texts,
        "tuple[float, ...]": numbers, "tuple[InputFile, ...]": inputs,
    }  # fmt: skip
    fields = [(field.name, kinds[str(field.type)]) for field in dataclasses.fields(Row)]
    return pa.schema([(name, kind) for name, kind in fields if name not in {"type", "date"}])


def read_dataset(folder: Path) -> list[Row]:
    """Return the rows of a data set, sorted by recording.

    Raises:
        InputError: It is none.
    """
    import pyarrow as pa
    import pyarrow.dataset as ds

    try:
        partitioning = ds.partitioning(pa.schema([("type", pa.string()), ("date", pa.string())]), flavor="hive")
        records = ds.dataset(folder, partitioning=partitioning).to_table().to_pylist()
        return sorted((row_of(record) for record in records), key=lambda row: row.recording)
    except (pa.ArrowException, OSError, TypeError) as error:
        raise InputError(folder, "", str(error).splitlines()[0], "a data set as calibration fleet writes it") from None
