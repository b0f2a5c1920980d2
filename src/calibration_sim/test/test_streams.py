"""Streams: slow enough, what the markers say, noise and clocks as stated."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from calibration_core.cell import Cell
from calibration_core.errors import CellError
from calibration_core.timeseries import NANOSECONDS, Phase, Streams
from calibration_sim.cell.configurations import random_protocol
from calibration_sim.cell.protocol import FOUR_STEPS, Configuration, Protocol
from calibration_sim.cell.sensors import ForceTorqueFaults, Sensors
from calibration_sim.cell.streams import START, Rates, observe, simulate_recording
from calibration_sim.cell.table import solve
from calibration_sim.cell.timeline import Pace, Timeline, play, sample
from calibration_sim.cell.truth import draw_truth

SPEED_BOUND = 0.250  # m/s, CWA 17384


@pytest.fixture
def timeline(demo: Cell) -> Timeline:
    return play(demo, draw_truth(demo, 0), random_protocol(demo, 4, 0))


@pytest.mark.parametrize("name", ["demo", "small"])
def test_no_point_exceeds_the_speed_bound(name: str, request: pytest.FixtureRequest) -> None:
    cell: Cell = request.getfixturevalue(name)
    played = play(cell, draw_truth(cell, 1), random_protocol(cell, 6, 1))
    time = np.arange(0.0, played.duration, 0.002)
    points = sample(played, time).points
    speed = np.linalg.norm(np.diff(points, axis=0), axis=2) / np.diff(time)[:, None]
    assert speed.max() <= SPEED_BOUND
    assert speed.max() > 0.5 * 0.2  # and motions do not dawdle


def test_segments_join_without_jumps(timeline: Timeline) -> None:
    """Points, angles and wrench are continuous across every boundary (ringing below a micrometre by then)."""
    for before, after in zip(timeline.segments[:-1], timeline.segments[1:], strict=True):
        assert after.start == pytest.approx(before.start + before.duration, abs=1e-9)
        left, right = sample(timeline, np.array([after.start - 1e-7, after.start + 1e-7])).points
        assert left == pytest.approx(right, abs=1e-6)


def test_phases_follow_one_another(demo: Cell) -> None:
    """Moving, then settle and measure per step with loading in between; an end under load is unloaded first."""
    played = play(demo, draw_truth(demo, 0), random_protocol(demo, 2, 0, levels=FOUR_STEPS))
    once = [Phase.MOVING, Phase.SETTLING, Phase.MEASURING]
    once += [Phase.LOADING, Phase.SETTLING, Phase.MEASURING] * 3 + [Phase.UNLOADING]
    assert [segment.phase for segment in played.segments] == once * 2
    moving = [segment for segment in played.segments if segment.phase is Phase.MOVING]
    assert [segment.configuration for segment in moving] == [1, 2]
    assert not any(segment.states.wrench.any() for segment in moving)


def test_measuring_phases_hold_the_solved_states(demo: Cell) -> None:
    """The perfect stream inside a MEASURING phase is the table's solution of that configuration and step."""
    truth, protocol = draw_truth(demo, 0), random_protocol(demo, 3, 0)
    solved, played = solve(demo, truth, protocol), play(demo, truth, protocol)
    measuring = [segment for segment in played.segments if segment.phase is Phase.MEASURING]
    assert [segment.configuration for segment in measuring] == solved.configuration.tolist()
    assert [segment.step for segment in measuring] == solved.step.tolist()
    for i, segment in enumerate(measuring):
        seen = sample(played, np.linspace(segment.start, segment.start + segment.duration - 1e-9, 7))
        assert np.ptp(seen.points, axis=0).max() == 0.0
        assert seen.points[0] == pytest.approx(solved.states.points[i], abs=1e-12)
        assert seen.wrench[3] == pytest.approx(solved.states.wrench[i], abs=1e-9)
        assert np.all(seen.q == solved.states.q[i])


def test_ramps_lie_on_the_equilibria(demo: Cell, timeline: Timeline) -> None:
    """Between the nodes of a ramp the spline meets the solution to a nanometre, and points ring after it."""
    ramp = next(segment for segment in timeline.segments if segment.phase is Phase.LOADING)
    truth, share = timeline.truth, 0.37
    configuration = random_protocol(demo, 4, 0).configurations[0]
    wrench = share * configuration.wrenches[1]
    exact = solve(demo, truth, Protocol((Configuration(1, configuration.q, wrench[None]),))).states.points[0]
    seen = sample(timeline, np.array([ramp.start + share * ramp.duration])).points[0]
    assert seen == pytest.approx(exact, abs=1e-9)
    settling = timeline.segments[timeline.segments.index(ramp) + 1]
    assert settling.phase is Phase.SETTLING
    time = settling.start + np.linspace(0.0, settling.duration, 300)
    swing = np.linalg.norm(sample(timeline, time).points[:, 0] - settling.states.points[0, 0], axis=1)
    assert swing[:60].max() > 5e-6
    assert swing[-30:].max() < 0.02 * swing.max()


def _windows(recording: Streams) -> list[tuple[int, int, int, int]]:
    steps = recording.steps
    assert steps is not None
    return [
        (int(steps.time[i]), int(steps.time[i + 1]), int(steps.configuration[i]), int(steps.step[i]))
        for i in np.flatnonzero(steps.phase == Phase.MEASURING)
    ]


def test_recorded_windows_average_to_the_solution(demo: Cell) -> None:
    """Means over MEASURING windows scatter about the solved states by the instruments' claims."""
    truth, protocol = draw_truth(demo, 0), random_protocol(demo, 6, 0)
    solved = solve(demo, truth, protocol)
    recording = simulate_recording(demo, truth, protocol, 3)
    windows = _windows(recording)
    assert [(c, s) for _, _, c, s in windows] == list(zip(solved.configuration, solved.step, strict=True))
    assert recording.wrench is not None
    errors, wrench_errors = [], []
    for i, (start, end, _, _) in enumerate(windows):
        for k, series in enumerate(recording.points.values()):
            inside = (series.time >= start) & (series.time < end)
            assert inside.sum() >= 19
            errors.append(series.values[inside].mean(axis=0) - solved.states.points[i, k])
        inside = (recording.wrench.time >= start) & (recording.wrench.time < end)
        wrench_errors.append(recording.wrench.values[inside].mean(axis=0) - solved.states.wrench[i])
        inside = (recording.joints.time >= start) & (recording.joints.time < end)
        assert np.all(recording.joints.values[inside] == solved.states.q[i])
    assert np.std(errors, axis=0) == pytest.approx(2e-5, rel=0.2)
    assert np.std(wrench_errors, axis=0) == pytest.approx([1, 1, 1, 0.5, 0.5, 0.5], rel=0.35)


def test_markers_announce_every_segment(demo: Cell, timeline: Timeline) -> None:
    recording = observe(timeline, demo, 0)
    steps = recording.steps
    assert steps is not None
    assert len(steps.time) == len(timeline.segments) + 1
    assert steps.phase[-1] == Phase.DONE
    assert steps.phase[:-1].tolist() == [int(segment.phase) for segment in timeline.segments]
    starts = (steps.time - START) / NANOSECONDS
    assert starts[:-1] == pytest.approx([segment.start for segment in timeline.segments], abs=1e-8)
    assert starts[-1] == pytest.approx(timeline.duration)
    assert observe(timeline, demo, 0, markers=False).steps is None


def test_force_torque_clock_is_off_by_the_offset(demo: Cell, timeline: Timeline) -> None:
    """Stamps shift, receive times and values do not."""
    slow = dataclasses.replace(
        timeline,
        truth=dataclasses.replace(timeline.truth, sensors=Sensors(force_torque=ForceTorqueFaults(clock_offset=0.120))),
    )
    straight, shifted = (observe(t, demo, 5) for t in (timeline, slow))
    assert straight.wrench is not None
    assert shifted.wrench is not None
    assert np.all(np.abs(shifted.wrench.time - straight.wrench.time - 120_000_000) <= 1)
    assert np.array_equal(shifted.wrench.received, straight.wrench.received)
    assert np.array_equal(shifted.wrench.values, straight.wrench.values)
    assert np.array_equal(shifted.points["mp1"].time, straight.points["mp1"].time)


def test_streams_reproduce_and_follow_their_rates(demo: Cell, timeline: Timeline) -> None:
    rates = Rates(joints=20.0, tracker=5.0, wrench=40.0, temperature=1.0)
    first, again, other = (observe(timeline, demo, seed, rates=rates) for seed in (1, 1, 2))
    for name in demo.points:
        assert np.array_equal(first.points[name].values, again.points[name].values)
        assert not np.array_equal(first.points[name].values, other.points[name].values)
    assert first.wrench is not None
    assert first.temperature is not None
    series = {20.0: first.joints, 5.0: first.points["mp1"], 40.0: first.wrench, 1.0: first.temperature}
    for rate, stream in series.items():
        assert np.diff(stream.time) == pytest.approx(NANOSECONDS / rate, abs=1.0)
        delay = (stream.received - stream.time) / NANOSECONDS
        assert delay.min() >= 0.0005 - 1e-8
        assert delay.max() <= 0.0025 + 1e-8
        assert len(stream) == pytest.approx(timeline.duration * rate, abs=1.0)
    assert first.joints.values.shape[1] == 6
    assert "<robot" in first.robot_description
    assert first.provenance.messages["/tracker/mp2"] == len(first.points["mp2"])


def test_a_demonstration_recording_stays_small(demo: Cell) -> None:
    """18 configurations of nine steps: about half an hour of data, 30 MB at 140 bytes a message."""
    recording = simulate_recording(demo, draw_truth(demo, 0), random_protocol(demo, 18, 0), 0)
    assert len(_windows(recording)) == 162
    assert sum(recording.provenance.messages.values()) < 30e6 / 140


def test_displacements_are_not_streamed(demo: Cell, changed: Callable[..., Cell]) -> None:
    cell = changed(demo, measurements={"points": "displacement"})
    with pytest.raises(CellError, match="displacement"):
        simulate_recording(cell, draw_truth(cell, 0), random_protocol(cell, 2, 0), 0)


def test_a_recording_of_single_steps_has_no_ramps(demo: Cell) -> None:
    """Under its own weight alone; a faster pace still keeps the order."""
    protocol = random_protocol(demo, 3, 0, levels=(0.0,))
    played = play(demo, draw_truth(demo, 0), protocol, Pace(lead_in=0.5, settle=0.5, measure=1.0))
    assert {segment.phase for segment in played.segments} == {Phase.MOVING, Phase.SETTLING, Phase.MEASURING}
    assert played.segments[0].duration == 0.5
