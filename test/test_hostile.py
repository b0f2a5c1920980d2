"""Hostile input: whatever is handed in, the answer is exit code 2 and one line, nothing half-written, memory bounded.

All cases run through two commands, a part of them through every command that reads them, in a process of its own, whose
processor time and peak memory are measured; one runs as users run it.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from hostile_cases import CASES, CELL, UNIDENTIFIED, prepare

from calibration_core.cell import load_cell
from calibration_core.commands import NAMES
from calibration_core.model.identified.model_file import model_text
from calibration_core.model.nominal import nominal_parameters

SECONDS = 3.0  # of processor time
MEGABYTES = 450
LINE = re.compile(r".{1,700}: found .{1,400}, expected .{1,400}\n")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, Path]]:
    """Cell file and recording of every case, made once: whoever is given them reads them alone."""
    folder = tmp_path_factory.mktemp("cases")
    return {name: prepare(name, folder / str(i)) for i, name in enumerate([*CASES, *UNIDENTIFIED])}


BATCH = """
import contextlib, io, json, pathlib, sys, time
from calibration_core.cli import main
from calibration_core.commands import command

for name in sys.argv[1:]:
    command(name)  # loading the libraries is not part of a case
for line in sys.stdin:
    case = json.loads(line)
    errors, output = io.StringIO(), io.StringIO()
    begin = time.process_time()
    with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(output):
        try:
            code = main(case["arguments"])
        except BaseException as error:
            code = repr(error)
    used = time.process_time() - begin
    peak = [line for line in pathlib.Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM")]
    told = [case["name"], code, errors.getvalue(), output.getvalue(), int(peak[0].split()[1]), used]
    print(json.dumps(told), flush=True)
"""
COMMANDS = {  # what each command reads of a case, and how it is called; a new command is tested by adding its name
    "plan": ("cell", "--cell {cell} --out {out}"),
    "simulate": ("cell", "--cell {cell} --out {out}"),
    "verify": ("recording", "{recording} --cell {cell} --model {model} --tolerance 1e-4 --out {out}"),
    "compare": ("recording", "{recording} {recording} --cell {cell} --out {out}"),
    "identify": ("recording", "{recording} --cell {cell} --out {out}"),
    "diagnose": ("recording", "{recording} --cell {cell} --out {out}"),
    "predict": ("recording", "{recording} --cell {cell} --model {model} --out {out}"),
    "deflect": ("cell", "--cell {cell} --model {model} --q 0.1,0.2,0.3 --wrench 1,2,3,0,0,0 --out {out}"),
    "compensate": ("cell", "{task} --cell {cell} --model {model} --out {out}"),
    "export": ("cell", "--cell {cell} --model {model} --format dh --out {out}"),
}
WHOLE, SOME = ("plan", "identify"), 5  # commands that read every case; of the others every fifth, by the same readers
TOGETHER = [(name,) for name in WHOLE] + [tuple(name for name in COMMANDS if name not in WHOLE)]  # in one process each
OTHERWISE = {"import", "describe", "init", "check", "completion", "fleet", "pendant"}  # they have tests of their own


def test_every_command_is_tested() -> None:
    assert COMMANDS.keys() | OTHERWISE == set(NAMES)


@pytest.mark.parametrize("commands", TOGETHER, ids=lambda commands: f"{commands[0]} {len(commands)}")
def test_the_program(commands: tuple[str, ...], files: dict[str, tuple[Path, Path]], tmp_path: Path) -> None:
    """Cases that commands read: exit code 2, one line, the output folder untouched, time and memory bounded."""
    (tmp_path / "good.yaml").write_text(CELL)
    good = load_cell(tmp_path / "good.yaml")
    (tmp_path / "model.yaml").write_text(model_text(nominal_parameters(good), good))
    (tmp_path / "task.csv").write_text("q1,q2,q3\n0.1,0.2,0.3\n")
    cases = []
    for command in commands:
        reads, form = COMMANDS[command]
        names = [name for name in CASES if reads == "recording" or name.startswith("cell: ")]
        names = names if command in WHOLE else names[::SOME]
        for name in [*names, *(UNIDENTIFIED if command == "identify" else ())]:
            cell, data = files[name]
            out = tmp_path / str(len(cases)) / "out"
            out.mkdir(parents=True)
            (out / "result.json").write_text("of an earlier run")
            given = {"cell": cell, "recording": data, "out": out, "model": tmp_path / "model.yaml",
                     "task": tmp_path / "task.csv"}  # fmt: skip
            words = [word.format(**given) for word in form.split(" ")]
            cases.append({"name": f"{command}: {name}", "arguments": [command, *words], "out": str(out)})
    lines = "".join(json.dumps(one) + "\n" for one in cases)
    done = subprocess.run(
        [sys.executable, "-c", BATCH, *commands], input=lines, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert [answer[0] for answer in answers] == [one["name"] for one in cases]
    wrong = [answer for answer in answers if answer[1] != 2 or not LINE.fullmatch(answer[2]) or answer[3]]
    assert wrong == []
    slow = [(answer[0], answer[5]) for answer in answers if answer[5] > SECONDS]
    assert slow == []
    assert answers[-1][4] < MEGABYTES * 1024
    for one in cases:
        assert [path.name for path in Path(one["out"]).iterdir()] == ["result.json"]
        assert Path(one["out"], "result.json").read_text() == "of an earlier run"


def test_as_users_run_it(files: dict[str, tuple[Path, Path]], tmp_path: Path) -> None:
    cell, data = files["mcap: a chunk that claims 2^60 bytes"]
    out = tmp_path / "out"
    words = ["identify", str(data), "--cell", str(cell), "--out", str(out)]
    command = [sys.executable, "-m", "calibration_core.cli", *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert done.stdout == ""
    assert not out.exists()
