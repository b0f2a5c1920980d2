"""Tables and programs as other software writes them: read right, or refused in one line that names the cure.

A kind is what one program or habit does to the same six readings.  Nothing that a file holds is lost without a word:
a quantity is read, listed as not used, or stops the import.
"""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calibration_core.errors import RecordingError
from calibration_core.recording.foreign.join import Imported, import_files
from calibration_core.recording.foreign.mapping import import_map
from calibration_core.recording.foreign.source import Source

COUNT = 6
STEP = np.arange(COUNT)
XYZ = np.column_stack([2.000123 + 0.05 * STEP, 0.300456 - 0.02 * STEP, 0.800789 + 0.01 * STEP**2])
DEGREES = np.column_stack(
    [-20.5 + 10 * STEP, -60.0 + 7 * STEP, 80.0 - 5 * STEP, 12.0 * STEP, 45 - 3 * STEP, 90 - 11 * STEP]
)
FORCE = np.column_stack([98.0665 * STEP, 0.0 * STEP, -9.80665 * STEP])
TIME = 1559066470.0 + 10.0 * STEP  # 2019-05-28 18:01:10 UTC
AXES = [f"J{i + 1} [deg]" for i in range(6)]
Rows = list[list[str]]


@dataclasses.dataclass(frozen=True)
class Kind:
    """What becomes of the readings in a file: name -> text; a map; what is expected.

    Attributes:
        files: Files, in the order in which they are given.
        how: The map.
        refused: What the one line says; None: the readings are right.
        listed: Columns that are said not to be used.
        time: Whether times are right, too.
        loaded: Whether forces are.
        warm: Whether the temperature is.
        rounded: Whether the file holds positions to a millimetre alone.
    """

    files: dict[str, str]
    how: dict[str, object] | None = None
    refused: str | None = None
    listed: tuple[str, ...] = ()
    time: bool = False
    loaded: bool = False
    warm: bool = False
    rounded: bool = False


def table(head: list[str], rows: Rows, separator: str = ",", *, title: str = "", end: str = "") -> str:
    lines = [separator.join(row) + end for row in ([head] if head else []) + rows]
    return "\n".join(([title] if title else []) + lines) + "\n"


def numbers(values: np.ndarray, form: str = "{:.6f}", mark: str = ".") -> Rows:
    return [[form.format(value).replace(".", mark) for value in row] for row in values]


def beside(*columns: Rows) -> Rows:
    return [list(itertools.chain(*row)) for row in zip(*columns, strict=True)]


NAMES = [["mp1"]] * COUNT
JOINTS = table(AXES, numbers(DEGREES))
MM = ["Point", "X [mm]", "Y [mm]", "Z [mm]"]
POINTS = beside(NAMES, numbers(1e3 * XYZ))
PLAIN = table(MM, POINTS)


def points(text: str, **expected: object) -> Kind:
    return Kind({"points.csv": text, "joints.csv": JOINTS}, **expected)  # type: ignore[arg-type]


def program(name: str, text: str, **expected: object) -> Kind:
    return Kind({"points.csv": PLAIN, name: text}, **expected)  # type: ignore[arg-type]


def timed(texts: list[str], name: str = "Time", **expected: object) -> Kind:
    quoted = [f'"{text}"' if "," in text else text for text in texts]
    return points(table([*MM, name], beside(POINTS, [[text] for text in quoted])), **expected)


def dated(form: str) -> Kind:
    import datetime as dt

    return timed([dt.datetime.fromtimestamp(t, dt.UTC).strftime(form) for t in TIME], time="%S" in form)


def rapid(lines: Callable[[int, str], str]) -> str:
    body = [lines(k, ",".join(f"{value:g}" for value in row)) for k, row in enumerate(DEGREES)]
    return "\n".join(["MODULE CAL", *body, "ENDMODULE", ""])


def listing(further: Callable[[int], str] = lambda _: "") -> str:
    parts = ["/PROG CAL", "/POS"]
    for k, row in enumerate(DEGREES):
        angles = ",\n".join(f"\tJ{i + 1}= {value:.3f} deg" for i, value in enumerate(row))
        parts.append(f'P[{k + 1}:"a"]{{\n   GP1:\n\tUF : 0, UT : 1,\n{angles}{further(k)}\n}};')
    return "\n".join([*parts, "/END", ""])


def krl(further: Callable[[int], str]) -> str:
    rows = [",".join(f"A{i + 1} {value:g}" for i, value in enumerate(row)) for row in DEGREES]
    body = [f"DECL E6AXIS XP{k + 1}={{{row}{further(k)}}}" for k, row in enumerate(rows)]
    return "\n".join(["&ACCESS RVP", "DEFDAT CAL PUBLIC", *body, "ENDDAT", ""])


def script(line: str, before: str = "") -> str:
    rows = [", ".join(f"d2r({value:g})" for value in row) for row in DEGREES]
    return "\n".join(["def cal():", before, *(line.format(row=row, k=k) for k, row in enumerate(rows)), "end", ""])


UNIT = "9E+09,9E+09,9E+09,9E+09,9E+09,9E+09"
QUATERNION = np.column_stack([np.cos(0.1 * STEP), np.sin(0.1 * STEP), 0 * STEP, 0 * STEP])
BY_NUMBER = {
    "files": [
        {"match": "points.txt", "header": 0, "columns": {"1": "x", "2": "y", "3": "z"}, "units": {"xyz": "mm"}},
        {"match": "joints.txt", "header": 0, "columns": {str(i): f"q{i}" for i in range(1, 7)}, "units": {"q": "deg"}},
    ]
}
TWO = table(
    ["configuration", *(f"{axis}{k}" for k in (1, 2) for axis in "XYZ"), *AXES],
    beside([[str(k + 1)] for k in STEP], numbers(1e3 * XYZ), numbers(1e3 * (XYZ + 0.1)), numbers(DEGREES)),
)
ROS = table(
    ["%time", "field.header.seq", "field.header.stamp", "field.header.frame_id", "field.point.x", "field.point.y",
     "field.point.z"],
    [[str(int(1e9 * (t + 5))), str(k), str(int(1e9 * t)), "tracker", *row]
     for k, (t, row) in enumerate(zip(TIME, numbers(XYZ), strict=True))],
)  # fmt: skip
ROS_JOINTS = table(
    ["%time", "field.header.seq", "field.header.stamp", "field.header.frame_id", *(f"field.name{i}" for i in range(6)),
     *(f"field.position{i}" for i in range(6)), *(f"field.velocity{i}" for i in range(6))],
    [[str(int(1e9 * t)), str(k), str(int(1e9 * t)), "", *(f"joint_{i + 1}" for i in range(6)), *row, *["0.0"] * 6]
     for k, (t, row) in enumerate(zip(TIME, numbers(np.radians(DEGREES), "{:.9f}"), strict=True))],
)  # fmt: skip
PLOT = table(
    ["__time", *(f"/joint_states/joint_{i + 1}/position" for i in range(6)), "/tracker/mp1/point/x",
     "/tracker/mp1/point/y", "/tracker/mp1/point/z", "/joint_states/joint_1/velocity"],
    beside([[f"{t:.3f}"] for t in TIME], numbers(np.radians(DEGREES), "{:.9f}"), numbers(XYZ), [["0"]] * COUNT),
)  # fmt: skip
STUDIO = table(
    ["receive_time", "header.stamp", "point.x", "point.y", "point.z"],
    beside([[str(int(1e9 * t))] for t in TIME], [[str(int(1e9 * t))] for t in TIME], numbers(XYZ)),
)
LISTS = [", ".join(f"{value:g}" for value in row) for row in DEGREES]
BLANKED = [row.replace(",", "") for row in LISTS]
EXPORT = "export the joint angles as a table"
OTHER_PROGRAMS = {
    "Yaskawa": ("cal.jbi", "/JOB\n//NAME CAL\n//POS\n///NPOS 6,0,0,0,0,0\n///TOOL 0\n///POSTYPE PULSE\n///PULSE\n"
                + "".join(f"C0000{k}={row}\n" for k, row in enumerate(LISTS)) + "//INST\nNOP\nEND\n"),
    "Staubli": ("cal.dtx", "<Database>\n" + "".join(
        f'<Value key="{k}" ' + " ".join(f'j{i + 1}="{value:g}"' for i, value in enumerate(row)) + " />\n"
        for k, row in enumerate(DEGREES)) + "</Database>\n"),
    "Kawasaki": ("cal.as", ".JOINTS\n" + "".join(f"#p{k} {row}\n" for k, row in enumerate(BLANKED)) + ".END\n"),
    "Mitsubishi": ("cal.prg", "1 Mov J1\n2 End\n" + "".join(f"J{k}=({row})\n" for k, row in enumerate(LISTS))),
    "Denso": ("cal.pac", "PROGRAM cal\n" + "".join(f"MOVE P, J({row})\n" for row in LISTS) + "END\n"),
    "Nachi": ("cal.src", "'CAL\n" + "".join(f"MOVEX A=1,M1J,P,({row}),T=10,H=1\n" for row in LISTS) + "END\n"),
    "Comau": ("cal.lsv", "cal:\n" + "".join(f"p{k} JNTP Arm: 1 AX: 6\n {row}\n" for k, row in enumerate(BLANKED))),
}  # fmt: skip


def thousands(form: str) -> str:
    return table(MM, [["mp1", *(f'"{form.format(value)}"' for value in 1e3 * row)] for row in XYZ])


KINDS = {
    "empty last column": points(table([*MM, "Remark"], POINTS, end=",")),
    "empty last columns, y first": points(
        table(["Point", "Y [mm]", "X [mm]", "Z [mm]", "A", "B"],
              beside(NAMES, numbers(1e3 * XYZ[:, [1, 0, 2]])), ";", end=";;")),
    "empty last column, inches": points(
        table(["Point", "X [in]", "Y [in]", "Z [in]", "Remark"], beside(NAMES, numbers(XYZ / 0.0254)), end=",")),
    "blanks in names of columns": points(table(["Point", "X [mm]", "Y [mm]", "Z [mm]"], POINTS, " ")),
    "fewer names than columns": points(
        table(["Y [mm]", "X [mm]", "Z [mm]"], POINTS), refused="3 names of columns, expected 4 fields"),
    "quaternion Q0 ... Q3": points(
        table([*MM, "Q0", "Q1", "Q2", "Q3"], beside(POINTS, numbers(QUATERNION))), listed=("Q0", "Q3")),
    "quaternion q1 ... q4": points(
        table([*MM, "q1", "q2", "q3", "q4"], beside(POINTS, numbers(QUATERNION))), listed=("q1", "q4")),
    "quaternion Q0 QX QY QZ beside q1 ... q6": Kind(
        {"all.csv": table([*MM, "Q0", "QX", "QY", "QZ", *(f"q{i} [deg]" for i in range(1, 7))],
                          beside(POINTS, numbers(QUATERNION), numbers(DEGREES)))}, listed=("Q0", "QZ")),
    "quaternion Q0 ... Q3 beside joint angles": Kind(
        {"all.csv": table([*MM, "Q0", "Q1", "Q2", "Q3", *AXES], beside(POINTS, numbers(QUATERNION), numbers(DEGREES)))},
        listed=("Q0", "Q3")),
    "names in quotes between blanks": points(table(['"Point name"', '"X [mm]"', '"Y [mm]"', '"Z [mm]"'], POINTS, " ")),
    "# for the number": points(
        table(["#", *MM[1:]], beside([[str(k + 1)] for k in STEP], numbers(1e3 * XYZ)), title="# exported")),
    "# for the number, and an empty last column": points(
        table(["#", *MM[1:], "Remark"], beside([[str(k + 1)] for k in STEP], numbers(1e3 * XYZ)), ";", end=";")),
    "# for the number, and an empty last column in quotes": points(
        table(["#", '"X [mm]"', '"Y [mm]"', '"Z [mm]"', "Remark"],
              beside([[str(k + 1)] for k in STEP], numbers(1e3 * XYZ), [['""']] * COUNT), " ")),
    "# for the number, and an empty last column between blanks": points(
        table(["#", '"X [mm]"', '"Y [mm]"', '"Z [mm]"', "Remark"],
              beside([[str(k + 1)] for k in STEP], numbers(1e3 * XYZ)), " "), refused="5 names of columns, expected 4"),
    "the time in a column of dates": timed([f"{t / 86400 + 25569:.8f}" for t in TIME], "Date", time=True),
    "date and time": timed([f"28.05.2019 18:0{k}:10" for k in STEP], "Datum/Zeit"),
    "a temperature by its unit": Kind(
        {"points.csv": PLAIN,
         "joints.csv": table([*AXES, "Hall 3 [°C]"], beside(numbers(DEGREES), [["21.5"]] * COUNT))}, warm=True),
    "three angles": points(
        table([*MM, "Angle 1 [deg]", "Angle 2 [deg]", "Angle 3 [deg]"], beside(POINTS, numbers(DEGREES[:, :3]))),
        listed=("Angle 1", "Angle 3")),
    "rotations": points(table([*MM, "Rx", "Ry", "Rz"], beside(POINTS, numbers(DEGREES[:, :3]))), listed=("Rx",)),
    "joint angles in two files": points(
        table([*MM, *AXES], beside(POINTS, numbers(DEGREES + 1))), refused="joint angles, as in points.csv"),
    "forces in kgf": points(
        table([*MM, "Fx [kgf]", "Fy [kgf]", "Fz [kgf]"], beside(POINTS, numbers(FORCE / 9.80665))), loaded=True),
    "forces in kp": points(
        table([*MM, "Fx", "Fy", "Fz"], beside(POINTS, numbers(FORCE / 9.80665)),
              title="Units: mm, kp"), loaded=True),
    "forces in no known unit": points(
        table([*MM, "Fx [dyn]", "Fy [dyn]", "Fz [dyn]"], beside(POINTS, numbers(FORCE))), refused="the unit 'dyn'"),
    "topics at times of their own in one table": Kind(
        {"all.csv": table(["__time", "/leica/point/x", "/leica/point/y", "/leica/point/z", *AXES],
                          beside([[f"{t:.3f}"] for t in TIME],
                                 [row if k % 2 else ["", "", ""] for k, row in enumerate(numbers(XYZ))],
                                 [[""] * 6 if k % 2 else row for k, row in enumerate(numbers(DEGREES))]))},
        refused="in a file of its own, joined by time"),
    "forces in counts": points(
        table([*MM, "Fx", "Fy", "Fz"], beside(POINTS, numbers(1e6 * FORCE))), refused="forces up to"),
    "targets of a row in two units": points(
        table(["X1 [mm]", "Y1 [mm]", "Z1 [mm]", "X2 [m]", "Y2 [m]", "Z2 [m]"],
              beside(numbers(1e3 * XYZ), numbers(XYZ + 0.1))), refused="2 in another unit than 1"),
    "seconds of LabVIEW": timed([f"{t + 2082844800:.3f}" for t in TIME], "Timestamp", time=True),
    "angles in gon": Kind({"p.csv": PLAIN, "j.csv": JOINTS.replace("[deg]", "[gon]")}, refused="the unit 'gon'"),
    "inches in a remark": points(
        table(["Point", "X", "Y", "Z"], beside(NAMES, numbers(XYZ / 0.0254)), title="# All lengths in inches")),
    "inches or millimetres": points(
        table(["Point", "X", "Y", "Z"], beside(NAMES, numbers(XYZ / 0.0254))), refused="a unit: state it"),
    "external axis in a table": Kind(
        {"points.csv": PLAIN,
         "joints.csv": table([*AXES, "E1"], beside(numbers(DEGREES), numbers(100.0 * STEP[:, None])))},
        refused="an external axis that moves"),
    "external axis in a table, with a unit": Kind(
        {"points.csv": PLAIN,
         "joints.csv": table([*AXES, "E1 [mm]"], beside(numbers(DEGREES), numbers(100.0 * STEP[:, None])))},
        refused="an external axis that moves"),
    "external axis that stands": Kind(
        {"points.csv": PLAIN, "joints.csv": table([*AXES, "E1"], beside(numbers(DEGREES), [["5"]] * COUNT))},
        listed=("E1",)),
    "external axis in RAPID": program(
        "cal.mod", rapid(lambda k, row: f"CONST jointtarget j{k}:=[[{row}],[{500 + k},9E9,9E9,9E9,9E9,9E9]];"),
        refused="an external axis that moves (500 to 505)"),
    "targets of RAPID in an array beside one": program(
        "cal.mod",
        f"CONST jointtarget j0:=[[{','.join(f'{value:g}' for value in DEGREES[0])}],[9E9,9E9,9E9,9E9,9E9,9E9]];\n"
        f"CONST jointtarget j{{{COUNT - 1}}}:=["
        + ",\n".join(f"[[{','.join(f'{value:g}' for value in row)}],[9E9,9E9,9E9,9E9,9E9,9E9]]" for row in DEGREES[1:])
        + "];\n"),
    "external axis in KRL": program(
        "cal.dat", krl(lambda k: f",E1 {k},E2 0.0,E3 0.0"), refused="an external axis that moves (0 to 5)"),
    "external axis in TP": program(
        "cal.ls", listing(lambda k: f",\n\tE1= {k}.000 mm"), refused="an external axis that moves (0 to 5)"),
    "external axis in TP, standing": program(
        "cal.ls", listing(lambda _: ",\n\tE1= 12.000 mm"), listed=("E1 (12)",)),
    "second group in TP": program(
        "cal.ls", listing(lambda _: "\n   GP2:\n\tUF : 0, UT : 1,\n\tJ1= 7.000 deg"), listed=("E2.J1 (7)",)),
    "external axes that are not there": program("cal.dat", krl(lambda _: ",E1 0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0")),
    "nanoseconds": timed([str(int(t * 1e9)) for t in TIME], time=True),
    "milliseconds since 1970": timed([str(int(t * 1e3)) for t in TIME], time=True),
    "days of a spreadsheet": timed([f"{t / 86400 + 25569:.8f}" for t in TIME], time=True),
    "time with a zone": timed([f"{t:.1f}" for t in TIME], "Time (UTC)", time=True),
    "without a header, by number": Kind(
        {"points.txt": table([], numbers(1e3 * XYZ), " "), "joints.txt": table([], numbers(DEGREES), "\t")}, BY_NUMBER),
    "several targets in one row": Kind({"all.csv": TWO}),
    "blanks between thousands": points(
        table(MM, [["mp1", *(f"{1e3 * v:,.3f}".translate({44: " ", 46: ","}) for v in row)] for row in XYZ], ";")),
    "apostrophes between thousands": points(
        table(MM, [["mp1", *(f"{v:,.4f}".replace(",", "'") for v in 1e3 * row)] for row in XYZ], ";")),
    "typographic minus": Kind({"points.csv": PLAIN, "joints.csv": JOINTS.replace("-", "\u2212")}),
    "rostopic": Kind({"points.csv": ROS, "joints.csv": ROS_JOINTS}, time=True),
    "PlotJuggler": Kind({"all.csv": PLOT}, time=True),
    "Foxglove": Kind({"points.csv": STUDIO, "joints.csv": JOINTS}, time=True),
    **{f"dates like {form}": dated(form) for form in (
        "%m/%d/%y %H:%M:%S", "%d.%m.%y %H:%M:%S", "%d-%m-%Y %H:%M:%S", "%Y/%m/%d %H:%M:%S", "%m/%d/%Y %I:%M %p",
        "%d-%b-%Y %H:%M:%S", "%d %b %Y %H:%M:%S", "%b %d, %Y %I:%M:%S %p", "%d/%m/%Y %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%SZ",
    )},
    "remarks in RAPID": program("cal.mod", rapid(
        lambda k, row: f"! jointtarget old:=[[1,2,3,4,5,6],[{UNIT}]];\nCONST jointtarget j{k}:=[[{row}],[{UNIT}]];")),
    "targets inline in RAPID": program(
        "cal.mod", rapid(lambda _, row: rf"MoveAbsJ [[{row}],[{UNIT}]]\NoEOffs,v100,fine,tool0;")),
    "Cartesian targets": program(
        "cal.mod", rapid(lambda k, _: f"CONST robtarget p{k}:=[[1,2,3],[1,0,0,0],[0,0,0,0],[{UNIT}]];"),
        refused="cal.mod: line 2: found Cartesian positions (ABB RAPID)"),
    "moves in a script": program("cal.script", script("  movej([{row}], a=1.4)", "  global weights=[1,2,3]")),
    "named lists in a script": program(
        "cal.script", script("  q{k} = [{row}]\n  movej(q{k})", "  cog = [0.0, 0.0, 0.05]\n  set_tcp(p[0,0,0,0,0,0])")),
    "a number that is none in a script": program(
        "cal.script", script("  movej([{row}])", "  movej([1,2,oops,4,5,6])"), refused="line 2: found 'oops'"),
    **{f"positions of {maker}": program(name, text, refused=EXPORT) for maker, (name, text) in OTHER_PROGRAMS.items()},
    "a binary program": program("cal.tp", "\x00\x01TPP\x00", refused=EXPORT),
    "a script in degrees": program(
        "cal.drl", "\n".join(f"movej([{', '.join(f'{value:g}' for value in row)}], v=30)" for row in DEGREES),
        refused="line 1: found -20.5 rad, more than a turn"),
    "whole thousands in quotes": points(thousands("{:,.0f}"), refused="line 2: found '2,000', expected a number"),
    "whole thousands in quotes, with a decimal mark": Kind(
        {"points.csv": thousands("{:,.0f}"), "joints.csv": JOINTS}, {"files": [{"match": "points*", "decimal": "."}]},
        rounded=True),
    "one whole thousand beside decimals": points(
        thousands("{:.3f}").replace("2000.123", "2,000"), refused="line 2: found '2,000', expected a number"),
    "whole thousands beside thousands with decimals": points(
        thousands("{:,.3f}").replace("2,000.123", "2,000"), rounded=True),
    "decimal commas in quotes": points(thousands("{:.3f}").replace(".", ",")),
    "decimal commas beside three integers": points(
        table(["No", "Layer", "Point", *MM[1:]],
              beside([[str(k), "1", "7"] for k in STEP], numbers(1e3 * XYZ, mark=",")), ";")),
    "a remark with brackets": Kind({"points.csv": "# SMR offset = [0.0, 0.0, 19.05]\n" + PLAIN, "joints.csv": JOINTS}),
    "a remark with brackets above angles": Kind(
        {"points.csv": PLAIN, "joints.csv": "# home = [0, -90, 90, 0, 45, 0]\n" + JOINTS}),
    "a remark like a program": Kind({"points.csv": "remark: set {x:1, x = [a, 2, 3]}\n" + PLAIN, "joints.csv": JOINTS}),
    "temperature beside the angles": Kind(
        {"points.csv": PLAIN,
         "joints.csv": table([*AXES, "Temperature [°C]"], beside(numbers(DEGREES), [["21.5"]] * COUNT))}, warm=True),
}  # fmt: skip


def imported(kind: Kind, folder: Path, *, encoding: str = "utf-8", end: str = "\n") -> Imported:
    paths = []
    for name, text in kind.files.items():
        paths.append(folder / name)
        paths[-1].write_bytes(text.replace("\n", end).encode(encoding))
    return import_files(paths, None if kind.how is None else import_map(folder / "map.yaml", kind.how))


def listed(sources: tuple[Source, ...]) -> set[str]:
    return {name for source in sources for name in source.ignored}


def judged(kind: Kind, folder: Path, **form: str) -> None:
    if kind.refused is not None:
        with pytest.raises(RecordingError) as caught:
            imported(kind, folder, **form)
        assert kind.refused in str(caught.value)
        assert "\n" not in str(caught.value)
        assert re.match(re.escape(str(folder)) + r"/\w+\.\w+: ", str(caught.value))
        return
    found = imported(kind, folder, **form)
    readings = found.readings
    first = readings.point == 0
    np.testing.assert_allclose(readings.position[first], XYZ, atol=5e-4 if kind.rounded else 1e-6)
    np.testing.assert_allclose(np.degrees(readings.q[first]), DEGREES, atol=1e-5)
    assert set(kind.listed) <= listed(found.sources)
    if kind.time:
        np.testing.assert_allclose(readings.time - readings.time[0], TIME - TIME[0], atol=1e-3)
    if kind.warm:
        np.testing.assert_allclose(readings.temperature, 21.5)
    if kind.loaded:
        assert readings.wrench is not None
        np.testing.assert_allclose(readings.wrench[:, :3], FORCE, atol=1e-4)


@pytest.mark.parametrize("name", KINDS)
def test_a_kind_is_read_right_or_refused_in_one_line(name: str, tmp_path: Path) -> None:
    judged(KINDS[name], tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(("encoding", "end"), [("utf-8-sig", "\r\n"), ("utf-16", "\n")])
@pytest.mark.parametrize("name", KINDS)
def test_a_kind_in_other_encodings(name: str, encoding: str, end: str, tmp_path: Path) -> None:
    judged(KINDS[name], tmp_path, encoding=encoding, end=end)


def test_what_two_targets_of_a_row_become(tmp_path: Path) -> None:
    readings = imported(KINDS["several targets in one row"], tmp_path).readings
    assert readings.points == ("1", "2")
    np.testing.assert_allclose(readings.position[readings.point == 1], XYZ + 0.1, atol=1e-6)


def test_a_map_says_which_joint_an_external_axis_is(tmp_path: Path) -> None:
    """A linear unit below the robot: its first joint, in mm."""
    columns = {"E1": "q1"} | {f"A{i}": f"q{i + 1}" for i in range(1, 7)}
    how = {"files": [{"match": "*.dat", "columns": columns, "units": {"q1": "mm"}}]}
    text = krl(lambda k: f",E1 {100 * k},E2 0.0")
    readings = imported(Kind({"points.csv": PLAIN, "cal.dat": text}, how), tmp_path).readings
    np.testing.assert_allclose(readings.q[:, 0], 0.1 * STEP)
    np.testing.assert_allclose(np.degrees(readings.q[:, 1:]), DEGREES, atol=1e-9)
