"""Who speaks of the robot, and how long a word of it lasts: the guard beside drivers as they are, over DDS."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("calibration_interfaces")

from calibration_interfaces.msg import Permission, RobotState
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from test_guard import CELL, GOOD, JOINTS, Cell

from calibration.guard.guard import GuardNode
from calibration.guard.joint_publishers import MEMORY, JointPublishers
from calibration.topics import PERMISSION

SLOW = """\
sources:
  status: {name: slow/status, type: std_msgs/msg/String, max_age: 2.5}
  key_switch: {name: slow/key_switch, type: std_srvs/srv/Trigger, max_age: 3.0}
state:
  operating_mode:
    - {read: status.data, means: {T1 standing: MANUAL_REDUCED, T1 moving: MANUAL_REDUCED, standing: next}}
    - {read: key_switch.message, means: {T1: MANUAL_REDUCED}}
  drives: ON
  safety: NORMAL
  in_motion: {read: status.data, means: {T1 standing: false, standing: false, T1 moving: true}}
in_motion_latency: 2.0
notes: {MODE_UNKNOWN: turn the key switch}
"""


class Slow(Cell):
    """A cell whose controller says a word a second."""

    def __init__(self, spinning: Any, folder: Path, word: str) -> None:
        (folder / "slow.yaml").write_text(SLOW, "utf-8")
        table = {"robot_state.adapter": "generic", "robot_state.table": str(folder / "slow.yaml")}
        super().__init__(spinning, freeze_time=0.1, **table)
        self.robot.state, self.word = None, word
        talker = self.robot.node.create_publisher(String, "slow/status", 10)
        self.said = 0
        self.talking = self.robot.node.create_timer(1.0, lambda: self._say(talker))

    def _say(self, talker: Any) -> None:
        talker.publish(String(data=self.word))
        self.said += 1


def test_a_slow_driver_that_lags_behind_latches_nothing(spinning: Any, until: Any, tmp_path: Path) -> None:
    cell = Slow(spinning, tmp_path, "T1 moving")
    until(cell.permitted)
    said = cell.said
    until(lambda: cell.said > said)  # a second more of "moving", while all joints stand still
    cell.word = "T1 standing"
    until(lambda: cell.said > said + 3)
    assert [one.text for one in cell.heard if one.latched] == []
    assert cell.now.permitted
    cell.talking.cancel()
    until(cell.why(Permission.STATE_STALE))
    assert "the robot state is out of date (slow/status: 2.5 s, at most 2.5 s)" in cell.now.text


def test_joints_that_repeat_for_longer_than_the_latency_are_frozen(spinning: Any, until: Any, tmp_path: Path) -> None:
    cell = Slow(spinning, tmp_path, "T1 moving")
    until(cell.permitted)
    until(cell.why(Permission.JOINTS_FROZEN))


def test_a_service_that_nobody_offers_is_missed_by_nobody(spinning: Any, until: Any, tmp_path: Path) -> None:
    pytest.importorskip("std_srvs.srv")
    cell = Slow(spinning, tmp_path, "standing")
    until(cell.why(Permission.MODE_UNKNOWN))
    assert "the operating mode is not known (turn the key switch)" in cell.now.text
    assert list(cell.now.reasons) == [Permission.MODE_UNKNOWN]
    cell.confirm(operator_name="A. Smith", operating_mode=RobotState.MODE_MANUAL_REDUCED, valid_for=60.0)
    until(cell.permitted)
    said = cell.said
    until(lambda: cell.said > said + 1)
    assert cell.now.permitted


def test_jogging_by_hand_needs_no_motion_from_outside(spinning: Any, until: Any) -> None:
    cell = Cell(spinning)  # with the back end `external`
    cell.robot.state = GOOD | {"motion_possible": RobotState.FALSE}
    until(cell.permitted)


def test_a_gripper_and_a_linear_unit_on_the_robots_topic_are_passed_over(spinning: Any, until: Any) -> None:
    cell = Cell(spinning)
    until(cell.permitted)
    other = spinning.plain("gripper")
    talker = other.create_publisher(JointState, "joint_states", 10)
    sent: list[str] = []

    def send() -> None:
        for names, values in (["finger"], [0.02]), (["rail"], [1.0]), (JOINTS[:2], []), (["finger"], [float("nan")]):
            talker.publish(JointState(name=names, position=values))
        sent.append("")

    other.create_timer(0.02, send)
    until(lambda: len(sent) > 100)  # two seconds: the graph has been looked at since
    assert [one.text for one in cell.heard if one.latched] == []
    assert cell.now.permitted


PUBLISHER = """
import sys, time, rclpy
from sensor_msgs.msg import JointState
node = rclpy.create_node("old_driver", context=None) if rclpy.init() is None else None
talker = node.create_publisher(JointState, "joint_states", 10)
while True:
    talker.publish(JointState(name=sys.argv[1:], position=[0.0] * len(sys.argv[1:])))
    time.sleep(0.02)
"""


def test_two_publishers_of_one_of_our_joints_are_named(spinning: Any, until: Any) -> None:
    cell = Cell(spinning)
    until(cell.permitted)
    other = subprocess.Popen([sys.executable, "-c", PUBLISHER, "finger", "joint_3"])
    try:
        until(cell.why(Permission.TWO_SOURCES), 30.0)
        assert "joint_3: " in cell.now.text
        assert "/joint_states is published by /old_driver, /robot" in cell.now.text
        assert "joint_4" not in cell.now.text
    finally:
        other.kill()
        other.wait()
    until(lambda: list(cell.now.reasons) == [Permission.LATCHED])  # it is counted no longer than its messages come
    assert cell.reset().permission.permitted


def test_a_driver_that_was_started_again_is_one(spinning: Any, until: Any) -> None:
    cell = Cell(spinning)
    until(cell.permitted)
    node = cell.robot.node
    node.destroy_publisher(cell.robot.joints)
    cell.robot.joints = node.create_publisher(JointState, "joint_states", 10)
    began = time.monotonic()
    until(lambda: time.monotonic() - began > MEMORY)
    assert not any(Permission.TWO_SOURCES in one.reasons for one in cell.heard)


def steady(kind: str, first: int, count: int, start: float, step: int = 1) -> list[tuple[str, int, float]]:
    """Messages of one publisher, 100 a second."""
    return [(kind, first + step * i, start + 0.01 * i) for i in range(count)]


@pytest.mark.parametrize(
    ("heard", "twice"),
    [
        (steady("robot", 1, 500, 0.0), ""),
        (steady("robot", 1, 70, 0.0, step=7), ""),  # many are lost
        (steady("robot", 1, 50, 0.0) + steady("robot", 1, 99, 0.6), ""),  # started again, and counts past where it was
        (
            steady("robot", 1, 50, 0.0) + steady("robot", 1, 49, 0.6) + steady("robot", 52, 99, 1.1),
            "",
        ),  # one is lost then
        (steady("robot", 1, 99, 0.0) + steady("gripper", 1, 99, 0.001), ""),
        (steady("robot", 1, 99, 0.0) + steady("robot", 1, 99, 0.001), "abc"),  # both began at once
        (steady("robot", 1, 99, 0.0) + steady("robot", 1, 99, 0.505), "abc"),
        (steady("robot", 1, 99, 0.0) + steady("robot", 70, 9, 0.605, step=2), "abc"),  # its numbers are met
        ([*steady("robot", 1, 200, 0.0), ("part", 1, 0.905), ("part", 2, 1.905)], "b"),  # once a second
        ([*steady("robot", 1, 200, 0.0), ("part", 1, 0.905)], ""),  # one word alone
        (steady("rail", 1, 99, 0.0) + steady("part", 40, 99, 0.005), ""),  # other joints of ours
        ([(kind, None, time) for kind, _, time in steady("robot", 1, 99, 0.0)], ""),
    ],
)
def test_publishers_are_told_apart_by_their_numbers(heard: list, twice: str) -> None:
    names = {"robot": ["a", "b", "c"], "gripper": ["finger"], "part": ["b"], "rail": ["a", "rail"]}
    publishers, now = JointPublishers(["a", "b", "c"]), 0.0
    for kind, number, now in sorted(heard, key=lambda one: one[2]):
        publishers.hear(names[kind], number, now)
    assert "".join(publishers.twice(now)) == twice
    assert publishers.twice(now + MEMORY + 0.1) == ()


def test_a_publisher_that_was_silent_is_the_same_and_one_that_counts_anew_is_another() -> None:
    """A stream that went on after a pause, however late, may not pass for a driver with another clock."""
    publishers = JointPublishers(["a"])
    heard = [*range(1, 50), *range(60, 80), 1, 2, 3]
    another = [publishers.hear(["a"], number, MEMORY * (number == 60) + 0.01 * i) for i, number in enumerate(heard)]
    assert [number for number, one in zip(heard, another, strict=True) if one] == [1]
    assert heard[another.index(True) - 1] == 79
    assert not publishers.hear(["finger"], 1, 9.0)


def test_two_cells_in_two_namespaces_hear_their_own_robot(spinning: Any, until: Any, tmp_path: Path) -> None:
    (tmp_path / "slow.yaml").write_text(SLOW, "utf-8")
    heard: dict[str, Permission] = {}
    talkers = {}
    for name in ("left", "right"):
        values = {"cell": CELL, "motion.backend": "external", "robot_state.adapter": "generic",
                  "robot_state.table": str(tmp_path / "slow.yaml")}  # fmt: skip
        parameters = [Parameter(key, value=value) for key, value in values.items()]
        spinning.add(GuardNode(context=spinning.context, namespace=name, parameter_overrides=parameters))
        node = spinning.plain(f"robot_{name}")
        node.create_subscription(
            Permission, f"/{name}/{PERMISSION.relative}", lambda m, k=name: heard.update({k: m}), 10
        )
        talkers[name] = node.create_publisher(String, f"/{name}/slow/status", 10)

    def state_of(name: str) -> set[int]:
        return set(heard[name].reasons) & {Permission.STATE_ABSENT, Permission.MODE_UNKNOWN} if name in heard else set()

    until(lambda: state_of("left") == state_of("right") == {Permission.STATE_ABSENT})
    until(lambda: talkers["left"].get_subscription_count() == 1)
    assert talkers["right"].get_subscription_count() == 1
    talkers["left"].publish(String(data="T1 standing"))
    until(lambda: state_of("left") == set())
    assert state_of("right") == {Permission.STATE_ABSENT}
    assert "awaited: slow/status" in heard["right"].text
