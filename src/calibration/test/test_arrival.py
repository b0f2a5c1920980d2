"""Arrival and standstill, judged from joint states."""

from __future__ import annotations

import math

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
