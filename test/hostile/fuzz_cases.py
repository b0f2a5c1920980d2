"""Changed inputs for the fuzzer: good files of every kind, what is done to them, and the commands that read them."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
from export_cases import template, ur

from calibration_core.cell import Cell, load_cell
from calibration_core.cli import main
from calibration_core.commands import WITHOUT_RESULT
from calibration_core.measurement.session import DATABASE, Session
from calibration_core.observations.observe import observe
from calibration_core.recording.bags.bag import read_bag
from calibration_core.recording.bags.writer import write_bag
from calibration_core.recording.session_values import ConfirmedReading
from calibration_core.timeseries import Readings

URDF = Path(__file__).resolve().parents[2] / "config" / "robots" / "kuka_kr6_r900.urdf"
WITH_REPORT = 0.02  # of the cases of commands that write one: it takes far longer than the rest
CELL = """name: a cell
robot:
  name: a robot
  dh: [{a: 0.05, alpha: -1.5708, d: 0.4}, {a: 0.45, alpha: 0, d: 0}, {a: 0.3, alpha: 1.5708, d: 0.2, theta: 0.1}]
  joints: [j1, j2, j3]
  joint_limits: [[-3, 3], [-2, 2], [-2, 2]]
  inertials: [{mass: 8, com: [0, 0, 0]}, {mass: 5, com: [-0.2, 0, 0]}, {mass: 3, com: [-0.1, 0, 0]}]
  rated_load: 10
  stiffness: [1.0e5, 1.0e5, 5.0e4]
frames:
  tracker: {xyz: [2, 0, 1], rpy: [0, 0, 3.0]}
  force_torque: {xyz: [0, 0, 0.02], rpy: [0, 0, 0.5]}
  wrench_point: [0.03, 0.02, 0.1]
  measurement_points: {mp1: [0.1, 0, 0.05], mp2: [0, 0.1, 0.05], mp3: [-0.1, 0, 0.08]}
instruments:
  tracker: {sigma: 2.0e-5}
  force_torque: {sigma_force: 0.1, sigma_torque: 0.05}
  temperature: {sigma: 0.1}
topics: {wrench: /force_torque/wrench}
"""
NASTY = (
    "nan", ".nan", "inf", "-inf", "1e300", "-1e300", "1e-300", "1e400", "9" * 400, "0x" + "F" * 5000, "-1", "0", "''",
    "null", "true", "[]", "{}", "*a", "&a x", "!!int ''", "!!python/none", "<<", "1:59:59", "2024-01-05", "\u202e",
    "\x00", "\ud800".encode("utf-8", "surrogatepass").decode("latin-1"), "=1+1", "x" * 5000, "[" * 200, "{a: " * 200,
    "1,5", "../../etc/passwd", "/dev/zero", "/dev/stdin", "18446744073709551616", "2147483648", "\t", "'", '"', "#",
    "%", "---", "0.1 0.2",
)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Case:
    """One changed input and the command that reads it."""

    number: int
    command: str
    role: str
    what: str
    arguments: tuple[str, ...]


Line = tuple[str, ...]
FITTED = ("--cell", "{cell}", "--model", "{model}")
READS: dict[str, tuple[Line, ...]] = {  # command -> lines of arguments, `{role}` for a file
    "plan": (
        ("--cell", "{cell}", "--configurations", "12", "--spares", "0"),
        (*FITTED, "--configurations", "12", "--spares", "0", "--task", "{task}", "--load-levels", "0", "1"),
        (*FITTED, "--for", "verify", "--tolerance", "1e-3", "--risk", "0.05"),
        ("--cell", "{cell}", "--for", "geometry", "--box", "-1", "1", "-1", "1", "0", "2", "--seed", "3"),
    ),
    "pendant": (
        ("{route}", "--cell", "{urdf_cell}", "--maker", "ur"),
        ("{route}", "--cell", "{urdf_cell}", "--maker", "fanuc", "--map", "{coupling}"),
        ("{route}", "--cell", "{urdf_cell}", "--maker", "kuka", "--axis-speeds", "360 300 360 381 388 615"),
    ),
    "simulate": (
        ("--cell", "{cell}", "--plan", "{plan}"), (*FITTED, "--plan", "{plan}"),
        ("--cell", "{cell}", "--plan", "{plan}", "--seed", "4"),
    ),
    "identify": (
        ("{table}", "--cell", "{cell}"), ("{bag}", "--cell", "{cell}"), ("{mcap}", "--cell", "{cell}"),
        ("{db3}", "--cell", "{cell}"), ("{session}", "--cell", "{cell}"), ("{table}", *FITTED),
        ("{other}", "--cell", "{cell}", "--test", "{mcap}"), ("{rest}", "--cell", "{cell}"),
        ("{table}", "--cell", "{cell}", "--readmit", "1:1:mp1", "--method", "linear", "--deflections", "pose"),
        ("{table}", "{other}", "--cell", "{cell}"), ("{rest}", "{other}", "--cell", "{cell}", "--cell", "{cell}"),
    ),
    "diagnose": (
        ("{table}", "--cell", "{cell}"), ("{mcap}", *FITTED), ("{rest}", "--cell", "{cell}"),
        ("{table}", "--cell", "{cell}", "--simulation", "{other}"), ("{session}", "--cell", "{cell}"),
    ),
    "predict": (
        ("{table}", *FITTED), ("{db3}", *FITTED), ("{bag}", *FITTED), ("{session}", *FITTED), ("{rest}", *FITTED),
    ),
    "export": (
        (*FITTED, "--format", "dh"), (*FITTED, "--format", "mjcf"), (*FITTED, "--format", "urdf"),
        (*FITTED, "--format", "table", "--joints", "2", "3", "--points", "5", "--q", "0 0 0", "--range", "-1 1 -1 1"),
        ("--cell", "{ur}", "--model", "{ur_model}", "--format", "ur", "--template", "{template}"),
    ),
    "deflect": (
        (*FITTED, "--q", "0.1 0.2 0.3", "--wrench", "10 20 30 0 0 0", "--payload", "2 0 0 0.1"),
        (*FITTED, "--poses", "{task}", "--axes", "tool"), (*FITTED, "--poses", "{places}", "--wrench", "1 2 3 0 0 0"),
    ),
    "compensate": (
        ("{task}", *FITTED), ("{places}", "--cell", "{cell}", "--model", "{model}", "--wrench", "0 0 -40 0 0 0"),
        ("{places}", *FITTED, "--wrench", "0 0 -40 0 0 0", "--payload", "2 0 0 0.1", "--seed-q", "0.1 0.2 0.3"),
    ),
    "verify": (
        ("{other}", *FITTED, "--tolerance", "1e-4"), ("{other}", *FITTED, "--tolerance", "1e-4", "--fit-tracker"),
        ("{rest}", *FITTED, "--tolerance", "1e-4"),
    ),
    "compare": (
        ("{table}", "{other}", "--cell", "{cell}"), ("{outcome}", "{table}", "--cell", "{cell}"),
        ("{outcome}", "{outcome}", "--cell", "{cell}", "--dates", "2024-01-05", "2025-01-05"),
        ("{session}", "{mcap}", "{other}", "--cell", "{cell}", "--cell", "{cell}", "--cell", "{cell}"),
    ),
    "import": (("{table}",), ("{table}", "--map", "{map}"), ("{points}", "{angles}"), ("{program}", "{points}")),
    "describe": (("{result}",), ("{outcome}",)),
    "init": (
        ("{urdf}", "--rated-load", "9", "--point", "mp1=0.1,0,0"), ("{described}", "--rated-load", "9"),
        ("{urdf}", "--rated-load", "9", "--tracker", "2", "0", "1", "0", "0", "3", "--tracker-sigma", "2e-5"),
    ),
    "check": (
        ("{cell}",), ("{cell}", "{table}"), ("{cell}", "{mcap}"), ("{cell}", "{session}"), ("{urdf_cell}",),
    ),
}  # fmt: skip
OFTEN = {
    "plan": 2, "pendant": 2, "simulate": 3, "identify": 8, "diagnose": 4, "predict": 7, "export": 4, "deflect": 3,
    "compensate": 4, "verify": 4, "compare": 4, "import": 4, "describe": 1, "init": 2, "check": 4,
}  # fmt: skip
DRAWN = {"plan", "simulate", "identify", "diagnose", "predict", "deflect", "compensate", "verify", "compare", "check"}

# --- good files -----------------------------------------------------------------------------------------------------


def good_files(folder: Path) -> dict[str, Path]:
    """Make one good file or folder of every role, most of them by the program itself."""
    cell = _written(folder / "cell.yaml", CELL)
    plan = _written(folder / "plan.yaml", _plan())
    out = ["--cell", str(cell), "--no-report", "-q", "--out"]
    for seed in (1, 2, 3):  # what a model was identified from verifies none
        assert main(["simulate", "--plan", str(plan), "--seed", str(seed), *out, str(folder / f"made_{seed}")]) == 0
    table, bag = folder / "made_1" / "measurements.csv", folder / "made_1" / "recording"
    assert main(["identify", str(table), *out, str(folder / "found")]) == 0
    loaded = load_cell(cell)
    write_bag(folder / "sqlite", read_bag(bag, loaded), loaded, storage="sqlite3")
    described = dataclasses.replace(read_bag(bag, loaded), robot_description=URDF.read_text(encoding="utf-8"))
    write_bag(folder / "described", described, loaded)
    of = ur(folder)
    rows = (folder / "made_3" / "measurements.csv").read_text().splitlines()
    unloaded = [row for row in rows[1:] if row.split(",")[rows[0].split(",").index("step")] == "0"]
    cell_of_urdf = CELL.replace(CELL[CELL.index("  dh:") : CELL.index("  joint_limits:")],
                                f"  urdf: {URDF}\n  base_link: base_link\n  flange: flange\n  joints: [joint_a1, "
                                "joint_a2, joint_a3, joint_a4, joint_a5, joint_a6]\n")  # fmt: skip
    cell_of_urdf = cell_of_urdf.replace(cell_of_urdf[cell_of_urdf.index("  joint_limits:") : cell_of_urdf.index(
        "  rated_load:")], "").replace("  stiffness: [1.0e5, 1.0e5, 5.0e4]\n", "")  # fmt: skip
    return {
        "cell": cell, "plan": plan, "table": table, "other": folder / "made_2" / "measurements.csv", "bag": bag,
        "mcap": next(bag.glob("*.mcap")), "db3": next((folder / "sqlite").glob("*.db3")),
        "session": _session(folder / "session", observe(table, loaded), loaded),
        "model": folder / "found" / "model.yaml", "outcome": folder / "found",
        "result": folder / "found" / "result.json", "urdf": URDF,
        "described": next((folder / "described").glob("*.mcap")), "ur": of.cell_path, "ur_model": of.model_path,
        "template": template(folder), "urdf_cell": _written(folder / "urdf.cell.yaml", cell_of_urdf),
        "rest": _written(folder / "rest.csv", "\n".join([rows[0], *unloaded]) + "\n"),
        "task": _written(folder / "task.csv", "q1,q2,q3,fx,fy,fz,tx,ty,tz,path\n0.1,0.2,0.3,5,6,-40,0,0,0,a\n"
                                              "0.2,0.2,0.4,5,6,-40,0,0,0,a\n"),
        "places": _written(folder / "places.csv", "x,y,z,roll,pitch,yaw,time\n0.6,0.1,0.5,0,1.5,0,0\n0.61,0.1,0.5,0,"
                                                  "1.5,0,1\n"),
        "route": _written(folder / "route.yaml", _plan(6, 0.7)),
        "coupling": _written(folder / "coupling.yaml", "joint_coupling: {q3: {q2: 1.0}}\n"),
        "map": _written(folder / "map.yaml", "files: [{separator: ',', columns: {x: x, y: y, z: z}}]\n"),
        "points": _written(folder / "points.txt", "Name;X [mm];Y [mm];Z [mm]\n" + "".join(
            f"C{k}_S1_mp1;{1000 + 3 * k},5;{20 * k},25;{700 - k},125\n" for k in range(1, 7))),
        "angles": _written(folder / "angles.csv", "No,J1 [deg],J2 [deg],J3 [deg]\n" + "".join(
            f"{k},{3 * k},{-2 * k},{k}\n" for k in range(1, 7))),
        "program": _written(folder / "program.src", "DEF prog()\n" + "".join(
            f"PTP {{A1 {k}, A2 -90, A3 90, A4 0, A5 {2 * k}, A6 0}}\n" for k in range(1, 7)) + "END\n"),
    }  # fmt: skip


def _written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def _plan(joints: int = 3, most: float = 1.2) -> str:
    rng = np.random.default_rng(1)
    lines = ["schema: 1", "configurations:"]
    for number in range(1, 13):
        q = ", ".join(f"{x:.3f}" for x in rng.uniform(-most, most, joints))
        pull = rng.normal(size=3)
        steps = [[*(scale * 60 * pull / np.linalg.norm(pull)).round(2).tolist(), 0, 0, 0] for scale in (0.0, 0.5, 1.0)]
        lines.append(f"  - {{number: {number}, q: [{q}], steps: {json.dumps(steps)}}}")
    return "\n".join(lines) + "\n"


def _session(directory: Path, readings: Readings, cell: Cell) -> Path:
    assert readings.wrench is not None
    with Session.create(directory, "schema: 1\n", cell) as session:
        for number in np.unique(readings.configuration).tolist():
            attempt = session.begin_attempt(number, 0)
            for step in np.unique(readings.step[readings.configuration == number]).tolist():
                rows = np.flatnonzero((readings.configuration == number) & (readings.step == step)).tolist()
                session.record(attempt, [
                    ConfirmedReading(
                        number, step, readings.points[int(readings.point[i])], 10**9 * (1_700_000_000 + i),
                        readings.q[i], readings.position[i], 4e-10 * np.eye(3), 20, readings.wrench[i], np.eye(6), 20.5,
                    )
                    for i in rows
                ])  # fmt: skip
            session.end_attempt(attempt, completed=True)
    return directory


# --- changes --------------------------------------------------------------------------------------------------------


def flipped(data: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        changed[int(rng.integers(len(changed)))] = int(rng.integers(256))
    return bytes(changed)


def cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: int(rng.integers(len(data)))]


def doubled(data: bytes, rng: np.random.Generator) -> bytes:
    begin, end = sorted(int(x) for x in rng.integers(0, len(data), 2))
    return data[:end] + data[begin:end] + data[end:]


def torn(data: bytes, rng: np.random.Generator) -> bytes:
    begin, end = sorted(int(x) for x in rng.integers(0, len(data), 2))
    return data[:begin] + data[min(end, begin + 5000) :]


def filled(data: bytes, rng: np.random.Generator) -> bytes:
    begin = int(rng.integers(len(data)))
    size = int(rng.integers(1, 64))
    return data[:begin] + bytes([int(rng.choice([0, 0xFF, 0x20]))]) * size + data[begin + size :]


def nasty_token(data: bytes, rng: np.random.Generator) -> bytes:
    """Put a nasty word in the place of a number or name."""
    text = data.decode("utf-8", "replace")
    marks = [i for i, char in enumerate(text) if char in " ,:[\n"]
    at = marks[int(rng.integers(len(marks)))] + 1
    end = at
    while end < len(text) and text[end] not in ",]}\n:":
        end += 1
    word = NASTY[int(rng.integers(len(NASTY)))]
    return (text[:at] + word + text[end:]).encode("utf-8", "surrogatepass")


def digits(data: bytes, rng: np.random.Generator) -> bytes:
    """Exchange a few digits: what stays readable, and is wrong."""
    changed = bytearray(data)
    places = [i for i, byte in enumerate(data) if byte in b"0123456789.-"]
    for i in rng.choice(places, int(rng.integers(1, 6))) if places else []:
        changed[int(i)] = int(rng.choice(list(b"0123456789")))
    return bytes(changed)


def nasty_line(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    i, j = (int(x) for x in rng.integers(0, len(lines), 2))
    kind = int(rng.integers(4))
    if kind == 0:
        del lines[i]
    elif kind == 1:
        lines.insert(i, lines[j])
    elif kind == 2:
        lines[i], lines[j] = lines[j], lines[i]
    else:
        lines[i] = lines[i] * int(rng.integers(2, 50))
    return b"\n".join(lines)


def scaled_column(data: bytes, rng: np.random.Generator) -> bytes:
    """Multiply one column of a table, or all numbers of one line of YAML: signs, units, absurd sizes."""
    factor = float(rng.choice([-1.0, 0.0, 1e-3, 1e3, 180 / np.pi, 1e6, 1e150, 1e-150]))
    rows = [line.split(",") for line in data.decode("utf-8").split("\n")]
    column = int(rng.integers(len(rows[0])))
    for row in rows[1:]:
        if column < len(row):
            try:
                row[column] = repr(float(row[column]) * factor)
            except ValueError:
                continue
    return "\n".join(",".join(row) for row in rows).encode()


def nasty_argument(arguments: Line, rng: np.random.Generator) -> Line:
    """Put a nasty word in the place of one argument that is no file, or of a part of it."""
    able = [i for i, text in enumerate(arguments) if not text.startswith(("{", "--"))]
    if not able:
        return arguments
    i = able[int(rng.integers(len(able)))]
    words = arguments[i].split(" ")
    words[int(rng.integers(len(words)))] = ARGUABLE[int(rng.integers(len(ARGUABLE)))]
    return (*arguments[:i], " ".join(words), *arguments[i + 1 :])


ARGUABLE = tuple(word for word in NASTY if "\x00" not in word and len(word) < 500)  # what a shell can hand over
Change = Callable[[bytes, np.random.Generator], bytes]
BYTES: tuple[Change, ...] = (flipped, cut, doubled, torn, filled)
TEXT: tuple[Change, ...] = (nasty_token, nasty_token, nasty_token, nasty_line, digits, digits, *BYTES)
TABLE: tuple[Change, ...] = (scaled_column, scaled_column, digits, *TEXT)
CHANGES = dict.fromkeys(("table", "other", "rest", "task", "places", "points", "angles"), TABLE) | dict.fromkeys(
    ("mcap", "db3", "session", "described"), BYTES)  # fmt: skip
INSIDE = {"bag": ("metadata.yaml",), "session": (DATABASE,), "outcome": ("result.json", "model.yaml")}
IN_ARGUMENTS = 0.08  # of the cases


def make_case(number: int, seed: int, good: dict[str, Path], folder: Path) -> Case:
    """Write the files of a case into a folder of its own."""
    rng = np.random.default_rng([seed, number])
    commands = [name for name, times in OFTEN.items() for _ in range(times)]
    command = commands[int(rng.integers(len(commands)))]
    arguments = READS[command][int(rng.integers(len(READS[command])))]
    roles = [text[1:-1] for text in arguments if text.startswith("{")]
    role = roles[int(rng.integers(len(roles)))]
    files, what = dict(good), "argument"
    folder.mkdir(parents=True)
    changed = nasty_argument(arguments, rng) if rng.random() < IN_ARGUMENTS else arguments
    if changed is arguments:
        change = CHANGES.get(role, TEXT)[int(rng.integers(len(CHANGES.get(role, TEXT))))]
        what, files[role] = change.__name__, _changed(role, good[role], folder, change, rng)
    (folder / "out").mkdir()
    (folder / "out" / "result.json").write_text("earlier")
    report = command in DRAWN and rng.random() < WITH_REPORT
    return Case(number, command, role, what, call(command, changed, files, folder, report=report))


def call(command: str, line: Line, files: dict[str, Path], folder: Path, *, report: bool) -> tuple[str, ...]:
    """Return the arguments of the program: files for roles, an output folder, with a report or without."""
    placed = [str(files.get(text[1:-1], text)) if text.startswith("{") else text for text in line]
    quiet = () if report or command not in DRAWN else ("--no-report",)
    out = () if command in WITHOUT_RESULT else ("--out", str(folder / "out"))
    return (command, *placed, *quiet, *out)


def _changed(role: str, path: Path, folder: Path, change: Change, rng: np.random.Generator) -> Path:
    """Copy a good file or folder, and change it, or one of the files in it."""
    there = folder / path.name
    if role not in INSIDE:
        there.write_bytes(change(path.read_bytes(), rng))
        return there
    shutil.copytree(path, there)
    target = there / INSIDE[role][int(rng.integers(len(INSIDE[role])))]
    target.write_bytes(change(target.read_bytes(), rng))
    return there
