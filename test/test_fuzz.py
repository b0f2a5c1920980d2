"""A seeded fuzzer over every file that is read and every command that reads it.

Each case changes one good input and runs one command.  Whatever comes out: exit code 0 or 2, one line on stderr or
none, a whole result or the earlier one, in 10 s and 1 GB.  `make test` runs 75 cases, `make prove-input` 5,000.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from fuzz_cases import OFTEN, READS, Case, call, good_files, make_case

from calibration_core.commands import NAMES, WITHOUT_RESULT

CASES = 75
MANY = int(os.environ.get("PROVE_INPUT_CASES", "5000"))
SEED, BATCH = 20261, 100
SECONDS, MEGABYTES = 10.0, 1000
JOBS = len(os.sched_getaffinity(0)) if sys.platform == "linux" else 1
NOTHING_TO_READ = {"completion"}
ELSEWHERE = {"fleet"}  # its manifests: src/calibration_core/test/fleet/test_manifest.py


def test_every_command_is_fuzzed() -> None:
    assert set(READS) == set(NAMES) - NOTHING_TO_READ - ELSEWHERE == set(OFTEN)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One good file of every kind."""
    return good_files(tmp_path_factory.mktemp("good"))


@pytest.mark.slow
def test_every_line_of_arguments_succeeds_on_good_files(good: dict[str, Path], tmp_path: Path) -> None:
    """Only then does a refusal come from the change."""
    cases = []
    for command, lines in READS.items():
        for line in lines:
            folder = tmp_path / str(len(cases))
            (folder / "out").mkdir(parents=True)
            (folder / "out" / "result.json").write_text("earlier")
            arguments = call(command, line, good, folder, report=False)
            cases.append(Case(len(cases), command, "", "nothing", arguments))
    said = [(cases[int(str(answer["number"]))], answer) for answer in answers(cases)]
    assert [(case.arguments, answer["errors"]) for case, answer in said if answer["code"] != 0] == []
    assert [found for case, answer in said if (found := fault(case, answer, tmp_path / str(case.number)))] == []


# --- running --------------------------------------------------------------------------------------------------------

RUNNER = f"""
import contextlib, faulthandler, io, json, pathlib, signal, sys, time
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
    faulthandler.dump_traceback_later({15 * SECONDS}, exit=True)  # where no signal gets through
    with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(output):
        try:
            code = main(case["arguments"])
        except SystemExit as ended:
            code = ended.code
        except BaseException as error:
            code = repr(error)
    faulthandler.cancel_dump_traceback_later()
    signal.setitimer(signal.ITIMER_REAL, 0)
    status = pathlib.Path("/proc/self/status").read_text()
    peak = int(status.split("VmHWM:")[1].split()[0]) // 1024
    code = code if code is None or isinstance(code, int) else str(code)
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
    said = str(answer["errors"]).splitlines(keepends=True)
    code, errors = (
        answer["code"],
        "".join(line for line in said if not line.rstrip().endswith("% done)")),
    )  # no progress
    beside = {path.name for path in folder.iterdir()} - {"out"}
    if code not in (0, 2) or "Traceback" in errors:
        return f"exit code {code}: {errors[-300:]}"
    if float(str(answer["seconds"])) > SECONDS or int(str(answer["megabytes"])) > MEGABYTES:
        return f"{answer['seconds']} s, {answer['megabytes']} MB"
    if len(beside) > 1:
        return f"left beside the output: {beside}"
    check = refused if code == 2 else completed
    return check(case, errors, str(answer["output"]), folder / "out")


def refused(case: Case, errors: str, output: str, out: Path) -> str:
    said = output.splitlines()
    expected = bool(said) == (case.command == "check")  # it lists every error on stdout
    if len(errors.splitlines()) != 1 or not expected or len(errors) > 1500 or ": found " not in errors:
        return f"not one line: {errors[:600]!r} {said[:2]!r}"
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


def fuzz(count: int, seed: int, good: dict[str, Path], folder: Path) -> tuple[list[str], Counter[tuple[str, object]]]:
    """Run so many cases; return what went wrong, and how often each exit code came of each command."""

    def batch(begin: int) -> tuple[list[str], list[tuple[str, object]]]:
        numbers = range(begin, min(begin + BATCH, count))
        cases = {number: make_case(number, seed, good, folder / str(number)) for number in numbers}
        wrong, codes = [], []
        for answer in answers(list(cases.values())):
            case = cases[int(str(answer["number"]))]
            codes.append((case.command, answer["code"]))
            found = fault(case, answer, folder / str(case.number))
            if found:
                wrong.append(f"case {case.number} ({case.command}, {case.role} {case.what}): {found}")
        for number in numbers:
            shutil.rmtree(folder / str(number))
        return wrong, codes

    with ThreadPoolExecutor(JOBS) as pool:
        parts = list(pool.map(batch, range(0, count, BATCH)))
    return [one for wrong, _ in parts for one in wrong], Counter(one for _, codes in parts for one in codes)


def exits(codes: Counter[tuple[str, object]], code: int) -> int:
    return sum(times for (_, each), times in codes.items() if each == code)


@pytest.mark.skipif(sys.platform != "linux", reason="memory is measured through /proc")
def test_some_cases(good: dict[str, Path], tmp_path: Path) -> None:
    wrong, codes = fuzz(CASES, SEED, good, tmp_path / "cases")
    assert wrong == []
    assert exits(codes, 2) > CASES / 4  # the changes do harm
    assert exits(codes, 0) > CASES / 20  # and not only harm


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory is measured through /proc")
def test_thousands_of_cases(good: dict[str, Path], tmp_path: Path) -> None:
    wrong, codes = fuzz(MANY, SEED + 1, good, tmp_path / "cases")
    for command in READS:
        print(
            f"{command}: "
            + ", ".join(f"{times} x exit {code}" for (name, code), times in codes.items() if name == command)
        )
    print(f"{sum(codes.values())} cases, wrong: {len(wrong)}")
    assert sum(codes.values()) == MANY
    assert wrong == []
