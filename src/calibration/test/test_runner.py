"""The thread that carries out the procedure, in a cell of stand-ins: drivers that lie, instruments that fail."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("calibration_interfaces")

from runner_bench import HOME, Bench

from calibration.motion.arrival import ArrivalRules, Joints
from calibration.motion.backends import End
from calibration.sequencer import runner as module
from calibration.sequencer.runner import Call
from calibration_core.measurement import messages as m


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    for name, value in (("LATE", 0.3), ("CALM", 1.0), ("SLACK_TIME", 0.5)):
        monkeypatch.setattr(module, name, value)
    one = Bench(Joints(ArrivalRules(dwell=0.05)))
    yield one
    one.end()


def test_a_plan_is_measured(bench: Bench) -> None:
    finish = bench.run()
    assert finish.outcome is m.Outcome.COMPLETED
    assert [(c.configuration, c.step) for c in bench.cell.confirmed] == [(1, 0), (1, 1), (2, 0), (2, 1)]
    assert all(move.speed_bound <= 0.25 for move in bench.robot.moves)
    np.testing.assert_allclose(bench.robot.moves[0].position[0], HOME, atol=1e-9)
    assert bench.cell.progressed > 0
    assert bench.stopper.stages == []


def test_success_without_arrival_is_none(bench: Bench) -> None:
    bench.robot.arrives = False
    finish = bench.run()
    assert finish.outcome is m.Outcome.INCOMPLETE
    assert bench.cell.confirmed == []
    assert any("rad off" in c.text for c in bench.cell.told if isinstance(c, m.Record))
    assert m.Kind.SPARE_USED in bench.cell.kinds()


def test_no_motion_begins_on_joint_states_of_before_it_was_asked_for(
    bench: Bench, until: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calibration.sequencer.runner.CALM", 0.5)
    until(bench.robot.joints.standing)
    bench.robot.lag = 3.0
    runner, thread = bench.start()
    until(lambda: runner.sequence.paused)
    assert bench.robot.moves == []
    words = r"the joint states are 0\.\d s behind the clock: put that right, then resume"
    asked = [c.text for c in bench.cell.told if isinstance(c, m.AskOperator)]
    assert any(re.fullmatch(words, text) for text in asked), asked
    bench.robot.lag = 0.0
    runner.post(m.Resume(0.0))
    thread.join(30.0)
    assert runner.finish is not None
    assert runner.finish.outcome is m.Outcome.COMPLETED


def test_joint_states_that_lag_behind_the_driver_are_awaited(bench: Bench) -> None:
    bench.robot.lag = 0.8  # more than they may be late where they are of later than the driver's word
    assert bench.run().outcome is m.Outcome.COMPLETED
    assert not any("rad off" in c.text for c in bench.cell.told if isinstance(c, m.Record))


def test_a_clock_that_leaps_makes_no_motion_late(bench: Bench, until: Any) -> None:
    """Also a simulation's, which outruns what joint states take to arrive."""
    runner, thread = bench.start()
    for count in (1, 2):
        until(lambda count=count: len(bench.robot.moves) == count)
        bench.cell.leap += 60.0  # joint states are stamped by the same clock
    thread.join(30.0)
    assert runner.finish is not None
    assert runner.finish.outcome is m.Outcome.COMPLETED
    assert m.Kind.CONFIGURATION_RETRIED not in bench.cell.kinds()


def test_nothing_moves_before_the_guard_hears_the_sequencer(bench: Bench, until: Any) -> None:
    bench.say_not_heard()
    runner, thread = bench.start()
    until(lambda: m.Kind.OPERATOR_ASKED in bench.cell.kinds())
    time.sleep(0.3)
    assert bench.robot.moves == []
    bench.hears = True
    thread.join(30.0)
    assert runner.finish is not None
    assert runner.finish.outcome is m.Outcome.COMPLETED


def test_a_driver_that_refuses(bench: Bench) -> None:
    bench.robot.fails_at_once = True
    assert bench.run().outcome is m.Outcome.INCOMPLETE
    assert len(bench.robot.moves) == 6  # two attempts for two configurations and a spare


def test_a_motion_that_somebody_else_cancelled_waits_for_the_operator(bench: Bench, until: Any) -> None:
    bench.robot.end_by = End.CANCELLED
    runner, thread = bench.start()
    until(lambda: m.Kind.PAUSED in bench.cell.kinds())
    time.sleep(0.3)
    assert len(bench.robot.moves) == 1
    assert runner.sequence.paused
    bench.robot.end_by = End.SUCCESS
    runner.post(m.ResumeMotion(time.monotonic(), "A. Smith"))
    thread.join(30.0)
    assert runner.finish is not None
    assert runner.finish.outcome is m.Outcome.COMPLETED


def test_a_stop_does_not_wait_for_the_disk(bench: Bench, until: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    stopped_when_told: list[bool] = []
    usual = bench.cell.carry_out

    def slow(command: m.Command) -> None:
        if isinstance(command, m.Record) and command.kind is m.Kind.PAUSED:
            stopped_when_told.append(bool(bench.stopper.stages))
        usual(command)

    monkeypatch.setattr(bench.cell, "carry_out", slow)
    monkeypatch.setattr(bench.robot, "move", lambda trajectory, _: bench.robot.moves.append(trajectory))
    runner, thread = bench.start()
    until(lambda: bench.robot.moves)
    runner.post(m.Pause(0.0))
    until(lambda: stopped_when_told)
    runner.post(m.Stop(0.0))
    thread.join(30.0)
    assert stopped_when_told == [True]


def test_a_driver_that_never_ends_is_stopped(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SLACK", 0.0)
    monkeypatch.setattr(bench.robot, "move", lambda trajectory, _: bench.robot.moves.append(trajectory))
    assert bench.run().outcome is m.Outcome.INCOMPLETE
    assert bench.robot.stops >= 6
    assert any("too long" in c.text for c in bench.cell.told if isinstance(c, m.Record))


def test_a_back_end_without_answers_arrives_by_its_joint_states(bench: Bench) -> None:
    bench.robot.answers = False
    assert bench.run().outcome is m.Outcome.COMPLETED


def test_a_loss_of_permission_stops_and_waits_for_the_operator(bench: Bench, until: Any) -> None:
    runner, thread = bench.start()
    until(lambda: runner.moving)
    bench.permitted, bench.text = False, "drives off"
    until(lambda: bench.robot.stops > 0)
    bench.permitted = True
    time.sleep(0.3)
    moves = len(bench.robot.moves)
    assert runner.sequence.paused
    time.sleep(0.3)
    assert len(bench.robot.moves) == moves  # nothing moves by itself
    runner.post(m.ResumeMotion(time.monotonic(), "A. Smith"))
    thread.join(30.0)
    assert runner.finish is not None
    assert runner.finish.outcome is m.Outcome.COMPLETED
    assert {m.Kind.PERMISSION_LOST, m.Kind.PERMISSION_GAINED, m.Kind.CONTINUED} <= set(bench.cell.kinds())


def test_a_silent_guard_is_no(bench: Bench, until: Any) -> None:
    bench.robot.pace = 1.0
    runner, _ = bench.start()
    until(lambda: runner.moving)
    bench.told_by_guard = False
    until(lambda: bench.robot.stops > 0)
    assert "the guard is silent" in [c.text for c in bench.cell.told if isinstance(c, m.Record)]


def test_the_ladder_is_climbed_when_the_robot_goes_on(
    bench: Bench, until: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.robot.pace = 1.0
    runner, _ = bench.start()
    until(lambda: runner.moving)
    monkeypatch.setattr(bench.robot, "stop", lambda: None)  # deaf
    monkeypatch.setattr(bench.robot.joints, "standing", lambda: False)
    bench.permitted = False
    until(lambda: bench.stopper.stages[-1:] == [3])
    assert bench.stopper.stages[0] == 0
    assert sorted(set(bench.stopper.stages)) == [0, 1, 2, 3]


def test_a_recorder_that_falls_silent_pauses_until_it_is_back(bench: Bench, until: Any) -> None:
    runner, thread = bench.start()
    until(lambda: runner.moving)
    bench.cell.absent = "the recorder is silent"
    until(lambda: m.Kind.PAUSED in bench.cell.kinds())
    moves = len(bench.robot.moves)
    runner.post(m.Resume(0.0))  # too early
    time.sleep(0.3)
    bench.cell.absent = ""
    assert (runner.sequence.paused, len(bench.robot.moves)) == (True, moves)  # nothing moves by itself
    runner.post(m.Resume(0.0))
    thread.join(30.0)
    assert runner.finish is not None and runner.finish.outcome is m.Outcome.COMPLETED  # noqa: PT018


def test_instruments_that_fail(bench: Bench) -> None:
    bench.cell.fault = "tracker: beam broken"
    assert bench.run().outcome is m.Outcome.INCOMPLETE
    assert any("beam broken" in c.reason for c in bench.cell.told if isinstance(c, m.EndAttempt))


def test_readings_that_cannot_be_stored(bench: Bench) -> None:
    bench.cell.refuses = True
    assert bench.run().outcome is m.Outcome.INCOMPLETE
    assert any("no joint states" in c.reason for c in bench.cell.told if isinstance(c, m.EndAttempt))


def test_a_load_device_that_is_stuck(bench: Bench) -> None:
    bench.cell.load_works = False
    assert bench.run().outcome is m.Outcome.INCOMPLETE
    assert {c.step for c in bench.cell.confirmed} == {0}


def test_pause_and_stop(bench: Bench, until: Any) -> None:
    runner, thread = bench.start()
    until(lambda: runner.moving)
    runner.post(m.Pause(0.0))
    until(lambda: bench.robot.stops > 0)
    until(lambda: not runner.moving)
    done: list[int] = []
    runner.post(Call(lambda: done.append(threading.get_ident())))
    until(lambda: done)
    assert done == [thread.ident]
    runner.post(m.Stop(0.0))
    thread.join(5.0)
    assert runner.finish is not None
    assert runner.finish.outcome is m.Outcome.STOPPED


def test_a_robot_without_joint_states_is_not_moved(bench: Bench) -> None:
    bench.robot.end()
    bench.robot.joints._kept = Joints(ArrivalRules())._kept  # as before the first
    assert bench.run().outcome is m.Outcome.INCOMPLETE
    assert bench.robot.moves == []


@pytest.mark.parametrize("moment", ["in the unloaded window", "in a window", "between"])
def test_no_reading_counts_of_a_robot_that_was_not_sound(bench: Bench, until: Any, moment: str) -> None:
    """Drives off for a moment, from the unloaded window on: the configuration begins again, and that is no failure."""
    asked: list[int] = []
    measure, load = bench.cell.measure, bench.cell.apply_load

    def fault() -> None:
        bench.say(permitted=False)
        bench.say(permitted=True)

    def measured(configuration: int, answered: Any) -> None:
        asked.append(1)
        if moment != "between" and len(asked) == (1 if moment == "in the unloaded window" else 2):
            fault()
        measure(configuration, answered)

    def loaded(command: m.RequestLoad, answered: Any) -> None:
        if moment == "between" and len(asked) == 1:
            fault()
        load(command, answered)

    bench.cell.measure, bench.cell.apply_load = measured, loaded  # type: ignore[method-assign]
    runner, thread = bench.start()
    until(lambda: runner.sequence.held)
    while thread.is_alive():
        if runner.sequence.held:
            runner.post(m.ResumeMotion(time.monotonic(), "A. Smith"))
        thread.join(0.2)
    assert runner.finish is not None
    assert runner.finish.outcome is m.Outcome.COMPLETED
    before = 0 if moment == "in the unloaded window" else 1
    assert [(c.configuration, c.step) for c in bench.cell.confirmed] == [
        *[(1, 0)] * before, (1, 0), (1, 1), (2, 0), (2, 1)
    ]  # fmt: skip
    assert bench.cell.kinds().count(m.Kind.READING_REJECTED) == 1
    (ended,) = [c for c in bench.cell.told if isinstance(c, m.EndAttempt) and not c.completed]
    assert ended.reason.endswith("the configuration begins again")


@pytest.mark.slow
def test_200_random_moments_of_a_robot_that_is_not_sound(bench: Bench) -> None:
    """Whenever mode, drives or safety are bad or unknown, and however shortly: no reading from the unloaded one on."""
    rng = np.random.default_rng(2047)
    faults: list[tuple[float, float]] = []
    asked: dict[int, float] = {}
    kept: list[tuple[float, float]] = []
    measure, confirm = bench.cell.measure, bench.cell.confirm

    def measured(configuration: int, answered: Any) -> None:
        command = runner._reading[max(runner._reading)]
        if command.step == 0:
            asked[command.configuration] = time.monotonic()
        threading.Timer(float(rng.uniform(0.02, 0.1)), lambda: measure(configuration, answered)).start()

    def confirmed(command: m.TakeReading, averages: Any) -> None:
        confirm(command, averages)
        kept.append((asked[command.configuration], time.monotonic()))

    bench.cell.measure, bench.cell.confirm = measured, confirmed  # type: ignore[method-assign]
    rejected = 0
    while len(faults) < 200:
        runner, thread = bench.start()
        while thread.is_alive():
            time.sleep(float(rng.uniform(0.0, 0.3)))
            began = time.monotonic()
            bench.say(permitted=False)
            time.sleep(float(rng.choice([0.0, rng.uniform(0.0, 0.05)])))
            bench.say(permitted=True)
            faults.append((began, time.monotonic()))
            time.sleep(0.03)
            if runner.sequence.held:
                runner.post(m.ResumeMotion(time.monotonic(), "A. Smith"))
            for _ in range(int(rng.integers(1, 12))):  # something is measured in between
                thread.join(0.1)
                if runner.sequence.held:
                    runner.post(m.ResumeMotion(time.monotonic(), "A. Smith"))
        rejected += bench.cell.kinds().count(m.Kind.READING_REJECTED)
        bench.cell.told.clear()
    bad = [one for one in kept if any(one[0] < end and begin < one[1] for begin, end in faults)]
    print(f"\n{len(faults)} faults, {len(kept)} readings kept, {rejected} rejected, {len(bad)} kept although")
    assert bad == []
    assert rejected > 20
