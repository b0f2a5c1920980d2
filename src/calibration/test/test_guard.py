"""The guard as a node: a pulse that says yes only when everything is known, fresh and slow."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("calibration_interfaces")

from action_msgs.srv import CancelGoal
from builtin_interfaces.msg import Time
from calibration_interfaces.msg import GuardEvidence, Outcome, Permission, RobotState
from calibration_interfaces.srv import ConfirmMode, ResetGuard
from rcl_interfaces.msg import Log
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Header
from std_msgs.msg import String as Text

from calibration.guard.guard import GuardNode
from calibration.process_tree import STANDSTILL
from calibration.topics import GUARD_EVIDENCE, MOTION_PULSE, PERMISSION
from calibration_core.errors import InputError

ROOT = Path(__file__).resolve().parents[3]
CELL = str(ROOT / "config" / "cells" / "demo.cell.yaml")
JOINTS = [f"joint_{i}" for i in range(1, 7)]
GOOD = {
    "operating_mode": RobotState.MODE_MANUAL_REDUCED,
    "drives": RobotState.DRIVES_ON,
    "safety": RobotState.SAFETY_NORMAL,
    "motion_possible": RobotState.TRUE,
    "in_motion": RobotState.FALSE,
    "in_error": RobotState.FALSE,
    "speed_scaling": 1.0,
    "speed_limit_mm_s": math.nan,
}


class Robot:
    """Publishes what a driver publishes, 50 times a second, until told otherwise."""

    def __init__(self, node: Any) -> None:
        self.node = node
        self.states = node.create_publisher(RobotState, "driver/robot_state", 10)
        self.joints = node.create_publisher(JointState, "joint_states", 10)
        self.state: dict[str, Any] | None = dict(GOOD)
        self.q: np.ndarray | None = np.zeros(6)
        self.rate = np.zeros(6)
        self._last = time.monotonic()
        self.timer = node.create_timer(0.02, self.send)

    def send(self) -> None:
        now = time.monotonic()
        wall = time.time_ns()
        if self.state is not None:
            self.states.publish(RobotState(**self.state))
        if self.q is not None:
            self.q = self.q + self.rate * (now - self._last)
            stamp = Time(sec=wall // 10**9, nanosec=wall % 10**9)
            header = Header(stamp=stamp)
            self.joints.publish(JointState(header=header, name=JOINTS[::-1], position=self.q[::-1].tolist()))
        self._last = now


class Cell:
    """A guard, a robot, and what was heard of the guard."""

    def __init__(self, spinning: Any, *, silent: bool = False, **parameters: Any) -> None:
        # The machine that runs the tests may be busy; ages are as generous as the checks below allow.
        usual = {
            "motion.backend": "external",
            "cell": CELL,
            "max_joints_age": 0.4,
            "max_state_age": 0.4,
            "freeze_time": 0.3,
        }
        overrides = [Parameter(name, value=value) for name, value in (usual | parameters).items()]
        self.heard: list[Permission] = []
        self.evidence: list[GuardEvidence] = []
        client = spinning.plain("robot")
        client.create_subscription(Permission, PERMISSION.relative, self.heard.append, QoSProfile(depth=100))
        client.create_subscription(GuardEvidence, GUARD_EVIDENCE.relative, self.evidence.append, GUARD_EVIDENCE.qos)
        self.resetter = client.create_client(ResetGuard, "guard/reset")
        self.confirmer = client.create_client(ConfirmMode, "guard/confirm_mode")
        self.robot = Robot(client)
        if silent:
            self.robot.timer.cancel()
        self.guard = spinning.add(GuardNode(context=spinning.context, parameter_overrides=overrides))

    @property
    def now(self) -> Permission:
        return self.heard[-1]

    def permitted(self) -> bool:
        return bool(self.heard) and self.now.permitted

    def why(self, reason: int) -> Callable[[], bool]:
        return lambda: bool(self.heard) and reason in self.now.reasons

    def reset(self, name: str = "A. Smith") -> Any:
        assert self.resetter.wait_for_service(10.0)
        return self.resetter.call(ResetGuard.Request(operator_name=name), timeout_sec=10.0)

    def confirm(self, **fields: Any) -> Any:
        assert self.confirmer.wait_for_service(10.0)
        return self.confirmer.call(ConfirmMode.Request(**fields), timeout_sec=10.0)


def test_yes_when_all_is_well_and_never_before(spinning: Any, until: Any) -> None:
    cell = Cell(spinning, silent=True)
    until(lambda: len(cell.heard) > 5)
    assert not any(one.permitted for one in cell.heard)
    cell.robot.timer.reset()
    until(cell.permitted)
    assert cell.now.text == "motion is permitted"
    assert cell.now.speed_limit == 0.25
    until(lambda: cell.evidence and cell.evidence[-1].permission.permitted)
    evidence = cell.evidence[-1]
    assert evidence.joints == JOINTS
    assert list(evidence.positions) == [0.0] * 6
    assert evidence.allowed_modes == ["MANUAL_REDUCED"]
    assert {"flange", "wrench point", "mp1"} <= set(evidence.points)
    assert evidence.state.operating_mode == RobotState.MODE_MANUAL_REDUCED
    began, seconds = len(cell.heard), 1.0
    time.sleep(seconds)
    assert len(cell.heard) - began == pytest.approx(50 * seconds, rel=0.4)


LOSSES = [
    ({"operating_mode": RobotState.MODE_AUTOMATIC}, Permission.MODE_NOT_ALLOWED),
    ({"operating_mode": RobotState.MODE_UNKNOWN}, Permission.MODE_UNKNOWN),
    ({"drives": RobotState.DRIVES_OFF}, Permission.DRIVES_OFF),
    ({"drives": RobotState.DRIVES_UNKNOWN}, Permission.DRIVES_UNKNOWN),
    ({"safety": RobotState.SAFETY_PROTECTIVE_STOP}, Permission.SAFETY_STOP),
    ({"safety": 77}, Permission.SAFETY_UNKNOWN),
    ({"motion_possible": RobotState.FALSE}, Permission.MOTION_NOT_POSSIBLE),
    ({"in_error": RobotState.TRUE}, Permission.IN_ERROR),
]


@pytest.mark.parametrize(("change", "reason"), LOSSES)
def test_a_loss_is_told_at_once_and_latched(spinning: Any, until: Any, change: dict[str, int], reason: int) -> None:
    cell = Cell(spinning)
    until(cell.permitted)
    cell.robot.state = GOOD | change
    until(cell.why(reason))
    assert not cell.now.permitted
    assert cell.now.latched
    refused = cell.reset()
    assert refused.outcome.code == Outcome.NOT_PERMITTED
    assert reason in refused.permission.reasons
    cell.robot.state = dict(GOOD)
    until(lambda: list(cell.now.reasons) == [Permission.LATCHED])
    assert cell.reset("  ").outcome.code == Outcome.INPUT_UNUSABLE
    assert not cell.permitted()
    assert cell.reset().outcome.code == Outcome.OK
    until(cell.permitted)


def test_a_loss_is_a_warning_in_the_log(spinning: Any, until: Any) -> None:
    cell = Cell(spinning)
    logged: list[Log] = []
    cell.robot.node.create_subscription(Log, "/rosout", logged.append, 100)
    until(cell.permitted)
    cell.robot.state = GOOD | {"drives": RobotState.DRIVES_OFF}
    until(lambda: any(one.level == Log.WARN and "drives are off" in one.msg for one in logged))
    assert not [one for one in logged if one.level == Log.INFO and "drives are off" in one.msg]


def test_silence_of_the_controller(spinning: Any, until: Any) -> None:
    cell = Cell(spinning)
    until(cell.permitted)
    cell.robot.state = None
    until(cell.why(Permission.STATE_STALE))
    assert cell.now.latched


def test_silence_of_the_joints(spinning: Any, until: Any) -> None:
    cell = Cell(spinning)
    until(cell.permitted)
    cell.robot.q = None
    until(cell.why(Permission.JOINTS_STALE))


def test_joints_that_are_no_numbers_or_missing(spinning: Any, until: Any) -> None:
    cell = Cell(spinning)
    until(cell.permitted)
    cell.robot.q = np.full(6, math.nan)
    until(cell.why(Permission.JOINTS_NOT_FINITE))


def test_joints_that_are_frozen_in_motion(spinning: Any, until: Any) -> None:
    cell = Cell(spinning)
    until(cell.permitted)
    cell.robot.state = GOOD | {"in_motion": RobotState.TRUE}
    until(cell.why(Permission.JOINTS_FROZEN))


def test_over_speed(spinning: Any, until: Any) -> None:
    cell = Cell(spinning)
    until(cell.permitted)
    cell.robot.rate = np.array([0.3, 0, 0, 0, 0, 0])
    until(cell.why(Permission.OVER_SPEED))
    fast = next(p for p in cell.heard if Permission.OVER_SPEED in p.reasons)
    assert fast.speed > 0.275
    assert fast.speed_point
    cell.robot.rate = np.zeros(6)
    until(lambda: list(cell.now.reasons) == [Permission.LATCHED])


def test_the_clock_of_the_messages(spinning: Any, until: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = Cell(spinning)
    until(cell.permitted)
    until(lambda: len(cell.heard) > 3)  # the first word may come before the guard has looked at its clock at all
    usual = cell.guard.now_ns
    monkeypatch.setattr(cell.guard, "now_ns", lambda: usual() - 10**10)
    until(lambda: any(Permission.CLOCK_JUMPED in p.reasons for p in cell.heard))
    assert cell.now.latched


def test_an_operators_word_where_the_controller_says_nothing(spinning: Any, until: Any) -> None:
    cell = Cell(spinning, **{"robot_state.adapter": "manual_confirm"})
    cell.robot.state = None
    until(cell.why(Permission.STATE_ABSENT))
    wrong = cell.confirm(operator_name="", operating_mode=RobotState.MODE_MANUAL_REDUCED, valid_for=60.0)
    assert wrong.outcome.code == Outcome.INPUT_UNUSABLE
    right = cell.confirm(operator_name="A. Smith", operating_mode=RobotState.MODE_MANUAL_REDUCED, valid_for=2.0)
    assert right.outcome.code == Outcome.OK
    until(cell.permitted)
    assert right.confirmed_until.sec > 0
    until(cell.why(Permission.CONFIRMATION_EXPIRED))
    assert any(e.state.operator_name == "A. Smith" and e.state.operator_confirmed for e in cell.evidence)


def declaring(directory: Path, text: str) -> str:
    """A copy of the cell file that says more."""
    file = directory / "cell.yaml"
    robots = (ROOT / "config" / "robots").as_posix()
    file.write_text(Path(CELL).read_text("utf-8").replace("../robots", robots) + text + "\n", "utf-8")
    return str(file)


def test_the_tool_of_the_cell_file_is_watched(spinning: Any, until: Any, tmp_path: Path) -> None:
    file = Path(declaring(tmp_path, ""))
    file.write_text(file.read_text("utf-8").replace("frames:", "frames:\n  tool: {xyz: [0, 0, 9]}"), "utf-8")
    cell = Cell(spinning, cell=str(file))
    cell.robot.rate = np.array([0, 0, 0, 0, 0.05, 0])
    until(cell.why(Permission.OVER_SPEED))


def test_a_limit_is_declared_in_the_cell_file_alone(spinning: Any, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="declared_limit: found an unknown parameter"):
        Cell(spinning, declared_limit=0.2)
    with pytest.raises(InputError, match=r"safety\.speed_limit: found 0\.3"):
        Cell(spinning, cell=declaring(tmp_path, "safety: {speed_limit: 0.3, source: nobody}"))


def test_automatic_mode_needs_a_declared_limit(spinning: Any, until: Any) -> None:
    cell = Cell(spinning, allowed_modes=["AUTOMATIC"])
    cell.robot.state = GOOD | {"operating_mode": RobotState.MODE_AUTOMATIC}
    until(cell.why(Permission.SPEED_LIMIT_MISSING))
    cell.robot.state = GOOD | {"operating_mode": RobotState.MODE_AUTOMATIC, "speed_limit_mm_s": 250.0}
    until(cell.permitted)


def test_automatic_mode_with_a_limit_declared_in_the_cell_file(spinning: Any, until: Any, tmp_path: Path) -> None:
    declared = declaring(tmp_path, "safety: {speed_limit: 0.2, source: safety configuration 8A3F}")
    cell = Cell(spinning, allowed_modes=["AUTOMATIC"], cell=declared)
    assert cell.guard.rules.declared_limit == 0.2
    cell.robot.state = GOOD | {"operating_mode": RobotState.MODE_AUTOMATIC}
    until(cell.permitted)


def test_a_generic_adapter_reads_any_topic(spinning: Any, until: Any) -> None:
    place = "robot_state.generic"
    cell = Cell(
        spinning,
        **{
            "robot_state.adapter": "generic",
            f"{place}.topic": "mode_word",
            f"{place}.type": "std_msgs/msg/String",
            f"{place}.operating_mode": "data = T1: MANUAL_REDUCED",
            f"{place}.drives": "data = T1: ON",
            f"{place}.safety": "data = T1: NORMAL, HALT: EMERGENCY_STOP",
        },
    )
    word = Text(data="T1")
    talker = cell.robot.node.create_publisher(Text, "mode_word", 10)
    cell.robot.node.create_timer(0.05, lambda: talker.publish(word))
    until(cell.permitted)
    word.data = "HALT"
    until(cell.why(Permission.SAFETY_STOP))


def test_the_last_word_is_no(spinning: Any, until: Any) -> None:
    cell = Cell(spinning)
    until(cell.permitted)
    cell.guard.stop()
    until(cell.why(Permission.STOPPING))


def ends_after(cell: Cell) -> float:
    began = time.monotonic()
    cell.guard.stop()
    return time.monotonic() - began


def test_a_robot_that_was_hardly_seen_and_is_gone_is_not_awaited(spinning: Any, until: Any) -> None:
    cell = Cell(spinning)
    until(lambda: cell.guard._joints.until > 0)
    cell.robot.timer.cancel()  # its driver has ended: what was heard of it is shorter than any standstill
    assert not cell.guard._joints.standing()
    assert ends_after(cell) < 3.0


def test_a_robot_that_moved_and_is_gone_is_awaited(spinning: Any, until: Any) -> None:
    cell = Cell(spinning)
    until(cell.permitted)
    cell.robot.rate = np.full(6, 0.01)
    until(cell.guard._joints.moving)
    cell.robot.timer.cancel()
    assert ends_after(cell) > STANDSTILL
    until(cell.why(Permission.STOPPING))


@pytest.mark.parametrize(
    ("parameters", "found"),
    [
        ({"cell": ""}, "cell"),
        ({"cell": "no.yaml"}, "no.yaml"),
        ({"allowed_modes": ["FAST"]}, "FAST"),
        ({"robot_state.adapter": "kuka"}, "kuka"),
        ({"robot_state.topics": ["status=x"]}, "status"),
        ({"robot_state.max_ages": ["state=soon"]}, "soon"),
        ({"robot_state.adapter": "abb"}, "abb_robot_msgs"),
        ({"robot_state.adapter": "generic"}, "operating_mode"),
        ({"speed_limit": 0.3}, "speed_limit"),
        ({"unheard_of": 1}, "unheard_of"),
    ],
)
def test_parameters_that_cannot_be_used(context: Any, parameters: dict[str, Any], found: str) -> None:
    overrides = [Parameter(name, value=value) for name, value in ({"cell": CELL} | parameters).items()]
    with pytest.raises(InputError, match=found):
        GuardNode(context=context, parameter_overrides=overrides)


class Sequencer:
    """Tells that a motion of its own is under way, and a driver that can be told to cancel."""

    def __init__(self, spinning: Any) -> None:
        self.node = spinning.plain("sequencer")
        self.pulse = self.node.create_publisher(Bool, MOTION_PULSE.relative, MOTION_PULSE.qos)
        self.cancelled: list[Any] = []
        spinning.plain("driver").create_service(CancelGoal, "driver/move_to/_action/cancel_goal", self._cancel)
        self.timer = self.node.create_timer(0.02, lambda: self.pulse.publish(Bool(data=self.moving)))
        self.moving = False

    def _cancel(self, request: Any, response: Any) -> Any:
        self.cancelled.append(request)
        return response


def test_a_motion_that_nobody_watches_is_cancelled(spinning: Any, until: Any) -> None:
    sequencer = Sequencer(spinning)
    cell = Cell(spinning, **{"motion.backend": "simulated"}, sequencer_age=0.4)
    cell.guard.guard.proof.proven = True  # which has tests of its own
    until(cell.permitted)
    until(lambda: cell.now.hears_sequencer)
    sequencer.timer.cancel()
    until(lambda: not cell.now.hears_sequencer)
    time.sleep(0.4)
    assert sequencer.cancelled == []  # it was not moving
    assert cell.now.permitted  # who moves the robot otherwise is the operator's affair
    sequencer.moving = True
    sequencer.timer.reset()
    time.sleep(0.8)
    assert sequencer.cancelled == []  # it is there
    sequencer.timer.cancel()
    until(lambda: sequencer.cancelled)
    assert list(sequencer.cancelled[0].goal_info.goal_id.uuid) == [0] * 16


def test_a_motion_that_is_not_permitted_is_cancelled(spinning: Any, until: Any) -> None:
    sequencer = Sequencer(spinning)
    cell = Cell(spinning, **{"motion.backend": "simulated"}, sequencer_age=1.0)
    cell.guard.guard.proof.proven = True
    until(cell.permitted)
    sequencer.moving = True
    time.sleep(0.2)
    cell.robot.state = GOOD | {"drives": RobotState.DRIVES_OFF}
    until(lambda: sequencer.cancelled)
