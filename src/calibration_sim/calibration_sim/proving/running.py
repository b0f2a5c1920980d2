"""Runs the diagnosis on every recording, in processes of its own that are told nothing but the recording.

One process per recording, or a few that take one recording after another (start-up then counts once).  A recording
whose result is there, made from the same files, is not run again.
"""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tqdm import tqdm

from calibration_sim.proving.writing import CELL, TABLE, folder_of, recording_digest

RUN, RESULT = "run.json", "result.json"
MEGABYTE = 1024.0  # kilobytes, in which Linux counts


@dataclasses.dataclass(frozen=True)
class Settings:
    """How the diagnosis is run.

    Attributes:
        command: Program and first arguments; `RECORDING --cell CELL --out DIR` is added.
        entry: `module:function` to be called in a process that takes many recordings; empty: one process each.
        jobs: Processes at a time.
        limit: s, for one recording.
    """

    command: tuple[str, ...]
    entry: str = ""
    jobs: int = 2
    limit: float = 120.0


@dataclasses.dataclass(frozen=True)
class Run:
    """How one diagnosis went.

    Attributes:
        sha256: Of the recording's files.
        exit: Exit code; -1: over the time limit or killed.
        seconds: Wall time.
        megabytes: Largest resident memory of the process.
        error: Last line on stderr.
        processor: User and system time of the process and its children, s: what a quiet machine would take, for one
            core at a time is used; None where it was not recorded.
    """

    sha256: str
    exit: int
    seconds: float
    megabytes: float
    error: str = ""
    processor: float | None = None


def run_all(names: Sequence[str], out: Path, settings: Settings) -> None:
    """Diagnose all recordings that have no result yet; results stand in OUT/results/NAME."""
    waiting = [name for name in names if not _is_done(name, out)]
    bar = tqdm(total=len(names), initial=len(names) - len(waiting), desc="diagnosis", unit="rec", mininterval=1.0)
    lock = threading.Lock()

    def work(diagnose: Callable[[str], Run]) -> None:
        while True:
            with lock:
                if not waiting:
                    return
                name = waiting.pop(0)
            run = diagnose(name)
            (_result_folder(out, name) / RUN).write_text(json.dumps(dataclasses.asdict(run)), encoding="utf-8")
            with lock:
                bar.update()

    def worker(_: int) -> None:
        if settings.entry:
            with _Server(out, settings) as server:
                work(server.diagnose)
        else:
            work(lambda name: _alone(name, out, settings))

    with bar, ThreadPoolExecutor(settings.jobs) as pool:
        for _ in pool.map(worker, range(settings.jobs)):
            pass


def read_run(out: Path, name: str) -> Run | None:
    """Return how a recording's diagnosis went; None: it was not run."""
    path = _result_folder(out, name) / RUN
    return Run(**json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else None


def result_path(out: Path, name: str) -> Path:
    """Return where a recording's result stands."""
    return _result_folder(out, name) / RESULT


def _result_folder(out: Path, name: str) -> Path:
    return out / "results" / name


def _is_done(name: str, out: Path) -> bool:
    run = read_run(out, name)
    return (
        run is not None
        and run.exit == 0
        and result_path(out, name).is_file()
        and run.sha256 == recording_digest(folder_of(out, name))
    )


def _arguments(name: str, out: Path) -> list[str]:
    folder = folder_of(out, name)
    return [str(folder / TABLE), "--cell", str(folder / CELL), "--out", str(_prepared(out, name))]


def _prepared(out: Path, name: str) -> Path:
    """Make the folder for a result; one left from before goes away."""
    folder = _result_folder(out, name)
    folder.mkdir(parents=True, exist_ok=True)
    for stale in (RUN, RESULT):
        (folder / stale).unlink(missing_ok=True)
    return folder


def _alone(name: str, out: Path, settings: Settings) -> Run:
    """Run one process for one recording."""
    digest, begun = recording_digest(folder_of(out, name)), time.monotonic()
    log = _prepared(out, name) / "stderr.txt"
    with log.open("wb") as stream:
        process = subprocess.Popen(
            [*settings.command, *_arguments(name, out)], stdout=subprocess.DEVNULL, stderr=stream, env=_environment()
        )
        timer = threading.Timer(settings.limit, process.kill)
        timer.start()
        _, status, usage = os.wait4(process.pid, 0)
        timer.cancel()
        process.returncode = os.waitstatus_to_exitcode(status)
    exit_code = process.returncode if process.returncode >= 0 else -1
    seconds = time.monotonic() - begun
    error = _last_line(log.read_text(errors="replace"))
    processor = usage.ru_utime + usage.ru_stime
    return Run(digest, exit_code, seconds, usage.ru_maxrss / MEGABYTE, error, processor)


class _Server:
    """A process that takes one recording after another; it is started again after a time limit or a crash."""

    def __init__(self, out: Path, settings: Settings) -> None:
        self._out, self._settings = out, settings
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> _Server:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()

    def diagnose(self, name: str) -> Run:
        digest, begun = recording_digest(folder_of(self._out, name)), time.monotonic()
        process = self._process or self._start()
        if process.stdin is None or process.stdout is None:
            raise RuntimeError("the diagnosis process has no pipes")
        timer = threading.Timer(self._settings.limit, process.kill)
        timer.start()
        try:
            process.stdin.write(json.dumps([*self._settings.command[1:], *_arguments(name, self._out)]) + "\n")
            process.stdin.flush()
            answer = process.stdout.readline()
        except BrokenPipeError:
            answer = ""
        timer.cancel()
        seconds = time.monotonic() - begun
        if not answer:
            self._stop()
            return Run(digest, -1, seconds, 0.0, "no answer within the time limit, or a crash")
        reply = json.loads(answer)
        megabytes, processor = float(reply["megabytes"]), float(reply["processor"])
        return Run(digest, int(reply["exit"]), seconds, megabytes, str(reply["error"]), processor)

    def _start(self) -> subprocess.Popen[str]:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "calibration_sim.proving.batch", self._settings.entry],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=_environment(),
        )
        return self._process

    def _stop(self) -> None:
        if self._process is None:
            return
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process = None


def _environment() -> dict[str, str]:
    return {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def _last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1][:300] if lines else ""
