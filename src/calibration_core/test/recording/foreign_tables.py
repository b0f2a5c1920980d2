"""One small measurement as foreign programs would export it.

SpatialAnalyzer's points are as its Users Manual describes them ("Exporting ASCII Formatted Points": collection, group
and target, then x y z, separated by blanks or commas, comments behind `//`).  Robot programs follow the makers'
languages: KUKA KRL (E6AXIS) and Universal Robots RTDE here, RAPID and TP listings in `test_foreign_kinds.py`.
The tables of PolyWorks, Verisurf and FARO software have layouts that their users can choose for text exports:
these programs let the user choose the columns, so that no layout is theirs alone.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

CONFIGURATIONS, STEPS, POINTS, JOINTS = 4, 3, ("mp1", "mp2", "mp3"), 6
_RANDOM = np.random.default_rng(7)
Q = np.round(_RANDOM.uniform(-1.6, 1.6, (CONFIGURATIONS, JOINTS)), 6)  # rad
WRENCH = np.round(_RANDOM.uniform(-900.0, 900.0, (CONFIGURATIONS, STEPS, 6)), 3)  # N, N*m
WRENCH[:, 0] = 0.0
POSITION = np.round(_RANDOM.uniform(1.0, 3.0, (CONFIGURATIONS, STEPS, len(POINTS), 3)), 7)  # m
TIME = 1000.0 + 60.0 * np.arange(CONFIGURATIONS * STEPS).reshape(CONFIGURATIONS, STEPS)  # s

Files = dict[str, bytes]
TABLES: dict[str, Callable[[], Files]] = {}
MAPS: dict[str, dict[str, Any]] = {}
LOADED = {True: (0, 1, 2), False: (0,)}


def table(name: str, **how: Any) -> Callable[[Callable[[], Files]], Callable[[], Files]]:
    """Register a table; `how` is the map that it needs, if any."""

    def register(make: Callable[[], Files]) -> Callable[[], Files]:
        TABLES[name] = make
        if how:
            MAPS[name] = how
        return make

    return register


def write(name: str, directory: Path) -> list[Path]:
    """Write the files of a table; return their paths, the points first."""
    paths = []
    for file, content in TABLES[name]().items():
        (directory / file).write_bytes(content)
        paths.append(directory / file)
    return paths


def rows(loaded: bool = True):
    """Configuration from 1, step, index of the point, over all readings in the order of time."""
    return [(c, s, p) for c in range(CONFIGURATIONS) for s in LOADED[loaded] for p in range(len(POINTS))]


def text(*lines: str, end: str = "\n") -> bytes:
    return (end.join(lines) + end).encode()


def numbers(values, form: str = "{:.7f}", sep: str = ",", decimal: str = ".") -> str:
    return sep.join(form.format(v).replace(".", decimal) for v in values)


def degrees(c: int):
    return np.degrees(Q[c])


# --- everything in one file ------------------------------------------------------------------------------------------


@table("own table with units in the header, semicolons and decimal commas")
def _excel_german() -> Files:
    head = "Konfiguration;Schritt;Messpunkt;X [mm];Y [mm];Z [mm];" + ";".join(f"A{i + 1} [°]" for i in range(JOINTS))
    head += ";Fx [kN];Fy [kN];Fz [kN];Mx [Nm];My [Nm];Mz [Nm]"
    lines = [head]
    for c, s, p in rows():
        body = [
            numbers(1e3 * POSITION[c, s, p], "{:.4f}", ";", ","),
            numbers(degrees(c), "{:.9f}", ";", ","),
            numbers(1e-3 * WRENCH[c, s, :3], "{:.6f}", ";", ","),
            numbers(WRENCH[c, s, 3:], "{:.3f}", ";", ","),
        ]
        lines.append(f"{c + 1};{s};{POINTS[p]};" + ";".join(body))
    return {"messung.csv": "\r\n".join(lines).encode("cp1252")}


@table("spreadsheet saved as UTF-16 with tabs and a row of units")
def _utf16() -> Files:
    lines = [
        "Config\tStep\tPoint\tX\tY\tZ\t" + "\t".join(f"J{i + 1}" for i in range(JOINTS)) + "\tFx\tFy\tFz\tTx\tTy\tTz"
    ]
    lines.append("\t\t\tmm\tmm\tmm" + "\tdeg" * JOINTS + "\tN" * 3 + "\tNm" * 3)
    for c, s, p in rows():
        values = [*1e3 * POSITION[c, s, p], *degrees(c), *WRENCH[c, s]]
        lines.append(f"{c + 1}\t{s}\t{POINTS[p]}\t" + numbers(values, "{:.9f}", "\t"))
    return {"table.txt": "\n".join(lines).encode("utf-16")}


@table("units in a remark, names C01_S0_mp1 beside joint angles")
def _names_in_one() -> Files:
    lines = ["# Units: millimeters, degrees", "Point Name,X,Y,Z," + ",".join(f"Joint {i + 1}" for i in range(JOINTS))]
    for c, s, p in rows():
        lines.append(f"C{c + 1:02d}_S{s}_{POINTS[p]}," + numbers([*1e3 * POSITION[c, s, p], *degrees(c)], "{:.9f}"))
    return {"points.csv": text(*lines)}


@table("no configurations: they begin where the joint angles change")
def _no_configuration() -> Files:
    lines = ["target x_m y_m z_m " + " ".join(f"q{i + 1}" for i in range(JOINTS)) + " fx fy fz tx ty tz"]
    for c, s, p in rows():
        values = [*POSITION[c, s, p], *Q[c], *WRENCH[c, s]]
        lines.append(f"{POINTS[p]} " + numbers(values, "{:.9f}", " "))
    return {"log.txt": text(*lines)}


@table("ROS 2 joint names, time stamps of ISO 8601")
def _ros() -> Files:
    joints = "shoulder_pan_joint,shoulder_lift_joint,elbow_joint,wrist_1_joint,wrist_2_joint,wrist_3_joint"
    lines = ["timestamp,configuration,point,x,y,z," + joints]
    for c, s, p in rows():
        stamp = f"1970-01-01T00:{int(TIME[c, s]) // 60:02d}:{int(TIME[c, s]) % 60:02d}Z"
        lines.append(f"{stamp},{c + 1},{POINTS[p]}," + numbers([*POSITION[c, s, p], *Q[c]], "{:.9f}"))
    return {"ros.csv": text(*lines)}


@table("Yaskawa's joints S L U R B T")
def _yaskawa() -> Files:
    lines = ["Pose,Step,Target,X(mm),Y(mm),Z(mm),S(deg),L(deg),U(deg),R(deg),B(deg),T(deg)"]
    for c, s, p in rows():
        lines.append(f"{c + 1},{s},{POINTS[p]}," + numbers([*1e3 * POSITION[c, s, p], *degrees(c)], "{:.9f}"))
    return {"motoman.csv": text(*lines)}


@table("inches and pounds-force")
def _inches() -> Files:
    head = "Config,Step,Point,X (in),Y (in),Z (in)," + ",".join(f"J{i + 1} (deg)" for i in range(JOINTS))
    lines = [head + ",Fx (lbf),Fy (lbf),Fz (lbf),Mx (in-lbf),My (in-lbf),Mz (in-lbf)"]
    pound = 4.4482216152605
    for c, s, p in rows():
        force, torque = WRENCH[c, s, :3] / pound, WRENCH[c, s, 3:] / (pound * 0.0254)
        values = [*POSITION[c, s, p] / 0.0254, *degrees(c), *force, *torque]
        lines.append(f"{c + 1},{s},{POINTS[p]}," + numbers(values, "{:.10f}"))
    return {"imperial.csv": text(*lines)}


# --- points of tracker software beside a robot's file -----------------------------------------------------------------


def joints_csv(loaded: bool = True) -> bytes:
    lines = ["configuration,step," + ",".join(f"q{i + 1} [rad]" for i in range(JOINTS)) + ",fx,fy,fz,tx,ty,tz"]
    for c in range(CONFIGURATIONS):
        lines += [f"{c + 1},{s}," + numbers([*Q[c], *WRENCH[c, s]], "{:.9f}") for s in LOADED[loaded]]
    return text(*lines)


@table("SpatialAnalyzer: Collection::Group::Point, comma separated")
def _spatial_analyzer() -> Files:
    lines = ["// Exported points", "// Units: Millimeters", "Collection,Group,Name,X,Y,Z"]
    for c, s, p in rows():
        lines.append(f"A,Config{c + 1} Step{s},{POINTS[p]}," + numbers(1e3 * POSITION[c, s, p], "{:.4f}"))
    return {"sa.txt": text(*lines), "robot.csv": joints_csv()}


@table("SpatialAnalyzer: no header, names and coordinates")
def _spatial_analyzer_plain() -> Files:
    lines = [
        f"A, C{c + 1}_S{s}, {POINTS[p]}, " + numbers(1e3 * POSITION[c, s, p], "{:.4f}", ", ") for c, s, p in rows()
    ]
    return {"sa_plain.csv": text(*lines), "robot.csv": joints_csv()}


@table("PolyWorks: tab separated report with nominal and measured")
def _polyworks() -> Files:
    head = [f"{what} {axis}" for what in ("Nominal", "Measured") for axis in "XYZ"]
    lines = ["PolyWorks|Inspector report", "Unit: mm", "", "	".join(["Name", *head])]
    for c, s, p in rows():
        nominal = np.round(1e3 * POSITION[c, s, p], 0)
        values = [*nominal, *1e3 * POSITION[c, s, p]]
        lines.append(f"pose {c + 1} - step {s} - {POINTS[p]}\t" + numbers(values, "{:.4f}", "\t"))
    return {"polyworks.txt": text(*lines, end="\r\n"), "robot.csv": joints_csv()}


@table("Verisurf: inspection report in CSV with deviations")
def _verisurf() -> Files:
    lines = ["Verisurf Inspection Report,,,,,,,,,", "Feature,Nom X,Nom Y,Nom Z,Meas X,Meas Y,Meas Z,Dev X,Dev Y,3D Dev"]
    for c, s, p in rows():
        at = 1e3 * POSITION[c, s, p]
        lines.append(f"conf{c + 1}.load{s}.{POINTS[p]}," + numbers([*np.round(at), *at, 0.1, 0.1, 0.14], "{:.4f}"))
    return {"verisurf.csv": text(*lines), "robot.csv": joints_csv()}


@table("FARO CAM2: semicolons, decimal commas, a group for each pose")
def _faro() -> Files:
    lines = ["CAM2 Measure;;;;;", "Einheit: mm;;;;;", "Gruppe;Bezeichnung;X Ist;Y Ist;Z Ist;RMS"]
    for c, s, p in rows():
        at = numbers(1e3 * POSITION[c, s, p], "{:.4f}", ";", ",")
        lines.append(f"Pose {c + 1} Laststufe {s};{POINTS[p]};{at};0,012")
    return {"faro.csv": "\r\n".join(lines).encode("cp1252"), "robot.csv": joints_csv()}


@table("points in order, KUKA's data list")
def _kuka() -> Files:
    lines = ["No\tTarget\tX\tY\tZ"]
    for number, (c, _, p) in enumerate(rows(loaded=False), 1):
        lines.append(f"{number}\t{POINTS[p]}\t" + numbers(1e3 * POSITION[c, 0, p], "{:.4f}", "\t"))
    program = ["DEFDAT CALIB"]
    for c in range(CONFIGURATIONS):
        axes = ",".join(f"A{i + 1} {v:.9f}" for i, v in enumerate(degrees(c)))
        program.append(f"DECL E6AXIS XP{c + 1}={{{axes},E1 0.0,E2 0.0}}")
    return {"points.txt": text(*lines), "calib.dat": text(*program, "ENDDAT")}


@table("points and RTDE record of Universal Robots, joined by time")
def _rtde() -> Files:
    lines = ["time [s],point,x [m],y [m],z [m]"]
    for c, s, p in rows():
        lines.append(f"{TIME[c, s] + 0.1 * p:.3f},{POINTS[p]}," + numbers(POSITION[c, s, p]))
    record = ["timestamp " + " ".join(f"actual_q_{i}" for i in range(JOINTS))]
    for c in range(CONFIGURATIONS):
        times = np.arange(TIME[c, 0] - 5.0, TIME[c, -1] + 6.0, 0.5)
        record += [f"{at:.3f} " + numbers(Q[c], "{:.9f}", " ") for at in times]
    return {"points.csv": text(*lines), "rtde.csv": text(*record)}


# --- tables that need a map -------------------------------------------------------------------------------------------


@table(
    "own words for everything",
    files=[
        {
            "columns": {"Lage": "configuration", "Stufe": "step", "Kugel": "point", "R": "x", "H": "y", "V": "z"}
            | {f"W{i + 1}": f"q{i + 1}" for i in range(JOINTS)},
            "units": {"xyz": "mm", "q": "deg"},
        }
    ],
    points={"Kugel A": "mp1", "Kugel B": "mp2", "Kugel C": "mp3"},
)
def _own_words() -> Files:
    lines = ["Lage;Stufe;Kugel;R;H;V;" + ";".join(f"W{i + 1}" for i in range(JOINTS))]
    for c, s, p in rows():
        values = [*1e3 * POSITION[c, s, p], *degrees(c)]
        lines.append(f"{c + 1};{s};Kugel {'ABC'[p]};" + numbers(values, "{:.9f}", ";"))
    return {"lagen.csv": text(*lines)}


@table(
    "names of another pattern, joint angles within half a radian",
    files=[
        {"match": "p*", "name": r"(?P<point>mp\d)@(?P<configuration>\d+)#(?P<step>\d+)", "units": {"xyz": "mm"}},
        {"match": "robot*", "units": {"q": "rad"}},
    ],
)
def _pattern() -> Files:
    lines = ["Name,X,Y,Z"]
    for c, s, p in rows():
        lines.append(f"{POINTS[p]}@{c + 1}#{s}," + numbers(1e3 * POSITION[c, s, p], "{:.4f}"))
    robot = ["configuration," + ",".join(f"q{i + 1}" for i in range(JOINTS))]
    robot += [f"{c + 1}," + numbers(Q[c], "{:.9f}") for c in range(CONFIGURATIONS)]
    return {"points.csv": text(*lines), "robot.csv": text(*robot)}


WITHOUT_LOADS = {name for name in TABLES if "order, " in name}
WITHOUT_WRENCH = {
    name
    for name in TABLES
    if name in WITHOUT_LOADS
    or any(word in name for word in ("beside", "ROS", "Yaskawa", "RTDE", "own words", "pattern"))
}
