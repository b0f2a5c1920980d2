"""The tracker's clock from motion: a known truth, and two recordings of others with clocks of their own."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from calibration_core.cell import Cell, load_cell
from calibration_core.measurement.sender_clock import ClockFromMotion, SenderClock, sender_clock
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.policy import CLOCK_KNOWN
from calibration_core.timeseries import NANOSECONDS, Float1D, Float2D, Int1D

ROOT = Path(__file__).resolve().parents[4]
REAL = next((found for one in ROOT.parents if (found := one / "shared/data/real").is_dir()), ROOT / "none")
CELL = ROOT / "config" / "cells" / "demo.cell.yaml"
real = pytest.mark.skipif(not (REAL / "streams").is_dir(), reason="shared/data/real/streams is not beside the project")
REST = 2.0  # s between two motions
NEARBY = 3e-3  # s; clocks so far off fit a recording worse


def ns(seconds: Float1D) -> Int1D:
    return np.round(np.asarray(seconds) * NANOSECONDS).astype(np.int64)


def places(cell: Cell, q: Float2D, name: str = "mp1") -> Float2D:
    """Where a point is, (k, 3) m, base frame."""
    return posture(chain_of(cell), q).point(nominal_parameters(cell).points[name]).T


@dataclasses.dataclass
class World:
    """A robot that moves and rests by turns, and a tracker with a clock of its own; times are s of the robot's."""

    seed: int
    offset: float = 5.6
    rate: float = 1.001
    noise: float = 3e-5  # m
    model: float = 1e-3  # rad, that the joints are off the model
    dropped: float = 0.05
    gross: float = 0.0  # share of the tracker's samples that are 20 mm off
    length: float = 22.0
    periodic: bool = False
    cruise: bool = False  # of constant speed between short ramps
    q: Float2D = dataclasses.field(init=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.cell = load_cell(CELL)
        self.time = np.arange(0.0, self.length, 2e-3)
        start = here = self.rng.uniform(-0.5, 0.5, 6)
        way, there, begin = self.rng.uniform(-0.6, 0.6, 6), start, 0.5
        self.q = np.tile(here, (len(self.time), 1))
        while begin < self.time[-1]:
            if self.periodic:
                there = start + way if here is start else start
            else:
                there = here + self.rng.uniform(-0.6, 0.6, 6)
            length = max(np.abs(there - here).max() * 1.875 / 0.4, 0.5)
            share = np.clip((self.time - begin) / length, 0.0, 1.0)
            course = 10 * share**3 - 15 * share**4 + 6 * share**5
            if self.cruise:
                length *= 2.0
                at, ramp = np.clip(self.time - begin, 0.0, length), 0.4
                course = np.where(at < ramp, at**2 / (2.0 * ramp), np.minimum(at, length - ramp) - ramp / 2.0)
                course = (course + np.where(at > length - ramp, ramp / 2 - (length - at) ** 2 / (2 * ramp), 0.0)) / (
                    length - ramp
                )
            self.q = np.where((self.time >= begin)[:, None], here + course[:, None] * (there - here), self.q)
            here, begin = there, begin + length + REST
        self.off = self.model * self.rng.standard_normal(6)
        turn = np.linalg.qr(self.rng.standard_normal((3, 3)))[0]
        self.turn = turn * np.sign(np.linalg.det(turn))

    def angles(self, at: Float1D) -> Float2D:
        return np.column_stack([np.interp(at, self.time, column) for column in self.q.T])

    def joints(self, begin: float, end: float, rate: float = 125.0) -> tuple[Int1D, Float2D]:
        at = np.arange(begin, end, 1.0 / rate)
        return ns(at), self.angles(at)

    def robot(self, begin: float, end: float, rate: float = 125.0) -> tuple[Int1D, Float2D]:
        time, q = self.joints(begin, end, rate)
        return time, places(self.cell, q)

    def tracker(self, begin: float, end: float, rate: float = 100.0, gap: float = 0.7) -> tuple[Int1D, Float2D, Int1D]:
        """Stamps, positions and receive times; some samples are missing, and those of a gap."""
        at = np.arange(begin, end, 1.0 / rate)
        at = np.sort(at + self.rng.uniform(-0.1, 0.1, len(at)) / rate)
        hidden = self.rng.uniform(begin + 1.0, end - 1.0)
        at = at[(self.rng.random(len(at)) > self.dropped) & (np.abs(at - hidden) > gap / 2.0)]
        seen = places(self.cell, self.angles(at) + self.off) @ self.turn.T + [1.0, -2.0, 3.0]
        late = self.rng.exponential(0.01, len(at))
        seen += self.noise * self.rng.standard_normal(seen.shape)
        seen[self.rng.random(len(at)) < self.gross] += 0.02
        return ns(self.offset + self.rate * at), seen, ns(at + late)

    def errors(self, found: SenderClock) -> Float1D:
        """Errors of offset and rate, in standard deviations."""
        truth = SenderClock(0, round(self.offset * NANOSECONDS), self.rate, np.zeros((2, 2))).at(found.robot)
        return found.minus(truth) / found.std


CASES = {
    "usual": ({}, {}),
    "a perfect model": ({"model": 0.0}, {}),
    "a bad model": ({"model": 5e-3}, {}),
    "constant speed between ramps": ({"cruise": True}, {}),
    "constant speed, slow streams": ({"cruise": True, "length": 42.0}, {"rate": 5.0}),
    "noise": ({"noise": 3e-4}, {}),
    "gross errors": ({"gross": 0.01}, {}),
    "slow streams": ({}, {"rate": 10.0}),
    "fast streams": ({}, {"rate": 500.0}),
    "many samples missing": ({"dropped": 0.4}, {"gap": 2.0}),
}


@pytest.mark.parametrize("case", CASES)
def test_offset_and_rate_lie_within_their_intervals(case: str) -> None:
    changes, stream = CASES[case]
    errors = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        world = World(seed, rng.uniform(-1e6, 1e6), 1.0 + 5e-4 * rng.standard_normal(), **changes)
        joints = {"rate": max(stream.get("rate", 125.0), 50.0)}
        found = sender_clock(world.robot(0.0, 20.0, **joints), world.tracker(1.0, 20.0, **stream)[:2])
        if isinstance(found, str):  # without receive times, a start of a motion may look like another one's
            assert "more than one offset fits" in found, (seed, found)
            continue
        assert found.std[0] < 3e-3
        errors.append(world.errors(found))
    assert len(errors) >= 18
    covered = (np.abs(errors) < 1.96).mean(axis=0)
    print(f"{case}: {covered} within, root mean square {np.sqrt(np.mean(np.square(errors), axis=0))}")
    assert covered.min() >= 0.85


def test_every_motion_makes_the_clock_surer() -> None:
    """Motions one after another, with receive times: what is known after six is as good as its interval says."""
    errors, first, last = [], [], []
    for seed in range(6):
        world = World(seed, 1e5 + seed, length=62.0)
        clock = ClockFromMotion(world.cell)
        assert clock.missing(0) == "the tracker's clock is not known (no motion was seen): move the robot"
        samples = list(zip(*world.tracker(0.0, 60.0), strict=True))
        stds = []
        for begin in np.arange(0.0, 60.0, 10.0):
            part = [one for one in samples if ns(begin) <= one[2] < ns(begin + 10.0)]
            for stamp, position, received in part:
                clock.by_robot(int(stamp), int(received))
                clock.add("mp1", int(stamp), int(received), position)
            assert clock.learn(*world.joints(begin, begin + 10.0))
            assert clock.clock is not None
            stds.append(clock.clock.std)
        assert clock.missing(ns(60.0)) == ""
        assert "rate 1.00" in clock.figures(ns(60.0))
        errors.append(world.errors(clock.clock))
        first.append(stds[0])
        last.append(stds[-1])
    assert np.median(last, axis=0)[1] < np.median(first, axis=0)[1] / 3.0
    assert (np.abs(errors) < 3.0).all()
    assert (np.abs(errors) < 1.96).mean() >= 0.8


def test_a_clock_is_known_the_less_the_longer_the_robot_stands() -> None:
    found = SenderClock(0, 0, 1.0, np.diag([1e-6, 1e-6]))
    clock = ClockFromMotion(load_cell(CELL))
    clock.clock = found
    assert clock.missing(10 * NANOSECONDS) == ""
    assert "is known to 0.2 s only: move the robot" in clock.missing(200 * NANOSECONDS)
    assert found.at(200 * NANOSECONDS).std[0] > CLOCK_KNOWN
    assert found.at(-200 * NANOSECONDS).std[0] == pytest.approx(found.at(200 * NANOSECONDS).std[0])


def test_a_clock_that_is_set_is_found_anew() -> None:
    world = World(1)
    clock = ClockFromMotion(world.cell)
    for shift in (0.0, 0.1, 3.0, 1000.0, -1000.0):
        world.offset = 5.6 + shift
        for stamp, position, received in zip(*world.tracker(0.0, 20.0), strict=True):
            clock.by_robot(int(stamp), int(received))
            clock.add("mp1", int(stamp), int(received), position)
        if abs(shift) == 1000.0:
            assert clock.clock is None
            assert "(it was set): move the robot" in clock.missing(0)
        assert clock.learn(*world.joints(0.0, 20.0)), clock.missing(0)
        assert np.abs(world.errors(clock.clock)).max() < 4.0
        clock._seen["mp1"].clear()


def test_what_shows_no_clock_is_told() -> None:
    world = World(3)
    robot, (stamps, seen, _) = world.robot(0.0, 20.0), world.tracker(0.0, 20.0)
    still = np.tile(robot[1][:1], (len(robot[1]), 1))
    assert "does not move" in str(sender_clock((robot[0], still), (stamps, seen)))
    assert "does not see it move" in str(sender_clock(robot, (stamps, seen * 0.0 + seen[0])))
    assert "are missing" in str(sender_clock(robot, (stamps[:2], seen[:2])))
    assert "another motion" in str(sender_clock(robot, World(4).tracker(0.0, 20.0)[:2]))
    turning = np.linspace(0.0, 10.0, len(robot[0]))
    circle = np.column_stack([np.cos(turning), np.sin(turning), 0.0 * turning])
    assert "more than one offset fits" in str(sender_clock((robot[0], circle), (robot[0], circle)))
    to_and_fro = World(5, periodic=True, length=92.0)
    assert "more than one offset fits" in str(
        sender_clock(to_and_fro.robot(0.0, 90.0), to_and_fro.tracker(30.0, 60.0)[:2])
    )


def registered(robot: tuple[Int1D, Float2D], tracker: tuple[Int1D, Float2D], clock: SenderClock) -> float:
    """What the best rigid motion leaves of the tracker's positions at the robot's times, root mean square, m."""
    at = np.array([clock.by_robot(int(one)) for one in tracker[0]])
    inside = (at > robot[0][0]) & (at < robot[0][-1])
    model = np.column_stack([np.interp(at[inside], robot[0], column) for column in robot[1].T])
    model, seen = model - model.mean(axis=0), tracker[1][inside] - tracker[1][inside].mean(axis=0)
    left, _, right = np.linalg.svd(model.T @ seen)
    turn = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
    return float(np.sqrt(np.mean((model @ turn - seen) ** 2)))


def recording(name: str) -> tuple[tuple[Int1D, Float2D], tuple[Int1D, Float2D]]:
    if name == "ur5":
        q, seen = (np.loadtxt(REAL / f"streams/ur5_{what}.txt", skiprows=1) for what in ("joints", "tracker"))
        robot_time, tracker_time = 0.008 * np.arange(len(q)), 0.008 * np.arange(len(seen))
    else:
        robot, tracker = (scipy.io.loadmat(REAL / f"streams/aubo_{what}.mat") for what in ("robot", "tracker"))
        q, seen = robot["q"], 1e-3 * tracker["p"]
        robot_time, tracker_time = robot["tRobot"].ravel(), tracker["t"].ravel()
    return (ns(robot_time), places(load_cell(REAL / f"{name}.cell.yaml"), q)), (ns(tracker_time), seen)


@real
@pytest.mark.parametrize(("name", "offset", "rate"), [("ur5", 0.210, 1.0), ("aubo", 6.843, 1.00107)])
def test_clocks_of_recordings(name: str, offset: float, rate: float) -> None:
    """The offset is where a rigid motion brings the positions together best, which the estimate does not use."""
    robot, tracker = recording(name)
    found = sender_clock(robot, tracker)
    assert isinstance(found, SenderClock), found
    print(f"{name}: {found.figures}")
    assert found.offset == pytest.approx(offset, abs=3e-3)
    assert found.rate == pytest.approx(rate, abs=2e-4)
    best = registered(robot, tracker, found)
    for by in (-NEARBY, NEARBY):
        moved = dataclasses.replace(found, sender=found.sender + round(by * NANOSECONDS))
        assert registered(robot, tracker, moved) > best
    half = len(robot[0]) // 2
    for rows in (slice(half), slice(half, None)):
        part = sender_clock((robot[0][rows], robot[1][rows]), tracker)
        assert isinstance(part, SenderClock), part
        there = found.at(part.robot)
        off = part.minus(there) / np.sqrt(np.add(np.square(part.std), np.square(there.std)))
        print(f"{name}, a half: {part.figures}, off {off}")
        assert np.abs(off).max() < 4.0
