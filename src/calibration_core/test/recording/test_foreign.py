"""Foreign tables become the same readings, whoever wrote them; what can be read in two ways is refused."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from foreign_tables import (
    CONFIGURATIONS,
    JOINTS,
    MAPS,
    POINTS,
    POSITION,
    STEPS,
    TABLES,
    WITHOUT_LOADS,
    WITHOUT_WRENCH,
    WRENCH,
    Q,
    write,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration_core.cell import load_cell
from calibration_core.cli import main
from calibration_core.errors import RecordingError
from calibration_core.recording.foreign.grid import number_of, read_grid
from calibration_core.recording.foreign.join import import_files
from calibration_core.recording.foreign.mapping import import_map
from calibration_core.recording.foreign.meaning import meanings
from calibration_core.recording.foreign.names import split_names
from calibration_core.recording.foreign.text import read_text
from calibration_core.recording.foreign.units import split_unit
from calibration_core.recording.tables.table import read_table

MAP = Path("map.yaml")


@pytest.mark.parametrize("name", list(TABLES))
def test_a_foreign_table_gives_the_readings(name: str, tmp_path: Path) -> None:
    paths = write(name, tmp_path)
    readings = import_files(paths, import_map(MAP, MAPS.get(name))).readings
    steps = 1 if name in WITHOUT_LOADS else STEPS
    assert len(readings) == CONFIGURATIONS * steps * len(POINTS)
    assert readings.points == POINTS
    c, s, p = readings.configuration - 1, readings.step, readings.point
    assert sorted(zip(c.tolist(), s.tolist(), p.tolist(), strict=True)) == sorted(
        (i, k, j) for i in range(CONFIGURATIONS) for k in range(steps) for j in range(len(POINTS))
    )
    np.testing.assert_allclose(readings.position, POSITION[c, s, p], atol=1e-7)
    np.testing.assert_allclose(readings.q, Q[c], atol=1e-8)
    if name in WITHOUT_WRENCH:
        assert readings.wrench is None
    else:
        assert readings.wrench is not None
        np.testing.assert_allclose(readings.wrench, WRENCH[c, s], atol=2e-3, rtol=1e-6)


@pytest.mark.parametrize("name", list(MAPS))
def test_a_table_that_needs_a_map_is_refused_without_one(name: str, tmp_path: Path) -> None:
    with pytest.raises(RecordingError) as caught:
        import_files(write(name, tmp_path))
    assert "\n" not in str(caught.value)


def test_the_account_says_what_was_taken_for_what(tmp_path: Path) -> None:
    imported = import_files(write("SpatialAnalyzer: Collection::Group::Point, comma separated", tmp_path))
    taken = {one.meaning: one for one in imported.sources[0].taken}
    assert (taken["x"].column, taken["x"].unit, taken["x"].how) == ("X", "mm", "stated")
    assert imported.sources[0].ignored == ("Collection",)
    assert any("joined by configuration and step" in line for line in imported.account)
    assert "4 configurations, 12 steps, 3 points (mp1, mp2, mp3), 6 joints." in imported.account


HEAD = "configuration,point,x,y,z," + ",".join(f"q{i + 1}" for i in range(JOINTS))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (HEAD + "\n1,a,0.001,0.002,0.003" + ",1" * 6, "a unit: state it in the header"),
        (HEAD + "\n1,a,1,2,3" + ",0.1" * 6, "angles up to 0.1 without a unit"),
        (HEAD + ",fx,fy,fz\n1,a,1,2,3" + ",60" * 6 + ",2,2,2", "forces up to 2 without a unit"),
        (HEAD.replace(",q2", "") + "\n1,a,1,2,3" + ",60" * 5, "joints counted from 1"),
        (HEAD.replace(",z", "") + "\n1,a,1,2" + ",60" * 6, "x, y without z"),
        (HEAD + ",X\n1,a,1,2,3" + ",60" * 6 + ",4", "one column for x"),
        (HEAD + "\n1.5,a,1,2,3" + ",60" * 6, "an integer"),
        ("point;x;y;z\na;1,234;2,345;3,456\nb;1,235;2,346;3,457\n", "read in one way only"),
        ("1 2 3 4 5 6 7 8 9\n", "a header"),
        ("nothing here\nat all\n", "no table"),
        ("point,x [N],y [N],z [N]\na,1,2,3\n", "a unit of length"),
    ],
)
def test_what_can_be_read_in_two_ways_is_refused(content: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(content)
    with pytest.raises(RecordingError) as caught:
        import_files([path])
    assert words in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_rows_that_do_not_match_are_refused(tmp_path: Path) -> None:
    paths = write("points in order, KUKA's data list", tmp_path)
    program = paths[1].read_text().splitlines()
    paths[1].write_text("\n".join([*program[:-2], program[-1]]))
    with pytest.raises(RecordingError, match="4 steps of 3 points, and 3 rows of joint angles"):
        import_files(paths)
    paths = write("points and RTDE record of Universal Robots, joined by time", tmp_path)
    record = paths[1].read_text().splitlines()
    paths[1].write_text("\n".join(record[: len(record) // 2]))
    with pytest.raises(RecordingError, match="to the nearest"):
        import_files(paths)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"file": []}, "file"),
        ({"files": [{"columns": {"X": "xx"}}]}, "one of q1 ... qn, x"),
        ({"files": [{"units": {"x": "furlong"}}]}, "one of"),
        ({"files": [{"name": "(?P<point>x)"}]}, "configuration"),
        ({"files": [{"name": "("}]}, "no regular expression"),
        ({"join": "luck"}, "join: found 'luck', expected one of number, order, time"),
        ([], "the map: found [], expected a map with keys of files, join, tolerance, points, joint_coupling"),
        ({"file": []}, "file: found an unknown key, expected one of files, join, tolerance, points"),
        ({"files": {}}, "files: found {}, expected a list with an entry for each kind of file"),
        ({"files": [3]}, "files.0: found 3, expected an entry with keys of match, encoding"),
        ({"files": [{"seperator": ";"}]}, "files.0.seperator: found an unknown key, expected one of match"),
        ({"files": [{"separator": "#"}]}, "files.0.separator: found '#', expected a tab, a semicolon, a bar"),
        ({"files": [{"header": -1}]}, "files.0.header: found -1, expected the number of the line"),
        ({"files": [{"columns": {"X": 3}}]}, "files.0.columns"),
        ({"tolerance": "soon"}, "tolerance: found 'soon', expected a time in s, more than 0"),
        ({"points": ["mp1"]}, "points: found ['mp1'], expected names of the cell file by names in the files"),
        ({"files": [{"name": r"C\d+_mp1"}]}, "expected a group (?P<configuration>...), and at most groups named step"),
        ({"files": [{"units": {"xyy": "mm"}}]}, "expected one of q, q1 ... qn, xyz"),
    ],
)
def test_a_wrong_map_is_one_line(content: object, words: str) -> None:
    with pytest.raises(RecordingError, match=r"map\.yaml") as caught:
        import_map(MAP, content)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert "Input should be" not in str(caught.value)


def test_a_column_of_the_map_must_be_there(tmp_path: Path) -> None:
    paths = write("own words for everything", tmp_path)
    with pytest.raises(RecordingError, match=r"'Laage'.*one of Lage, Stufe"):
        import_files(paths, import_map(MAP, {"files": [{"columns": {"Laage": "configuration"}}]}))


@pytest.mark.parametrize(
    ("field", "name", "unit"),
    [
        ("X [mm]", "X", "mm"),
        ("A1(deg)", "A1", "deg"),
        ("Fx/kN", "Fx", "kN"),
        ("x_m", "x", "m"),
        ("Load step", "Load step", None),
    ],
)
def test_units_are_taken_off_a_name(field: str, name: str, unit: str | None) -> None:
    found, of = split_unit(field)
    assert (found, None if of is None else of.name) == (name, unit)


def test_names_of_columns() -> None:
    names = [
        "Point Name",
        "PointID",
        "X",
        "pos_y",
        "Z Ist",
        "Nominal X",
        "A1",
        "joint_2",
        "Achse 3",
        "Fx",
        "Moment X",
        "foo",
    ]
    assert meanings(names) == ["point", "point", "x", "y", "z", "ignored", "q1", "q2", "q3", "fx", "tx", None]
    assert meanings(["actual_q_0", "actual_q_1"]) == ["q1", "q2"]


def test_names_of_points() -> None:
    assert split_names(["C01_S2_mp1", "c1-s0-mp2"]) == ([1, 1], [2, 0], ["mp1", "mp2"])
    assert split_names(["Pose 3 - TCP left"]) == ([3], None, ["TCP_left"])
    assert split_names(["mp1", "C1_mp1"]) is None
    assert split_names(["C1_S1_a", "C1_b"]) is None


@given(st.floats(-1e6, 1e6).map(lambda v: round(v, 4)))
def test_numbers_are_read_with_either_mark(value: float) -> None:
    assert number_of(f"{value:.4f}", ".") == value
    assert number_of(f"{value:.4f}".replace(".", ","), ",") == value
    assert number_of(f"{value:,.4f}".translate(str.maketrans(",.", ".,")), ",") == value


@settings(max_examples=200, deadline=None)
@given(
    content=st.one_of(st.binary(max_size=400), st.text("0123456789,;.\t| xyzq[]\nmpE+-", max_size=400).map(str.encode))
)
def test_any_bytes_are_read_or_refused(content: bytes, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(content)
    try:
        said, rows = "", len(import_files([path]).readings)
    except RecordingError as error:
        said, rows = str(error), 0
    assert rows > 0 or (str(path) in said and "\n" not in said)


def test_a_grid_tells_its_form(tmp_path: Path) -> None:
    path = tmp_path / "table.txt"
    path.write_text("# remark\nname\tx\ty\tz\n\tmm\tmm\tmm\na\t1,5\t2,5\t3,5\n")
    grid = read_grid(read_text(path))
    assert (grid.separator, grid.decimal, grid.header, grid.units) == (
        "\t",
        ",",
        ("name", "x", "y", "z"),
        ("", "mm", "mm", "mm"),
    )
    assert grid.lines == (4,)
    assert grid.remarks == ("# remark",)


# --- commands --------------------------------------------------------------------------------------------------------


def test_the_command_writes_a_measurement_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = write("PolyWorks: tab separated report with nominal and measured", tmp_path)
    assert main(["import", *map(str, paths), "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert "'Measured X' is x, mm" in told
    assert "not used: 'Nominal X'" in told
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert (result["command"], result["recording"]["steps"]) == ("import", CONFIGURATIONS * STEPS)
    rows = (tmp_path / "out" / "measurements.csv").read_text().splitlines()
    assert rows[0].startswith("configuration,step,q1")
    assert len(rows) == 1 + CONFIGURATIONS * STEPS * len(POINTS)


def test_the_command_names_the_digest_of_every_file(tmp_path: Path) -> None:
    paths = []
    for path in write("PolyWorks: tab separated report with nominal and measured", tmp_path):
        (tmp_path / path.stem).mkdir()
        paths.append(path.rename(tmp_path / path.stem / "export.txt"))
    assert len(paths) > 1
    assert main(["import", *map(str, paths), "--out", str(tmp_path / "out")]) == 0
    rows = json.loads((tmp_path / "out" / "result.json").read_text())["sha256"]
    assert {row["file"]: row["sha256"] for row in rows} == {
        str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths
    }
    assert set(import_files(paths).readings.provenance.sha256) == {str(path) for path in paths}


def test_the_command_takes_a_map(tmp_path: Path) -> None:
    name = "own words for everything"
    how = tmp_path / "map.yaml"
    how.write_text(yaml.safe_dump(MAPS[name]))
    paths = write(name, tmp_path)
    out = tmp_path / "out"
    assert main(["import", *map(str, paths), "--map", str(how), "--out", str(out)]) == 0
    assert sorted(path.name for path in out.iterdir()) == ["measurements.csv", "result.json"]


def test_a_map_states_a_coupling_of_joints(tmp_path: Path) -> None:
    name = "own words for everything"
    paths = write(name, tmp_path)
    plain, coupled = (
        import_files(paths, import_map(MAP, {**MAPS[name], **more}))
        for more in ({}, {"joint_coupling": {"q3": {"q2": 1.0}}})
    )
    np.testing.assert_allclose(coupled.readings.q[:, 2], plain.readings.q[:, 2] + plain.readings.q[:, 1])
    assert "To q3 is added 1 times q2." in coupled.account
    with pytest.raises(RecordingError, match="joint_coupling: found 'q9', expected two of q1"):
        import_files(paths, import_map(MAP, {**MAPS[name], "joint_coupling": {"q3": {"q9": 1.0}}}))


def test_the_command_refuses_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = write("own words for everything", tmp_path)
    assert main(["import", *map(str, paths), "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_foreign_table_is_read_directly(tmp_path: Path) -> None:
    cell = load_cell(Path(__file__).resolve().parents[4] / "config" / "cells" / "demo.cell.yaml")
    name = "own table with units in the header, semicolons and decimal commas"
    readings = read_table(write(name, tmp_path)[0], cell)
    assert readings.points == cell.points
    np.testing.assert_allclose(readings.q[::9], Q, atol=1e-8)
    assert [note.kind for note in readings.notes] == ["foreign_table"]
    with pytest.raises(RecordingError, match=r"calibration import lagen.csv --map map.yaml"):
        read_table(write("own words for everything", tmp_path)[0], cell)


def with_times(stamps: list[str], tmp_path: Path, header: str = "Time") -> Path:
    """A table with everything, one point and these times; fields separated by semicolons, decimal commas."""
    names = [f"q{i + 1} [rad]" for i in range(JOINTS)]
    lines = [";".join([header, "configuration", "point", "x [m]", "y [m]", "z [m]", *names])]
    for c, stamp in enumerate(stamps):
        numbers = [*POSITION[c, 0, 0], *Q[c]]
        lines.append(";".join([stamp, str(c + 1), "mp1", *(f"{value:.6f}".replace(".", ",") for value in numbers)]))
    path = tmp_path / "points.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("stamps", "how"),
    [
        (["10:00:04,250", "10:00:06,5", "10:01:04,25", "10:01:05"], "times of day"),
        (["23:59:58", "23:59:59.5", "00:00:01", "0:00:02"], "times of day"),
        (["12.11.2026 10:00:04,250", "12.11.2026 10:00:06", "12.11.2026 10:01:04", "13.11.2026 00:00:00"],
         "dates and times"),
        (["2026-11-12T10:00:04.250", "2026-11-12 10:00:06", "2026-11-12 10:01:04", "2026-11-13 00:00:00"],
         "dates and times"),
        (["11/12/2026 10:00:04.250", "11/12/2026 10:00:06", "11/12/2026 10:01:04", "11/13/2026 00:00:00"],
         "dates and times"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("header", ["Time", "Time [ms]"])
def test_times_of_tracker_software(stamps: list[str], how: str, header: str, tmp_path: Path) -> None:
    imported = import_files([with_times(stamps, tmp_path, header)])
    time = imported.readings.time - imported.readings.time[0]
    expected = {"10:00:04,250": [0.0, 2.25, 60.0, 60.75], "23:59:58": [0.0, 1.5, 3.0, 4.0]}
    np.testing.assert_allclose(time, expected.get(stamps[0], [0.0, 1.75, 59.75, 50395.75]), atol=1e-5)
    taken = {one.meaning: one for one in imported.sources[0].taken}
    assert (taken["time"].unit, taken["time"].how) == ("s", how)
    if how == "times of day":
        assert 0.0 <= imported.readings.time[0] < 86400.0  # so that a log in seconds of the day can be joined


def test_a_time_that_is_none_is_refused_with_its_place(tmp_path: Path) -> None:
    for third in ("25:00:00", "soon", "12.11.2026 10:00:00"):
        path = with_times(["10:00:00", "10:00:01", third, "10:00:03"], tmp_path)
        with pytest.raises(RecordingError, match=f"line 4, column Time: found '{third}', expected seconds, a date"):
            import_files([path])
