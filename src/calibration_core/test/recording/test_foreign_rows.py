"""No row of a foreign table is lost: it becomes a reading, or the table is refused with line and column."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration_core.cli import main
from calibration_core.errors import RecordingError
from calibration_core.recording.foreign.join import import_files

JOINTS = "configuration," + ",".join(f"q{i + 1} [deg]" for i in range(6))
UNREADABLE = ("nan", "NaN", "inf", "-inf", "1e999", "#N/A", "---", "", "12 mm", "1,5")
FORMS = {"comma": ",", "semicolon": ";", "tab": "\t"}


def rows(count: int, separator: str = ",") -> list[str]:
    """Header and one row for each configuration, x y z in mm."""
    head = separator.join(["Name", "X [mm]", "Y [mm]", "Z [mm]"])
    body = [
        separator.join([f"C{i + 1}_mp1", f"{1000 + i}.5", f"{2000 + i}.25", f"{300 + i}.125"]) for i in range(count)
    ]
    return [head, *body]


def files(directory: Path, lines: list[str], count: int) -> list[Path]:
    """Write the points and the joint angles."""
    points, robot = directory / "points.csv", directory / "robot.csv"
    points.write_text("\n".join(lines) + "\n")
    q = np.random.default_rng(1).uniform(-90.0, 90.0, (count, 6)).round(3)
    robot.write_text("\n".join([JOINTS, *(f"{i + 1}," + ",".join(map(str, q[i])) for i in range(count))]) + "\n")
    return [points, robot]


def refusal(paths: list[Path]) -> str:
    with pytest.raises(RecordingError) as caught:
        import_files(paths)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("form", list(FORMS))
@pytest.mark.parametrize(("row", "count"), [(1, 2), (2, 4), (-1, 30)])
@pytest.mark.parametrize("text", UNREADABLE)
def test_an_unreadable_coordinate_is_refused(text: str, count: int, row: int, form: str, tmp_path: Path) -> None:
    lines = rows(count, FORMS[form])
    lines[row] = FORMS[form].join([lines[row].split(FORMS[form])[0], text, "2000.5", "300.5"])
    said = refusal(files(tmp_path, lines, count))
    assert said.startswith(f"{tmp_path / 'points.csv'}: line ")
    if (form, text) == ("comma", "1,5"):  # then it is two fields, and of two rows either may be the wrong one
        assert "fields, one for each column" in said
        assert count == 2 or f"line {range(count + 1)[row] + 1}, " in said
    else:
        assert f"line {range(count + 1)[row] + 1}, " in said
        assert "column X [mm]: found" in said
        assert repr(text) in said


def test_a_row_that_is_cut_off_or_too_long_is_refused(tmp_path: Path) -> None:
    for wrong in ("C3_mp1,1000.5,2000.5", "C3_mp1", "C3_mp1,1000.5,2000.5,300.5,7", "end of the report"):
        lines = rows(6)
        lines[3] = wrong
        assert f"{tmp_path / 'points.csv'}: line 4, column" in refusal(files(tmp_path, lines, 6))
    lines = [line.replace(",", " ").replace(" [mm]", "_mm") for line in rows(6)]
    lines[4] = "C4_mp1 1000.5 300.5"
    assert "line 5, column 4: found 3 fields" in refusal(files(tmp_path, lines, 6))


def test_a_row_without_its_first_field_is_no_comment(tmp_path: Path) -> None:
    lines = rows(6, ";")
    lines[3] = ";" + lines[3].split(";", 1)[1]
    assert "line 4, column name: found ''" in refusal(files(tmp_path, lines, 6))
    lines = ["Pose;Punkt;X [mm];Y [mm];Z [mm]"] + [f"{i};mp1;100{i}.5;200{i}.5;30{i}.5" for i in range(1, 7)]
    lines[3] = ";mp1;1003.5;2003.5;303.5"
    assert "line 4, column Pose: found '', expected a finite number" in refusal(files(tmp_path, lines, 6))


def test_empty_rows_comments_and_a_header_once_more_are_no_rows(tmp_path: Path) -> None:
    lines = rows(6)
    lines[3:3] = ["", ",,,", "# remark, 1, 2, 3", lines[0]]
    assert len(import_files(files(tmp_path, [*lines, "// end of the report"], 6)).readings) == 6


@pytest.mark.parametrize("head", ["Name", "Pose,Point", "Pose,Step,Point"])
def test_a_reading_that_stands_twice_is_refused(head: str, tmp_path: Path) -> None:
    names = {"Name": "C{0}_mp1", "Pose,Point": "{0},mp1", "Pose,Step,Point": "{0},0,mp1"}[head]
    lines = [f"{head},X [mm],Y [mm],Z [mm]"]
    lines += [names.format(i) + f",100{i}.5,200{i}.5,30{i}.5" for i in range(1, 7)]
    lines.insert(4, lines[3])
    said = refusal(files(tmp_path, lines, 6))
    assert "line 5, column" in said
    assert "line 4" in said
    assert said.endswith("expected every reading once")


def test_two_values_of_one_reading_are_refused_in_the_file_where_the_second_stands(tmp_path: Path) -> None:
    first, second = tmp_path / "a.csv", tmp_path / "b.csv"
    head = "Pose,Step,Point,X [mm],Y [mm],Z [mm]," + JOINTS.split(",", 1)[1]
    angles = ",10,20,30,40,50,60"
    first.write_text(f"{head}\n1,0,mp1,1000.5,2000,300{angles}\n2,0,mp1,1001.5,2000,300{angles}\n")
    second.write_text(f"{head}\n3,0,mp1,1002.5,2000,300{angles}\n2,0,mp1,1003.5,2000,300{angles}\n")
    assert refusal([first, second]).startswith(f"{second}: line 3, column point: found configuration 2, step 0")


def test_an_entry_of_the_map_that_fits_no_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = files(tmp_path, rows(6), 6)
    how = tmp_path / "map.yaml"
    for entries, line in (
        ([{"match": "point*"}, {"match": "pionts_*.txt"}], 3),
        ([{"units": {"xyz": "mm"}}, {"match": "robot*"}], 4),  # the first fits every file
    ):
        how.write_text(yaml.safe_dump({"files": entries}))
        assert main(["import", *map(str, paths), "--map", str(how), "--out", str(tmp_path / "out")]) == 2
        said = capsys.readouterr().err
        assert f"{how}:{line}:" in said
        assert "files.1.match: found" in said
        assert not (tmp_path / "out").exists()
