"""A plan survives the file; a hostile file gets one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration_core.cell import Cell
from calibration_core.errors import PlanError
from calibration_core.files.yaml_file import yaml_text
from calibration_core.planning.plans.plan import Plan, PlannedConfiguration
from calibration_core.planning.plans.plan_file import KEYS, plan_dict, plan_text, read_plan
from calibration_core.planning.plans.planned_robot import planned_robot
from calibration_core.planning.plans.tolerances import Tolerances


def test_round_trip(plan: Plan, demo_cell: Cell, tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(plan_text(plan), encoding="utf-8")
    again = read_plan(path, demo_cell)
    assert plan_text(again) == plan_text(plan)
    assert np.array_equal(again.table1()[1], plan.table1()[1])
    assert again.expected is not None
    assert plan.expected is not None
    assert again.expected.efficiency == plan.expected.efficiency
    assert again.joints == plan.joints


def test_least_plan(demo_cell: Cell, tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text("configurations: [{q: [0, 0, 0, 0, 0.5, 0], steps: [[0, 0, 0, 0, 0, 0], [0, 0, -500, 0, 0, 0]]}]")
    plan = read_plan(path, demo_cell)
    assert plan.configurations[0].number == 1
    assert plan.startup_cycle.shape == (0, 6)
    assert plan.reference is None


def _change(plan: Plan, *keys: object, value: object) -> str:
    data = plan_dict(plan)
    place = data
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value
    return yaml_text(data)


def test_tolerances(demo_cell: Cell, tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    least = "configurations: [{q: [0, 0, 0, 0, 0.5, 0], steps: [[0, 0, 0, 0, 0, 0]]}]\n"
    path.write_text(least)
    assert read_plan(path, demo_cell).tolerances == Tolerances()
    path.write_text(least + "tolerances: {hold: 0.001, force_floor: 20}\n")
    assert read_plan(path, demo_cell).tolerances == Tolerances(hold=0.001, force_floor=20)


def test_a_plan_for_another_robot_is_refused(small_cell: Cell, tmp_path: Path) -> None:
    path, robot = tmp_path / "plan.yaml", small_cell.robot
    one = PlannedConfiguration(1, np.full(6, 0.1), np.zeros((1, 6)))
    plan = Plan(robot.name, robot.joints, (one,), np.empty((0, 6)), made_for=planned_robot(small_cell))
    path.write_text(plan_text(plan), encoding="utf-8")

    def read_with(**changes: object) -> Plan:
        return read_plan(path, small_cell.model_copy(update={"robot": robot.model_copy(update=changes)}))

    assert plan_text(read_with()) == plan_text(plan)
    with pytest.raises(PlanError, match=r"robot: found '.*', expected the cell's robot 'another'"):
        read_with(name="another")
    assert robot.dh is not None
    assert robot.joint_limits is not None
    longer, calibrated = (tuple(row.model_copy(update={"a": row.a + more}) for row in robot.dh) for more in (0.2, 1e-3))
    with pytest.raises(PlanError, match=r"made_for: found the flange \d+ mm elsewhere"):
        read_with(dh=longer)
    read_with(dh=calibrated)
    with pytest.raises(PlanError, match=r"limits of joint_1 .* not .*; limits of joint_2"):
        read_with(joint_limits=tuple((lo, hi + 0.1) for lo, hi in robot.joint_limits))


HOSTILE = [
    ("robot", "another"),
    ("made_for", 3),
    ("made_for", {"limits": []}),
    ("made_for", {"limits": [[0, 1]], "flange": [[0, 0, 0]]}),
    ("made_for", "limits", 0, 0, float("nan")),
    ("made_for", "flange", 0, [1, 2]),
    ("made_for", "flange", 0, "x"),
    ("tolerances", [1]),
    ("tolerances", {"postures": 0.01}),
    ("tolerances", {"posture": 0.0}),
    ("tolerances", {"posture": float("nan")}),
    ("tolerances", {"hold": "wide"}),
    ("tolerances", {"force": True}),
    ("tolerances", {"direction": 2.0}),
    ("configurations", 0, "q", [0.0] * 5),
    ("configurations", 0, "q", [0.0] * 5 + [float("nan")]),
    ("configurations", 0, "q", [0.0] * 5 + [99.0]),
    ("configurations", 0, "q", "home"),
    ("configurations", 0, "steps", []),
    ("configurations", 0, "steps", [[0.0] * 5]),
    ("configurations", 0, "steps", [[1e9, 0, 0, 0, 0, 0]]),
    ("configurations", 0, "steps", [[True, 0, 0, 0, 0, 0]]),
    ("configurations", 0, "number", 2),
    ("configurations", 0, "number", -1),
    ("configurations", 0, "number", 1.5),
    ("configurations", 0, "spare", "yes"),
    ("configurations", 0, "speed", 3),
    ("configurations", 0, 7),
    ("configurations", []),
    ("configurations", None),
    ("joints", ["a", "b"]),
    ("robot", 5),
    ("schema", 2),
    ("startup_cycle", 3),
    ("startup_cycle", [[0.0]]),
    ("reference", [1]),
    ("reference", {"q": [0.0] * 6, "every": -1}),
    ("reference", {"q": [9.0] * 6, "every": 1}),
    ("extra", 1),
]


@pytest.mark.parametrize("change", HOSTILE, ids=lambda change: str(change)[:40])
def test_hostile_values(change: tuple, plan: Plan, demo_cell: Cell, tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(_change(plan, *change[:-1], value=change[-1]))
    with pytest.raises(PlanError) as caught:
        read_plan(path, demo_cell)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "content",
    [b"", b"\xff\xfe\x00", b"[1, 2", b"text", b"{" * 3000, b"a: &a [1]\nb: [" + b"*a, " * 200 + b"]", b"- 1\n- 2\n"],
    ids=["empty", "binary", "cut off", "text", "deep", "aliases", "list"],
)
def test_hostile_bytes(content: bytes, demo_cell: Cell, tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    path.write_bytes(content)
    with pytest.raises(PlanError):
        read_plan(path, demo_cell)


def test_missing_directory_and_huge(demo_cell: Cell, tmp_path: Path) -> None:
    for path in (tmp_path / "none.yaml", tmp_path):
        with pytest.raises(PlanError):
            read_plan(path, demo_cell)
    huge = tmp_path / "huge.yaml"
    with huge.open("wb") as file:
        file.truncate(9 << 20)
    with pytest.raises(PlanError, match="at most"):
        read_plan(huge, demo_cell)


def test_all_spares(plan: Plan, demo_cell: Cell, tmp_path: Path) -> None:
    data = plan_dict(plan)
    for row in data["configurations"]:
        row["spare"] = True
    path = tmp_path / "plan.yaml"
    path.write_text(yaml_text(data))
    with pytest.raises(PlanError, match="spares only"):
        read_plan(path, demo_cell)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=7) | st.dictionaries(st.sampled_from(["q", "steps"]), inner, max_size=2),
    max_leaves=12,
)


@settings(max_examples=150, deadline=None)
@given(value=VALUES, key=st.sampled_from(KEYS))
def test_any_value_is_read_or_refused(
    value: object, key: str, demo_cell: Cell, tmp_path_factory: pytest.TempPathFactory
) -> None:
    data = {"configurations": [{"q": [0.0] * 6, "steps": [[0.0] * 6]}], key: value}
    path = tmp_path_factory.mktemp("plans") / "plan.yaml"
    path.write_text(yaml_text(data))
    text, plan = "", None
    try:
        plan = read_plan(path, demo_cell)
    except PlanError as error:
        text = str(error)
    assert "\n" not in text
    assert text or (plan is not None and plan.configurations)
