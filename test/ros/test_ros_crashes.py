"""Processes that are killed or interrupted: nothing confirmed is lost, the bag can be read, a restart goes on."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import NonSeekingReader
from numpy.lib.stride_tricks import sliding_window_view
from rosbags.typesys import Stores, get_typestore

pytest.importorskip("rclpy")

from calibration.process_tree import SIMULATED_CELL
from calibration_core.cell import Cell, load_cell
from calibration_core.measurement.load_time import LOAD_TIME
from calibration_core.measurement.session import Session
from calibration_core.recording.bags.bag import read_bag
from calibration_core.recording.session_values import ConfirmedReading
from calibration_core.timeseries import NANOSECONDS

ROOT = Path(__file__).resolve().parents[2]
FIRST, CONFIGURATIONS = 3, 18  # of the short plan and of the whole one
KILLS = 20
SPEED = 20.0  # times real time
Samples = tuple[np.ndarray, np.ndarray]  # stamps and positions
WITHIN = 2.0  # s, a process may take to end


@pytest.fixture(scope="module")
def cell() -> Cell:
    return load_cell(ROOT / "config" / "cells" / "demo.cell.yaml")


def wait(condition: Any, seconds: float, what: str) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.01)


def stored(suite: Any) -> int:
    """How many readings are on the disk."""
    with Session.look(suite.session) as session:
        return len(session.confirmed(all_attempts=True))


def test_sigint_while_the_robot_moves(suite: Any, plan: Path, cell: Cell) -> None:
    """The motion is cancelled, the bag closed, every process ends well and soon."""
    log = suite.directory / "cell.csv"
    log.touch()
    suite.start_tree(SIMULATED_CELL, {"simulated_cell": {"event_log": log}, "sequencer": {"server_wait": 30.0}})
    suite.run(plan)
    wait(lambda: "motion" in log.read_text(), 60.0, suite.log("sequencer"))
    time.sleep(1.0)
    code, took = suite.end("sequencer")
    assert (code, took < WITHIN) == (0, True), (took, suite.log("sequencer"))
    assert log.read_text().splitlines()[-1].endswith(("cancel", "rest"))
    wait(lambda: log.read_text().splitlines()[-1].endswith("rest"), 5.0, log.read_text())
    assert "stop_commanded" in suite.log("sequencer")
    for name in ("manager", "identification", "recorder", "guard", "tracker", "force_torque", "simulated_cell"):
        code, took = suite.end(name)
        assert (code, took < WITHIN) == (0, True), (name, took, suite.log(name))
    notes = [note.kind for note in read_bag(suite.bag, cell).notes]
    assert "truncated" not in notes
    with Session.look(suite.session) as session:
        assert session.completed == ()


def allow(suite: Any, done: Any) -> None:
    """Reset the guard and resume until the run is over, as an operator would after a crash."""
    while not done():
        time.sleep(1.0)
        go_on(suite)


def go_on(suite: Any) -> bool:
    """Reset the guard and resume; whether that was possible."""
    from calibration_interfaces.msg import Outcome
    from calibration_interfaces.srv import ResetGuard, ResumeMotion

    suite.call(ResetGuard, "guard/reset", operator_name="test")
    answer = suite.call(ResumeMotion, "sequencer/resume_motion", operator_name="test")
    return bool(answer.outcome.code == Outcome.OK)


class Killing:
    """One measurement, in which a process is killed again and again."""

    def __init__(self, suite: Any, plan: Path, name: str, rng: np.random.Generator) -> None:
        self.suite, self.plan, self.name, self.rng = suite, plan, name, rng
        self.kills = 0
        self.seen: set[tuple[Any, ...]] = set()  # readings that were on the disk at any moment
        self.blind: set[int] = set()  # configurations under way while nothing was recorded
        suite.directory.mkdir()
        suite.start_tree(SIMULATED_CELL, speed=SPEED)
        self.run = suite.run(plan)

    def strike(self, cell: Cell) -> bool:
        """Kill the process at a random moment, start it again, go on; False if the run was over before."""
        before = len(self.seen)
        end = time.monotonic() + 120.0
        while len(self.seen) <= before and not self.run.over:
            assert time.monotonic() < end, self.suite.log("sequencer")[-3000:]
            if not self.look():
                go_on(self.suite)
            time.sleep(0.2)
        time.sleep(self.rng.uniform(0.0, 5.0))
        if self.run.over:
            return False
        self.look()
        self.suite.end(self.name, signal.SIGKILL)
        self.kills += 1
        first = len(self.attempts()) - 1
        read_bag(self.suite.bag, cell)
        self.look()
        self.suite.again(self.name)
        if self.name == "simulated_cell":  # whose clock begins anew
            self.suite.end("sequencer", signal.SIGKILL)
            self.suite.again("sequencer")
        if self.name in ("sequencer", "simulated_cell"):
            self.run = self.suite.run(self.plan, resume=True)
        if self.name == "recorder":
            wait(lambda: recording(self.suite.bag) > self.kills, 30.0, self.suite.log("recorder"))
            time.sleep(1.0)
            self.blind |= set(self.attempts()[max(first, 0) :])
        return True

    def attempts(self) -> list[int]:
        with Session.look(self.suite.session) as session:
            return [configuration for _, configuration, _, _ in session.attempts]

    def look(self) -> bool:
        """See that what was on the disk still is; whether anything came since."""
        if not (self.suite.session / "session.db").exists():
            return False
        with Session.look(self.suite.session) as session:
            now = {(r.configuration, r.step, r.point, r.time) for r in session.confirmed(all_attempts=True)}
        assert self.seen <= now
        new = now > self.seen
        self.seen = now
        return new

    def finish(self, cell: Cell, announced: set[tuple[Any, ...]]) -> None:
        """Let the measurement end, and see that nothing confirmed is lost, neither on the disk nor in the bag."""
        allow(self.suite, lambda: self.run.over)
        result = self.run.result(1.0)
        assert result.configurations_done == CONFIGURATIONS, result.outcome.text
        self.look()
        self.suite.stop()
        with Session.look(self.suite.session) as session:
            assert len(session.completed) == CONFIGURATIONS
            readings = session.confirmed()
        assert announced <= {row[:3] for row in self.seen}
        samples: Mapping[str, Samples] = {
            name: (series.time, series.values) for name, series in read_bag(self.suite.bag, cell).points.items()
        }
        if (
            self.name == "simulated_cell"
        ):  # its clock began anew each time: stamps come more than once, and are no order
            samples = as_written(self.suite.bag, cell)
        lost = [
            (one.configuration, one.step, one.point)
            for one in readings
            if one.configuration not in self.blind | {0} and not holds(*samples[one.point], one)
        ]
        assert lost == []


def as_written(bag: Path, cell: Cell) -> dict[str, Samples]:
    """Return stamps (m,) ns and positions (m, 3) m of every point, in the order in which they were written."""
    rows: dict[str, list[tuple[int, float, float, float]]] = {point: [] for point in cell.points}
    topics, store = {f"/tracker/{point}": point for point in cell.points}, get_typestore(Stores.ROS2_JAZZY)
    for path in sorted(bag.glob("*.mcap")):
        with path.open("rb") as file:
            for schema, channel, raw in NonSeekingReader(file).iter_messages(list(topics), log_time_order=False):
                assert schema is not None
                message: Any = store.deserialize_cdr(raw.data, schema.name)
                stamp, at = message.header.stamp, message.point
                rows[topics[channel.topic]].append((stamp.sec * NANOSECONDS + stamp.nanosec, at.x, at.y, at.z))
    return {
        point: (np.array([row[0] for row in some]), np.array([row[1:] for row in some])) for point, some in rows.items()
    }


def holds(stamps: np.ndarray, positions: np.ndarray, reading: ConfirmedReading) -> bool:
    """Tell whether the samples of which a reading is the mean stand one after another in the bag."""
    n = reading.samples
    if len(stamps) < n:
        return False
    middle = sliding_window_view(stamps - reading.time, n).mean(axis=1)
    mean = sliding_window_view(positions, n, axis=0).mean(axis=2)
    return bool(np.any((np.abs(middle) < 1e6) & (np.abs(mean - reading.position).max(axis=1) < 1e-9)))


def recording(bag: Path) -> int:
    """How many files the bag has."""
    return len(list(bag.glob("*.mcap")))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sequencer", "guard", "tracker", "force_torque", "recorder", "simulated_cell"])
def test_a_killed_process_loses_nothing(suite: Any, brisk_plan: Path, cell: Cell, name: str) -> None:
    """Twenty times, at random moments, in as many measurements as that takes."""
    from calibration_interfaces.msg import Reading

    rng = np.random.default_rng(sum(name.encode()))
    announced: set[tuple[Any, ...]] = set()
    suite.client.create_subscription(
        Reading, "calibration/reading", lambda one: announced.add((one.configuration, one.step, one.point)), 1000
    )
    directory, kills, measurements = suite.directory, 0, 0
    while kills < KILLS:
        suite.directory = directory / str(measurements)
        announced.clear()
        killing = Killing(suite, brisk_plan, name, rng)
        while kills + killing.kills < KILLS and killing.strike(cell):
            pass
        killing.finish(cell, announced)
        kills, measurements = kills + killing.kills, measurements + 1
    print(f"\n{name}: killed {kills} times in {measurements} measurements")


@pytest.mark.slow
def test_a_sensor_that_dies_while_a_load_comes_or_goes_costs_no_run(suite: Any, short_plan: Path) -> None:
    """What pulls is not known then: the run waits for the sensor, and goes on when the operator says so."""
    from calibration_interfaces.msg import MeasurementStep

    steps: list[Any] = []
    suite.client.create_subscription(MeasurementStep, "calibration/step", steps.append, 100)
    suite.start_tree(SIMULATED_CELL, speed=SPEED)
    run = suite.run(short_plan)
    for phase in (MeasurementStep.LOADING, MeasurementStep.UNLOADING):
        wait(lambda phase=phase: steps and steps[-1].phase == phase, 120.0, suite.log("sequencer"))
        suite.end("force_torque", signal.SIGKILL)
        time.sleep(2 * LOAD_TIME)
        assert not run.over, suite.log("sequencer")
        suite.again("force_torque")
        passed = len(steps)
        end = time.monotonic() + 60.0
        while len(steps) == passed:
            assert time.monotonic() < end, suite.log("sequencer")
            time.sleep(1.0)
            go_on(suite)
    allow(suite, lambda: run.over)
    assert run.result(1.0).configurations_done == FIRST, suite.log("sequencer")


@pytest.mark.slow
def test_a_killed_identification_answers_again(suite: Any) -> None:
    """Twenty times, at random moments of an evaluation: nothing is written half."""
    from calibration_interfaces.msg import Outcome
    from calibration_interfaces.srv import IdentifyStiffness

    rng = np.random.default_rng(1)
    cell, out = ROOT / "config" / "cells" / "small.cell.yaml", suite.directory / "identify"
    asked = {"cell": str(cell), "recording": str(ROOT / "bags" / "small_loaded"), "out": str(out)}
    suite.start("identification")
    for _ in range(KILLS):
        client = suite.client.create_client(IdentifyStiffness, "identification/identify_stiffness")
        assert client.wait_for_service(60.0), suite.log("identification")
        client.call_async(IdentifyStiffness.Request(**asked))
        time.sleep(rng.uniform(0.0, 4.0))
        suite.end("identification", signal.SIGKILL)
        suite.client.destroy_client(client)
        if (out / "result.json").exists():
            assert json.loads((out / "result.json").read_text(encoding="utf-8"))["command"] == "identify"
        suite.again("identification")
    answer = suite.call(
        IdentifyStiffness, "identification/identify_stiffness", patience=20.0, **asked
    )  # a lost one again
    assert answer.outcome.code == Outcome.OK, answer.outcome.text
    assert all(answer.identifiable)


def test_a_killed_sequencer_goes_on_at_the_next_configuration(suite: Any, short_plan: Path, cell: Cell) -> None:
    suite.start_tree(SIMULATED_CELL, speed=SPEED)
    suite.run(short_plan)

    def one_done() -> bool:
        if not (suite.session / "session.db").exists():
            return False
        with Session.look(suite.session) as session:
            return bool(session.completed)

    wait(one_done, 120.0, suite.log("sequencer"))
    before = stored(suite)
    suite.end("sequencer", signal.SIGKILL)
    read_bag(suite.bag, cell)
    with Session.look(suite.session) as session:
        done = session.completed
        assert len(session.confirmed(all_attempts=True)) >= before
    suite.again("sequencer")
    run = suite.run(short_plan, resume=True)
    allow(suite, lambda: run.over)
    result = run.result(1.0)
    assert result.configurations_done == FIRST
    with Session.look(suite.session) as session:
        assert len(session.runs) == 2
        assert session.completed[: len(done)] == done
        tried = [configuration for _, configuration, outcome, _ in session.attempts if outcome == "completed"]
        assert len([number for number in tried if number > 0]) == FIRST  # what was done is not done again
        assert any(event.kind == "resumed" for event in session.events)
