"""The living cell: motors follow controllers' cubics, the structure follows statics, faults do what they say."""

from __future__ import annotations

from pathlib import Path as FilePath

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from calibration_core.cell import Cell
from calibration_sim.cell.sensors import stream_noise
from calibration_sim.cell.streams import Rates
from calibration_sim.cell.table import build_mechanism, solve_states
from calibration_sim.cell.truth import Truth, nominal_truth
from calibration_sim.living_cell.faults import Fault, Faults, Kind
from calibration_sim.living_cell.live import BRAKING, LiveCell, Path, Refused
from calibration_sim.living_cell.live_sensors import LiveNoise, LiveSensors
from calibration_sim.living_cell.motion_log import MotionLog, TruthLog, true_places, true_speeds
from calibration_sim.living_cell.schedule import Schedule
from calibration_sim.mechanics.chain import read_chain
from calibration_sim.mechanics.mjcf import Spring

START = np.array([0.1, -0.4, 0.5, 0.2, -0.3, 0.1])
GOAL = START + np.array([0.2, 0.1, -0.1, 0.3, 0.2, -0.2])


@pytest.fixture
def truth(demo: Cell) -> Truth:
    return nominal_truth(demo)


@pytest.fixture
def live(demo: Cell, truth: Truth) -> LiveCell:
    return LiveCell(demo, truth, START)


def path(duration: float = 2.0) -> Path:
    time = np.array([0.0, 0.3 * duration, 0.7 * duration, duration])
    share = np.array([0.0, 0.2, 0.8, 1.0])[:, None]
    speed = np.array([0.0, 1.2, 1.2, 0.0])[:, None] / duration
    return Path(time, START + share * (GOAL - START), speed * (GOAL - START))


def run(live: LiveCell, seconds: float, tick: float = 0.01) -> np.ndarray:
    rows = [live.q.copy()]
    for _ in range(round(seconds / tick)):
        live.advance(live.time + tick)
        rows.append(live.q.copy())
    return np.array(rows)


def test_motors_follow_the_cubic(live: LiveCell) -> None:
    live.follow(path())
    rows = run(live, 2.0)
    expected = CubicHermiteSpline(path().time, path().position, path().velocity)(np.arange(201) * 0.01)
    np.testing.assert_allclose(rows, expected, atol=1e-12)
    assert not live.moving
    np.testing.assert_array_equal(live.q, GOAL)


def test_braking_comes_to_rest_on_the_path(live: LiveCell) -> None:
    live.follow(path())
    run(live, 1.0)
    before = live.q.copy()
    live.brake()
    rows = run(live, 2 * BRAKING)
    assert not live.moving
    direction = (GOAL - START) / np.linalg.norm(GOAL - START)
    travelled = (live.q - before) @ direction
    assert 0.0 < travelled < BRAKING * 1.2 / 2.0 * np.linalg.norm(GOAL - START)
    np.testing.assert_allclose(live.q - before, travelled * direction, atol=1e-9)
    np.testing.assert_array_equal(rows[-1], rows[-3])


def test_haste_hold_and_blockade(live: LiveCell) -> None:
    live.follow(path())
    live.haste = 2.0
    run(live, 1.0)
    np.testing.assert_array_equal(live.q, GOAL)
    live.follow(Path(np.array([0.0, 1.0]), np.stack([GOAL, START]), np.zeros((2, 6))))
    live.haste = 0.0
    run(live, 1.0)
    assert live.moving
    np.testing.assert_array_equal(live.q, GOAL)
    live.haste, live.blocked_after = 1.0, 0.5
    run(live, 2.0)
    assert not live.moving
    np.testing.assert_allclose(live.q, 0.5 * (START + GOAL), atol=1e-9)


def test_a_small_gap_at_the_start_is_closed_without_a_step(live: LiveCell) -> None:
    shifted = Path(path().time, path().position + 1e-3, path().velocity)
    live.follow(shifted)
    rows = run(live, 2.0, tick=0.001)
    np.testing.assert_allclose(live.q, GOAL + 1e-3, atol=1e-12)
    assert np.abs(np.diff(rows, axis=0)).max() < 1e-3


@pytest.mark.parametrize(
    "change",
    [
        {"time": [0.0, 1.0]},
        {"time": [0.1, 0.6, 1.4, 2.0]},
        {"time": [0.0, 1.0, 1.0, 2.0]},
        {"time": [0.0, 0.6, 1.4, np.nan]},
        {"velocity": np.ones((4, 6))},
    ],
)
def test_paths_that_no_controller_follows(change: dict[str, object]) -> None:
    values = {"time": path().time, "position": path().position, "velocity": path().velocity} | change
    with pytest.raises(Refused):
        Path(**values)


def test_a_path_that_begins_elsewhere_is_refused(live: LiveCell) -> None:
    with pytest.raises(Refused, match="away from"):
        live.follow(Path(path().time, path().position + 0.1, path().velocity))


def test_load_and_points_are_those_of_statics(live: LiveCell, demo: Cell, truth: Truth) -> None:
    wrench = np.array([300.0, -200.0, -1000.0, 0.0, 0.0, 0.0])
    unloaded = live.points()
    live.pull(wrench, 1.0)
    run(live, 0.5)
    assert live.loading
    np.testing.assert_allclose(live.load, 0.5 * wrench)
    run(live, 0.6)
    assert not live.loading
    run(live, 5.0)  # rung down
    states = solve_states(build_mechanism(demo, truth), demo, truth, START[None], wrench[None])
    np.testing.assert_allclose(live.points(), states.points[0], atol=1e-10)
    np.testing.assert_allclose(live.wrench(), states.wrench[0], atol=1e-9)
    assert np.abs(live.points() - unloaded).max() > 1e-4
    with pytest.raises(Refused):
        live.pull([np.nan] * 6, 1.0)


def test_a_concealed_spring_gives_way_besides_the_joints(demo: Cell, truth: Truth, live: LiveCell) -> None:
    link = next(link for link in read_chain(demo).links if link.joint == "joint_2")
    across = np.linalg.svd(link.axis[None])[2][1]
    soft = LiveCell(demo, truth, START, (Spring(link.name, across, np.zeros(3), 5e6),))
    moved = []
    for one in (live, soft):
        before = one.points()
        one.pull([600.0, 600.0, -1000.0, 0.0, 0.0, 0.0], 0.5)
        run(one, 6.0)
        moved.append(one.points() - before)
    assert np.abs(moved[1] - moved[0]).max() > 5e-5
    np.testing.assert_array_equal(soft.q, START)


def test_it_rings_after_a_change_of_load(live: LiveCell) -> None:
    live.pull([0.0, 0.0, -1000.0, 0.0, 0.0, 0.0], 0.5)
    run(live, 0.5)
    swing = []
    for _ in range(200):
        live.advance(live.time + 0.005)
        swing.append(live.points())
    deviation = np.abs(np.array(swing) - swing[-1]).max(axis=(1, 2))
    assert deviation[:60].max() > 1e-6
    assert deviation[160:].max() < 0.05 * deviation[:60].max()


def test_motion_log_tells_the_true_speed(live: LiveCell, tmp_path: FilePath) -> None:
    with MotionLog(tmp_path / "motion.log") as log:
        live.follow(path())
        for _ in range(210):
            log.add(*live.advance(live.time + 0.01))
    found = true_speeds(tmp_path / "motion.log", live)
    assert len(found) == pytest.approx(2000, abs=2)
    np.testing.assert_allclose(np.diff(found[:, 0]), 1e-3, atol=2e-4)
    in_flange = np.array(list(live.truth.points.values()))
    points = [live.mechanism.forward(q).apply(in_flange) for q in path().at([1.0 - 1e-5, 1.0 + 1e-5])]
    speed = np.linalg.norm(points[1] - points[0], axis=1).max() / 2e-5
    at = found[np.argmin(np.abs(found[:, 0] - 1.0)), 1]
    assert at == pytest.approx(speed, rel=0.05)
    assert at >= speed * 0.999


def test_truth_log_tells_where_the_points_are(live: LiveCell, tmp_path: FilePath) -> None:
    log = TruthLog(tmp_path / "truth.log")
    live.pull([0.0, 0.0, -1000.0, 0.0, 0.0, 0.0], 0.5)
    seen = []
    for _ in range(6):
        live.advance(live.time + 0.1)
        log.add(live)
        seen.append(live.points())
    log.close()
    with (tmp_path / "truth.log").open("ab") as file:
        file.write(b"half a row")
    time, q, load, points = true_places(tmp_path / "truth.log", len(live.q), len(live.truth.points))
    np.testing.assert_allclose(time, 0.1 * np.arange(1, 7))
    np.testing.assert_array_equal(q, np.tile(live.q, (6, 1)))
    np.testing.assert_allclose(load[:, 2], [-200.0, -400.0, -600.0, -800.0, -1000.0, -1000.0])
    np.testing.assert_array_equal(points, seen)
    assert np.linalg.norm(points[-1] - points[0], axis=1).max() > 1e-4


def test_noise_is_that_of_the_streams() -> None:
    rate, window = 10.0, 2.0
    source = LiveNoise(np.random.default_rng(1), 400, rate=rate, window=window)
    live = np.array([source.next() for _ in range(200)])
    stream = stream_noise(np.random.default_rng(2), 200, 400, rate=rate, window=window)
    for values in (live, stream):
        means = values.reshape(10, 20, 400).mean(axis=1)
        assert means.std() == pytest.approx(1.0, rel=0.06)
    assert live.std() == pytest.approx(stream.std(), rel=0.03)


def test_sensors_show_the_truth_with_the_claimed_noise(demo: Cell, truth: Truth) -> None:
    sensors = LiveSensors(demo, truth, 3, rates=Rates(), window=2.0)
    place = np.array([2.0, 1.0, 0.5])
    shown = np.array([sensors.point(0, place) for _ in range(4000)])
    np.testing.assert_allclose(shown.mean(axis=0), place, atol=1e-5)
    pulled = np.array([sensors.wrench(np.arange(6.0)) for _ in range(4000)])
    np.testing.assert_allclose(pulled.mean(axis=0), np.arange(6.0), atol=0.5)
    assert sensors.temperature() == pytest.approx(20.0, abs=0.6)


def test_the_schedule_neither_drifts_nor_sends_twice() -> None:
    schedule = Schedule({"a": 10.0, "b": 3.0, "never": 0.0})
    now, count = 0.0, {"a": 0, "b": 0}
    while now < 100.0:
        now = schedule.next(now)
        for name in schedule.due(now):
            count[name] += 1
    assert count == {"a": 1000, "b": 300}
    assert schedule.due(now + 5.0) == {"a", "b"}
    assert schedule.due(now + 5.0) == frozenset()


def test_faults_begin_and_end() -> None:
    faults = Faults()
    faults.begin(Fault.read("TRACKER_JUMP 0.1 mp2", 2.0))
    faults.begin(Fault.read("OVER_SPEED 3", 2.0))
    assert faults.on(Kind.TRACKER_JUMP, "mp2")
    assert not faults.on(Kind.TRACKER_JUMP, "mp1")
    assert faults.grown(Kind.TRACKER_JUMP, 4.0) == pytest.approx(0.2)
    assert faults.value(Kind.OVER_SPEED, 1.0) == 3.0
    for wrong in ("NO_SUCH_KIND", "OVER_SPEED fast", "OVER_SPEED 1 mp1 2"):
        with pytest.raises(ValueError, match=r"found|convert|unpack"):
            Fault.read(wrong, 0.0)
    faults.begin(Fault(Kind.NONE))
    assert faults.value(Kind.OVER_SPEED, 1.0) == 1.0
