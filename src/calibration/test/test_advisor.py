"""While measuring: the process beside the sequencer, what it answers, and what the sequencer makes of it."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("calibration_interfaces")

from calibration_interfaces.action import RunPlan
from calibration_interfaces.msg import MeasurementProgress
from rclpy.parameter import Parameter

from calibration.evaluation.worker import worked_out
from calibration.sequencer.feedback import Advisor
from calibration.sequencer.sequencer import SequencerNode
from calibration.topics import PROGRESS
from calibration_core.cell import load_cell
from calibration_core.commands.evaluation.progress import progress_record, session_progress
from calibration_core.measurement import messages as m
from calibration_core.measurement.session import Session
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.simulation.simulate import simulate_plan
from calibration_core.planning.plans.plan import Plan, PlannedConfiguration
from calibration_core.planning.plans.plan_file import plan_text
from calibration_core.recording.session_values import ConfirmedReading

CELL = Path(__file__).resolve().parents[3] / "config" / "cells" / "demo.cell.yaml"
DONE, ALL = 5, 8


def planned() -> Plan:
    """Return eight configurations and a spare, after one standstill of a phase before."""
    rng = np.random.default_rng(3)
    low, high = np.array([-1.5, -0.6, -0.6, -2, -1.5, -2]), np.array([1.5, 0.6, 0.9, 2, 1.5, 2])
    configurations = []
    for number in range(1, ALL + 2):
        pull = rng.normal(size=3)
        force = np.outer([0.0, 1000.0, 2000.0], pull / np.linalg.norm(pull))
        steps = np.hstack([force, np.zeros((3, 3))])
        configurations.append(PlannedConfiguration(number, rng.uniform(low, high), steps, spare=number > ALL))
    swept = PlannedConfiguration(1001, rng.uniform(low, high), np.zeros((1, 6)), phase="base_frame")
    robot = load_cell(CELL).robot
    return Plan(robot.name, robot.joints, tuple(configurations), np.empty((0, 6)), preparation=(swept,))


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the directory of a session in which five of eight configurations are measured, and one was given up."""
    cell, plan = load_cell(CELL), planned()
    directory = tmp_path_factory.mktemp("session")
    measured = [*plan.preparation, *plan.primary[:DONE]]
    rows = simulate_plan(measured, cell, nominal_parameters(cell), 1)
    with Session.create(directory / "s", plan_text(plan), cell) as one:
        for configuration in measured:
            attempt = one.begin_attempt(configuration.number, 1)
            some = np.flatnonzero(rows.configuration == configuration.number)
            one.record(attempt, [confirmed(rows, int(row), cell) for row in some])
            one.end_attempt(attempt, completed=True)
        one.end_attempt(one.begin_attempt(6, 2), completed=False, reason="blocked")
    return directory / "s"


def confirmed(rows: Any, row: int, cell: Any) -> ConfirmedReading:
    return ConfirmedReading(
        configuration=int(rows.configuration[row]),
        step=int(rows.step[row]),
        point=rows.points[rows.point[row]],
        time=row,
        q=rows.q[row],
        position=rows.position[row],
        position_covariance=4e-10 * np.eye(3),
        samples=20,
        wrench=rows.wrench[row],
        wrench_covariance=np.diag([1.0] * 3 + [0.25] * 3),
        temperature=20.0,
    )


def test_a_session_tells_what_it_has_told(session: Path) -> None:
    found = session_progress(session, load_cell(CELL), wanted=10.0)
    assert found.configuration == DONE
    assert found.enough
    assert found.next_configuration in {7, 8, 9}  # 6 was given up
    stiffness = np.array(load_cell(CELL).robot.stiffness)
    assert np.all(np.abs(found.stiffness / stiffness - 1.0) < 2.0 * found.accuracy)
    assert np.all(found.expected < found.accuracy)


def test_the_process_says_the_same(session: Path, until: Any) -> None:
    told: list[dict[str, Any]] = []
    complaints: list[str] = []
    advisor = Advisor(told.append, complaints.append)
    try:
        advisor.ask(str(session), str(CELL), 0.05)
        until(lambda: told or complaints, timeout=120.0)
        assert complaints == []
        assert told == [progress_record(str(session), str(CELL), 0.05)]
        advisor.ask(str(session / "nowhere"), str(CELL), 0.05)
        until(lambda: complaints, timeout=60.0)
        assert "nowhere" in complaints[0]
    finally:
        advisor.close()


def test_while_nothing_can_be_told_nobody_complains(tmp_path: Path) -> None:
    cell, plan = load_cell(CELL), planned()
    with Session.create(tmp_path / "s", plan_text(plan), cell):
        answer = worked_out({"session": str(tmp_path / "s"), "cell": str(CELL), "wanted": 0.0})
    assert (answer["kind"], answer["progress"]) == ("", None)
    assert "no configuration yet" in answer["text"]


def test_a_defect_is_told_in_full() -> None:
    answer = worked_out({"session": None, "cell": str(CELL), "wanted": 0.0})
    assert answer["kind"] == "defect"
    assert "Traceback" in answer["trace"]


@dataclasses.dataclass
class Runner:
    """Takes what is posted."""

    posted: list[Any] = dataclasses.field(default_factory=list)

    def post(self, event: Any) -> None:
        self.posted.append(event)


@pytest.mark.parametrize("stop", [True, False])
def test_enough_ends_the_run_only_if_that_was_asked_for(
    spinning: Any, session: Path, until: Any, *, stop: bool
) -> None:
    usual = {"cell": str(CELL), "motion.backend": "external", "force_torque": "", "recorder": "", "progress": False}
    given = [Parameter(name, value=value) for name, value in usual.items()]
    node = spinning.add(SequencerNode(context=spinning.context, parameter_overrides=given))
    heard: list[Any] = []
    spinning.plain("listener").create_subscription(MeasurementProgress, PROGRESS.relative, heard.append, PROGRESS.qos)
    runner = Runner()
    goal = SimpleNamespace(request=RunPlan.Goal(stop_when_enough=stop, wanted_accuracy=10.0))
    node.feedback.begin(goal, runner)
    node.feedback._on_progress(progress_record(str(session), str(CELL), 10.0))
    until(lambda: heard)
    assert heard[0].enough
    assert heard[0].configuration == DONE
    assert len(heard[0].accuracy) == 6
    assert runner.posted == ([m.Enough(0.0, heard[0].text)] if stop else [])
    node.feedback.end("")
