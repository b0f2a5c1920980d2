from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration_core.errors import InputError
from calibration_core.fleet.recordings.manifest import COLUMNS, Entry, read_entries

HEADER = ",".join(COLUMNS)


def written(folder: Path, *rows: str, header: str = HEADER) -> Path:
    path = folder / "plant.csv"
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def test_a_table_is_read_in_the_order_of_types_robots_and_dates(tmp_path: Path) -> None:
    rows = (
        "b.csv,c.yaml,r2,kr,2026-07-01T08:00",
        "a.csv,c.yaml,r1,kr,2026-01-01",
        "s3://x/a,s3://x/c,r1,ab,2026-01-01",
    )
    first, second, third = read_entries(written(tmp_path, *rows))
    assert first == Entry("ab", "r1", "2026-01-01", "s3://x/a", "s3://x/c")
    assert second == Entry("kr", "r1", "2026-01-01", str(tmp_path / "a.csv"), str(tmp_path / "c.yaml"))
    assert third.date == "2026-07-01"


def test_columns_in_any_order_with_others_among_them(tmp_path: Path) -> None:
    (entry,) = read_entries(
        written(tmp_path, "2026-01-01,7,kr,r,c.yaml,a.csv", header="date,shift,type,robot,cell,recording")
    )
    assert (entry.robot, entry.type) == ("r", "kr")


@pytest.mark.parametrize(
    ("rows", "header", "says"),
    [
        (("a,c,r,kr,2026-13-01",), HEADER, r"plant.csv:2:1: date: found '2026-13-01'"),
        (("a,c,r,kr,2026-01-01", "a,c,,kr,2026-01-01"), HEADER, r"plant.csv:3:1: robot: found nothing"),
        (("a,c,r,kr",), HEADER, r"plant.csv:2:1: found 4 cells, expected 5"),
        (("a,c,r,2026-01-01",), "recording,cell,robot,date", r"header: found 'recording, cell, robot, date'"),
        (("a,c,r,kr,2026-01-01", "a,c,s,kr,2026-01-01"), HEADER, r"recording: found .* twice"),
        ((), HEADER, r"found no recording"),
        (("a,c,r\0,kr,2026-01-01",), HEADER, r"robot|line contains NUL"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(tmp_path: Path, rows: tuple[str, ...], header: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        read_entries(written(tmp_path, *rows, header=header))


def test_a_parquet_table_says_the_same_as_a_csv_table(tmp_path: Path) -> None:
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    rows = ("a.csv,c.yaml,r1,kr,2026-01-01", "b.csv,c.yaml,r2,kr,2026-07-01")
    columns = zip(*(row.split(",") for row in rows), strict=True)
    table = pa.table(dict(zip(COLUMNS, map(list, columns), strict=True)))
    pq.write_table(table, tmp_path / "plant.parquet")
    assert read_entries(tmp_path / "plant.parquet") == read_entries(written(tmp_path, *rows))
    (tmp_path / "bad.parquet").write_bytes(b"no table")
    with pytest.raises(InputError, match="a Parquet table"):
        read_entries(tmp_path / "bad.parquet")


def test_folders_type_robot_date(tmp_path: Path) -> None:
    for robot, date in (("r1", "2026-01-01"), ("r1", "2026-07-01"), ("r2", "2026-01-01"), ("r3", "2026-01-01")):
        folder = tmp_path / "kr" / robot / date
        folder.mkdir(parents=True)
        (folder / "measured.csv").touch()
    (tmp_path / "kr" / "cell.yaml").touch()
    (tmp_path / "kr" / "r2" / "2026-01-01" / "cell.yaml").touch()
    (tmp_path / "kr" / "r3" / "2026-01-01" / "second.csv").touch()
    entries = read_entries(tmp_path)
    assert [(one.robot, one.date) for one in entries][:3] == [
        ("r1", "2026-01-01"),
        ("r1", "2026-07-01"),
        ("r2", "2026-01-01"),
    ]
    assert entries[0].cell == str(tmp_path / "kr" / "cell.yaml")
    assert entries[2].cell == str(tmp_path / "kr" / "r2" / "2026-01-01" / "cell.yaml")
    assert entries[3].recording == str(tmp_path / "kr" / "r3" / "2026-01-01")  # two recordings: reading it says so
    shutil.rmtree(tmp_path / "kr" / "r3")
    (tmp_path / "kr" / "r3" / "yesterday").mkdir(parents=True)
    with pytest.raises(InputError, match="'yesterday', expected TYPE/ROBOT/DATE"):
        read_entries(tmp_path)


TEXTS = st.text(max_size=100).map(lambda text: f"{HEADER}\n{text}".encode("utf-8", "replace"))


@settings(max_examples=200, deadline=None)
@given(content=st.one_of(st.binary(max_size=200), TEXTS))
def test_any_bytes_give_entries_or_one_line(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(content)
    error = ""
    try:
        entries = read_entries(path)
    except InputError as fault:
        error, entries = str(fault), ()
    assert len(error.splitlines()) == (0 if entries else 1)
    assert all(entry.date and entry.robot for entry in entries)
