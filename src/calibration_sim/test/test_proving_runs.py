"""How the proof has its recordings diagnosed: by the engine, by processes that see the recording alone, in time."""

from __future__ import annotations

import io
import json
import os
import shlex
import sys
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("distributed")

from calibration_core.engine.cluster import Cluster
from calibration_sim.proving import batch
from calibration_sim.proving.cli import main
from calibration_sim.proving.diagnosing import Answer, Piece, Settings, diagnose
from calibration_sim.proving.running import read_run, result_path, run_all
from calibration_sim.proving.writing import open_labels, recording_digest, write_recordings
from calibration_sim.scenarios.grid import grid

RESULT: dict[str, Any] = {"schema": 1, "verdict": "consistent", "findings": [], "anomalies": [], "stiffness": []}
# A stand-in for the diagnosis: notes what it was given, says "consistent", fails where asked to.
PROGRAM = f"""
import json, pathlib, sys, time
args = sys.argv[1:]
out = pathlib.Path(args[args.index("--out") + 1])
with open(pathlib.Path(__file__).with_name("calls.txt"), "a") as calls:
    calls.write(json.dumps(args) + "\\n")
mode = pathlib.Path(__file__).with_name("mode.txt").read_text()
if mode == "fail":
    sys.exit("measurements.csv: line 3: found 'x', expected a number")
if mode == "hang":
    time.sleep(60)
(out / "result.json").write_text(json.dumps({RESULT!r}))
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    path = tmp_path / "program.py"
    path.write_text(PROGRAM)
    (tmp_path / "mode.txt").write_text("well")
    return path


def _command(program: Path) -> tuple[str, ...]:
    return sys.executable, str(program)


def _calls(program: Path) -> list[list[str]]:
    return [json.loads(line) for line in program.with_name("calls.txt").read_text().splitlines()]


def test_end_to_end_with_a_stand_in(tmp_path: Path, program: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The hash comes first, the diagnosis is given two files and a folder, a second call runs nothing again."""
    out = tmp_path / "proof"
    command = shlex.join(_command(program))
    arguments = ["--seed", "5", "--out", str(out), "--count", "3", "--jobs", "1", "--command", command]
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert said.startswith("SHA-256 of the labels: ")
    digest = said.splitlines()[0].rsplit(" ", 1)[1]
    assert set(open_labels(out, digest)) == {path.name for path in (out / "recordings").iterdir()}
    calls = _calls(program)
    assert len(calls) == 3
    for recording, key, cell, option, folder in calls:
        assert (key, option) == ("--cell", "--out")
        assert {path.name for path in Path(recording).parent.iterdir()} == {"measurements.csv", "cell.yaml"}
        assert Path(cell).parent == Path(recording).parent
        assert Path(folder).name == Path(recording).parent.name
    assert json.loads((out / "table.json").read_text())["labels"] == digest
    assert (out / "table.md").read_text() in said
    assert main(arguments) == 0
    assert len(_calls(program)) == 3
    cell = next((out / "recordings").iterdir()) / "cell.yaml"
    cell.write_text(cell.read_text() + "\n")
    assert main(arguments) == 0  # that recording is written anew, the same as before, and its result still holds
    assert len(_calls(program)) == 3
    assert capsys.readouterr().out.count(digest) == 4


@pytest.mark.parametrize(("options", "named"), [
    (("--report", "--batch"), "--batch"), (("--report", "--limit", "120"), "--limit"),
    (("--report", "--command", "x"), "--command"), (("--report", "--cluster", "tcp://h:1"), "--cluster"),
    (("--tls", "a", "b", "c"), "--tls"),
])  # fmt: skip
def test_an_option_without_effect_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], named: str
) -> None:
    out = tmp_path / "proof"
    assert main(["--out", str(out), "--count", "1", *options]) == 2
    assert f"calibration-prove: {named}: found an option that has no effect" in capsys.readouterr().err
    assert not out.exists()


def test_labels_that_were_touched_are_refused(tmp_path: Path) -> None:
    scenarios = grid(5)
    _, digest = write_recordings(scenarios[:1], len(scenarios), tmp_path, jobs=1)
    (tmp_path / "labels.json").write_text("{}")
    with pytest.raises(ValueError, match="sealed as"):
        open_labels(tmp_path, digest)


def _recorded(tmp_path: Path) -> tuple[Path, str]:
    folder = tmp_path / "proof" / "recordings" / "r0001"
    folder.mkdir(parents=True)
    (folder / "measurements.csv").write_text("a table")
    (folder / "cell.yaml").write_text("a cell")
    return tmp_path / "proof", recording_digest(folder)


def _diagnosed(out: Path, command: tuple[str, ...], **changes: Any) -> Answer:
    return diagnose(Piece(out / "recordings" / "r0001", Settings(command, **changes)))


def test_failures_and_time_limits_are_recorded(tmp_path: Path, program: Path) -> None:
    out, digest = _recorded(tmp_path)
    mode = program.with_name("mode.txt")
    mode.write_text("fail")
    failed = _diagnosed(out, _command(program))
    assert (failed.run.exit, failed.run.sha256, failed.result) == (1, digest, b"")
    assert failed.run.error.startswith("measurements.csv: line 3")
    mode.write_text("hang")
    hung = _diagnosed(out, _command(program), limit=1.0)
    assert hung.run.exit == -1
    assert hung.run.seconds < 10.0
    mode.write_text("well")
    well = _diagnosed(out, _command(program))
    assert well.run.exit == 0
    assert well.run.megabytes > 3.0
    assert well.run.processor is not None
    assert 0.0 < well.run.processor <= well.run.seconds * (os.cpu_count() or 1)
    assert json.loads(well.result) == RESULT


def test_what_failed_is_tried_again_and_what_is_done_is_not(tmp_path: Path, program: Path) -> None:
    """Workers of the engine do it; the processes that they start see the recording alone."""
    out, digest = _recorded(tmp_path)
    settings, mode = Settings(_command(program)), program.with_name("mode.txt")
    mode.write_text("fail")
    run_all(["r0001"], out, settings, Cluster(jobs=1))
    failed = read_run(out, "r0001")
    assert failed is not None
    assert (failed.exit, failed.sha256) == (1, digest)
    assert not result_path(out, "r0001").is_file()
    mode.write_text("well")
    for _ in range(2):
        run_all(["r0001"], out, settings, Cluster(jobs=1))
        well = read_run(out, "r0001")
        assert well is not None
        assert well.exit == 0
        assert json.loads(result_path(out, "r0001").read_text()) == RESULT
    assert len(_calls(program)) == 2


SERVED = """
import json, os, pathlib, sys, time
def main(arguments):
    out = pathlib.Path(arguments[arguments.index("--out") + 1])
    if pathlib.Path(__file__).with_name("mode.txt").read_text() == "hang":
        time.sleep(60)
    (out / "result.json").write_text(json.dumps({"process": os.getpid()}))
"""


def test_one_process_takes_many_recordings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Until one takes too long: then the next recording has a new process."""
    out, _ = _recorded(tmp_path)
    (tmp_path / "served.py").write_text(SERVED)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    mode, command = tmp_path / "mode.txt", ("calibration", "diagnose")
    mode.write_text("well")
    first, second = (json.loads(_diagnosed(out, command, entry="served:main").result) for _ in range(2))
    assert first == second
    mode.write_text("hang")
    hung = _diagnosed(out, command, entry="served:main", limit=1.0)
    assert (hung.run.exit, hung.result) == (-1, b"")
    mode.write_text("well")
    assert json.loads(_diagnosed(out, command, entry="served:main").result) != first


def test_a_defect_of_what_is_served_is_an_answer(tmp_path: Path) -> None:
    """`os.path:join` stands in for the diagnosis: it answers without being a program, so every call is a defect."""
    out, _ = _recorded(tmp_path)
    answer = _diagnosed(out, ("calibration", "diagnose"), entry="os.path:join")
    assert answer.run.exit == 1
    assert "TypeError" in answer.run.error


def test_batch_answers_every_line() -> None:
    def call(arguments: list[str]) -> int:
        if arguments == ["exit"]:
            sys.exit(2)
        if arguments == ["fault"]:
            raise ValueError("a defect")
        sys.stderr.write("one\ntwo\n")
        return 0

    answers = io.StringIO()
    batch.serve(call, io.StringIO('["well"]\n["exit"]\n["fault"]\n'), answers)
    replies = [json.loads(line) for line in answers.getvalue().splitlines()]
    assert [reply["exit"] for reply in replies] == [0, 2, 1]
    assert replies[0]["error"] == "two"
    assert replies[2]["error"] == "ValueError: a defect"
    assert replies[0]["megabytes"] > 3.0


def test_batch_counts_the_processor_time_of_the_call_alone() -> None:
    def call(arguments: list[str]) -> int:
        begun = time.process_time()
        while time.process_time() - begun < float(arguments[0]):
            pass
        return 0

    answers = io.StringIO()
    batch.serve(call, io.StringIO('["0.3"]\n["0.0"]\n'), answers)
    busy, idle = (json.loads(line)["processor"] for line in answers.getvalue().splitlines())
    assert 0.29 < busy < 1.0
    assert idle < 0.2
