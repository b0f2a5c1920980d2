"""Arrival and standstill, judged from joint states."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

pytest.importorskip("rclpy")

from calibration.motion.arrival import ArrivalRules, Joints
from calibration_core.timeseries import NANOSECONDS


def standing(values: list[float], rate: float = 50.0) -> Joints:
    joints = Joints(ArrivalRules(tolerance=1e-3, speed=1e-3, dwell=0.3))
    for i, value in enumerate(values):
        joints.add(round(i / rate * NANOSECONDS), np.array([0.0, value]))
    return joints


def test_arrival_is_nearness_and_standstill() -> None:
    goal = np.array([0.0, 0.5])
    assert standing([0.4] * 5 + [0.5] * 20).arrived(goal)
    assert not standing([0.4] * 5 + [0.5] * 10).arrived(goal)  # not for long enough
    assert not standing([0.5] * 10).standing()  # not known for so long
    assert not standing([0.4] * 20 + [0.4 + 1e-4 * i for i in range(20)]).standing()  # creeps at 5 mrad/s
    assert standing([0.4] * 25).standing()
    assert not standing([0.4] * 25).arrived(goal)
    assert standing([0.5] * 25).arrived(goal + 9e-4)
    assert not Joints(ArrivalRules()).arrived(goal)
    assert Joints(ArrivalRules()).latest is None


def test_motion_is_seen_in_few_joint_states_and_rest_is_not() -> None:
    assert not Joints(ArrivalRules()).moving()
    assert not standing([0.5]).moving()
    assert not standing([0.5] * 10).moving()
    assert standing([0.5, 0.5 + 4e-4]).moving()  # more than 0.3 mrad, in 20 ms
    assert not standing([0.5, 0.5 + 2e-4]).moving()
    assert standing([0.4] * 20 + [0.4 + 1e-4 * i for i in range(20)]).moving()
    assert not standing([0.4 + 1e-4 * i for i in range(20)] + [0.402] * 20).moving()  # it moved, and stands
    assert standing([0.5, 0.5, 0.6], rate=1.0).moving()
    assert not standing([0.5, 0.5, 0.5006], rate=1.0).moving()  # 0.6 mrad in one second


def test_slow_joint_states_are_judged_by_what_there_is() -> None:
    assert standing([0.5, 0.5, 0.5], rate=1.0).standing()
    assert not standing([0.5, 0.5, 0.6], rate=1.0).standing()


def test_samples_that_are_bad_or_old_are_passed_over() -> None:
    joints = standing([0.5] * 25)
    joints.add(10**12, np.array([math.nan, 0.0]))
    joints.add(0, np.array([1.0, 1.0]))
    assert joints.latest is not None
    assert joints.latest.tolist() == [0.0, 0.5]
    joints.add(-5 * NANOSECONDS, np.array([1.0, 1.0]))  # the clock was set back
    assert joints.latest.tolist() == [1.0, 1.0]
    assert joints.until == -5 * NANOSECONDS


def test_samples_of_a_stretch_of_time() -> None:
    joints = standing([0.1, 0.2, 0.3, 0.4], rate=10.0)
    stamps, q = joints.between(10**8, 2 * 10**8)
    assert stamps.tolist() == [10**8, 2 * 10**8]
    assert q[:, 1].tolist() == [0.2, 0.3]
    assert joints.between(10**12, 10**13)[1].shape == (0, 2)


@pytest.mark.parametrize("rate", [10.0, 100.0, 500.0, 1000.0])
def test_how_a_robot_moves_is_seen_at_every_rate(rate: float) -> None:
    joints = Joints(ArrivalRules())
    assert joints.course(0) is None
    joints.add(0, np.zeros(2))
    q, speed, _ = joints.course(0)  # type: ignore[misc]
    assert (q.tolist(), speed.tolist()) == ([0.0, 0.0], [0.0, 0.0])
    for i in range(1, 5000):
        joints.add(round(i / rate * NANOSECONDS), np.array([0.5, -0.2]) * i / rate)
    q, speed, age = joints.course(joints.until + 20_000_000)  # type: ignore[misc]
    assert q.tolist() == pytest.approx((np.array([0.5, -0.2]) * 4999 / rate).tolist())
    assert speed.tolist() == pytest.approx([0.5, -0.2])
    assert age == pytest.approx(0.02)


def test_what_is_older_than_it_is_kept_goes() -> None:
    joints = Joints(ArrivalRules(), keep=1.0)
    for i in range(20_000):
        joints.add(i * 1_000_000, np.array([float(i)]))
    stamps, q = joints.between(0, 10**12)
    assert (len(stamps), q[0, 0], q[-1, 0]) == (1001, 18999.0, 19999.0)
    assert len(joints._kept.stamps) < 4 * 1001


def test_a_look_costs_the_same_however_much_is_kept() -> None:
    """At 1 kHz a minute of joint states is 60,000 samples; the sequencer looks a hundred times a second."""
    joints = Joints(ArrivalRules())
    for i in range(60_000):
        joints.add(i * 1_000_000, np.zeros(6))
    began = time.process_time()
    for _ in range(1000):
        assert joints.standing()
    assert (time.process_time() - began) / 1000 < 5e-4  # s; 1 % of a core is 1e-4
