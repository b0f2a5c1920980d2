"""The node `identification`: every branch of every service, the same files as the command line, cancel and progress."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from granted import Granted

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces import srv
from calibration_interfaces.action import Identify
from calibration_interfaces.msg import Outcome
from goals import GoalClient
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import Parameter
from scipy.spatial.transform import Rotation

from calibration.evaluation import results
from calibration.evaluation.identification import IdentificationNode

ROOT = Path(__file__).resolve().parents[3]
BAG = ROOT / "bags" / "small_loaded"
CELL = ROOT / "config" / "cells" / "small.cell.yaml"
BIN = Path(sys.prefix) / "bin"


@pytest.fixture
def node(spinning: Any) -> IdentificationNode:
    overrides = [Parameter("cell", value=str(CELL))]
    return spinning.add(IdentificationNode(context=spinning.context, parameter_overrides=overrides))


def finish(future: Any, timeout: float = 60.0) -> Any:
    end = time.monotonic() + timeout
    while not future.done():
        assert time.monotonic() < end, "no answer"
        time.sleep(0.005)
    return future.result()


def ask(client: Any, kind: Any, name: str, **fields: Any) -> Any:
    service = client.create_client(kind, f"/identification/{name}")
    assert service.wait_for_service(20.0)
    return finish(service.call_async(kind.Request(**fields)))


@pytest.fixture(scope="module")
def offline(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the command line makes of the recording."""
    out = tmp_path_factory.mktemp("offline")
    command = [BIN / "calibration", "identify", BAG, "--cell", CELL, "--out", out]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    return out


def test_stiffness_is_that_of_the_command_line(
    spinning: Any, node: Any, offline: Path, until: Callable[..., None], tmp_path: Path
) -> None:
    answer = ask(spinning.plain(), srv.IdentifyStiffness, "identify_stiffness", recording=str(BAG), out=str(tmp_path))
    assert answer.outcome.code == Outcome.OK, answer.outcome.text
    assert (tmp_path / "result.json").read_bytes() == (offline / "result.json").read_bytes()
    for name in ("table2.csv", "model.yaml"):
        assert (tmp_path / name).read_bytes() == (offline / name).read_bytes()
    assert answer.result_json.encode() == (offline / "result.json").read_bytes()
    assert Path(answer.report_path) == tmp_path / "report.html"
    until(Path(answer.report_path).is_file, timeout=120.0)
    assert (tmp_path / "result.json").read_bytes() == (offline / "result.json").read_bytes()
    rows = json.loads(answer.result_json)["stiffness"]
    assert list(answer.joints) == [row["joint"] for row in rows]
    assert list(answer.stiffness) == [row["value"] for row in rows]
    assert list(answer.std) == [row["std"] for row in rows]
    assert all(answer.identifiable)


def test_the_current_session_and_its_default_place(spinning: Any, node: Any, tmp_path: Path) -> None:
    client = spinning.plain()
    answer = ask(client, srv.IdentifyStiffness, "identify_stiffness")
    assert answer.outcome.code == Outcome.INPUT_UNUSABLE
    assert answer.outcome.text.startswith("recording: found nothing")
    shutil.copytree(BAG, tmp_path / "recording")
    node.set_parameters([Parameter("recording", value=str(tmp_path / "recording"))])
    answer = ask(client, srv.IdentifyStiffness, "identify_stiffness")
    assert answer.outcome.code == Outcome.OK, answer.outcome.text
    assert Path(answer.report_path) == tmp_path / "identify" / "report.html"


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"recording": "/no/such/bag"}, "/no/such/bag"),
        ({"recording": str(BAG), "cell": "/no/such/cell.yaml"}, "/no/such/cell.yaml"),
        ({"recording": str(BAG), "test": "/no/such/test"}, "/no/such/test"),
    ],
)
def test_input_that_cannot_be_used(
    spinning: Any, node: Any, tmp_path: Path, fields: dict[str, str], words: str
) -> None:
    out = tmp_path / "out"
    answer = ask(spinning.plain(), srv.IdentifyStiffness, "identify_stiffness", out=str(out), **fields)
    assert answer.outcome.code == Outcome.INPUT_UNUSABLE
    assert words in answer.outcome.text
    assert "\n" not in answer.outcome.text
    assert not out.exists()


def test_a_command_that_this_version_has_not(
    spinning: Any, node: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(node._worker, "commands_when_ready", lambda _cancelled: ("identify",))
    answer = ask(spinning.plain(), srv.Diagnose, "diagnose", recording=str(BAG), out=str(tmp_path / "out"))
    assert answer.outcome.code == Outcome.NOT_AVAILABLE
    assert answer.outcome.text == "this version has no command diagnose"
    assert not (tmp_path / "out").exists()


def test_busy_and_responsive_meanwhile(spinning: Any, node: Any, tmp_path: Path) -> None:
    client = spinning.plain()
    service = client.create_client(srv.IdentifyStiffness, "/identification/identify_stiffness")
    parameters = client.create_client(GetParameters, "/identification/get_parameters")
    assert service.wait_for_service(20.0)
    assert parameters.wait_for_service(20.0)
    long = service.call_async(srv.IdentifyStiffness.Request(recording=str(BAG), out=str(tmp_path / "a")))
    time.sleep(0.05)
    answer = finish(service.call_async(srv.IdentifyStiffness.Request(recording=str(BAG), out=str(tmp_path / "b"))))
    assert answer.outcome.code == Outcome.BUSY
    watch = Granted()
    finish(parameters.call_async(GetParameters.Request(names=["cell"])))
    assert watch.seconds < 0.5
    assert not long.done()
    assert finish(long).outcome.code == Outcome.OK


def test_action_with_progress(spinning: Any, node: Any, offline: Path, tmp_path: Path) -> None:
    told: list[Any] = []
    client = GoalClient(spinning.plain(), Identify, "/identification/identify")
    assert client.wait_for_server(20.0)
    goal = Identify.Goal(what=Identify.Goal.STIFFNESS, recording=str(BAG), out=str(tmp_path))
    handle = finish(client.send_goal_async(goal, feedback_callback=told.append))
    result = finish(handle.get_result_async()).result
    assert result.outcome.code == Outcome.OK, result.outcome.text
    assert result.result_json.encode() == (offline / "result.json").read_bytes()
    shares = [one.feedback.share_done for one in told]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    said = [one.feedback.text for one in told]
    assert any(text.startswith(("identifying", "drawing the report")) for text in said), said
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in offline.iterdir()}


def test_cancel_leaves_nothing_half_and_the_next_works(
    spinning: Any, node: Any, until: Callable[..., None], tmp_path: Path
) -> None:
    client = GoalClient(spinning.plain(), Identify, "/identification/identify")
    assert client.wait_for_server(20.0)
    goal = Identify.Goal(what=Identify.Goal.STIFFNESS, recording=str(BAG), out=str(tmp_path / "out"))
    handle = finish(client.send_goal_async(goal))
    assert finish(handle.cancel_goal_async()).goals_canceling
    result = finish(handle.get_result_async()).result
    assert result.outcome.code == Outcome.CANCELLED
    assert not (tmp_path / "out").exists()
    result = finish(finish(client.send_goal_async(goal)).get_result_async()).result
    assert result.outcome.code == Outcome.OK, result.outcome.text


def test_unknown_goal_and_lost_process(spinning: Any, node: Any, tmp_path: Path) -> None:
    client = GoalClient(spinning.plain(), Identify, "/identification/identify")
    assert client.wait_for_server(20.0)
    result = finish(finish(client.send_goal_async(Identify.Goal(what=99))).get_result_async()).result
    assert result.outcome.code == Outcome.INPUT_UNUSABLE
    node._worker._process.kill()
    goal = Identify.Goal(recording=str(BAG), out=str(tmp_path))
    result = finish(finish(client.send_goal_async(goal)).get_result_async()).result
    assert (result.outcome.code, result.outcome.text) == (Outcome.INTERNAL, "the process that computes has died")
    result = finish(finish(client.send_goal_async(goal)).get_result_async()).result
    assert result.outcome.code == Outcome.OK, result.outcome.text


# --- result.json to fields --------------------------------------------------------------------------------------


def row(name: str, group: str, value: float | None, fitted: bool = True) -> dict[str, Any]:
    return {"name": name, "group": group, "value": value, "std": 0.5, "unit": "m", "nominal": 0.0, "fitted": fitted}


def test_base_frame_is_filled() -> None:
    pose = [1.0, 2.0, 3.0, 0.1, -0.2, 0.3]
    rows = [row(f"tracker {name}", "tracker", value) for name, value in zip(results.POSE, pose, strict=True)]
    response = srv.IdentifyBaseFrame.Response()
    assert results.fill_base_frame(response, json.dumps({"parameters": rows})) == ""
    turned = response.tracker.orientation
    expected = Rotation.from_euler("xyz", pose[3:]).as_quat()
    np.testing.assert_allclose([turned.x, turned.y, turned.z, turned.w], expected, atol=1e-12)
    assert response.tracker.position.y == 2.0
    assert "no tracker frame" in results.fill_base_frame(response, json.dumps({"parameters": rows[:5]}))


def test_geometry_and_points_are_filled() -> None:
    rows = [
        row("a_2", "geometry", 1e-3),
        row("d_3", "geometry", 0.0, fitted=False),
        *(row(f"mp1 {axis}", "point", value) for axis, value in zip("xyz", (0.1, 0.2, 0.3), strict=True)),
    ]
    text = json.dumps({"parameters": rows, "recording": {"points": ["mp1", "mp2"]}})
    geometry, points = srv.IdentifyGeometry.Response(), srv.IdentifyPoints.Response()
    assert results.fill_geometry(geometry, text) == ""
    assert (list(geometry.parameters), list(geometry.values), list(geometry.units)) == (["a_2"], [1e-3], ["m"])
    assert results.fill_points(points, text) == ""
    assert (list(points.points), points.positions[0].z, list(points.std)) == (["mp1"], 0.3, [0.5] * 3)
    empty = json.dumps({"parameters": [], "recording": {"points": ["mp1"]}})
    assert results.fill_geometry(srv.IdentifyGeometry.Response(), empty)
    assert results.fill_points(srv.IdentifyPoints.Response(), empty)


def test_stiffness_that_is_not_identifiable() -> None:
    rows = [{"joint": "joint_1", "value": None, "std": None, "identifiable": False}]
    response = srv.IdentifyStiffness.Response()
    assert "no joint stiffness" in results.fill_stiffness(response, json.dumps({"stiffness": rows}))
    assert np.isnan(response.stiffness).all()
