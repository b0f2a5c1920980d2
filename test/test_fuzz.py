"""A seeded fuzzer over every file that is read and every command that reads it.

Each case changes one good input and runs one command.  Whatever comes out: exit code 0 or 2, one line on stderr or
none, a whole result or the earlier one, in 10 s and 1 GB.  `make test` runs 300 cases, `make prove-input` 5,000.
"""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import load_cell
from calibration_core.cli import main
from calibration_core.commands import NAMES, WITHOUT_RESULT
from calibration_core.recording.bag import read_bag
from calibration_core.recording.bag_writer import write_bag

CASES = 300
MANY = int(os.environ.get("PROVE_INPUT_CASES", "5000"))
SEED, BATCH = 20261, 100
SECONDS, MEGABYTES = 10.0, 1000
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
    """One changed input and the command that reads it: arguments with `{role}` for the files."""

    number: int
    command: str
    role: str
    what: str
    arguments: tuple[str, ...]


READS: dict[str, tuple[tuple[str, ...], ...]] = {
    "plan": (("--cell", "{cell}", "--configurations", "12", "--spares", "0"),),
    "simulate": (
        ("--cell", "{cell}", "--plan", "{plan}"), ("--cell", "{cell}", "--plan", "{plan}", "--model", "{model}"),
    ),
    "identify": (
        ("{table}", "--cell", "{cell}"), ("{bag}", "--cell", "{cell}"), ("{mcap}", "--cell", "{cell}"),
        ("{db3}", "--cell", "{cell}"), ("{table}", "--cell", "{cell}", "--model", "{model}"),
        ("{table}", "--cell", "{cell}", "--test", "{mcap}"),
    ),
    "diagnose": (("{table}", "--cell", "{cell}"), ("{mcap}", "--cell", "{cell}", "--model", "{model}")),
    "predict": (
        ("{table}", "--cell", "{cell}", "--model", "{model}"), ("{db3}", "--cell", "{cell}", "--model", "{model}"),
        ("{bag}", "--cell", "{cell}", "--model", "{model}"),
    ),
    "import": (("{table}",), ("{table}", "--map", "{map}")),
    "describe": (("{result}",),),
}  # fmt: skip
OFTEN = {"plan": 1, "simulate": 3, "identify": 8, "diagnose": 2, "predict": 8, "import": 3, "describe": 1}


def test_every_command_is_fuzzed() -> None:
    assert set(READS) == set(NAMES) == set(OFTEN)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One good file of every kind, made by the program itself."""
    folder = tmp_path_factory.mktemp("good")
    cell = folder / "cell.yaml"
    cell.write_text(CELL, encoding="utf-8")
    rng = np.random.default_rng(1)
    plan = ["schema: 1", "configurations:"]
    for number in range(1, 7):
        q = ", ".join(f"{x:.3f}" for x in rng.uniform(-1.2, 1.2, 3))
        pull = rng.normal(size=3)
        steps = [[*(scale * 60 * pull / np.linalg.norm(pull)).round(2).tolist(), 0, 0, 0] for scale in (0.0, 0.5, 1.0)]
        plan.append(f"  - {{number: {number}, q: [{q}], steps: {json.dumps(steps)}}}")
    (folder / "plan.yaml").write_text("\n".join(plan) + "\n", encoding="utf-8")
    arguments = ["--cell", str(cell), "--no-report", "--out"]
    assert main(["simulate", "--plan", str(folder / "plan.yaml"), "--seed", "1", *arguments, str(folder / "made")]) == 0
    table = folder / "made" / "measurements.csv"
    assert main(["identify", str(table), *arguments, str(folder / "found")]) == 0
    bag = folder / "made" / "recording"
    loaded = load_cell(cell)
    write_bag(folder / "other", read_bag(bag, loaded), loaded, storage="sqlite3")
    (folder / "map.yaml").write_text("files: [{separator: ',', columns: {x: x, y: y, z: z}}]\n", encoding="utf-8")
    return {
        "cell": cell, "plan": folder / "plan.yaml", "table": table, "bag": bag, "mcap": next(bag.glob("*.mcap")),
        "db3": next((folder / "other").glob("*.db3")), "model": folder / "found" / "model.yaml",
        "map": folder / "map.yaml", "result": folder / "found" / "result.json",
    }  # fmt: skip


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


BYTES = (flipped, cut, doubled, torn, filled)
TEXT = (nasty_token, nasty_token, nasty_token, nasty_line, *BYTES)
TABLE = (scaled_column, scaled_column, *TEXT)
CHANGES: dict[str, tuple[Callable[[bytes, np.random.Generator], bytes], ...]] = {
    "cell": TEXT, "plan": TEXT, "model": TEXT, "map": TEXT, "result": TEXT, "bag": TEXT, "table": TABLE, "mcap": BYTES,
    "db3": BYTES,
}  # fmt: skip


def make_case(number: int, seed: int, good: dict[str, Path], folder: Path) -> Case:
    """Write the files of a case into a folder of its own."""
    rng = np.random.default_rng([seed, number])
    commands = [name for name, times in OFTEN.items() for _ in range(times)]
    command = commands[int(rng.integers(len(commands)))]
    arguments = READS[command][int(rng.integers(len(READS[command])))]
    roles = [text[1:-1] for text in arguments if text.startswith("{")]
    role = roles[int(rng.integers(len(roles)))]
    change = CHANGES[role][int(rng.integers(len(CHANGES[role])))]
    folder.mkdir(parents=True)
    files = dict(good)
    files[role] = folder / good[role].name
    if role == "bag":
        shutil.copytree(good[role], files[role])
        target = files[role] / "metadata.yaml"
        target.write_bytes(change(target.read_bytes(), rng))
    else:
        files[role].write_bytes(change(good[role].read_bytes(), rng))
    (folder / "out").mkdir()
    (folder / "out" / "result.json").write_text("earlier")
    placed = [str(files[text[1:-1]]) if text.startswith("{") else text for text in arguments]
    report = ("--no-report",) if "--cell" in arguments else ()
    out = () if command in WITHOUT_RESULT else ("--out", str(folder / "out"))
    return Case(number, command, role, change.__name__, (command, *placed, *report, *out))


# --- running --------------------------------------------------------------------------------------------------------

RUNNER = f"""
import contextlib, io, json, pathlib, signal, sys, time
from calibration_core.cli import main

class Hang(BaseException):
    pass

def hang(*_):
    raise Hang

signal.signal(signal.SIGALRM, hang)
for line in sys.stdin:
    case = json.loads(line)
    errors, output = io.StringIO(), io.StringIO()
    pathlib.Path("/proc/self/clear_refs").write_text("5")
    print(json.dumps({{"begin": case["number"]}}), flush=True)
    begin = time.monotonic()
    used = time.process_time()
    signal.setitimer(signal.ITIMER_REAL, {12 * SECONDS})
    with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(output):
        try:
            code = main(case["arguments"])
        except SystemExit as ended:
            code = ended.code
        except BaseException as error:
            code = repr(error)
    signal.setitimer(signal.ITIMER_REAL, 0)
    status = pathlib.Path("/proc/self/status").read_text()
    peak = int(status.split("VmHWM:")[1].split()[0]) // 1024
    answer = {{"number": case["number"], "code": code, "errors": errors.getvalue(), "output": output.getvalue()}}
    print(json.dumps({{**answer, "seconds": time.process_time() - used, "megabytes": peak}}), flush=True)
"""


def answers(cases: list[Case]) -> Iterator[dict[str, object]]:
    """Run cases in a process of their own; where it dies, the case at fault is told and the others go on."""
    left = list(cases)
    while left:
        lines = "".join(json.dumps({"number": one.number, "arguments": one.arguments}) + "\n" for one in left)
        done = subprocess.run(
            [sys.executable, "-c", RUNNER], input=lines, capture_output=True, text=True, check=False,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        said = [json.loads(line) for line in done.stdout.splitlines()]
        ended = [one for one in said if "code" in one]
        yield from ended
        left = left[len(ended) :]
        if left:
            text = done.stderr[-300:]
            yield {"number": left.pop(0).number, "code": f"died: {done.returncode}", "errors": text, "output": "",
                   "seconds": 0.0, "megabytes": 0}  # fmt: skip


def fault(case: Case, answer: dict[str, object], folder: Path) -> str:
    """Return what is wrong with an answer; empty if nothing is."""
    code, errors = answer["code"], str(answer["errors"])
    beside = {path.name for path in folder.iterdir()} - {"out"}
    if code not in (0, 2) or "Traceback" in errors:
        return f"exit code {code}: {errors[-300:]}"
    if float(str(answer["seconds"])) > SECONDS or int(str(answer["megabytes"])) > MEGABYTES:
        return f"{answer['seconds']} s, {answer['megabytes']} MB"
    if len(beside) > 1:
        return f"left beside the output: {beside}"
    check = refused if code == 2 else completed
    return check(case, errors, str(answer["output"]), folder / "out")


def refused(_: Case, errors: str, output: str, out: Path) -> str:
    if len(errors.splitlines()) != 1 or output or len(errors) > 1500 or ": found " not in errors:
        return f"not one line: {errors[:600]!r} {output[:100]!r}"
    return untouched(out)


def completed(case: Case, errors: str, output: str, out: Path) -> str:
    if errors or not output:
        return f"a result, and on stderr: {errors[:300]!r}"
    if case.command in WITHOUT_RESULT:
        return untouched(out)
    names = sorted(path.name for path in out.iterdir())
    result = json.loads((out / "result.json").read_text())
    whole = result["command"] == case.command and not any(name.startswith(".") for name in names)
    return "" if whole else f"half written: {names}"


def untouched(out: Path) -> str:
    names = sorted(path.name for path in out.iterdir())
    same = names == ["result.json"] and (out / "result.json").read_text() == "earlier"
    return "" if same else f"half written: {names}"


def fuzz(
    count: int, seed: int, good: dict[str, Path], folder: Path, batch: int = 100
) -> tuple[list[str], Counter[object]]:
    """Run so many cases; return what went wrong, and how often each exit code came."""
    wrong: list[str] = []
    codes: Counter[object] = Counter()
    for begin in range(0, count, BATCH):
        numbers = range(begin, min(begin + BATCH, count))
        cases = {number: make_case(number, seed, good, folder / str(number)) for number in numbers}
        for answer in answers(list(cases.values())):
            case = cases[int(str(answer["number"]))]
            codes[answer["code"]] += 1
            found = fault(case, answer, folder / str(case.number))
            if found:
                wrong.append(f"case {case.number} ({case.command}, {case.role} {case.what}): {found}")
        for number in numbers:
            shutil.rmtree(folder / str(number))
    return wrong, codes


@pytest.mark.skipif(sys.platform != "linux", reason="memory is measured through /proc")
def test_a_few_hundred_cases(good: dict[str, Path], tmp_path: Path) -> None:
    wrong, codes = fuzz(CASES, SEED, good, tmp_path / "cases")
    assert wrong == []
    assert codes[2] > CASES / 4  # the changes do harm
    assert codes[0] > CASES / 20  # and not only harm


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory is measured through /proc")
def test_thousands_of_cases(good: dict[str, Path], tmp_path: Path) -> None:
    wrong, codes = fuzz(MANY, SEED + 1, good, tmp_path / "cases")
    print(f"{sum(codes.values())} cases: {dict(codes)}")
    assert wrong == []
