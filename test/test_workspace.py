"""The workspace sets itself up: prerequisites, pins, versions and the built messages."""

from __future__ import annotations

import importlib.metadata
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
BIN = Path(sys.prefix) / "bin"
PACKAGES = ("calibration_core", "calibration_sim")
PREREQUISITES = ROOT / ".ci" / "prerequisites"

FIELDS = {"header": "std_msgs/Header", "configuration": "uint32", "step": "uint32", "phase": "uint8"}
PHASES = {"MOVING": 0, "LOADING": 1, "SETTLING": 2, "MEASURING": 3, "UNLOADING": 4, "DONE": 5}


# --- prerequisites --------------------------------------------------------------------------------------------------


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """A folder that, taken as PATH, holds what set-up needs and nothing else."""
    for tool in ("bash", "uname", "cc", "c++"):
        (tmp_path / tool).symlink_to(shutil.which(tool) or f"no {tool}")
    return tmp_path


def stand_in(folder: Path, name: str, version: str, *, venv: bool = True, headers: bool = True) -> Path:
    """Writes an executable that answers the three questions of the check as a Python of this kind would."""
    path = folder / name
    path.write_text(
        "#!/usr/bin/env bash\n"
        f'case "$2" in *base_executable*) echo "{version} $0";; *ensurepip*) exit {int(not venv)};;'
        f" *Python.h*) exit {int(not headers)};; esac\n",
        encoding="utf-8",
    )
    path.chmod(0o755)
    return path


def prerequisites(path: Path, python: str, script: Path = PREREQUISITES) -> subprocess.CompletedProcess[str]:
    environment = {"PATH": str(path)}
    bash = shutil.which("bash") or "bash"
    command = [bash, str(script), python]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_a_complete_machine_is_accepted(bare: Path) -> None:
    python = stand_in(bare, "python3.12", "3.12")
    answer = prerequisites(bare, "python3.12")
    assert (answer.returncode, answer.stdout) == (0, f"ok {python}\n")


@pytest.mark.parametrize(
    ("python", "absent", "parts"),
    [
        ({"version": "3.10"}, (), ("python-one: 3.10", "install CPython")),
        ({"version": "3.14"}, (), ("python-one: 3.14", "install CPython")),
        (None, (), ("python-one: missing", "install CPython")),
        ({"venv": False}, (), ("no venv module", "python3.12-venv")),
        ({"headers": False}, (), ("Python.h", "python3.12-dev")),
        ({}, ("cc",), ("compiler", "apt install gcc")),
        ({}, ("c++",), ("compiler", "apt install g++")),
    ],
)
def test_what_a_machine_lacks_is_one_line(
    bare: Path, python: dict[str, Any] | None, absent: tuple[str, ...], parts: tuple[str, ...]
) -> None:
    if python is not None:
        stand_in(bare, "python-one", **{"version": "3.12", **python})
    for tool in absent:
        (bare / tool).unlink()
    _expect_one_line(prerequisites(bare, "python-one"), *parts)


def _expect_one_line(answer: subprocess.CompletedProcess[str], *parts: str) -> None:
    assert answer.returncode == 1
    assert answer.stdout.count("\n") == 1
    assert answer.stderr == ""
    for part in parts:
        assert part in answer.stdout


def test_path_with_a_blank(bare: Path) -> None:
    workspace = bare / "with blank"
    (workspace / ".ci").mkdir(parents=True)
    shutil.copy(PREREQUISITES, workspace / ".ci")
    stand_in(bare, "python3.12", "3.12")
    script = workspace / ".ci" / PREREQUISITES.name
    _expect_one_line(prerequisites(bare, "python3.12", script), str(workspace), "move the workspace")


def test_make_stops_with_the_one_line() -> None:
    command = ["make", "-C", str(ROOT), "--no-print-directory", "PYTHON=python-none", "demo"]
    answer = subprocess.run(command, env=_outside_make(), capture_output=True, text=True, check=False)
    assert answer.returncode == 2
    assert answer.stdout == ""
    assert re.fullmatch(r"Makefile:\d+: \*\*\* no suitable Python .*install CPython.*Stop\.\n", answer.stderr)


def _outside_make() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name not in {"MAKEFLAGS", "MAKELEVEL", "MFLAGS"}}


# --- the gate -------------------------------------------------------------------------------------------------------

GATE = """#!/usr/bin/env bash
[ "$*" = test ] && echo "$HOME $TMPDIR ${XDG_CACHE_HOME:-}" && ls -A "$HOME" "$HOME/.config" "$TMPDIR"
touch "$HOME/left" "$TMPDIR/left"
[ -z "${PYTHON:-}" ] || echo "${PIP_INDEX_URL:-$("$PYTHON" -m pip config get global.index-url)}"
exit 7
"""


def gate(folder: Path, **settings: str) -> tuple[int, list[str]]:
    """Exit code and lines of `.ci/run`, whose `make` is a stand-in that lists the homes which it is given."""
    tools = folder / "tools"
    tools.mkdir()
    for tool in ("bash", "dirname", "id", "ln", "ls", "mkdir", "mktemp", "rm", "touch"):
        (tools / tool).symlink_to(shutil.which(tool) or f"no {tool}")
    for name, text in {"make": GATE, "chromium": ""}.items():
        (tools / name).write_text(text, encoding="utf-8")
        (tools / name).chmod(0o755)
    environment = {"PATH": str(tools), "TMPDIR": str(folder), **settings}
    done = subprocess.run([ROOT / ".ci" / "run"], env=environment, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    return done.returncode, done.stdout.splitlines()


def test_the_gate_runs_with_an_empty_home_and_leaves_nothing(tmp_path: Path) -> None:
    home = tmp_path / "home"
    for name in (".cache", ".ros", ".config/matplotlib"):
        (home / name).mkdir(parents=True)
    code, lines = gate(tmp_path, HOME=str(home), XDG_CACHE_HOME=str(home / ".cache"))
    assert code == 7
    own, temporary = map(Path, lines[0].split())
    assert [line for line in lines[1:] if line and not line.endswith(":")] == [".config"]
    assert own.parent == temporary.parent != tmp_path
    assert not own.parent.exists()
    assert not (home / "left").exists()


@pytest.mark.parametrize("place", [".pip/pip.conf", ".config/pip/pip.conf", "elsewhere/pip/pip.conf", "variable"])
def test_the_gate_is_told_where_packages_come_from(place: str, tmp_path: Path) -> None:
    """By a file of the user, by one where XDG_CONFIG_HOME says, or by PIP_INDEX_URL alone; without a home, too."""
    index, home = "https://example.invalid/simple", tmp_path / "home"
    settings = {"PYTHON": str(BIN / "python"), "HOME": str(home)}
    if place == "variable":
        assert gate(tmp_path, PYTHON=settings["PYTHON"], PIP_INDEX_URL=index)[1][-1] == index
        return
    (home / place).parent.mkdir(parents=True)
    (home / place).write_text(f"[global]\nindex-url = {index}\n", encoding="utf-8")
    if place.startswith("elsewhere"):
        settings["XDG_CONFIG_HOME"] = str(home / "elsewhere")
    assert gate(tmp_path, **settings)[1][-1] == index


# --- pins -----------------------------------------------------------------------------------------------------------


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", re.split(r"[\[<>=!~ ;]", name)[0]).lower()


def pins() -> dict[str, str]:
    lines = (ROOT / ".ci" / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pairs = [line.split("==") for line in lines if line and not line.startswith("#")]
    return {canonical(name): version for name, version in pairs}


def test_every_direct_dependency_is_pinned() -> None:
    wanted = set()
    for package in PACKAGES:
        declared = tomllib.loads((ROOT / "src" / package / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        wanted |= {canonical(name) for name in declared["dependencies"]}
        wanted |= {canonical(name) for name in declared["optional-dependencies"]["test"]}
    for requirements in (ROOT / ".ci").glob("requirements*.txt"):
        lines = requirements.read_text(encoding="utf-8").splitlines()
        wanted |= {canonical(line) for line in lines if line and not line.startswith("#")}
    assert wanted - set(pins()) - {canonical(package) for package in PACKAGES} == set()


def test_installed_versions_are_the_pinned_ones() -> None:
    ours = importlib.metadata.distributions(path=[sysconfig.get_path("purelib")])
    installed = {canonical(found.name): found.version for found in ours}
    wrong = {name: (installed[name], pin) for name, pin in pins().items() if installed.get(name, pin) != pin}
    assert wrong == {}


# --- versions -------------------------------------------------------------------------------------------------------


def test_one_version_everywhere() -> None:
    versions = {re.search(r"<version>(.*?)</version>", path.read_text(encoding="utf-8"))[1] for path in manifests()}
    for package in PACKAGES:
        declared = tomllib.loads((ROOT / "src" / package / "pyproject.toml").read_text(encoding="utf-8"))
        versions.add(declared["project"]["version"])
    assert len(versions) == 1


def manifests() -> list[Path]:
    found = sorted((ROOT / "src").glob("*/package.xml"))
    assert len(found) >= 3
    return found


# --- messages -------------------------------------------------------------------------------------------------------

INSPECT = """
import json
from calibration_interfaces.msg import MeasurementStep
from rclpy.serialization import deserialize_message, serialize_message
sent = MeasurementStep(configuration=7, step=3, phase=MeasurementStep.MEASURING)
print(json.dumps({
    "fields": MeasurementStep.get_fields_and_field_types(),
    "phases": {name: value for name in dir(MeasurementStep)
               if name.isupper() and isinstance(value := getattr(MeasurementStep, name), int)},
    "round_trip": deserialize_message(serialize_message(sent), MeasurementStep) == sent,
}, sort_keys=True))
"""


def test_built_messages_are_those_of_the_contract() -> None:
    setup = ROOT / "install" / "setup.bash"
    assert setup.is_file(), "the messages are not built: run make setup"
    command = ["bash", "-c", 'source "$0" && "$1" -c "$2"', str(setup), str(BIN / "python"), INSPECT]
    answer = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert answer.returncode == 0, answer.stderr
    found = json.loads(answer.stdout)
    assert found["fields"] == FIELDS
    assert found["phases"] == PHASES
    assert found["round_trip"] is True
