"""Launch files and the parameter file name only what there is; checked without `launch`, which may be absent."""

from __future__ import annotations

import ast
import itertools
import os
import re
import runpy
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

import calibration.executables as entry_points
from calibration import compensation, manager, panel, process_tree, recorder
from calibration.evaluation import identification
from calibration.guard import guard
from calibration.instruments import force_torque, tracker
from calibration.instruments.acquisition import COMMON
from calibration.node import NODE_NAMES, Declared
from calibration.sequencer import parameters as sequencer_parameters
from calibration_core.errors import InputError

ROOT = Path(__file__).resolve().parents[3]
PACKAGE = Path(__file__).resolve().parents[1]
CELL = ROOT / "config" / "cells" / "demo.cell.yaml"
SHARE = ROOT / "install" / "calibration" / "share" / "calibration"
LAUNCH_FILES = sorted((PACKAGE / "launch").glob("*.launch.py"))
TABLES: dict[str, tuple[Declared, ...]] = {
    "tracker": (*COMMON, *tracker.PARAMETERS),
    "force_torque": (*COMMON, *force_torque.PARAMETERS),
    "guard": guard.PARAMETERS,
    "sequencer": sequencer_parameters.PARAMETERS,
    "recorder": recorder.PARAMETERS,
    "manager": manager.PARAMETERS,
    "panel": panel.PARAMETERS,
    "identification": identification.PARAMETERS,
    "compensation": compensation.PARAMETERS,
}


class Made:
    """Stands for any class of launch: remembers what it was made with."""

    def __init__(self, *positional: Any, **named: Any) -> None:
        self.positional, self.named = positional, named


STAND_INS = {
    "launch": ("LaunchDescription",),
    "launch.actions": ("DeclareLaunchArgument", "ExecuteProcess", "LogInfo", "OpaqueFunction", "TimerAction"),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.parameter_descriptions": ("ParameterValue",),
}
TREES = {
    "real_cell": process_tree.REAL_CELL,
    "replay": process_tree.REPLAY,
    "simulated_cell": process_tree.SIMULATED_CELL,
}


@pytest.fixture(params=LAUNCH_FILES, ids=lambda path: path.name.partition(".")[0])
def path(request: pytest.FixtureRequest) -> Path:
    """A launch file."""
    return Path(request.param)


@pytest.fixture
def tree(path: Path) -> process_tree.Tree:
    """The table that a launch file reads."""
    return TREES[path.name.partition(".")[0]]


@pytest.fixture
def said(tmp_path: Path, tree: process_tree.Tree) -> dict[str, str]:
    """Values of the arguments that must be said."""
    return {one.name: str(CELL if one.path == "file" else tmp_path) for one in tree.arguments if one.default is None}


@pytest.fixture
def description(path: Path, said: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> list[Made]:
    """The entities that a launch file declares, and those that it starts."""
    monkeypatch.delitem(sys.modules, "calibration.launch_tree", raising=False)
    for name, classes in STAND_INS.items():
        module = ModuleType(name)
        for one in classes:
            setattr(module, one, type(one, (Made,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    made = runpy.run_path(str(path))["generate_launch_description"]()
    monkeypatch.setattr(sys.modules["calibration.launch_tree"], "get_package_share_directory", lambda _: str(SHARE))
    monkeypatch.delitem(sys.modules, "calibration.launch_tree", raising=False)  # it knows the stand-ins
    *declared, starting = made.positional[0]
    values = {one.positional[0]: one.named["default_value"] for one in declared} | said
    context = Made()
    context.launch_configurations = values
    return [*declared, *starting.named["function"](context, *starting.named["args"])]


def of(kind: str, entities: list[Made]) -> list[Made]:
    return [one for one in entities if type(one).__name__ == kind]


def executables(package: str) -> set[str]:
    """Names of the executables that a package's setup.py declares."""
    code = (ROOT / "src" / package / "setup.py").read_text("utf-8")
    if package == "calibration":
        (names,) = [
            one.value
            for one in ast.walk(ast.parse(code))
            if isinstance(one, ast.Assign) and one.targets[0].id == "NODES"
        ]
        return set(ast.literal_eval(names))
    return set(re.findall(r'"(\w+) = [\w.]+:\w+"', code))


def test_every_executable_has_an_entry_point() -> None:
    assert all(callable(getattr(entry_points, name)) for name in executables("calibration"))


def simulated_cell() -> set[str]:
    from calibration_sim.living_cell.messages import PARAMETERS

    return set(PARAMETERS)


def known(node: str) -> set[str]:
    names = simulated_cell() if node == "simulated_cell" else {one.name for one in TABLES[node]}
    return names | {"use_sim_time"}


def test_every_executable_exists(description: list[Made]) -> None:
    nodes = of("Node", description)
    assert nodes
    for node in nodes:
        assert node.named["executable"] in executables(node.named["package"])


def test_every_parameter_exists_and_has_its_type(tree: process_tree.Tree) -> None:
    for process in tree.processes:
        assert process.parameters.keys() <= known(process.name)
        for one in TABLES.get(process.name, ()):
            value = process.parameters.get(one.name)
            types = {argument.name: argument.type for argument in tree.arguments}
            if isinstance(value, process_tree.Given):
                assert types[value.argument] is type(one.default)
            else:
                assert value is None or (one.fault(value) == "" and type(value) is type(one.default))
            assert not one.required or one.name in process.parameters


def test_a_launch_file_says_what_the_table_says(
    description: list[Made], tree: process_tree.Tree, said: dict[str, str]
) -> None:
    nodes = [one for one in of("Node", description) if one.named["package"].startswith("calibration")]
    assert [node.named["executable"] for node in nodes] == [process.name for process in tree.processes]
    values = process_tree.values_of(tree, said)
    for node, process in zip(nodes, tree.processes, strict=True):
        *files, given = node.named["parameters"]
        assert tuple(files) == process_tree.files_of(values, str(SHARE))
        assert node.named["package"] == process.package
        found = {name: value.positional[0] for name, value in given.items()}
        assert found == process_tree.parameters_of(tree, process, values)
        assert all(value.named["value_type"] is type(value.positional[0]) for value in given.values())
        assert node.named["additional_env"] == {process_tree.STARTED_BY: str(os.getpid())}
        assert float(node.named["sigterm_timeout"]) == process.sigterm_after
        assert float(node.named["sigkill_timeout"]) == process.sigkill_after
    assert [len(one.named["cmd"]) for one in of("ExecuteProcess", description)] == [
        len(tool.words) for tool in tree.tools
    ]


def test_every_argument_is_declared_described_and_used(description: list[Made], tree: process_tree.Tree) -> None:
    declared = [one.positional[0] for one in of("DeclareLaunchArgument", description)]
    values = [*(value for process in tree.processes for value in process.parameters.values()),
              *(word for tool in tree.tools for word in tool.words)]  # fmt: skip
    used = {value.argument for value in values if isinstance(value, process_tree.Given)}
    assert used | {"namespace", "params_file", "log_level", "rviz", "transforms"} == set(declared)
    assert all(one.named["description"].endswith(".") for one in of("DeclareLaunchArgument", description))


def test_a_node_that_ends_ends_no_other_and_one_that_crashed_is_started_again(
    description: list[Made], tree: process_tree.Tree
) -> None:
    nodes = [one for one in of("Node", description) if one.named["package"].startswith("calibration")]
    for node, process in zip(nodes, tree.processes, strict=True):
        for code, shutdown in itertools.product((0, 1, 2, -9, -11), (False, True)):
            event, context = Made(), Made()
            event.returncode, context.is_shutdown = code, shutdown
            started = node.named["on_exit"](event, context)
            again = code not in (0, 2) and not shutdown and process.name != "simulated_cell"
            assert bool(started) is again
            for timer in started:
                (same,) = timer.named["actions"]
                assert timer.named["period"] > 1.0
                assert same.named["executable"] == process.name
                assert same.named["on_exit"] is not None


@pytest.mark.parametrize("name", ["real_cell", "simulated_cell"])
def test_the_guard_outlives_the_others(name: str) -> None:
    """Launch ends a process 5 s after the first signal; who stops the robot waits longer for it to stand."""
    rows = {process.name: process for process in TREES[name].processes}
    assert rows["guard"].sigterm_after > process_tree.STANDSTILL
    assert rows["guard"].sigterm_after > rows["sequencer"].sigterm_after
    assert list(rows).index("guard") < list(rows).index("sequencer")
    motion = [{key: value for key, value in rows[node].parameters.items() if key.startswith("motion.")}
              for node in ("guard", "sequencer")]  # fmt: skip
    assert motion[0] == motion[1] != {}  # who stops the robot reaches it where it is moved


def test_values_of_a_tree(tmp_path: Path) -> None:
    said = {"cell": str(CELL), "session": "/s", "speed": "2.5"}
    values = process_tree.values_of(process_tree.SIMULATED_CELL, said)
    rows = {process.name: process for process in process_tree.SIMULATED_CELL.processes}
    given = process_tree.parameters_of(process_tree.SIMULATED_CELL, rows["simulated_cell"], values)
    assert (given["speed"], given["seed"], given["cell"]) == (2.5, 1, str(CELL))
    sequencer = process_tree.parameters_of(process_tree.SIMULATED_CELL, rows["sequencer"], values)
    assert "recording" not in sequencer  # the goal's session decides
    recorder = process_tree.parameters_of(process_tree.SIMULATED_CELL, rows["recorder"], values)
    assert recorder["out"] == "/s/bag"


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"cell": "/no/such.yaml"}, "arguments: cell: found no file /no/such.yaml, expected The cell file. Say cell:="),
        ({"cell": str(ROOT / "config")}, "cell: found a directory"),
        ({"cell": ""}, "cell: found nothing"),
        ({}, "cell: found nothing"),
        ({"cell": str(CELL), "session": "s", "speed": "fast"}, "speed: found 'fast', expected a number"),
        ({"cell": str(CELL), "session": "s", "params_file": "/no.yaml"}, "params_file: found no file /no.yaml"),
    ],
)
def test_what_cannot_be_used_is_one_line_before_anything_starts(said: dict[str, str], words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)) as error:
        process_tree.values_of(process_tree.SIMULATED_CELL, said)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("content", "words"), [("name: [", "cell.yaml:2:1: found "), ("name: x\nrobot: 3\n", "cell.yaml: ")]
)
def test_a_broken_cell_file_starts_nothing(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text(content, "utf-8")
    with pytest.raises(InputError, match=words) as error:
        process_tree.values_of(process_tree.SIMULATED_CELL, {"cell": str(path), "session": "s"})
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_later_parameter_files_overrule_and_all_are_installed(tmp_path: Path) -> None:
    own = tmp_path / "my.yaml"
    own.write_text("guard: {ros__parameters: {rate: 30.0}}\n", "utf-8")
    said = {"cell": str(CELL), "session": "s", "params_file": str(own)}
    slow = process_tree.values_of(process_tree.SIMULATED_CELL, said)
    fast = process_tree.values_of(process_tree.SIMULATED_CELL, {**said, "speed": "20.0"})
    faster = f"{SHARE}/config/simulation.yaml"
    assert process_tree.files_of(slow, str(SHARE)) == (str(own),)
    assert process_tree.files_of(fast, str(SHARE)) == (faster, str(own))
    assert Path(faster).resolve() == ROOT / "config" / "simulation.yaml"


def test_the_file_of_a_fast_simulation_knows_what_it_names_and_is_wide_throughout() -> None:
    file = yaml.safe_load((ROOT / "config" / "simulation.yaml").read_text("utf-8"))
    for key, section in file.items():
        node, given = key.removeprefix("/**/"), section["ros__parameters"]
        assert given.keys() <= known(node)
        for one in TABLES.get(node, ()):
            value = given.get(one.name)
            assert value is None or (one.fault(value) == "" and type(value) is type(one.default)), one.name
            age = one.name.endswith("_age") and "generic" not in one.name
            assert not age or value is not None, f"{node}: {one.name} counts wall time and stays narrow"
            assert not age or value > one.default


def test_launch_files_compute_nothing() -> None:
    assert len(LAUNCH_FILES) == 3
    for path in LAUNCH_FILES:
        tree = ast.parse(path.read_text("utf-8"))
        doing = (ast.If, ast.For, ast.While, ast.Try, ast.Lambda, ast.BinOp, ast.ListComp)
        assert not [node for node in ast.walk(tree) if isinstance(node, doing)]


def test_nodes_are_all_known() -> None:
    assert executables("calibration") | executables("calibration_sim") == set(NODE_NAMES)
