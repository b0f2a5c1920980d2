"""One recording in a worker of the engine: diagnosed by a process of its own that is given nothing but the recording.

One process per recording, or one per worker that takes one recording after another (start-up then counts once).  The
process can be ended at the time limit, which what runs in the worker itself could not.
"""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from calibration_sim.proving.writing import CELL, TABLE, recording_digest

RESULT = "result.json"
MEGABYTE = 1024.0  # kilobytes, in which Linux counts
NO_ANSWER = "no answer within the time limit, or a crash"


@dataclasses.dataclass(frozen=True)
class Settings:
    """How a diagnosis is run.

    Attributes:
        command: Program and first arguments; `RECORDING --cell CELL --out DIR` is added.  A program that stands beside
            the worker's Python is taken from there.
        entry: `module:function` to be called in a process that takes many recordings; empty: one process each.
        limit: s, for one recording.
    """

    command: tuple[str, ...]
    entry: str = ""
    limit: float = 120.0


@dataclasses.dataclass(frozen=True)
class Piece:
    """What a worker is asked for.

    Attributes:
        folder: Of the recording, under the same path for all workers.
        settings: How it is diagnosed.
    """

    folder: Path
    settings: Settings


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


@dataclasses.dataclass(frozen=True)
class Answer:
    """What a worker hands back.

    Attributes:
        run: How it went.
        result: The bytes of result.json; empty where there is none.
    """

    run: Run
    result: bytes


def diagnose(piece: Piece) -> Answer:
    """Diagnose one recording; whatever goes wrong stands in the answer."""
    with tempfile.TemporaryDirectory(prefix="calibration-prove-") as parent:
        out = Path(parent) / piece.folder.name
        out.mkdir()
        asked = [str(piece.folder / TABLE), "--cell", str(piece.folder / CELL), "--out", str(out)]
        run = (_one_of_many if piece.settings.entry else _alone)(piece, asked)
        path = out / RESULT
        return Answer(run, path.read_bytes() if path.is_file() else b"")


def _alone(piece: Piece, asked: list[str]) -> Run:
    """Run one process for one recording."""
    digest, begun = recording_digest(piece.folder), time.monotonic()
    program, *first = piece.settings.command
    with tempfile.TemporaryFile() as printed:
        process = subprocess.Popen(
            [_beside(program), *first, *asked], stdout=subprocess.DEVNULL, stderr=printed, env=_environment()
        )
        timer = threading.Timer(piece.settings.limit, process.kill)
        timer.start()
        _, status, usage = os.wait4(process.pid, 0)
        timer.cancel()
        process.returncode = os.waitstatus_to_exitcode(status)
        printed.seek(0)
        error = _last_line(printed.read().decode("utf-8", "replace"))
    exit_code = process.returncode if process.returncode >= 0 else -1
    seconds = time.monotonic() - begun
    return Run(digest, exit_code, seconds, usage.ru_maxrss / MEGABYTE, error, usage.ru_utime + usage.ru_stime)


def _one_of_many(piece: Piece, asked: list[str]) -> Run:
    """Hand one recording to the process of this worker that takes one after another."""
    digest, begun = recording_digest(piece.folder), time.monotonic()
    answer = _served(piece.settings, [*piece.settings.command[1:], *asked])
    seconds = time.monotonic() - begun
    if not answer:
        return Run(digest, -1, seconds, 0.0, NO_ANSWER)
    reply = json.loads(answer)
    megabytes, processor = float(reply["megabytes"]), float(reply["processor"])
    return Run(digest, int(reply["exit"]), seconds, megabytes, str(reply["error"]), processor)


_own = threading.local()  # a thread of a worker does one piece at a time, and has one process; both end together


def _served(settings: Settings, arguments: list[str]) -> str:
    """Return the answer of the thread's process; empty, and the process has ended, where there is none in time."""
    process = getattr(_own, "process", None) if getattr(_own, "entry", "") == settings.entry else None
    if process is None or process.poll() is not None:
        process = _own.process = _server(settings.entry)
        _own.entry = settings.entry
    if process.stdin is None or process.stdout is None:
        raise RuntimeError("the diagnosis process has no pipes")
    timer = threading.Timer(settings.limit, process.kill)
    timer.start()
    try:
        process.stdin.write(json.dumps(arguments) + "\n")
        process.stdin.flush()
        answer: str = process.stdout.readline()
    except BrokenPipeError:
        answer = ""
    timer.cancel()
    if not answer:
        process.kill()
        process.wait()
    return answer


def _server(entry: str) -> subprocess.Popen[str]:
    """Start a process that takes one recording after another; it ends when nobody holds its standard input."""
    return subprocess.Popen(
        [sys.executable, "-m", "calibration_sim.proving.batch", entry],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=_environment(),
    )  # fmt: skip


def _beside(program: str) -> str:
    path = Path(sys.executable).parent / program
    return str(path) if path.is_file() else program


def _environment() -> dict[str, str]:
    return {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def _last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1][:300] if lines else ""
