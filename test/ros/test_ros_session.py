"""What is measured is recorded, where the session is; whoever of recorder and instruments is lost pauses the run."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")

from calibration_core.cell import load_cell
from calibration_core.measurement.session import Session
from calibration_core.observations.observe import observe
from calibration_core.recording.bags.bag import read_bag
from calibration_core.timeseries import Readings

ROOT = Path(__file__).resolve().parents[2]
CELL = ROOT / "config" / "cells" / "demo.cell.yaml"
FAST = ROOT / "config" / "simulation.yaml"
LONG = 60.0
QUIET = 2.0  # s, in which nothing happens


def some(plan: Path, name: str, which: slice) -> Path:
    """Write some configurations of a plan, unloaded and fully loaded, numbered from 1, and nothing besides."""
    content = yaml.safe_load(plan.read_text(encoding="utf-8"))
    rows = content["configurations"][which]
    for number, row in enumerate(rows, start=1):
        row |= {"number": number, "steps": [row["steps"][0], row["steps"][-1]], "spare": False}
    content |= {"configurations": rows, "startup_cycle": [], "reference": None, "expected": None}
    path = plan.parent / f"{name}.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


class Watch:
    """Sees readings, events and the marks of what is done."""

    def __init__(self, suite: Any) -> None:
        from calibration_interfaces.msg import MeasurementStep, Reading, SessionEvent
        from rclpy.qos import DurabilityPolicy, QoSProfile

        kept = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.suite = suite
        self.events: list[Any] = []
        self.readings: list[Any] = []
        self.steps: list[Any] = []
        for kind, topic, rows in (
            (SessionEvent, "calibration/event", self.events),
            (Reading, "calibration/reading", self.readings),
            (MeasurementStep, "calibration/step", self.steps),
        ):
            suite.client.create_subscription(kind, topic, rows.append, kept)

    def until(self, condition: Any) -> None:
        """Wait; a run that the guard has stopped on a busy machine is resumed."""
        end, again = time.monotonic() + 2.0 * LONG, time.monotonic() + 8.0
        while not condition():
            assert time.monotonic() < end, self.suite.log("sequencer")[-3000:]
            if time.monotonic() > again:
                again += 8.0
                self.resume()
            time.sleep(0.01)

    def resume(self) -> None:
        """Say that it may go on."""
        from std_srvs.srv import Trigger

        self.suite.call(Trigger, "sequencer/resume")

    def of(self, kind: int) -> list[Any]:
        """Events of one kind."""
        return [one for one in self.events if one.kind == kind]


def test_each_session_has_its_own_bag_and_knows_its_plan(suite: Any, plan: Path) -> None:
    """Two plans one after the other: the recorder follows, and nothing of one is in the other's."""
    from calibration_interfaces.msg import Outcome
    from calibration_interfaces.srv import IdentifyStiffness

    plans = [some(plan, "first", slice(0, 1)), some(plan, "second", slice(3, 5))]
    suite.start_fast()
    suite.start("identification")
    home, watch = suite.directory, Watch(suite)
    sessions = []
    for number, path in enumerate(plans):
        suite.directory = home / str(number)
        suite.directory.mkdir()
        run = suite.run(path)
        watch.until(lambda run=run: run.over)
        result = run.result(1.0)
        assert result.outcome.code == Outcome.OK, result.outcome.text
        assert result.recording == str(suite.bag)
        sessions.append(suite.session)
    answer = suite.call(IdentifyStiffness, "identification/identify_stiffness", patience=LONG)
    told = json.loads(answer.result_json)["recording"]["file"] if answer.result_json else answer.outcome.text
    assert str(sessions[1] / "bag") in told  # the session measured last, though the node was told of none
    suite.directory = home
    suite.stop()
    cell = load_cell(CELL)
    hashes = []
    for directory, numbers in zip(sessions, ({1}, {1, 2}), strict=True):
        bag = observe(directory / "bag", cell)
        confirmed = observe(directory, cell)
        assert set(bag.configuration.tolist()) == set(confirmed.configuration.tolist()) == numbers
        there, here = by_place(bag), by_place(confirmed)
        assert (
            there.keys() == here.keys()
        )  # the phases between markers are a little longer than the windows averaged live
        assert max(np.abs(there[place] - here[place]).max() for place in here) < 2e-4
        hashes.append(confirmed.provenance.plan_sha256)
        assert bag.provenance.plan_sha256 == hashes[-1]
        metadata = yaml.safe_load((directory / "bag" / "metadata.yaml").read_text())
        assert metadata["rosbag2_bagfile_information"]["custom_data"] == {"plan_sha256": hashes[-1]}
        with Session.look(directory) as session:
            assert session.plan_sha256 == hashes[-1]
    assert hashes[0] != hashes[1]
    mixed = home / "mixed"
    mixed.mkdir()
    for number, directory in enumerate(sessions):
        for file in (directory / "bag").glob("*.mcap"):
            (mixed / f"mixed_{number}.mcap").write_bytes(file.read_bytes())
    program = [str(Path(sys.executable).parent / "calibration"), "identify", str(mixed), "--cell", str(CELL)]
    done = subprocess.run([*program, "--out", str(home / "no")], capture_output=True, text=True, check=False)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert "found configurations of 2 plans" in done.stderr


def by_place(readings: Readings) -> dict[tuple[int, int, int], np.ndarray]:
    """Return the positions by configuration, step and point."""
    columns = (readings.configuration, readings.step, readings.point)
    places = zip(*(column.tolist() for column in columns), strict=True)
    return dict(zip(places, readings.position, strict=True))


def test_without_a_recorder_no_run_begins(suite: Any, plan: Path) -> None:
    from calibration_interfaces.msg import Outcome

    path = some(plan, "unrecorded", slice(0, 1))
    suite.start_fast()
    suite.end("recorder")
    suite.end("sequencer")
    suite.start("sequencer", FAST, server_wait=5.0)
    outcome = suite.run(path).result(LONG).outcome
    assert (outcome.code, "no recorder recorder" in outcome.text) == (Outcome.NO_DATA, True), outcome.text
    assert not suite.session.exists()


@pytest.mark.parametrize(
    ("name", "how"),
    [
        ("recorder", signal.SIGKILL),
        pytest.param("recorder", signal.SIGSTOP, marks=pytest.mark.slow),
        pytest.param("recorder", None, marks=pytest.mark.slow),
        ("tracker", signal.SIGKILL),
        pytest.param("force_torque", signal.SIGKILL, marks=pytest.mark.slow),
        pytest.param("identification", signal.SIGKILL, marks=pytest.mark.slow),
    ],
)
def test_whoever_is_lost_pauses_the_run(suite: Any, plan: Path, name: str, how: signal.Signals | None) -> None:
    """Killed, stopped or closed in a motion: that motion may end, no other begins, and no reading is confirmed."""
    from calibration_interfaces.msg import MeasurementStep, Outcome, SessionEvent
    from std_srvs.srv import Trigger

    path = some(plan, "lost", slice(0, 3))
    suite.start_fast(speed=5.0)
    suite.start("identification")
    watch = Watch(suite)
    run = suite.run(path)
    watch.until(lambda: any(one.phase == MeasurementStep.DONE for one in watch.steps))
    watch.until(lambda: watch.steps[-1].phase == MeasurementStep.MOVING)
    if how is None:
        assert suite.call(Trigger, f"{name}/close").success
    else:
        suite.processes[name].send_signal(how)
    readings, moves = len(watch.readings), moving(watch)
    watch_quiet(watch, QUIET if name == "recorder" else 5.0 * QUIET)
    watch.until(lambda: watch.of(SessionEvent.PAUSED))
    assert len(watch.readings) == readings
    assert moving(watch) == moves
    if how is not None:  # one that was only closed is brought back to the bag at once
        watch.resume()  # too early: it stays paused
    watch_quiet(watch, QUIET)
    assert len(watch.readings) == readings
    assert moving(watch) == moves
    if how is signal.SIGSTOP:
        suite.processes[name].send_signal(signal.SIGCONT)
    elif how is signal.SIGKILL:
        suite.processes.pop(name).wait()
        suite.again(name)
    time.sleep(2.0 * QUIET)
    assert moving(watch) == moves  # nothing moves by itself
    end = time.monotonic() + 180.0
    while not run.over:
        assert time.monotonic() < end, suite.log("sequencer")[-3000:]
        watch.resume()
        time.sleep(2.0)
    result = run.result(1.0)
    assert (result.outcome.code, result.configurations_done) == (Outcome.OK, 3), result.outcome.text
    assert result.recording == str(suite.bag)
    suite.stop()
    cell = load_cell(CELL)
    with contextlib.closing(Session.look(suite.session)) as session:
        confirmed = {(one.configuration, one.step, one.point) for one in session.confirmed()}
    bag = observe(suite.bag, cell)
    points = [cell.points[i] for i in bag.point]
    assert confirmed <= set(zip(bag.configuration.tolist(), bag.step.tolist(), points, strict=True))
    assert read_bag(suite.bag, cell).provenance.plan_sha256 != ""


def moving(watch: Watch) -> int:
    """How many motions have been announced."""
    from calibration_interfaces.msg import MeasurementStep

    return sum(one.phase == MeasurementStep.MOVING for one in watch.steps)


def watch_quiet(watch: Watch, seconds: float) -> None:
    """Let time pass."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        assert watch.suite.processes["sequencer"].poll() is None
        time.sleep(0.05)
