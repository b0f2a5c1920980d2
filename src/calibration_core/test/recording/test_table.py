"""Measurement tables: what is written is read, and every fault is named with line and column."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calibration_core.cell import Cell, load_cell
from calibration_core.errors import RecordingError
from calibration_core.recording.tables.arrays import readings_of_columns
from calibration_core.recording.tables.table import read_table, write_table
from calibration_core.timeseries import Provenance, Readings

HEADER = "configuration,step,q1,q2,q3,point,x,y,z"
ROW = "1,0,0.1,0.2,0.3,left,1.0,2.0,3.0"
FULL = "configuration,step,time,temperature,q1,q2,q3,fx,fy,fz,tx,ty,tz,point,x,y,z"
FULL_ROW = "1,0,0.5,20.1,0.1,0.2,0.3,10,20,30,1,2,3,left,1.0,2.0,3.0"


def read(tmp_path: Path, cell: Cell, text: str) -> Readings:
    path = tmp_path / "table.csv"
    path.write_text(text, encoding="utf-8")
    return read_table(path, cell)


def test_columns_in_any_order(tmp_path: Path, cell: Cell) -> None:
    readings = read(tmp_path, cell, "z,y,x,point,q3,q2,q1,step,configuration\n3,2,1,right,0.3,0.2,0.1,0,7\n")
    assert readings.position.tolist() == [[1, 2, 3]]
    assert readings.q.tolist() == [[0.1, 0.2, 0.3]]
    assert (readings.configuration[0], readings.step[0], readings.point[0]) == (7, 0, 1)
    assert readings.wrench is None
    assert np.isnan(readings.time).all()
    assert np.isnan(readings.temperature).all()


def test_everything(tmp_path: Path, cell: Cell) -> None:
    readings = read(
        tmp_path, cell, "\ufeff" + FULL + "\r\n" + FULL_ROW + "\r\n\r\n" + FULL_ROW.replace("left", "right")
    )
    assert len(readings) == 2
    assert readings.wrench is not None
    assert readings.wrench[1].tolist() == [10, 20, 30, 1, 2, 3]
    assert readings.time.tolist() == [0.5, 0.5]
    assert readings.temperature[0] == 20.1
    assert readings.provenance.messages == {"rows": 2}


def test_empty_time_and_temperature_are_unknown(tmp_path: Path, cell: Cell) -> None:
    readings = read(tmp_path, cell, f"{FULL}\n{FULL_ROW.replace('0.5,20.1', ',')}\n")
    assert np.isnan([readings.time[0], readings.temperature[0]]).all()


@pytest.mark.parametrize(
    ("text", "place", "found"),
    [
        ("", "line 1", "nothing"),
        ("\n", "line 1", "nothing"),
        (HEADER, "", "a header without rows"),
        (HEADER.replace(",", ";"), "", "no table"),
        (HEADER + ",x\n", "line 1, column x", "2 times"),
        (HEADER + ",colour\n", "line 1, column 'colour'", "an unknown column"),
        (HEADER.replace("x,y", "x,Y"), "line 1, column 'Y'", "an unknown column"),
        (HEADER.replace("step,", ""), "line 1, column step", "no such column"),
        (HEADER.replace("q3,", ""), "line 1, column q3", "no such column"),
        (HEADER.replace("q3,", "q3,q4,"), "line 1, column 'q4'", "an unknown column"),
        (HEADER + ",fx,fy\n", "line 1, column fz", "no such column beside fx, fy"),
        (HEADER + ",tx,fz\n", "line 1, column fx", "no such column beside fz, tx"),
        (f"{HEADER}\n{ROW},5\n", "line 2", "10 fields"),
        (f"{HEADER}\n{ROW[:-4]}\n", "line 2", "8 fields"),
        (f"{HEADER}\n{ROW}\n{ROW.replace('0.2', 'abc')}\n", "line 3, column q2", "'abc'"),
        (f"{HEADER}\n{ROW.replace('0.2', '')}\n", "line 2, column q2", "''"),
        (f"{HEADER}\n{ROW.replace('0.2', 'nan')}\n", "line 2, column q2", "'nan'"),
        (f"{HEADER}\n{ROW.replace('2.0', '-inf')}\n", "line 2, column y", "'-inf'"),
        (f"{HEADER}\n{ROW.replace('2.0', '1e999')}\n", "line 2, column y", "'1e999'"),
        (f"{HEADER}\n{ROW.replace('2.0', '1_0')}\n", "line 2, column y", "'1_0'"),
        (f"{HEADER}\n{ROW.replace('1,0', '1.5,0', 1)}\n", "line 2, column configuration", "'1.5'"),
        (f"{HEADER}\n{ROW.replace('1,0', '1,0.0', 1)}\n", "line 2, column step", "'0.0'"),
        (f"{HEADER}\n{ROW.replace('1,0', '99999999999999999999,0', 1)}\n", "line 2, column configuration", "'9999"),
        (f"{HEADER}\n{ROW.replace('1,0', '1,-1', 1)}\n", "line 2, column step", "-1"),
        (f"{HEADER}\n{ROW.replace('left', 'centre')}\n", "line 2, column point", "'centre'"),
        (f"{HEADER}\n{ROW}\n{ROW}\n", "line 3", "point left as in line 2"),
        (f"{HEADER}\n{ROW.replace('1,0', '1,1', 1)}\n{ROW}\n", "line 3, column step", "step 0 of configuration 1"),
        (f"{HEADER}\n{ROW.replace('2.0', '2000.0')}\n", "line 2, column x y z", "2000"),
        (f"{HEADER}\n{ROW.replace('0.2', '45')}\n", "line 2, column q2", "45"),
        (f'{HEADER}\n"{ROW}\n', "line 2", "unexpected end of data"),
        (f"{HEADER}\n{ROW}\x00\n", "line 2", "a zero byte"),
        (f"{HEADER}\n{ROW}{' ' * 70_000}\n", "line 2", "more than"),
        (f"{FULL}\n{FULL_ROW.replace('20.1', '293.2')}\n", "line 2, column temperature", "293.2"),
        (f"{FULL}\n{FULL_ROW.replace('10,20,30', '1e6,0,0')}\n", "line 2, column fx fy fz", "1e+06"),
        (f"{FULL}\n{FULL_ROW.replace('30,1,2', '30,1e6,2')}\n", "line 2, column tx ty tz", "1e+06"),
        (f"{FULL}\n{FULL_ROW.replace(',10,', ',,')}\n", "line 2, column fx", "''"),
        (f"{FULL}\n{FULL_ROW}\n{FULL_ROW.replace('left', 'right').replace('0.5', '0.4')}", "line 3, column time", "0."),
    ],
)  # fmt: skip
def test_faults(tmp_path: Path, cell: Cell, text: str, place: str, found: str) -> None:
    with pytest.raises(RecordingError) as caught:
        read(tmp_path, cell, text)
    assert caught.value.place == place
    assert found in caught.value.found
    assert "\n" not in str(caught.value)


def test_not_utf8(tmp_path: Path, cell: Cell) -> None:
    (tmp_path / "table.csv").write_bytes(HEADER.encode() + b"\n\xff\xfe1,0\n")
    with pytest.raises(RecordingError, match=r"line 2, byte 1: found b'.xff'"):
        read_table(tmp_path / "table.csv", cell)


def test_displacements_in_millimetres(tmp_path: Path, cell: Cell) -> None:
    other = tmp_path / "other.yaml"
    other.write_text(cell.path.read_text() + "measurements: {points: displacement}\n")
    with pytest.raises(RecordingError, match=r"column x y z.*a displacement in m"):
        read(tmp_path, load_cell(other), f"{HEADER}\n{ROW.replace('1.0,2.0,3.0', '1.2,0.5,0.1')}\n")


def test_a_later_first_step_is_noted(tmp_path: Path, cell: Cell) -> None:
    readings = read(tmp_path, cell, f"{HEADER}\n{ROW}\n{ROW.replace('1,0', '2,3', 1)}\n")
    assert [(note.kind, note.count) for note in readings.notes] == [("no_step_zero", 1)]


def test_two_gigabytes_of_rubbish_are_refused_at_once(tmp_path: Path, cell: Cell) -> None:
    path = tmp_path / "huge.csv"
    for size in (2 << 30, 1 << 29):  # refused by size, and at the first line
        with path.open("wb") as stream:
            stream.truncate(size)
        begin = time.perf_counter()
        with pytest.raises(RecordingError):
            read_table(path, cell)
        assert time.perf_counter() - begin < 1.0


sizes = st.floats(-3.0, 3.0)


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), rows=st.integers(1, 20), wrench=st.booleans(), known=st.booleans())
def test_round_trip(tmp_path: Path, cell: Cell, data: st.DataObject, rows: int, wrench: bool, known: bool) -> None:
    def numbers(columns: int) -> np.ndarray:
        return np.array(data.draw(st.lists(sizes, min_size=rows * columns, max_size=rows * columns))).reshape(rows, -1)

    written = Readings(
        points=cell.points,
        configuration=np.arange(rows) // 4,
        step=np.arange(rows) % 4 // 2,
        point=np.arange(rows) % 2,
        q=numbers(3),
        position=numbers(3),
        wrench=numbers(6) if wrench else None,
        time=np.sort(numbers(1)[:, 0]) if known else np.full(rows, np.nan),
        temperature=np.where(np.arange(rows) % 3 == 0, np.nan, 20.5),
        provenance=Provenance("", "csv", {}, {}),
    )
    write_table(tmp_path / "t.csv", written)
    back = read_table(tmp_path / "t.csv", cell)
    for name in ("configuration", "step", "point", "q", "position", "time", "temperature"):
        assert np.array_equal(getattr(written, name), getattr(back, name), equal_nan=name in ("time", "temperature"))
    assert (written.wrench is None) == (back.wrench is None)
    if written.wrench is not None and back.wrench is not None:
        assert np.array_equal(written.wrench, back.wrench)


def test_twelve_thousand_rows_are_quick(tmp_path: Path, cell: Cell) -> None:
    lines = [f"{i},0,{i * 1e-5!r},0.2,0.3,left,1.{i:05d},2.0,3.0" for i in range(12_000)]
    (tmp_path / "t.csv").write_text("\n".join([HEADER, *lines]))
    best = min(timed(tmp_path / "t.csv", cell) for _ in range(3))
    assert best < 0.2


def timed(path: Path, cell: Cell) -> float:
    begin = time.process_time()
    assert len(read_table(path, cell)) == 12_000
    return time.process_time() - begin


def sliding_cell(tmp_path: Path, limits: list[float]) -> Cell:
    """The small cell's robot with a linear unit as its first joint."""
    content = yaml.safe_load((Path(__file__).parents[4] / "config" / "cells" / "small.cell.yaml").read_text())
    robot = content["robot"]
    robot["joint_types"] = ["prismatic", *["revolute"] * (len(robot["joints"]) - 1)]
    robot["joint_limits"][0] = limits
    path = tmp_path / "sliding.cell.yaml"
    path.write_text(yaml.safe_dump(content))
    return load_cell(path)


def sliding_urdf_cell(tmp_path: Path, limits: list[float]) -> Cell:
    """A cell whose URDF states the travel."""
    links = "".join(f'<link name="l{i}"/>' for i in range(4))
    joints = "".join(
        f'<joint name="j{i}" type="{kind}"><parent link="l{i}"/><child link="l{i + 1}"/><origin xyz="0.3 0 0.2"/>'
        f'<axis xyz="0 {i % 2} {(i + 1) % 2}"/><limit lower="{low}" upper="{high}"/></joint>'
        for i, (kind, low, high) in enumerate([("prismatic", *limits), ("revolute", -2, 2), ("revolute", -2, 2)])
    )
    (tmp_path / "robot.urdf").write_text(f'<robot name="r">{links}{joints}</robot>')
    content = {
        "name": "sliding", "frames": {"measurement_points": {"mp1": [0.1, 0.0, 0.0]}},
        "instruments": {"tracker": {"sigma": 1e-5}},
        "robot": {"name": "r", "urdf": "robot.urdf", "base_link": "l0", "flange": "l3", "rated_load": 5.0,
                  "joints": ["j0", "j1", "j2"]},
    }  # fmt: skip
    path = tmp_path / "sliding.cell.yaml"
    path.write_text(yaml.safe_dump(content))
    return load_cell(path)


def columns_at(cell: Cell, q1: float) -> dict[str, list[float] | list[str]]:
    n = len(cell.robot.joints)
    numbers: dict[str, float] = {"configuration": 1, "step": 0, "q1": q1, **{f"q{i}": 0.1 for i in range(2, n + 1)}}
    numbers |= dict.fromkeys("xyz", 1.0)
    return {"point": [cell.points[0]], **{name: [value] for name, value in numbers.items()}}


def of_a_file(tmp_path: Path, cell: Cell, q1: float) -> Readings:
    columns = columns_at(cell, q1)
    row = ",".join(str(values[0]) for values in columns.values())
    return read(tmp_path, cell, f"{','.join(columns)}\n{row}\n")


def of_arrays(tmp_path: Path, cell: Cell, q1: float) -> Readings:
    return readings_of_columns(columns_at(cell, q1), cell)


@pytest.mark.parametrize("reader", [of_a_file, of_arrays])
@pytest.mark.parametrize("made", [sliding_cell, sliding_urdf_cell])
class TestSlidingJoints:
    """A travel is a length: it is judged by the limits of its joint, in m, and not as an angle."""

    Make = Callable[[Path, list[float]], Cell]
    Reader = Callable[[Path, Cell, float], Readings]

    def test_a_long_linear_unit_is_read(self, tmp_path: Path, made: Make, reader: Reader) -> None:
        cell = made(tmp_path, [0.0, 30.0])
        assert reader(tmp_path, cell, 13.976).q[0, 0] == 13.976
        assert reader(tmp_path, cell, 30.5).q[0, 0] == 30.5

    @pytest.mark.parametrize(("limits", "value"), [([0.0, 30.0], 13976.0), ([-0.4, 0.8], 650.0), ([0.0, 0.05], 40.0)])
    def test_millimetres_are_refused(
        self, tmp_path: Path, made: Make, reader: Reader, limits: list[float], value: float
    ) -> None:
        with pytest.raises(RecordingError, match=r"column q1: found a size of .*, expected a distance in m, at most"):
            reader(tmp_path, made(tmp_path, limits), value)


def test_a_joint_that_turns_beside_one_that_slides_is_in_radians(tmp_path: Path) -> None:
    cell = sliding_cell(tmp_path, [0.0, 30.0])
    with pytest.raises(RecordingError, match=r"column q3: found a size of 14, expected an angle in rad, at most 4 pi"):
        readings_of_columns({**columns_at(cell, 20.0), "q3": [14.0]}, cell)
