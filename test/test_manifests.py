"""Every package.xml says what is imported, launched and in messages, and rosdep knows every key."""

from __future__ import annotations

import ast
import re
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = sorted(path.parent.name for path in ROOT.glob("src/*/package.xml"))
PYTHON = [name for name in PACKAGES if name != "calibration_interfaces"]
BUILT_IN = {
    "bool", "byte", "char", "float32", "float64", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64",
    "uint64", "string", "wstring",
}  # fmt: skip

# Imported module -> rosdep key, where they differ.  A module of a ROS package has the name of its package.
# Looked up in ros/rosdistro, commit 8468e88ccd52 (2026-08-22): rosdep/python.yaml for what begins with python3-,
# jazzy/distribution.yaml for the others.
KEYS = {
    "aiohttp": "python3-aiohttp",
    "hypothesis": "python3-hypothesis",
    "jinja2": "python3-jinja2",
    "jsonschema": "python3-jsonschema",
    "lxml": "python3-lxml",
    "matplotlib": "python3-matplotlib",
    "mujoco": "python3-mujoco-pip",
    "numpy": "python3-numpy",
    "pydantic": "python3-pydantic",
    "pytest": "python3-pytest",
    "rich": "python3-rich",
    "rosbags": "python3-rosbags-pip",
    "scipy": "python3-scipy",
    "tqdm": "python3-tqdm",
    "trimesh": "python3-trimesh-pip",
    "yaml": "python3-yaml",
    "yourdfpy": "python3-yourdfpy-pip",
}
# Modules for which rosdep has no key; pyproject.toml names their packages, and pip installs them.
NO_KEY = {"lz4", "markupsafe", "mcap", "mcap_ros2", "pydantic_core", "typst", "zstandard"}
# Modules that only an extra of pyproject.toml brings, imported where a user asks for what they do.
EXTRAS = {"dask", "distributed", "fsspec", "pandas", "pyarrow"}
# Packages of jazzy/distribution.yaml, same commit.
JAZZY = {
    "action_msgs", "ament_cmake", "ament_index_python", "builtin_interfaces", "coal", "control_msgs", "diagnostic_msgs",
    "geometry_msgs", "launch", "launch_ros", "pinocchio", "rcl_interfaces", "rclpy",
    "robot_state_publisher", "ros2bag", "ros2launch", "rosbag2_storage_mcap", "rosgraph_msgs",
    "rosidl_default_generators", "rosidl_default_runtime", "rosidl_parser", "rviz2", "sensor_msgs", "service_msgs",
    "std_msgs", "std_srvs", "tf2_msgs", "trajectory_msgs", "visualization_msgs",
}  # fmt: skip
# The operator's panel: no key either; .ci/requirements.txt names the packages.
NO_KEY |= {"playwright", "segno", "textual"}
# What no import shows: why it is needed all the same.
BESIDES = {
    "calibration": {
        "control_msgs": "the back end follow_joint_trajectory imports it by name, where it is chosen",
        "tf2_msgs": "the tracker's node reads a target's pose from /tf, where its input_type says so",
        "ros2launch": "the command `ros2 launch`",
        "ros2bag": "the launch file replay plays a bag with it",
        "rosbag2_storage_mcap": "the bags are MCAP",
        "robot_state_publisher": "the launch files start it where it is",
        "rviz2": "the launch files start it where it is",
    },
}


def imports(path: Path) -> set[str]:
    """Top-level modules that the files of a folder import, without those of Python itself."""
    found: set[str] = set()
    for file in path.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                found |= {name.name.partition(".")[0] for name in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
                found.add(node.module.partition(".")[0])
            elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "import_module":
                given = node.args[0] if node.args else None
                if isinstance(given, ast.Constant) and isinstance(given.value, str):
                    found.add(given.value.partition(".")[0])
    return found - set(sys.stdlib_module_names)


def keys(modules: set[str]) -> set[str]:
    """The rosdep keys of modules."""
    return {KEYS.get(module, module) for module in modules - NO_KEY - EXTRAS}


def declared(package: str, *kinds: str) -> set[str]:
    """What a package.xml declares."""
    tree = ET.parse(ROOT / "src" / package / "package.xml")
    return {str(found.text) for kind in kinds for found in tree.findall(kind)}


def launched() -> set[str]:
    """The packages whose executables the launch files start, without their own."""
    path = ROOT / "src" / "calibration" / "calibration" / "process_tree.py"
    sys.path.insert(0, str(path.parents[1]))  # it reads the names of the drivers' tables
    try:
        tree = runpy.run_path(str(path))
    finally:
        del sys.path[0]
    trees = [value for value in tree.values() if type(value).__name__ == "Tree"]
    return {process.package for one in trees for process in one.processes} - {"calibration"}


def messages(package: str) -> Iterator[str]:
    """Packages whose types the messages, services and actions of a package are made of."""
    for file in (ROOT / "src" / package).glob("*/*"):
        if file.suffix in (".msg", ".srv", ".action"):
            for line in file.read_text("utf-8").splitlines():
                match = re.match(r"([a-z]\w*)/\w+", line.partition("#")[0].strip())
                if match and match[1] not in BUILT_IN:
                    yield match[1]
            if file.suffix == ".action":
                yield "action_msgs"


@pytest.mark.parametrize("package", PYTHON)
def test_what_is_imported_is_declared_and_nothing_else(package: str) -> None:
    folder = ROOT / "src" / package
    needed = keys(imports(folder / package) | imports(folder / "launch")) - {package}
    needed |= set(BESIDES.get(package, {})) | (launched() if package == "calibration" else set())
    given = declared(package, "depend", "exec_depend")
    assert given == needed, f"package.xml of {package}: add {sorted(needed - given)}, drop {sorted(given - needed)}"


@pytest.mark.parametrize("package", PYTHON)
def test_what_tests_import_is_declared_and_nothing_else(package: str) -> None:
    folder = ROOT / "src" / package / "test"
    local = {path.stem for path in folder.rglob("*.py")} | {path.name for path in folder.rglob("*") if path.is_dir()}
    local |= {path.stem for path in folder.with_name("doc").rglob("*.py")}  # what makes the documents is tested, too
    given = declared(package, "test_depend")
    needed = keys(imports(folder) - local) - {package} - declared(package, "depend", "exec_depend")
    assert given == needed, (
        f"package.xml of {package}: test: add {sorted(needed - given)}, drop {sorted(given - needed)}"
    )


def test_what_messages_are_made_of_is_declared_found_and_handed_on() -> None:
    package = "calibration_interfaces"
    needed = set(messages(package)) - {package}
    build = (ROOT / "src" / package / "CMakeLists.txt").read_text("utf-8")
    assert declared(package, "depend") == needed
    tools = declared(package, "buildtool_depend")
    assert set(re.findall(r"find_package\((\w+)", build)) == needed | tools
    (handed_on,) = re.findall(r"DEPENDENCIES ([\w\s]+?)\)", build)
    assert set(handed_on.split()) == needed


def test_every_interface_file_is_built() -> None:
    folder = ROOT / "src" / "calibration_interfaces"
    there = {
        f"{path.parent.name}/{path.name}" for path in folder.glob("*/*") if path.suffix in (".msg", ".srv", ".action")
    }
    assert set(re.findall(r'"(\w+/\w+\.(?:msg|srv|action))"', (folder / "CMakeLists.txt").read_text("utf-8"))) == there


@pytest.mark.parametrize("package", PACKAGES)
def test_rosdep_knows_every_key(package: str) -> None:
    kinds = ("depend", "exec_depend", "test_depend", "buildtool_depend")
    unknown = declared(package, *kinds) - set(KEYS.values()) - JAZZY - set(PACKAGES)
    assert unknown == set(), "look these up in ros/rosdistro, then add them to the table of this test"
