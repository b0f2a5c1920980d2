"""Starts a tree of processes where there is no `launch`: ROS 2 of the package index brings neither `launch` nor `ros2`.

    source install/setup.bash
    .venv/bin/python -m calibration.without_launch simulated_cell cell:=CELL.yaml session:=DIR speed:=20.0

The arguments are those of the launch file of that name; `--help` states them.  Ctrl-C, SIGTERM or a terminal that is
closed ends every process, as launch does it.  Where this process is killed, they end by themselves.  A node that
crashed or was killed is started again.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import FrameType

from ament_index_python.packages import get_package_prefix, get_package_share_directory

from calibration.process_tree import (
    AGAIN_AFTER,
    DONE,
    REAL_CELL,
    REPLAY,
    SIMULATED_CELL,
    STARTED_BY,
    UNUSABLE,
    Process,
    Tree,
    files_of,
    on_end,
    parameters_of,
    values_of,
)
from calibration_core.errors import InputError, quoted

TREES = {"real_cell": REAL_CELL, "simulated_cell": SIMULATED_CELL, "replay": REPLAY}
HELP = ("-h", "--help")
WIDTH = 100  # characters of a line of help
LOOK = 0.2  # s between looks at whether a process still runs


def command_of(
    executable: str | Path,
    tree: Tree,
    process: Process,
    values: Mapping[str, str],
    files: Sequence[str],
    more: Mapping[str, object] | None = None,
) -> list[str]:
    """Return the command line that launch would make of a process.

    Args:
        executable: Its file.
        tree: What it belongs to.
        process: The process.
        values: Of the tree's arguments.
        files: Parameter files, later ones overrule earlier ones.
        more: Parameters besides.
    """
    words = [str(executable), "--ros-args"]
    words += ["--enclave", process.enclave, "-r", f"__ns:=/{values['namespace'].strip('/')}"]
    for name, there in tree.remappings.items():
        words += ["-r", f"{name}:={there}"]
    words += ["--log-level", values["log_level"]]
    for file in files:
        words += ["--params-file", file]
    for key, value in {**parameters_of(tree, process, values), **(more or {})}.items():
        text = str(value) if isinstance(value, str | Path) else json.dumps(value)
        words += ["-p", f"{key}:={json.dumps(text) if text == '' else text}"]
    return words


def asked_of(words: Sequence[str]) -> tuple[Tree, dict[str, str]]:
    """Return the tree and the values of its arguments that a command line asks for.

    Raises:
        InputError: A word is no tree or no argument of it, or a value cannot be used.
    """
    name = words[0] if words else ""
    if name not in TREES:
        raise InputError("arguments", "", quoted(name) if name else "nothing", f"one of {', '.join(TREES)}")
    tree = TREES[name]
    known = [argument.name for argument in tree.arguments]
    asked = {}
    for word in words[1:]:
        key, there, value = word.partition(":=")
        if not there or key not in known:
            raise InputError("arguments", name, quoted(word), f"NAME:=VALUE with one of {', '.join(known)}")
        asked[key] = value
    if tree.tools and shutil.which("ros2") is None:
        raise InputError("arguments", name, "no command `ros2`", "a system ROS 2: the bag is played by `ros2 bag play`")
    return tree, values_of(tree, asked)


def usage_of(words: Sequence[str]) -> str:
    """Return what can be typed: the arguments of the tree that the first word names, or those of all trees."""
    named = [word for word in words[:1] if word in TREES] or list(TREES)
    lines = [
        f"usage: python -m calibration.without_launch {'|'.join(named)} [NAME:=VALUE ...]",
        "",
        "Start the nodes of the launch file of that name where there is no `launch`; Ctrl-C or SIGTERM ends them.",
    ]
    for name in named:
        width = 3 + max(len(argument.name) for argument in TREES[name].arguments)
        lines += ["", f"arguments of {name}:"]
        for argument in TREES[name].arguments:
            default = "must be given" if argument.default is None else f"default {argument.default or 'empty'}"
            among = f", one of {', '.join(argument.choices)}" if argument.choices else ""
            text = f"{argument.description} ({default}{among})"
            start = f"  {argument.name + ':=':{width}}"
            lines += textwrap.wrap(text, WIDTH, initial_indent=start, subsequent_indent=" " * len(start),
                                   break_long_words=False, break_on_hyphens=False)  # fmt: skip
    return "\n".join(lines)


def main(words: Sequence[str] | None = None) -> int:
    """Start a tree, wait until it is to end or nothing of it is left, end it; return the exit code."""
    words = sys.argv[1:] if words is None else words
    if any(word in HELP for word in words):
        print(usage_of(words))
        return DONE
    try:
        tree, values = asked_of(words)
    except InputError as error:
        print(error, file=sys.stderr)
        return UNUSABLE
    asked_to_end: list[int] = []

    def end(number: int, _: FrameType | None) -> None:
        asked_to_end.append(number)

    before = on_end(end)
    files = files_of(values, get_package_share_directory("calibration"))
    running: list[tuple[Process, subprocess.Popen[bytes]]] = []

    def started(process: Process) -> tuple[Process, subprocess.Popen[bytes]]:
        # each in a session of its own: the keyboard's signal reaches it once, from here
        executable = f"{get_package_prefix(process.package)}/lib/{process.package}/{process.name}"
        command = command_of(executable, tree, process, values, files)
        own = {**os.environ, STARTED_BY: str(os.getpid())}
        return process, subprocess.Popen(command, start_new_session=True, env=own)

    try:
        running.extend(map(started, tree.processes))
        ended: dict[subprocess.Popen[bytes], float] = {}  # s of the monotonic clock
        while not asked_to_end and any((code := one.poll()) is None or process.again(code) for process, one in running):
            time.sleep(LOOK)
            for row, (process, one) in enumerate(running):
                if (code := one.poll()) is None or not process.again(code):
                    continue
                if time.monotonic() - ended.setdefault(one, time.monotonic()) > AGAIN_AFTER:
                    print(f"{process.name} ended with {code}, and is started again", file=sys.stderr)
                    running[row] = started(process)
    finally:
        _end(running)
        for number, handler in before.items():
            signal.signal(number, handler)
    return DONE if asked_to_end else max((one.returncode for _, one in running), key=abs, default=DONE)


def _end(running: Sequence[tuple[Process, subprocess.Popen[bytes]]]) -> None:
    """SIGINT to every process at once, SIGTERM and SIGKILL after the times of the table."""
    began = time.monotonic()
    for _, process in running:
        process.send_signal(signal.SIGINT)
    for row, process in sorted(running, key=lambda one: one[0].sigterm_after):
        for number, after in ((signal.SIGTERM, row.sigterm_after), (signal.SIGKILL, row.sigkill_after)):
            try:
                process.wait(max(began + after - time.monotonic(), 0.0) if number == signal.SIGTERM else after)
                break
            except subprocess.TimeoutExpired:
                process.send_signal(number)
        process.wait()


if __name__ == "__main__":
    sys.exit(main())
