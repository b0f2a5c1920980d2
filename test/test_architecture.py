"""The house keeps its shape: imports run one way, files stay small, and what is public is described."""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = {
    name: ROOT / "src" / name / name
    for name in ("calibration_core", "calibration_sim", "calibration")
    if (ROOT / "src" / name / name).is_dir()
}
MAX_LINES = 400
TOP_LEVEL = {"src", "config", "test", "bags", "README.md", "colcon.meta", "Makefile", "LICENSE"}

CHAIN = ("timeseries", "recording", "observations", "model", "input_checks", "identification", "diagnosis", "report")
FOR_ALL = {"errors", "files", "cell"}
FOR_PROCEDURE = {"timeseries", "recording", "model", "procedure", "identification.observability"}
ENTRY = {"cli", "commands", "__main__"}
FOR_SIM = {"errors", "files", "cell", "timeseries", "recording"}
SIM_NODE = {"calibration_sim.node", "calibration_sim.node_cell", "calibration_sim.node_messages"}
MESSAGES = re.compile(r"(.*_(msgs|interfaces)|rclpy|rosidl_.*|launch|launch_ros|ament_.*)(\..*)?")


# --- reading imports ------------------------------------------------------------------------------------------------


def module_name(path: Path, package: Path) -> str:
    """Dotted name of a source file, e.g. calibration_core.model.robot."""
    parts = path.relative_to(package.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(code: str, module: str, is_package: bool) -> Iterator[tuple[int, str]]:
    """Yields (line, dotted name) for everything that a file imports, wherever in the file it does so.

    `from a.b import c` yields a.b.c, because c may be a module; names are compared by prefix.
    """
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                up = node.level - 1 if is_package else node.level
                parents = module.split(".")
                base = ".".join(parents[: len(parents) - up] + ([base] if base else []))
            yield from ((node.lineno, f"{base}.{alias.name}") for alias in node.names)
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in {"import_module", "__import__"} and isinstance(node.args[0].value, str):
                yield node.lineno, node.args[0].value


def within(name: str, allowed: set[str]) -> bool:
    """Whether a dotted name is one of the allowed modules or lies inside one."""
    return any(name == item or name.startswith(item + ".") for item in allowed)


def may_import(module: str, target: str) -> bool:
    """Whether the design lets `module` import `target` (both dotted names)."""
    here, _, inside = module.partition(".")
    there, _, part = target.partition(".")
    if here in {"calibration_core", "calibration_sim"} and module not in SIM_NODE and MESSAGES.fullmatch(target):
        return False
    if there not in {"calibration_core", "calibration_sim", "calibration"}:
        return True
    if here == "calibration_sim":
        return there == here or (there == "calibration_core" and within(part, FOR_SIM))
    if here == "calibration":
        return there != "calibration_sim"
    return there == "calibration_core" and _core_may_import(inside, part)


def _core_may_import(inside: str, part: str) -> bool:
    layer = inside.partition(".")[0]
    if layer in ENTRY:
        return True
    if layer in {"", "errors"}:  # the package itself and the errors stand on nothing else
        return not within(part.partition(".")[0], {*CHAIN, "cell", "procedure", *ENTRY})
    if layer == "files":
        return within(part, {"errors", "files"})
    if part == "__version__" or within(part, FOR_ALL):
        return True
    if layer == "procedure":
        return within(part, FOR_PROCEDURE)
    return layer in CHAIN and within(part, set(CHAIN[: CHAIN.index(layer) + 1]))


def python_files() -> list[tuple[str, Path]]:
    return [(name, path) for name, package in SOURCES.items() for path in sorted(package.rglob("*.py"))]


# --- the rules on the tree ------------------------------------------------------------------------------------------


def test_imports_follow_the_arrows() -> None:
    wrong = []
    for name, path in python_files():
        module = module_name(path, SOURCES[name])
        for line, target in imports(path.read_text(encoding="utf-8"), module, path.name == "__init__.py"):
            if not may_import(module, target):
                wrong.append(f"{path.relative_to(ROOT)}:{line}: {module} may not import {target}")
    assert len(python_files()) > 20
    assert wrong == []


@pytest.mark.parametrize(
    ("module", "line", "allowed"),
    [
        ("calibration_core.model.robot", "from calibration_core.timeseries import Wrench", True),
        ("calibration_core.model.robot", "from calibration_core import errors", True),
        ("calibration_core.model.robot", "from calibration_core.identification import fit", False),
        ("calibration_core.model.robot", "from calibration_core import report", False),
        ("calibration_core.model.robot", "from ..diagnosis import findings", False),
        ("calibration_core.model.robot", "from .chain import Chain", True),
        ("calibration_core.model.effects.creep", "def f():\n    import calibration_core.diagnosis.evidence", False),
        ("calibration_core.report.document", "from calibration_core.recording.csv import read", True),
        ("calibration_core.recording.bag", "from calibration_core.observations import plateaus", False),
        ("calibration_core.recording.bag", "from sensor_msgs.msg import JointState", False),
        ("calibration_core.recording.bag", "import importlib\nimportlib.import_module('rclpy.node')", False),
        ("calibration_core.recording.bag", "from calibration_interfaces.msg import MeasurementStep", False),
        ("calibration_core.recording.bag", "from rosbags.highlevel import AnyReader", True),
        ("calibration_core.timeseries", "from calibration_core.cell import Cell", True),
        ("calibration_core.errors", "from calibration_core.cell import Cell", False),
        ("calibration_core.files.yaml_file", "from calibration_core.errors import InputError", True),
        ("calibration_core.files.yaml_file", "from calibration_core.cell import Cell", False),
        ("calibration_core.cell", "from calibration_core.files.yaml_file import read_yaml", True),
        ("calibration_core.procedure.plan", "from calibration_core.identification.observability import rank", True),
        ("calibration_core.procedure.plan", "from calibration_core.identification.solve import solve", False),
        ("calibration_core.procedure.plan", "from calibration_core.model.robot import Robot", True),
        ("calibration_core.diagnosis.evidence", "from calibration_core.procedure import plan", False),
        ("calibration_core.diagnosis.evidence", "from calibration_core.cli import main", False),
        ("calibration_core.cli", "from calibration_core.report import document", True),
        ("calibration_core.cli", "from calibration_sim.cli import main", False),
        ("calibration_core.cli", "from calibration.topics import TOPICS", False),
        ("calibration_sim.sensors", "from calibration_core.recording.writer import write", True),
        ("calibration_sim.sensors", "from calibration_core.model.robot import Robot", False),
        ("calibration_sim.sensors", "import calibration_core", False),
        ("calibration_sim.sensors", "from std_msgs.msg import String", False),
        ("calibration_sim.node", "from std_msgs.msg import String", True),
        ("calibration_sim.node", "from calibration.topics import TOPICS", False),
        ("calibration.topics", "from sensor_msgs.msg import JointState", True),
        ("calibration.topics", "from calibration_sim.cli import main", False),
    ],
)
def test_the_arrows_themselves(module: str, line: str, allowed: bool) -> None:
    targets = [target for _, target in imports(line, module, is_package=False)]
    assert all(may_import(module, target) for target in targets) is allowed


def test_public_names_of_the_core_are_described() -> None:
    silent = []
    for path in sorted(SOURCES["calibration_core"].rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        place = path.relative_to(ROOT)
        if not ast.get_docstring(tree):
            silent.append(f"{place}: module")
        silent += [f"{place}:{line}: {name}" for line, name in undescribed(tree)]
    assert silent == []


def undescribed(tree: ast.Module | ast.ClassDef) -> Iterator[tuple[int, str]]:
    """Yields (line, name) of public classes and functions without a docstring; overloads and setters need none."""
    for node in tree.body:
        if not isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) or node.name.startswith("_"):
            continue
        marks = {getattr(mark, "attr", getattr(mark, "id", "")) for mark in node.decorator_list}
        if not ast.get_docstring(node) and not marks & {"overload", "setter", "override"}:
            yield node.lineno, node.name
        if isinstance(node, ast.ClassDef):
            yield from undescribed(node)


def test_undescribed_finds_what_is_silent() -> None:
    code = 'def a():\n  "x"\ndef b(): ...\ndef _c(): ...\nclass D:\n  "x"\n  def e(self): ...\n  def __f__(self): ...'
    assert [name for _, name in undescribed(ast.parse(code))] == ["b", "e"]


# --- the rules on tracked files -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tracked() -> list[Path]:
    """Files that belong to the project, relative to its root."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("not a git checkout: which files belong to the project cannot be told")
    names = [Path(name) for name in listed.stdout.split("\0") if name]
    return [name for name in names if (ROOT / name).is_file()]


def test_top_level_holds_the_agreed_names_only(tracked: list[Path]) -> None:
    names = {path.parts[0] for path in tracked}
    assert {name for name in names if not name.startswith(".")} <= TOP_LEVEL
    assert names >= {"src", "config", "test", "README.md", "colcon.meta", "Makefile", "LICENSE"}


def test_files_hold_one_idea(tracked: list[Path]) -> None:
    lengths = {path: len((ROOT / path).read_text(encoding="utf-8").splitlines()) for path in tracked if is_python(path)}
    assert {str(path): lines for path, lines in lengths.items() if lines > MAX_LINES} == {}


def is_python(path: Path) -> bool:
    return path.suffix == ".py"


def test_no_path_of_a_machine(tracked: list[Path]) -> None:
    machine = re.compile(r"(?<![\w.\-~}])/(root|home|work|Users|tmp)/[\w.]")
    found = []
    for path in tracked:
        data = (ROOT / path).read_bytes()
        if b"\0" in data[:4096]:
            continue
        text = data.decode("utf-8", errors="replace")
        found += [f"{path}:{n}" for n, line in enumerate(text.splitlines(), 1) if machine.search(line)]
    assert found == []
