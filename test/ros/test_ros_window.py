"""Who has started the cell ends, by whatever signal, while the robot moves: it stops, and no node stays behind.

The tree is started by `calibration.without_launch` in a terminal of its own, whose window can be closed.
"""

from __future__ import annotations

import contextlib
import os
import pty
import select
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")
pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from live_tree import SIMULATED, STOPS, LiveTree, long_ways, rows

ROOT = Path(__file__).resolve().parents[2]
CELL = ROOT / "config" / "cells" / "demo.cell.yaml"
BAR = 0.150 + 0.1  # s, from the blow to the command to stop: a node looks for its parent ten times a second
GONE = 40.0  # s, in which every node has ended


class Window:
    """A terminal's window in which a cell was launched."""

    def __init__(self, suite: Any, marked: Callable[[str], dict[int, str]]) -> None:
        self.suite, self._marked, self._master, self._closing = suite, marked, -1, threading.Event()
        suite.start_tree = self.start_tree

    def start_tree(self, _tree: Any, more: dict[str, dict[str, object]], **_said: object) -> None:
        """Start the simulated cell as one does by hand, in place of `Suite.start_tree`."""
        own = {name: {"ros__parameters": {key: str(at) for key, at in given.items()}} for name, given in more.items()}
        file = self.suite.directory / "own.yaml"
        file.write_text(yaml.safe_dump(own), encoding="utf-8")
        words = [f"cell:={CELL}", f"session:={self.suite.session}", f"params_file:={file}", "port:=0"]
        self._master, slave = pty.openpty()
        launch = [sys.executable, "-m", "calibration.without_launch", "simulated_cell", *words]
        self.launch = subprocess.Popen(
            ["setsid", "--ctty", *launch], env=self.suite.environment, stdin=slave, stdout=slave, stderr=slave
        )
        os.close(slave)
        self.suite.processes["launch"] = self.launch
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        with contextlib.suppress(OSError), (self.suite.directory / "sequencer.log").open("ab") as log:
            while not self._closing.is_set():
                if select.select([self._master], [], [], 0.01)[0]:  # a read under way would keep the window open
                    log.write(os.read(self._master, 4096))
                    log.flush()

    def processes(self, *packages: str) -> list[int]:
        """The nodes of packages."""
        own = self._marked(self.suite.mark)
        return [pid for pid, words in own.items() if any(f"lib/{name}/" in words for name in packages)]

    def strike(self, how: str) -> None:
        """Close the window, or send a signal to the launch, or to all of ours at once."""
        if how == "window":
            self._closing.set()
            self._reader.join()
            os.close(self._master)
            return
        name, _, target = how.partition(" to ")
        nodes = self.processes("calibration") if target == "all" else []
        for pid in [self.launch.pid, *nodes]:
            os.kill(pid, signal.Signals[name])


def strike(suite: Any, marked: Callable[[str], dict[int, str]], plan: Path, how: str) -> float:
    """Launch a cell, strike while the robot moves, see stop and end of every node; return when it was stopped, s.

    A robot that stood by itself before counts as stopped then.
    """
    window = Window(suite, marked)
    for trace in ("cell.csv", "guard.trace", "sequencer.trace"):
        (suite.directory / trace).unlink(missing_ok=True)
    shutil.rmtree(suite.directory / "session_1", ignore_errors=True)
    tree = LiveTree(suite, plan, SIMULATED)
    tree.move()
    struck = time.monotonic_ns()
    window.strike(how)
    tree.wait(lambda: tree.events(struck, "rest", *STOPS), f"{how}: the robot is not told to stop", 30.0)
    at, what = tree.events(struck, "rest", *STOPS)[0]
    tree.wait(lambda: tree.events(struck, "rest"), f"{how}: the robot goes on", 30.0)
    rest = tree.events(struck, "rest")[-1][0]
    suite.processes.pop("launch").wait(GONE)
    end = time.monotonic() + GONE
    while left := window.processes("calibration", "calibration_sim"):
        assert time.monotonic() < end, (how, left)
        time.sleep(0.05)
    took = (time.monotonic_ns() - struck) / 1e9
    assert [event for event in rows(tree.log) if event[0] > rest and event[1] == "motion"] == []
    late = (at - struck) / 1e9
    print(f"{how}: {what} after {1e3 * late:.0f} ms, every node gone after {took:.1f} s", flush=True)
    return late


SIGNALS = ("SIGHUP", "SIGTERM", "SIGINT")  # SIGKILL to all: nobody is left, see `test_guard_and_sequencer_at_once`
TWENTY = ("window", "SIGKILL to launch", *(f"{name} to {whom}" for name in SIGNALS for whom in ("launch", "all")))


def test_the_launch_is_killed_while_the_robot_moves(suite: Any, marked_processes: Any, plan: Path) -> None:
    """On a busy machine the stop may come late, but it comes."""
    assert strike(suite, marked_processes, long_ways(plan), "SIGKILL to launch") < 10.0 * BAR


@pytest.mark.slow
@pytest.mark.parametrize("how", TWENTY)
def test_twenty_times(suite: Any, marked_processes: Any, plan: Path, how: str) -> None:
    late = [strike(suite, marked_processes, long_ways(plan), how) for _ in range(20)]
    print(f"\n{how}: median {1e3 * np.median(late):.0f} ms, longest {1e3 * max(late):.0f} ms of 20")
    assert np.mean(np.array(late) <= BAR) >= 0.95
