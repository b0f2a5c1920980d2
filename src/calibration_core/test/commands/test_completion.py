"""Completion: what real shells offer."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from calibration_core.cli import argument_parser
from calibration_core.commands import NAMES
from calibration_core.commands.terminal.completion import SHELLS, completion


@pytest.mark.parametrize("shell", SHELLS)
def test_every_command_and_option_is_offered(shell: str) -> None:
    script = completion(shell, argument_parser())
    for name in NAMES:
        assert name in script
    for word in ("cell", "protocol", "ur_ur10e", "observability"):
        assert word in script


@pytest.mark.parametrize("shell", SHELLS)
def test_the_shell_can_read_it(shell: str) -> None:
    program = shutil.which(shell)
    if program is None:
        pytest.skip(f"{shell} is not installed")
    done = subprocess.run(
        [program, "-n"],
        input=completion(shell, argument_parser()),
        capture_output=True,
        text=True,
        check=False,
        timeout=30,
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        (["calibration", "ide"], {"identify"}),
        (["calibration", "init", "ur_"], {"ur_ur5e", "ur_ur10e"}),
        (["calibration", "identify", "--met"], {"--method"}),
        (["calibration", "identify", "--method", ""], {"equilibrium", "linear"}),
        (["calibration", "completion", "f"], {"fish"}),
    ],
)
def test_bash_completes(typed: list[str], offered: set[str]) -> None:
    words = " ".join(f"'{word}'" for word in typed)
    lines = f"COMP_WORDS=({words}); COMP_CWORD={len(typed) - 1}; _calibration; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    script = completion("bash", argument_parser()) + lines
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True, timeout=30, cwd="/")
    assert set(done.stdout.split()) == offered
