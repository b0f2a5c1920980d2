"""The diagnosis over ROS: the same files as the command line's, with progress, and cancelled without a trace."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("calibration_interfaces.msg", reason="the messages are not built: run make setup")

from calibration_interfaces.action import Identify
from calibration_interfaces.msg import Outcome
from goals import GoalClient
from rclpy.parameter import Parameter
from test_identification import BAG, CELL, act, finish

from calibration.evaluation.identification import IdentificationNode
from calibration_core.cell import load_cell
from calibration_core.observations.observe import observe
from calibration_core.recording.tables.table import write_table

SAME = ("result.json", "model.yaml", "table2.csv")


@pytest.fixture
def node(spinning: Any) -> IdentificationNode:
    given = {"cell": str(CELL), "recording": str(BAG)}
    overrides = [Parameter(name, value=value) for name, value in given.items()]
    return spinning.add(IdentificationNode(context=spinning.context, parameter_overrides=overrides))


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A second recording: the same angles and loads, other noise."""
    path = tmp_path_factory.mktemp("other") / "other.csv"
    readings = observe(BAG, load_cell(CELL))
    noise = np.random.default_rng(5).normal(0.0, 2e-5, readings.position.shape)
    write_table(path, dataclasses.replace(readings, position=readings.position + noise))
    return path


@pytest.fixture(scope="module")
def offline(other: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the command line makes of the recording, a second one predicted, and compared with a simulation."""
    out = tmp_path_factory.mktemp("offline")
    program = Path(sys.prefix) / "bin" / "calibration"
    command = [program, "diagnose", BAG, "--cell", CELL, "--test", other, "--simulation", BAG, "--out", out]
    subprocess.run(command, check=True, capture_output=True, timeout=300)
    return out


def test_the_action_tells_its_progress_and_can_be_cancelled(
    spinning: Any, node: Any, other: Path, offline: Path, until: Callable[..., None], tmp_path: Path
) -> None:
    client = GoalClient(spinning.plain(), Identify, "/identification/identify")
    assert client.wait_for_server(20.0)
    told: list[Any] = []
    goal = Identify.Goal(what=Identify.Goal.DIAGNOSIS, test=str(other), simulation=str(BAG), out=str(tmp_path / "out"))
    handle = finish(client.send_goal_async(goal, feedback_callback=told.append))
    until(lambda: any("looking for missing physics" in one.feedback.text for one in told), timeout=120.0)
    assert finish(handle.cancel_goal_async()).goals_canceling
    assert finish(handle.get_result_async()).result.outcome.code == Outcome.CANCELLED
    assert not (tmp_path / "out").exists()
    told.clear()
    handle = finish(client.send_goal_async(goal, feedback_callback=told.append))
    result = finish(handle.get_result_async(), timeout=300.0).result
    assert result.outcome.code == Outcome.OK, result.outcome.text
    assert result.result_json.encode() == (offline / "result.json").read_bytes()
    assert json.loads(result.result_json)["test"] is not None
    assert {path.name for path in (tmp_path / "out").iterdir()} == {path.name for path in offline.iterdir()}
    for name in SAME:
        assert (tmp_path / "out" / name).read_bytes() == (offline / name).read_bytes()
    assert Path(result.report_path).is_file()
    shares = [one.feedback.share_done for one in told]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert any("drawing the report" in one.feedback.text for one in told)


def test_what_cannot_be_diagnosed_or_compared(spinning: Any, node: Any, tmp_path: Path) -> None:
    """Only a diagnosis compares with a simulation."""
    out = tmp_path / "out"
    for what, fields, words in (
        (Identify.Goal.DIAGNOSIS, {"recording": "/no/such/bag"}, "/no/such/bag"),
        (Identify.Goal.STIFFNESS, {"simulation": str(BAG)}, "simulation"),
    ):
        result = act(spinning.plain(), what, out=str(out), **fields)
        assert result.outcome.code == Outcome.INPUT_UNUSABLE
        assert words in result.outcome.text
        assert not out.exists()
