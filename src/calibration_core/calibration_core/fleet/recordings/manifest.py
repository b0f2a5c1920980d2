"""Which recordings there are: a manifest (CSV or Parquet), or folders TYPE/ROBOT/DATE."""

from __future__ import annotations

import csv
import dataclasses
import datetime as dt
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from calibration_core.errors import InputError, quoted
from calibration_core.files.csv_cells import meant
from calibration_core.files.names import NAME, is_name
from calibration_core.files.regular import read_regular
from calibration_core.recording.source import BAG_SUFFIXES, SESSION_DATABASE, storage_suffix

COLUMNS = ("recording", "cell", "robot", "type", "date")
CELL = "cell.yaml"
MAX_MANIFEST = 1 << 28
MAX_NAME = 120  # characters of a robot or type: both become folder names
TABLE = "a manifest (CSV in UTF-8, or Parquet)"
DATE = "a date in ISO 8601, for example 2026-05-31"


@dataclasses.dataclass(frozen=True, order=True)
class Entry:
    """One recording of one robot.

    Attributes:
        type: Type of the robot: what its sisters share.
        date: Day of the measurement, ISO 8601.
        recording: Absolute path or URL that fsspec reads.
        cell: The same of its cell file.
    """

    type: str
    robot: str
    date: str
    recording: str
    cell: str


def read_entries(source: Path) -> tuple[Entry, ...]:
    """Return the recordings of a manifest or folder, sorted by type, robot and date.

    Raises:
        InputError: The manifest cannot be used; the message names line and column.  A recording that cannot be used is
            no error here.
    """
    if _is_directory(source):
        entries = _of_folder(source)
    elif source.suffix.lower() == ".parquet":
        entries = _of_parquet(source)
    else:
        entries = _of_csv(source)
    if not entries:
        raise InputError(
            source, "", "no recording", f"a table with the columns {', '.join(COLUMNS)}, or TYPE/ROBOT/DATE/"
        )
    seen: dict[str, Entry] = {}
    for entry in entries:
        if entry.recording in seen:
            raise InputError(source, "recording", f"{quoted(entry.recording)} twice", "every recording once")
        seen[entry.recording] = entry
    return tuple(sorted(entries))


def _is_directory(source: Path) -> bool:
    try:
        return source.is_dir()
    except (OSError, ValueError):  # a name that no file system can hold: reading it says so
        return False


def _of_csv(source: Path) -> list[Entry]:
    raw = read_regular(source, MAX_MANIFEST, "manifest (CSV or Parquet)")
    try:
        rows = csv.reader(io.StringIO(raw.decode("utf-8-sig"), newline=""), strict=True)
        header = [name.strip() for name in next(rows, [])]
        _check_header(source, header)
        entries = []
        for row in rows:
            if not any(cell.strip() for cell in row):
                continue
            if len(row) != len(header):
                raise InputError(source, "", f"{len(row)} cells", f"{len(header)}, as in the header", rows.line_num, 1)
            values = {name: meant(cell.strip()) for name, cell in zip(header, row, strict=True)}
            entries.append(_entry(source, values, rows.line_num))
    except UnicodeDecodeError as error:
        raise InputError(
            source, f"byte {error.start}", "no UTF-8 text", "a manifest (CSV in UTF-8, or Parquet)"
        ) from None
    except csv.Error as error:
        raise InputError(source, "", str(error), TABLE) from None
    return entries


def _of_parquet(source: Path) -> list[Entry]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    read_regular(source, MAX_MANIFEST, "manifest (CSV or Parquet)")
    try:
        table = pq.ParquetFile(source).read()
    except (pa.ArrowException, OSError) as error:
        raise InputError(source, "", quoted(str(error).splitlines()[0], 120), "a Parquet table") from None
    _check_header(source, table.column_names)
    records = table.select(COLUMNS).to_pylist()
    return [_entry(source, record, k) for k, record in enumerate(records, start=1)]


def _check_header(source: Path, header: Sequence[str]) -> None:
    missing = [name for name in COLUMNS if name not in header]
    if missing:
        raise InputError(source, "header", quoted(", ".join(header)), f"the columns {', '.join(COLUMNS)}")
    repeated = [name for name in COLUMNS if list(header).count(name) > 1]
    if repeated:
        raise InputError(source, "header", f"{', '.join(repeated)} twice", "every column once")


def _entry(source: Path, values: dict[str, Any], line: int) -> Entry:
    for name in COLUMNS:
        if values[name] is None or not str(values[name]).strip():
            raise InputError(source, name, "nothing", "a value in every row", line, 1)
    for name in ("robot", "type"):
        text = str(values[name])
        if len(text) > MAX_NAME or not is_name(text):
            raise InputError(source, name, quoted(text), f"{NAME}, of at most {MAX_NAME} characters", line, 1)
    return Entry(
        type=str(values["type"]),
        robot=str(values["robot"]),
        date=_day(source, values["date"], line),
        recording=_place(source, values["recording"], "recording", line),
        cell=_place(source, values["cell"], "cell", line),
    )


def _day(source: Path, value: object, line: int) -> str:
    if isinstance(value, dt.date):
        return value.date().isoformat() if isinstance(value, dt.datetime) else value.isoformat()
    try:
        return dt.datetime.fromisoformat(str(value).strip()).date().isoformat()
    except ValueError:
        raise InputError(source, "date", quoted(str(value)), DATE, line, 1) from None


def _place(source: Path, value: object, name: str, line: int) -> str:
    """Return an absolute path, or a URL as it stands; relative paths start at the manifest."""
    text = str(value).strip()
    if "://" in text:
        return text
    if "\0" in text:
        raise InputError(source, name, quoted(text), "a path or URL", line, 1)
    return str(source.absolute().parent / text)


def _of_folder(source: Path) -> list[Entry]:
    entries = []
    try:
        for kind in _folders(source):
            for robot in _folders(kind):
                for folder in (kind, robot):
                    if not is_name(folder.name):
                        raise InputError(folder, "", quoted(folder.name), NAME)
                for date in _folders(robot):
                    day = _folder_day(date)
                    entries.append(Entry(kind.name, robot.name, day, str(_recording_in(date)), str(_cell_of(date))))
    except OSError as error:
        raise InputError(error.filename or source, "", error.strerror or str(error), "a readable folder") from None
    return entries


def _folders(parent: Path) -> Iterable[Path]:
    return sorted(child.absolute() for child in parent.iterdir() if child.is_dir() and not child.name.startswith("."))


def _folder_day(folder: Path) -> str:
    try:
        return dt.datetime.fromisoformat(folder.name).date().isoformat()
    except ValueError:
        raise InputError(folder, "", quoted(folder.name), f"TYPE/ROBOT/DATE with {DATE}") from None


def _cell_of(folder: Path) -> Path:
    """Return the cell file of a date, or the robot's or type's where the date has none."""
    for place in (folder, folder.parent, folder.parent.parent):
        if (place / CELL).is_file():
            return place / CELL
    return folder / CELL


def _recording_in(folder: Path) -> Path:
    """Return the one recording of a folder; the folder itself where there is none or several: reading it says so."""
    if (folder / "metadata.yaml").is_file() or (folder / SESSION_DATABASE).is_file():
        return folder
    found = [
        child
        for child in sorted(folder.iterdir())
        if (child.is_dir() and ((child / "metadata.yaml").is_file() or (child / SESSION_DATABASE).is_file()))
        or (child.is_file() and storage_suffix(child) in {".csv", *BAG_SUFFIXES})
    ]
    return found[0] if len(found) == 1 else folder
