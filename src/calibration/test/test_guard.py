"""The guard as a node: a pulse that says yes only when everything is known, fresh and slow."""

from __future__ import annotations

import errno
import itertools
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from granted import Granted

pytest.importorskip("rclpy")
pytest.importorskip("calibration_interfaces")

from action_msgs.srv import CancelGoal
from builtin_interfaces.msg import Time
from calibration_interfaces.msg import MotionPulse, Outcome, Permission, RobotState
from calibration_interfaces.srv import ConfirmMode, ResetGuard
from rcl_interfaces.msg import Log
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from calibration.guard.guard import GuardNode
from calibration.guard.latch import SIZE, Latch, latch_file
from calibration.process_tree import STANDSTILL
from calibration.topics import MOTION_PULSE, PERMISSION, ROBOT_STATE
from calibration_core.cell import load_cell
from calibration_core.errors import InputError
from calibration_core.motion.robot_status import Reason

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
        self.rate, self.late = np.zeros(6), 0.0  # rad/s; s, that joint states arrive late
        self._last = time.monotonic()
        self.timer = node.create_timer(0.02, self.send)

    def send(self) -> None:
        now = time.monotonic()
        wall = time.time_ns()
        if self.state is not None:
            self.states.publish(RobotState(**self.state))
        if self.q is not None:
            self.q = self.q + self.rate * (now - self._last)
            sent = wall - round(self.late * 1e9)
            stamp = Time(sec=sent // 10**9, nanosec=sent % 10**9)
            header = Header(stamp=stamp)
            self.joints.publish(JointState(header=header, name=JOINTS[::-1], position=self.q[::-1].tolist()))
        self._last = now


class Cell:
    """A guard, a robot, and what was heard of the guard."""

    def __init__(self, spinning: Any, *, silent: bool = False, **parameters: Any) -> None:
        # The machine that runs the tests may be busy; ages are as generous as the checks below allow.
        usual: dict[str, Any] = {
            "motion.backend": "external",
            "cell": CELL,
            "max_joints_age": 1.0,
            "freeze_time": 0.3,
        }
        if "robot_state.adapter" not in parameters:
            usual["robot_state.max_ages"] = ["state=1.0"]
        overrides = [Parameter(name, value=value) for name, value in (usual | parameters).items()]
        self.heard: list[Permission] = []
        self.states: list[RobotState] = []
        client = spinning.plain("robot")
        client.create_subscription(Permission, PERMISSION.relative, self.heard.append, QoSProfile(depth=100))
        client.create_subscription(RobotState, ROBOT_STATE.relative, self.states.append, QoSProfile(depth=100))
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
    until(lambda: cell.states and cell.states[-1].operating_mode == RobotState.MODE_MANUAL_REDUCED)
    count, began, watch = len(cell.heard), time.monotonic(), Granted()
    until(lambda: len(cell.heard) >= count + 50)
    assert time.monotonic() - began > 0.6
    assert watch.seconds < 1.4


@pytest.mark.parametrize("come", [True, False])
def test_a_guard_that_was_held_up_takes_what_waits_before_it_decides(spinning: Any, until: Any, come: bool) -> None:
    """Joint states that came meanwhile are as old as they are, and not as old as its last look."""
    cell = Cell(spinning, max_joints_age=0.4)
    until(cell.permitted)
    cell.robot.timer.cancel()
    before, over = len(cell.heard), threading.Event()

    def hold() -> None:
        for _ in range(30):
            if come:
                cell.robot.send()
            time.sleep(0.02)  # this is what holds it up, for longer than joint states may be old
        cell.robot.timer.reset()
        over.set()

    cell.guard.executor.create_task(hold)
    until(over.is_set)
    until(lambda: len(cell.heard) >= before + 10)
    assert any(Permission.JOINTS_STALE in one.reasons for one in cell.heard[before:]) is not come


FAULTS: list[tuple[int, dict[str, Any]]] = [  # what is heard of the robot, as it differs from a good one that stands
    (Permission.DRIVES_OFF, {"state": GOOD | {"drives": RobotState.DRIVES_OFF}}),
    (Permission.SAFETY_UNKNOWN, {"state": GOOD | {"safety": 77}}),
    (Permission.STATE_STALE, {"state": None}),
    (Permission.JOINTS_STALE, {"q": None}),
    (Permission.JOINTS_STALE, {"late": 2.0}),
    (Permission.JOINTS_NOT_FINITE, {"q": np.full(6, math.nan)}),
    (Permission.JOINTS_FROZEN, {"state": GOOD | {"in_motion": RobotState.TRUE}}),
    (Permission.OVER_SPEED, {"rate": np.array([0.3, 0, 0, 0, 0, 0])}),
]


def test_what_is_heard_of_the_robot_is_judged_told_at_once_and_latched(spinning: Any, until: Any) -> None:
    """One fault of each kind; the rule itself has tests of its own, in the core."""
    cell = Cell(spinning)
    logged: list[Log] = []
    cell.robot.node.create_subscription(Log, "/rosout", logged.append, 100)
    for reason, fault in FAULTS:
        until(cell.permitted)
        before = len(cell.heard)
        for name, value in fault.items():
            setattr(cell.robot, name, value)
        until(cell.why(reason), what=f"{reason}: {cell.now.text}")
        assert not cell.now.permitted
        assert cell.now.latched
        refused = cell.reset()
        assert refused.outcome.code == Outcome.NOT_PERMITTED
        assert reason in refused.permission.reasons
        text = next(one.text for one in cell.heard[before:] if reason in one.reasons)
        until(lambda text=text: any(one.level == Log.WARN and text in one.msg for one in logged), what=text)
        stands = cell.robot.q if "rate" in fault else np.zeros(6)
        cell.robot.state, cell.robot.q, cell.robot.rate, cell.robot.late = dict(GOOD), stands, np.zeros(6), 0.0
        until(lambda: list(cell.now.reasons) == [Permission.LATCHED])
        assert cell.reset("  ").outcome.code == Outcome.INPUT_UNUSABLE
        assert not cell.permitted()
        assert cell.reset().outcome.code == Outcome.OK
    fast = next(one for one in cell.heard if Permission.OVER_SPEED in one.reasons)
    assert fast.speed > 0.24
    assert fast.speed_point


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
    assert any(one.operator_name == "A. Smith" and one.operator_confirmed for one in cell.states)


def test_an_operators_word_ends_when_the_key_switch_is_turned_and_turned_back(spinning: Any, until: Any) -> None:
    cell = Cell(spinning)
    manual = GOOD | {"operating_mode": RobotState.MODE_MANUAL_UNSPECIFIED}
    word = {"operator_name": "A. Smith", "operating_mode": RobotState.MODE_MANUAL_REDUCED, "valid_for": 8 * 3600.0}
    until(cell.permitted)
    assert "MANUAL_REDUCED" in cell.confirm(**word).outcome.text  # the controller tells the mode itself: refused
    cell.robot.state = manual
    until(cell.why(Permission.MODE_NOT_ALLOWED))
    given = cell.confirm(**word)
    assert given.outcome.text == "A. Smith confirms MANUAL_REDUCED for 3600 s"
    assert given.confirmed_until.sec <= time.time() + 3600.0
    assert cell.reset().outcome.code == Outcome.OK
    until(cell.permitted)
    cell.robot.state = GOOD | {"operating_mode": RobotState.MODE_AUTOMATIC}
    until(lambda: cell.states[-1].operating_mode == RobotState.MODE_AUTOMATIC)
    cell.robot.state = manual
    until(cell.why(Permission.CONFIRMATION_EXPIRED))
    assert cell.reset().outcome.code == Outcome.NOT_PERMITTED
    assert cell.confirm(**word).outcome.code == Outcome.OK
    assert cell.reset().outcome.code == Outcome.OK
    until(cell.permitted)


GUARD = ROOT / "install" / "calibration" / "lib" / "calibration" / "guard"


def test_what_is_latched_outlives_the_process(
    spinning: Any, until: Any, source_environment: dict[str, str], home: Path
) -> None:
    """The guard is killed while it is latched, told to end, and reset by name; the next one each time knows."""
    heard: list[Permission] = []
    client = spinning.plain("robot")
    client.create_subscription(Permission, PERMISSION.relative, heard.append, QoSProfile(depth=100))
    reset = client.create_client(ResetGuard, "guard/reset")
    robot = Robot(client)
    words = [str(GUARD), "--ros-args"]
    for one in (
        f"cell:={CELL}",
        "motion.backend:=external",
        "max_joints_age:=1.0",
        "robot_state.max_ages:=[state=1.0]",
    ):
        words += ["-p", one]

    def start() -> subprocess.Popen[bytes]:
        heard.clear()
        return subprocess.Popen(words, env={**source_environment, "ROS_HOME": str(home)})

    def end(guard: subprocess.Popen[bytes], how: signal.Signals) -> None:
        guard.send_signal(how)
        guard.wait(20.0)

    guard = start()
    try:
        until(lambda: heard and heard[-1].permitted, timeout=30.0)
        robot.state = GOOD | {"drives": RobotState.DRIVES_OFF}
        until(lambda: heard[-1].latched)
        end(guard, signal.SIGKILL)
        robot.state = dict(GOOD)
        for how in (signal.SIGINT, signal.SIGKILL):
            guard = start()
            until(lambda: heard and list(heard[-1].reasons) == [Permission.LATCHED], timeout=30.0)
            assert "the drives are off" in heard[-1].text
            assert not any(one.permitted for one in heard)
            end(guard, how)
        guard = start()
        until(lambda: heard and list(heard[-1].reasons) == [Permission.LATCHED], timeout=30.0)
        answer = reset.call(ResetGuard.Request(operator_name="A. Smith"), timeout_sec=10.0)
        assert answer.outcome.code == Outcome.OK
        until(lambda: heard[-1].permitted)
        end(guard, signal.SIGINT)  # that it is told to end is no fault
        guard = start()
        until(lambda: heard and heard[-1].permitted, timeout=30.0)
        assert not any(one.latched for one in heard)
    finally:
        guard.kill()
        guard.wait()


def test_a_latch_that_cannot_be_read_or_kept(
    spinning: Any, until: Any, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file that holds something else, or none: no guard.  One that cannot be written: the guard stays latched."""

    def full(_: Any) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    cell = load_cell(CELL)
    file = latch_file(cell, "/")
    assert file.parent.parent == home
    assert len({latch_file(cell, "/"), latch_file(cell, "/left")}) == 2
    file.parent.write_text("no folder", "utf-8")
    given = [Parameter("cell", value=CELL)]
    with pytest.raises(InputError, match=r"latch-.*: found .*, expected a file that can be written"):
        GuardNode(context=spinning.context, parameter_overrides=given)
    file.parent.unlink()
    Latch(file).keep(tuple(Reason))
    assert file.stat().st_size == SIZE
    assert Latch(file).reasons == tuple(Reason)
    file.write_text("7 nonsense", "utf-8")
    with pytest.raises(InputError, match=r"latch-.*: found '7 nonsense', expected numbers of reasons"):
        GuardNode(context=spinning.context, parameter_overrides=given)
    file.unlink()
    node = Cell(spinning)
    until(node.permitted)
    monkeypatch.setattr(node.guard._latch, "keep", full)
    node.robot.state = GOOD | {"drives": RobotState.DRIVES_OFF}
    until(lambda: node.now.latched)
    until(lambda: "will not be latched" in node.guard.diagnostics.worst[1])


def declaring(directory: Path, text: str) -> str:
    """A copy of the cell file that says more."""
    file = directory / "cell.yaml"
    robots = (ROOT / "config" / "robots").as_posix()
    file.write_text(Path(CELL).read_text("utf-8").replace("../robots", robots) + text + "\n", "utf-8")
    return str(file)


def test_what_is_read_from_the_cell_file_holds(spinning: Any, until: Any, tmp_path: Path) -> None:
    """The tool, and the limit that makes another mode possible, which no parameter declares."""
    for wrong, given in (
        ("declared_limit: found an unknown parameter", {"cell": CELL, "declared_limit": 0.2}),
        (r"safety\.speed_limit: found 0\.3",
         {"cell": declaring(tmp_path, "safety: {speed_limit: 0.3, source: nobody}")}),
    ):  # fmt: skip
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        with pytest.raises(InputError, match=wrong):
            GuardNode(context=spinning.context, parameter_overrides=overrides)
    file = Path(declaring(tmp_path, "safety: {speed_limit: 0.2, source: safety configuration 8A3F}"))
    file.write_text(file.read_text("utf-8").replace("frames:", "frames:\n  tool: {xyz: [0, 0, 9]}"), "utf-8")
    cell = Cell(spinning, allowed_modes=["AUTOMATIC"], cell=str(file))
    cell.robot.state = GOOD | {"operating_mode": RobotState.MODE_AUTOMATIC}
    until(cell.permitted)
    assert cell.guard.rules.declared_limit == 0.2
    cell.robot.rate = np.array([0, 0, 0, 0, 0.05, 0])
    until(cell.why(Permission.OVER_SPEED))


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
        ({"robot_state.adapter": "generic"}, "robot_state.table"),
        ({"robot_state.adapter": "generic", "robot_state.table": "no.yaml"}, "no.yaml"),
        ({"max_state_age": 1.0}, "max_state_age"),
        ({"speed_limit": 0.3}, "speed_limit"),
        ({"unheard_of": 1}, "unheard_of"),
    ],
)
def test_parameters_that_cannot_be_used(context: Any, parameters: dict[str, Any], found: str) -> None:
    overrides = [Parameter(name, value=value) for name, value in ({"cell": CELL} | parameters).items()]
    with pytest.raises(InputError, match=found):
        GuardNode(context=context, parameter_overrides=overrides)


class Sequencer:
    """Tells fifty times a second that it lives, and whether a motion of its own is under way."""

    def __init__(self, spinning: Any, name: str = "sequencer", identity: int = 1) -> None:
        self.node, self.identity, self.moving = spinning.plain(name), identity, False
        self.pulse = self.node.create_publisher(MotionPulse, MOTION_PULSE.relative, MOTION_PULSE.qos)
        self.counted = itertools.count()
        self.timer = self.node.create_timer(0.02, self.speak)

    def speak(self) -> None:
        self.pulse.publish(MotionPulse(identity=self.identity, count=next(self.counted), moving=self.moving))


@pytest.fixture
def cancelled(spinning: Any) -> list[Any]:
    """What a driver was told to cancel."""
    heard: list[Any] = []

    def cancel(request: Any, response: Any) -> Any:
        heard.append(request)
        return response

    spinning.plain("driver").create_service(CancelGoal, "driver/move_to/_action/cancel_goal", cancel)
    return heard


def moving(spinning: Any, until: Any, **parameters: Any) -> Cell:
    """A cell whose robot may be moved, with a guard that can stop it, and that bears a busy machine."""
    ages = {"max_joints_age": 1.0, "robot_state.max_ages": ["state=2.0"], "max_pause": 5.0}
    cell = Cell(spinning, **{"motion.backend": "simulated"}, **ages, **parameters)
    until(lambda: bool(cell.heard) and list(cell.now.reasons) == [Permission.STOP_UNPROVEN])
    cell.guard.guard.proof.proven = True  # which has tests of its own
    until(cell.permitted)
    return cell


def test_a_motion_that_nobody_watches_is_cancelled(spinning: Any, until: Any, cancelled: list[Any]) -> None:
    sequencer = Sequencer(spinning)
    cell = moving(spinning, until, sequencer_age=1.0)
    until(lambda: cell.now.hears_sequencer)
    sequencer.timer.cancel()
    until(lambda: not cell.now.hears_sequencer)
    time.sleep(0.4)
    assert cancelled == []  # it was not moving
    assert cell.now.permitted  # who moves the robot otherwise is the operator's affair
    sequencer.moving = True
    sequencer.timer.reset()
    time.sleep(1.4)
    assert cancelled == []  # it is there
    sequencer.timer.cancel()
    until(lambda: cancelled)
    assert list(cancelled[0].goal_info.goal_id.uuid) == [0] * 16


def test_a_motion_that_is_not_permitted_is_cancelled(spinning: Any, until: Any, cancelled: list[Any]) -> None:
    sequencer = Sequencer(spinning)
    cell = moving(spinning, until, sequencer_age=1.0)
    sequencer.moving = True
    until(lambda: cell.guard._emergency.moving)
    cell.robot.state = GOOD | {"drives": RobotState.DRIVES_OFF}
    until(lambda: cancelled)


TRUE_ONE = """
import itertools, sys, threading, rclpy
from calibration_interfaces.msg import MotionPulse
from calibration.topics import MOTION_PULSE
rclpy.init()
node = rclpy.create_node("sequencer")
pulse = node.create_publisher(MotionPulse, MOTION_PULSE.relative, MOTION_PULSE.qos)
counted, moving = itertools.count(), threading.Event()
def speak():
    pulse.publish(MotionPulse(identity=5, count=next(counted), moving=moving.is_set()))
node.create_timer(0.02, speak)
threading.Thread(target=lambda: sys.stdin.readline() and moving.set(), daemon=True).start()
rclpy.spin(node)
"""


def test_a_sequencer_that_is_killed_in_motion_is_hidden_by_nobody(
    spinning: Any, until: Any, cancelled: list[Any], source_environment: dict[str, str]
) -> None:
    stranger = Sequencer(spinning, identity=6)  # bears its name, and is silent as long as it lives
    stranger.timer.cancel()
    true_one = subprocess.Popen([sys.executable, "-c", TRUE_ONE], env=source_environment, stdin=subprocess.PIPE)
    try:
        until(lambda: stranger.node.count_publishers(MOTION_PULSE.relative) == 2)
        cell = moving(spinning, until, sequencer_age=1.0)
        until(lambda: cell.now.hears_sequencer)
        assert true_one.stdin is not None
        true_one.stdin.write(b"move\n")
        true_one.stdin.flush()
        until(lambda: cell.guard._emergency.moving)
        assert cell.now.permitted
        true_one.kill()
        began = time.monotonic()
        stranger.moving = True
        stranger.timer.reset()
        until(lambda: cancelled)
        assert time.monotonic() - began < 1.0 + 1.0  # its age, and what a busy machine takes
        assert not cell.permitted()
        assert set(cell.now.reasons) & {Permission.TWO_SOURCES, Permission.SEQUENCER_SILENT}
    finally:
        true_one.kill()
        true_one.wait()
    stranger.moving = False
    until(lambda: cell.now.hears_sequencer)  # the robot stands: whoever speaks now is followed
    until(lambda: list(cell.now.reasons) == [Permission.LATCHED])


def test_a_second_sign_of_life_is_named_and_forbids_motion(spinning: Any, until: Any, cancelled: list[Any]) -> None:
    sequencer = Sequencer(spinning)
    cell = moving(spinning, until, sequencer_age=1.0)
    sequencer.moving = True
    until(lambda: cell.guard._emergency.moving)
    stranger = Sequencer(spinning, "bag_player")
    until(cell.why(Permission.TWO_SOURCES))
    until(lambda: "/calibration/motion_pulse is published by /bag_player, /sequencer" in cell.now.text)
    until(lambda: cancelled)
    assert cell.now.hears_sequencer
    sequencer.moving = False
    stranger.timer.cancel()
    spinning.executor.create_task(lambda: stranger.node.destroy_publisher(stranger.pulse))
    until(lambda: list(cell.now.reasons) == [Permission.LATCHED])
    namesake = Sequencer(spinning, identity=2)  # by its number alone it is another one
    until(cell.why(Permission.TWO_SOURCES))
    assert "/calibration/motion_pulse is published by /sequencer, /sequencer" in cell.now.text
    namesake.timer.cancel()
    until(lambda: list(cell.now.reasons) == [Permission.LATCHED])
    assert cell.reset().outcome.code == Outcome.OK
    sequencer.timer.cancel()  # and is started again
    until(lambda: not cell.now.hears_sequencer)
    namesake.timer.reset()
    until(lambda: cell.now.hears_sequencer)
    assert cell.now.permitted
