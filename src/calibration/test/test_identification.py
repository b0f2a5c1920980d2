"""The node `identification`: every branch of service and action, the command line's files, cancel and progress."""

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
from protocols import record, sweeps, wrist

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.action import Identify
from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import IdentifyStiffness
from goals import GoalClient
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import Parameter

from calibration.evaluation.identification import IdentificationNode
from calibration_core.cli import main

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


def act(node: Any, what: int, **fields: Any) -> Any:
    """Ask for something by the action; return its result."""
    client = GoalClient(node, Identify, "/identification/identify")
    assert client.wait_for_server(20.0)
    return finish(finish(client.send_goal_async(Identify.Goal(what=what, **fields))).get_result_async()).result


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
    answer = ask(spinning.plain(), IdentifyStiffness, "identify_stiffness", recording=str(BAG), out=str(tmp_path))
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
    answer = ask(client, IdentifyStiffness, "identify_stiffness")
    assert answer.outcome.code == Outcome.INPUT_UNUSABLE
    assert answer.outcome.text.startswith("recording: found nothing")
    shutil.copytree(BAG, tmp_path / "recording")
    node.set_parameters([Parameter("recording", value=str(tmp_path / "recording"))])
    answer = ask(client, IdentifyStiffness, "identify_stiffness")
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
    answer = ask(spinning.plain(), IdentifyStiffness, "identify_stiffness", out=str(out), **fields)
    assert answer.outcome.code == Outcome.INPUT_UNUSABLE
    assert words in answer.outcome.text
    assert "\n" not in answer.outcome.text
    assert not out.exists()


def test_a_command_that_this_version_has_not(
    spinning: Any, node: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(node._worker, "commands_when_ready", lambda _cancelled: ("identify",))
    result = act(spinning.plain(), Identify.Goal.DIAGNOSIS, recording=str(BAG), out=str(tmp_path / "out"))
    assert result.outcome.code == Outcome.NOT_AVAILABLE
    assert result.outcome.text == "this version has no command diagnose"
    assert not (tmp_path / "out").exists()


def test_busy_and_responsive_meanwhile(spinning: Any, node: Any, tmp_path: Path) -> None:
    client = spinning.plain()
    service = client.create_client(IdentifyStiffness, "/identification/identify_stiffness")
    parameters = client.create_client(GetParameters, "/identification/get_parameters")
    assert service.wait_for_service(20.0)
    assert parameters.wait_for_service(20.0)
    long = service.call_async(IdentifyStiffness.Request(recording=str(BAG), out=str(tmp_path / "a")))
    time.sleep(0.05)
    answer = finish(service.call_async(IdentifyStiffness.Request(recording=str(BAG), out=str(tmp_path / "b"))))
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
    client = spinning.plain()
    assert act(client, 99).outcome.code == Outcome.INPUT_UNUSABLE
    node._worker._process.kill()
    asked = {"what": Identify.Goal.STIFFNESS, "recording": str(BAG), "out": str(tmp_path)}
    result = act(client, **asked)
    assert (result.outcome.code, result.outcome.text) == (Outcome.INTERNAL, "the process that computes has died")
    result = act(client, **asked)
    assert result.outcome.code == Outcome.OK, result.outcome.text


# --- what is asked for, and what a recording determines -------------------------------------------------------------


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("tables")
    motions = {"axes": sweeps(*range(6)), "base": sweeps(0, 1), "wrist": wrist()}
    return {name: record(folder / f"{name}.csv", CELL, q) for name, q in motions.items()}


def test_frames_and_geometry_are_those_of_the_command_line(
    spinning: Any, node: Any, tables: dict[str, Path], tmp_path: Path
) -> None:
    own = tmp_path / "own"
    assert main(["identify", str(tables["axes"]), "--cell", str(CELL), "--out", str(own), "--no-report"]) == 0
    client = spinning.plain()
    for what in (Identify.Goal.BASE_FRAME, Identify.Goal.GEOMETRY, Identify.Goal.POINTS):
        result = act(client, what, recording=str(tables["axes"]), out=str(tmp_path / "live"))
        assert result.outcome.code == Outcome.OK, result.outcome.text
        assert result.result_json.encode() == (own / "result.json").read_bytes()
        assert (tmp_path / "live" / "model.yaml").read_bytes() == (own / "model.yaml").read_bytes()


def test_what_a_recording_does_not_determine(spinning: Any, node: Any, tables: dict[str, Path], tmp_path: Path) -> None:
    client = spinning.plain()
    differences, sigma = tmp_path / "cell.yaml", "sigma_range: 8.0e-6, sigma_range_per_m: 4.0e-7, sigma_angle: 3.0e-6"
    text = CELL.read_text("utf-8").replace(sigma, "sigma: 1.0e-5")
    differences.write_text(f"{text}measurements: {{points: displacement}}\n", "utf-8")
    for what, recording, words in (
        (Identify.Goal.STIFFNESS, tables["wrist"], "determines no joint stiffness"),
        (Identify.Goal.WRIST_CENTRE, tables["base"], "found 0 with a wrist motion"),
        (Identify.Goal.WRIST_CENTRE, BAG, "has loads"),
        (Identify.Goal.BASE_FRAME, BAG, "determines no tracker frame"),
        (Identify.Goal.GEOMETRY, BAG, "determines no geometry"),
        (Identify.Goal.POINTS, BAG, "determines no measurement point"),
    ):
        cell = differences if recording == BAG else CELL
        result = act(client, what, recording=str(recording), cell=str(cell), out=str(tmp_path / "out"))
        assert result.outcome.code == Outcome.NOT_IDENTIFIABLE, words
        assert words in result.outcome.text
        assert json.loads(result.result_json)["command"] == "identify"
        assert Path(result.report_path).is_file()
    answer = ask(client, IdentifyStiffness, "identify_stiffness", recording=str(tables["wrist"]), out=str(tmp_path))
    assert answer.outcome.code == Outcome.NOT_IDENTIFIABLE
    assert np.isnan(answer.stiffness).all()
