"""Markers for RViz: what is shown, in which frame, how large; and over DDS, for whoever comes late."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces import srv
from calibration_interfaces.action import RunPlan
from calibration_interfaces.msg import Outcome
from diagnostic_msgs.msg import DiagnosticArray
from goals import GoalClient
from rclpy.parameter import Parameter
from test_identification import BAG, CELL, ask, finish
from visualization_msgs.msg import Marker, MarkerArray

from calibration.evaluation import identification
from calibration.evaluation.identification import ENLARGED, IdentificationNode
from calibration.evaluation.markers import to_markers
from calibration.sequencer.sequencer import SequencerNode
from calibration.topics import MARKERS, PLAN_MARKERS
from calibration_core.cell import load_cell
from calibration_core.files.yaml_file import yaml_text
from calibration_core.model.kinematics import posture
from calibration_core.model.robot import chain_of
from calibration_core.report.results.scene import Scene

DEMO = CELL.with_name("demo.cell.yaml")
POSES = [[0.1, 0.2, 0.1, 0.0, 0.3, 0.0], [0.4, -0.1, 0.2, 0.3, -0.5, 0.2]]


def by_space(markers: MarkerArray) -> dict[str, list[Marker]]:
    """Markers by namespace; the first one of all clears what was there."""
    assert markers.markers[0].action == Marker.DELETEALL
    found: dict[str, list[Marker]] = {}
    for marker in markers.markers[1:]:
        assert marker.action == Marker.ADD
        assert marker.color.a > 0
        found.setdefault(marker.ns, []).append(marker)
    for same in found.values():
        assert [marker.id for marker in same] == list(range(same[0].id, same[0].id + len(same)))
    return found


def places(points: Any) -> np.ndarray:
    return np.array([[point.x, point.y, point.z] for point in points])


def scene(loads: int) -> Scene:
    first, second = np.arange(6.0).reshape(2, 3), np.arange(6.0).reshape(2, 3) + 0.5
    arrows = np.stack([first, first + 0.1], axis=1)[:loads]
    wrench = np.ones((loads, 3))
    return Scene({"mp1": first, "mp2": second}, wrench, arrows, np.array([[1.75, 2.75, 3.75], [3.5, 3.5, 3.5]]))


def test_points_stand_on_the_flange() -> None:
    cell = load_cell(DEMO)
    found = by_space(to_markers(cell, None))
    assert set(found) == {"measurement_points", "measurement_points_names", "wrench_point", "wrench_point_names"}
    spheres = found["measurement_points"]
    assert {marker.header.frame_id for marker in spheres} == {"flange"}
    expected = list(cell.frames.measurement_points.values())
    np.testing.assert_array_equal(places(marker.pose.position for marker in spheres), expected)
    assert [marker.text for marker in found["measurement_points_names"]] == list(cell.points)
    assert {marker.scale.x for marker in spheres} == {0.02}
    assert tuple(places([found["wrench_point"][0].pose.position])[0]) == cell.frames.wrench_point


def test_space_and_deflections_stand_in_the_base_frame() -> None:
    shown = scene(loads=2)
    found = by_space(to_markers(load_cell(DEMO), shown))
    for name in ("mp1", "mp2"):
        (marker,) = found[f"space_{name}"]
        assert (marker.type, marker.header.frame_id) == (Marker.SPHERE_LIST, "base_link")
        np.testing.assert_array_equal(places(marker.points), shown.points[name])
    np.testing.assert_array_equal(places(found["space_wrench_point"][0].points), shown.wrench_point)
    arrows = found["deflection"]
    assert {(marker.type, marker.header.frame_id) for marker in arrows} == {(Marker.ARROW, "base_link")}
    np.testing.assert_array_equal([places(marker.points) for marker in arrows], shown.arrows)
    (box,) = found["operating_space"]
    np.testing.assert_array_equal(places([box.pose.position]), shown.box[:1])
    assert (box.type, box.scale.x, box.color.a < 0.5) == (Marker.CUBE, 3.5, True)


def test_without_loads_there_are_neither_arrows_nor_wrench_points() -> None:
    found = by_space(to_markers(load_cell(DEMO), scene(loads=0)))
    assert not {"deflection", "space_wrench_point"} & set(found)


def a_plan(folder: Path) -> Path:
    configurations = [
        {"number": number, "q": q, "steps": [[0.0] * 6, [0.0, 0.0, -500.0, 0.0, 0.0, 0.0]]}
        for number, q in enumerate(POSES, start=3)
    ]
    joints = [f"joint_{i}" for i in range(1, 7)]
    path = folder / "plan.yaml"
    path.write_text(yaml_text({"schema": 1, "joints": joints, "configurations": configurations}), "utf-8")
    return path


def test_a_plan_is_shown_when_its_measurement_begins(spinning: Any, until: Callable[..., None], tmp_path: Path) -> None:
    given = {"cell": str(DEMO), "motion.backend": "external", "force_torque": "", "recorder": "", "server_wait": 0.1}
    overrides = [Parameter(name, value=value) for name, value in given.items()]
    spinning.add(SequencerNode(context=spinning.context, parameter_overrides=overrides))
    client = spinning.plain()
    run = GoalClient(client, RunPlan, "/sequencer/run")
    assert run.wait_for_server(20.0)
    goal = RunPlan.Goal(plan=str(a_plan(tmp_path)), session=str(tmp_path / "session"))
    finish(finish(run.send_goal_async(goal)).get_result_async())  # nothing else of the cell is there
    late: list[MarkerArray] = []
    client.create_subscription(PLAN_MARKERS.message, f"/{PLAN_MARKERS.relative}", late.append, PLAN_MARKERS.qos)
    until(lambda: late)
    found = by_space(late[-1])
    cell = load_cell(DEMO)
    at = posture(chain_of(cell), np.array(POSES))
    for name, point in cell.frames.measurement_points.items():
        (marker,) = found[f"space_{name}"]
        np.testing.assert_allclose(places(marker.points), at.point(np.array(point)).T, atol=1e-12)
        assert marker.scale.x == 0.02
    assert cell.frames.wrench_point is not None
    wrench = at.point(np.array(cell.frames.wrench_point)).T
    np.testing.assert_allclose(places(found["space_wrench_point"][0].points), wrench, atol=1e-12)
    assert "deflection" not in found


def test_a_result_is_shown_to_whoever_comes_late(spinning: Any, until: Callable[..., None], tmp_path: Path) -> None:
    overrides = [Parameter("cell", value=str(CELL))]
    spinning.add(IdentificationNode(context=spinning.context, parameter_overrides=overrides))
    client = spinning.plain()
    heard: list[MarkerArray] = []
    client.create_subscription(MARKERS.message, f"/{MARKERS.relative}", heard.append, MARKERS.qos)
    until(lambda: heard)
    assert "operating_space" not in by_space(heard[-1])
    answer = ask(client, srv.IdentifyStiffness, "identify_stiffness", recording=str(BAG), out=str(tmp_path))
    assert answer.outcome.code == Outcome.OK, answer.outcome.text
    late: list[MarkerArray] = []
    spinning.plain("late").create_subscription(MARKERS.message, f"/{MARKERS.relative}", late.append, MARKERS.qos)
    until(lambda: late and "deflection" in by_space(late[-1]))  # drawn beside the answer, not before it
    found = by_space(late[-1])
    space = json.loads(answer.result_json)["operating_space"]
    arrows = np.array([places(marker.points) for marker in found["deflection"]])
    np.testing.assert_allclose(arrows[:, 0], space["points"]["mp1"], rtol=1e-12)
    np.testing.assert_allclose(arrows[:, 1] - arrows[:, 0], ENLARGED * np.array(space["deflection"]), rtol=1e-9)
    assert found["deflection"][0].header.frame_id == "base_link"


def test_a_defect_in_showing_is_told_and_spoils_no_answer(
    spinning: Any, until: Callable[..., None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    node = spinning.add(
        IdentificationNode(context=spinning.context, parameter_overrides=[Parameter("cell", value=str(CELL))])
    )

    def broken(*_: Any) -> None:
        raise RuntimeError("no paint")

    monkeypatch.setattr(identification, "to_markers", broken)
    client = spinning.plain()
    heard: list[Any] = []
    client.create_subscription(DiagnosticArray, "/diagnostics", heard.append, 100)
    until(lambda: heard)
    answer = ask(client, srv.IdentifyStiffness, "identify_stiffness", recording=str(BAG), out=str(tmp_path))
    assert answer.outcome.code == Outcome.OK, answer.outcome.text
    until(lambda: any(one.message == "RuntimeError: no paint" for array in heard for one in array.status))
    assert node.count_publishers(MARKERS.relative) == 1


def test_a_cell_that_cannot_be_read_shows_nothing(spinning: Any, until: Callable[..., None]) -> None:
    overrides = [Parameter("cell", value="/no/such/cell.yaml")]
    node = spinning.add(IdentificationNode(context=spinning.context, parameter_overrides=overrides))
    answer = ask(spinning.plain(), srv.IdentifyStiffness, "identify_stiffness", recording=str(BAG))
    assert answer.outcome.code == Outcome.INPUT_UNUSABLE
    assert "/no/such/cell.yaml" in answer.outcome.text
    assert node.count_publishers(MARKERS.relative) == 1
