"""The house keeps its shape: imports run one way, and files stay small."""

from __future__ import annotations

import ast
import functools
import re
import subprocess
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = {
    name: ROOT / "src" / name / name
    for name in ("calibration_core", "calibration_sim", "calibration")
    if (ROOT / "src" / name / name).is_dir()
}
MAX_LINES = 700
TOP_LEVEL = {"src", "config", "test", "bags", "README.md", "colcon.meta", "Makefile", "LICENSE"}

CHAIN = (
    "timeseries",
    "recording",
    "observations",
    "model",
    "input_checks",
    "identification",
    "estimation",
    "compensation",
    "diagnosis",
    "report",
)
# Families of a layer and its single modules: each may import itself and what stands before it.
FAMILIES = {
    "identification": (
        "statistics", "circle_point", "wrist", "result", "checks", "geometry", "stiffness", "absolute", "standard",
        "several", "identify", "progress",
    ),
    "diagnosis": (
        "location", "comparison", "result", "data_checks", "evidence", "empirical", "findings", "proposals",
        "model_estimate", "loaded", "positions", "simulated", "waterfall", "diagnose",
    ),
}  # fmt: skip
FOR_ALL = {"errors", "files", "cell", "loading", "policy"}
BESIDE_THE_CHAIN = {
    "motion": {"timeseries", "model", "motion"},
    "planning": {"timeseries", "recording", "model", "motion", "planning", "identification.result.observability"},
    "measurement": {"timeseries", "recording", "model", "planning.plans", "measurement"},
    "formats": {"timeseries", "model", "formats"},
    "acceptance": {"timeseries", "observations", "model", "identification", "acceptance"},
    "engine": {"engine"},
}
# Above all of these: what commands and library compute, and the whole reports of it.
OUTCOMES = {*CHAIN, *BESIDE_THE_CHAIN, "outcomes"}
DOCUMENTS = "report.documents"
ENTRY = {"cli", "start", "commands", "library", "fleet", "__main__"}
FOR_SIM = {"errors", "files", "cell", "loading", "timeseries", "recording", "engine"}
SIM_NODE = {f"calibration_sim.living_cell.{name}" for name in ("process", "node", "messages")}
parse = functools.cache(ast.parse)  # each file once
MESSAGES = re.compile(r"(.*_(msgs|interfaces)|rclpy|rosidl_.*|launch|launch_ros|ament_.*)(\..*)?")


# --- reading imports ------------------------------------------------------------------------------------------------


def module_name(path: Path, package: Path) -> str:
    """Dotted name of a source file, e.g. calibration_core.model.robot."""
    parts = path.relative_to(package.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(tree: ast.Module, module: str, is_package: bool) -> Iterator[tuple[int, str]]:
    """Yields (line, dotted name) for everything that a file imports, wherever in the file it does so.

    `from a.b import c` yields a.b.c, because c may be a module; names are compared by prefix.
    """
    for node in ast.walk(tree):
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
    document = within(inside, {DOCUMENTS})
    if layer == "outcomes" or document or within(part, {DOCUMENTS}):
        return within(part, {*OUTCOMES, *FOR_ALL}) and (document or not within(part, {DOCUMENTS}))
    if not layer and within(part, {"library", "cell", "errors"}):  # the package's names are the library's
        return True
    if layer in {"", "errors"}:  # besides, the package itself and the errors stand on nothing else
        return not within(part.partition(".")[0], {*OUTCOMES, "cell", *ENTRY})
    if layer == "files":
        return within(part, {"errors", "files"})
    if part == "__version__" or within(part, FOR_ALL):
        return True
    if layer in BESIDE_THE_CHAIN:
        return within(part, BESIDE_THE_CHAIN[layer])
    return layer in CHAIN and within(part, set(CHAIN[: CHAIN.index(layer) + 1])) and _within_families(inside, part)


def _within_families(inside: str, part: str) -> bool:
    """Whether, within one layer, a family imports itself or one before it; between layers there is no more to say."""
    (layer, _, mine), (other, _, target) = inside.partition("."), part.partition(".")
    if layer != other or layer not in FAMILIES:
        return True
    families = FAMILIES[layer]
    return target.partition(".")[0] in families[: families.index(mine.partition(".")[0]) + 1]


def python_files() -> list[tuple[str, Path]]:
    return [(name, path) for name, package in SOURCES.items() for path in sorted(package.rglob("*.py"))]


# --- the rules on the tree ------------------------------------------------------------------------------------------


def test_imports_follow_the_arrows() -> None:
    wrong = []
    for name, path in python_files():
        module = module_name(path, SOURCES[name])
        for line, target in imports(parse(path.read_text(encoding="utf-8")), module, path.name == "__init__.py"):
            if not may_import(module, target):
                wrong.append(f"{path.relative_to(ROOT)}:{line}: {module} may not import {target}")
    assert len(python_files()) > 20
    assert wrong == []


@pytest.mark.parametrize("layer", FAMILIES)
def test_families_are_those_that_exist(layer: str) -> None:
    inside = (SOURCES["calibration_core"] / layer).iterdir()
    names = {path.stem for path in inside if path.suffix == ".py" or (path / "__init__.py").is_file()}
    assert names - {"__init__"} == set(FAMILIES[layer])


def without_types(tree: ast.Module) -> ast.Module:
    """Code without what only a type checker reads."""
    body = [node for node in tree.body if not (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test))]
    return ast.Module(body, [])


def test_no_module_needs_itself() -> None:
    paths = {module_name(path, SOURCES[name]): path for name, path in python_files()}
    needs: dict[str, set[str]] = {}
    for module, path in paths.items():
        tree = without_types(parse(path.read_text(encoding="utf-8")))
        targets = {target for _, target in imports(tree, module, path.name == "__init__.py")}
        homes = {target if target in paths else target.rpartition(".")[0] for target in targets}
        needs[module] = {home for home in homes if home in paths and home != module}
    assert sum(map(len, needs.values())) > 2000
    TopologicalSorter(needs).prepare()  # raises CycleError with the circle


@pytest.mark.parametrize(
    ("module", "line", "allowed"),
    [
        ("calibration_core.model.robot", "from calibration_core import report", False),
        ("calibration_core.model.robot", "from ..diagnosis import findings", False),
        ("calibration_core.model.effects.joint_law.creep", "def f():\n    import calibration_core.diagnosis", False),
        ("calibration_core.recording.bags.bag", "import importlib\nimportlib.import_module('rclpy.node')", False),
        ("calibration_core.files.yaml_file", "from calibration_core.cell import Cell", False),
        ("calibration_core.outcomes.prediction", "from calibration_core.report.documents import plan", False),
        ("calibration_core.report.documents.plan", "from calibration_core.outcomes.spaces import planned_space", True),
        ("calibration_core.identification.geometry.fit", "from calibration_core.identification import progress", False),
        ("calibration_sim.cell.sensors", "from calibration_core.model.robot import Robot", False),
        ("calibration_sim.living_cell.process", "from std_msgs.msg import String", True),
        ("calibration.topics", "from calibration_sim.cli import main", False),
    ],
)
def test_the_arrows_themselves(module: str, line: str, allowed: bool) -> None:
    targets = [target for _, target in imports(parse(line), module, is_package=False)]
    assert all(may_import(module, target) for target in targets) is allowed


def uncomparable(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yields (line, name) of dataclasses that are compared by value although a field can hold an array or NaN.

    Comparing arrays raises; NaN differs from itself, so that two equal values differ (since Python 3.13 always).
    """
    for node in ast.walk(tree):
        marks = [ast.unparse(mark) for mark in node.decorator_list] if isinstance(node, ast.ClassDef) else []
        if not any("dataclass" in mark and "eq=False" not in mark for mark in marks):
            continue
        fields = [one for one in node.body if isinstance(one, ast.AnnAssign) and "ClassVar" not in ast.unparse(one)]
        kinds = [ast.unparse(one.annotation).partition("Callable")[0] for one in fields]
        defaults = [ast.unparse(one.value) for one in fields if one.value is not None]
        if (
            any(re.search(r"\b((Float|Int|Bool)[1-4N]D?|NDArray|ndarray)\b", kind) for kind in kinds)
            or any(re.search(r"\bnan\b", default, re.IGNORECASE) for default in defaults)
            or "NaN" in (ast.get_docstring(node) or "")
        ):
            yield node.lineno, node.name


def test_values_that_are_compared_hold_neither_arrays_nor_nan() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {name} (eq=False, or None for what is unknown)"
        for _, path in python_files()
        for line, name in uncomparable(parse(path.read_text(encoding="utf-8")))
    ]
    assert found == []


@pytest.mark.parametrize(
    ("mark", "field", "found"),
    [
        ("frozen=True", "q: Float1D", True),
        ("", "q: NDArray[np.bool_] | None = None", True),
        ("frozen=True", "age: float = math.nan", True),
        ("frozen=True", "'age: s; NaN where nothing is known.'", True),
        ("frozen=True, eq=False", "q: Float1D", False),
        ("frozen=True", "age: float | None = None", False),
        ("frozen=True", "score: Callable[[Float1D], float]", False),
    ],
)
def test_uncomparable_values_are_found(mark: str, field: str, found: bool) -> None:
    assert bool(list(uncomparable(parse(f"@dataclasses.dataclass({mark})\nclass A:\n    {field}")))) is found


# --- the rules on tracked files -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tracked() -> list[Path]:
    """Files that belong to the project, relative to its root."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("not a git checkout: which files belong to the project is not known")
    names = [Path(name) for name in listed.stdout.split("\0") if name]
    return [name for name in names if (ROOT / name).is_file()]


def test_top_level_holds_the_agreed_names_only(tracked: list[Path]) -> None:
    names = {path.parts[0] for path in tracked}
    assert {name for name in names if not name.startswith(".")} <= TOP_LEVEL
    assert names >= {"src", "config", "test", "README.md", "colcon.meta", "Makefile", "LICENSE"}


def test_files_have_one_subject(tracked: list[Path]) -> None:
    lengths = {path: len((ROOT / path).read_text(encoding="utf-8").splitlines()) for path in tracked if is_python(path)}
    assert {str(path): lines for path, lines in lengths.items() if lines > MAX_LINES} == {}


def test_words_of_a_variant_are_read_in_files_alone() -> None:
    """What a form of an effect is stands in `Candidate.shape`; a model file, which has words alone, is read back."""
    taken_apart = re.compile(
        r"variant(\.\w+with|\.remove\w+|\.r?split|\.r?partition|\[)|\bin \w*\.?variant\b|match\(\w*\.?variant"
    )
    readers = {"absolute/transmission_error.py", "effects/point_chain.py", "structure/gravity_compensator.py"}
    found = {
        f"{path.parent.name}/{path.name}"
        for name, path in python_files()
        if name == "calibration_core" and taken_apart.search(path.read_text(encoding="utf-8"))
    }
    assert found == readers


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
