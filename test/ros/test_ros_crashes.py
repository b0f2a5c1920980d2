"""Processes that are killed or interrupted: nothing confirmed is lost, the bag can be read, a restart goes on."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from calibration_core.cell import Cell, load_cell
from calibration_core.observations.observe import observe
from calibration_core.procedure.session import Session
from calibration_core.recording.bag import read_bag

ROOT = Path(__file__).resolve().parents[2]
FIRST = 3  # configurations of the short plan
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
    suite.start("simulated_cell", clock=True, event_log=log)
    for name in ("guard", "tracker", "force_torque"):
        suite.start(name, use_sim_time=True)
    suite.start("recorder", use_sim_time=True, out=suite.bag)
    suite.start("sequencer", use_sim_time=True, motion__backend="simulated", load__by="device", server_wait=30.0)
    suite.run(plan)
    wait(lambda: "motion" in log.read_text(), 60.0, suite.log("sequencer"))
    time.sleep(1.0)
    code, took = suite.end("sequencer")
    assert (code, took < WITHIN) == (0, True), (took, suite.log("sequencer"))
    assert log.read_text().splitlines()[-1].endswith(("cancel", "rest"))
    wait(lambda: log.read_text().splitlines()[-1].endswith("rest"), 5.0, log.read_text())
    assert "stop_commanded" in suite.log("sequencer")
    for name in ("recorder", "guard", "tracker", "force_torque", "simulated_cell"):
        code, took = suite.end(name)
        assert (code, took < WITHIN) == (0, True), (name, took, suite.log(name))
    notes = [note.kind for note in read_bag(suite.bag, cell).notes]
    assert "truncated" not in notes
    with Session.look(suite.session) as session:
        assert session.completed == ()


def end_somewhere(suite: Any, name: str, rng: np.random.Generator) -> int:
    """Kill a process at a random moment of a measurement; return how many readings were on the disk before."""
    wait(lambda: (suite.session / "session.db").exists() and stored(suite) > 0, 90.0, suite.log("sequencer"))
    time.sleep(rng.uniform(0.0, 2.0))
    before = stored(suite)
    suite.end(name, signal.SIGKILL)
    return before


def go_on(suite: Any, plan: Path, name: str) -> Any:
    """Start the killed process again, and everything that then has to be said; return the run."""
    suite.again(name)
    if name != "sequencer":
        suite.end("sequencer", signal.SIGKILL)  # whatever it was in the middle of
        suite.again("sequencer")
    return suite.run(plan, resume=True)


def allow(suite: Any, done: Any) -> None:
    """Reset the guard and resume until the run is over, as an operator would after a crash."""
    from calibration_interfaces.srv import ResetGuard
    from std_srvs.srv import Trigger

    while not done():
        time.sleep(1.0)
        if suite.call(ResetGuard, "guard/reset", operator_name="test").permission.permitted:
            suite.call(Trigger, "sequencer/resume")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sequencer", "guard", "tracker", "force_torque", "recorder", "simulated_cell"])
def test_a_killed_process_loses_nothing(suite: Any, short_plan: Path, cell: Cell, name: str) -> None:
    kills = 5
    rng = np.random.default_rng(sum(name.encode()))
    suite.start_fast()
    run = suite.run(short_plan)
    for _ in range(kills):
        if run.over:
            break
        before = end_somewhere(suite, name, rng)
        read_bag(suite.bag, cell)
        assert stored(suite) >= before
        run = go_on(suite, short_plan, name)
    allow(suite, lambda: run.over)
    assert run.result(1.0).configurations_done == FIRST
    suite.stop()
    with Session.look(suite.session) as session:
        assert len(session.completed) == FIRST
        confirmed = {(r.configuration, r.step, r.point) for r in session.confirmed()}
    found = observe(suite.bag, cell)
    replayed = {
        (int(c), int(s), found.points[p]) for c, s, p in zip(found.configuration, found.step, found.point, strict=True)
    }
    assert {row for row in confirmed if row[0] > 0} <= replayed


def test_a_killed_sequencer_goes_on_at_the_next_configuration(suite: Any, short_plan: Path, cell: Cell) -> None:
    suite.start_fast()
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
