"""Every run of the benchmarks is kept in build/bench/runs.json: what each said, with date, commit and machine."""

from __future__ import annotations

import datetime as dt
import io
import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
RUNS = ROOT / "build" / "bench" / "runs.json"
SAID = pytest.StashKey[dict[str, dict[str, str]]]()
MOST = 20  # runs that are kept


class Tee(io.TextIOBase):
    """Writes to two streams."""

    def __init__(self, *streams: Any) -> None:
        self._streams = streams

    def write(self, text: str) -> int:
        """Write to both."""
        for stream in self._streams:
            stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush both."""
        for stream in self._streams:
            stream.flush()


def pytest_configure(config: pytest.Config) -> None:
    config.stash[SAID] = {}


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    said, before, outcome = io.StringIO(), sys.stdout, "failed"
    sys.stdout = Tee(before, said)
    try:
        answer = yield
        outcome = "passed"
        return answer
    except pytest.skip.Exception:
        outcome = "skipped"
        raise
    finally:
        sys.stdout = before
        name = item.nodeid.removeprefix("test/bench/")
        item.config.stash[SAID][name] = {"outcome": outcome, "text": said.getvalue().strip()}


def pytest_sessionfinish(session: pytest.Session) -> None:
    tests = session.config.stash[SAID]
    if not tests:
        return
    git = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False)
    run = {
        "date": f"{dt.datetime.now(dt.UTC):%Y-%m-%d %H:%M}",
        "commit": git.stdout.strip(),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "load": os.getloadavg()[0],
        "tests": tests,
    }
    runs = json.loads(RUNS.read_text("utf-8")) if RUNS.is_file() else []
    RUNS.parent.mkdir(parents=True, exist_ok=True)
    RUNS.write_text(json.dumps([*runs, run][-MOST:], indent=1) + "\n", "utf-8")
