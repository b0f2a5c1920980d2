"""Starts and ends the shipped tree of processes as `launch` does, where there is no `launch`."""

from __future__ import annotations

import signal
import socket
import subprocess
import threading
import time
from pathlib import Path

from calibration.process_tree import Process, Tree, files_of, values_of
from calibration.without_launch import command_of

ROOT = Path(__file__).resolve().parents[3]
INSTALL = ROOT / "install"
SHOWN = 30  # lines of a log that a failed test shows
STACKS = 2.0  # s, that a deaf process has for writing where it stands


def free_port() -> int:
    """Return a port of this machine that nobody serves."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port: int = one.getsockname()[1]
        return port


class TreeRunner:
    """The processes of one tree.

    Attributes:
        running: By name.
        ended: Names in the order in which they ended, and how: (name, exit code, s since the signals).
    """

    def __init__(
        self,
        tree: Tree,
        environment: dict[str, str],
        directory: Path,
        files: tuple[Path, ...] = (),
        more: dict[str, dict[str, object]] | None = None,
        **said: object,
    ) -> None:
        """Prepare; `files` are parameter files after the tree's own, `more` parameters of single nodes."""
        self.tree, self._directory = tree, directory
        self._environment = {**environment, "PYTHONFAULTHANDLER": "1"}  # a deaf process says where it stands
        self._more = more or {}
        texts = {name: str(value) for name, value in said.items()}
        if any(argument.name == "tracker_address" for argument in tree.arguments):
            texts.setdefault("tracker_address", f"127.0.0.1:{free_port()}")
        self._values = values_of(tree, texts)
        own = files_of(self._values, str(INSTALL / "calibration" / "share" / "calibration"))
        self._files = (*map(Path, own), *files)
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        self.ended: list[tuple[str, int, float]] = []

    def command(self, process: Process) -> list[str]:
        """Return the command line that launch would make."""
        executable = INSTALL / process.package / "lib" / process.package / process.name
        files = [str(file) for file in self._files]
        return command_of(executable, self.tree, process, self._values, files, self._more.get(process.name))

    def start(self) -> None:
        """Start everything, in the order of the table."""
        for process in self.tree.processes:
            self.again(process.name)

    def again(self, name: str) -> None:
        """Start one process, as it was started."""
        process = next(one for one in self.tree.processes if one.name == name)
        with (self._directory / f"{name}.log").open("ab") as log:
            self.running[name] = subprocess.Popen(
                self.command(process), env=self._environment, stdout=log, stderr=subprocess.STDOUT
            )

    def strike(self, name: str, how: signal.Signals) -> None:
        """Send one process a signal, and wait for its end where that is what it means."""
        self.running[name].send_signal(how)
        if how is signal.SIGKILL:
            self.running.pop(name).wait()

    def log(self, name: str) -> str:
        """What a process said."""
        return (self._directory / f"{name}.log").read_text(encoding="utf-8", errors="replace")

    def shutdown(self) -> list[tuple[str, int, float]]:
        """SIGINT to every process at once, SIGTERM and the end after the times of the table; return what ended when.

        What the processes said last is printed: a test that fails shows it.
        """
        self.ended.clear()
        began = time.monotonic()
        for process in self.running.values():
            process.send_signal(signal.SIGCONT)  # one that a test has stopped must hear the next one
            process.send_signal(signal.SIGINT)
        rows = {one.name: one for one in self.tree.processes}
        threads = [
            threading.Thread(target=self._escalate, args=(rows[name], process, began))
            for name, process in self.running.items()
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        self.running.clear()
        for name in rows:
            if (self._directory / f"{name}.log").exists():
                print(f"--- {name}", *self.log(name).splitlines()[-SHOWN:], sep="\n")
        return self.ended

    def _escalate(self, row: Process, process: subprocess.Popen[bytes], began: float) -> None:
        try:
            process.wait(row.sigterm_after)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(row.sigkill_after)
            except subprocess.TimeoutExpired:
                _end_deaf(process)
        self.ended.append((row.name, process.wait(), time.monotonic() - began))


def _end_deaf(process: subprocess.Popen[bytes]) -> None:
    """End a process that hears no signal; its threads' stacks are in its log."""
    process.send_signal(signal.SIGABRT)
    try:
        process.wait(STACKS)
    except subprocess.TimeoutExpired:
        process.kill()
