"""Back ends, arrival, the staged stop: against drivers that accept, refuse, fail, are silent, or lie."""

from __future__ import annotations

import sys
import threading
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("calibration_interfaces")

from action_msgs.srv import CancelGoal
from calibration_interfaces.action import MoveTo
from calibration_interfaces.msg import Outcome
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from calibration.asks import Call, parse_call, succeeded, wait_until
from calibration.motion.arrival import ArrivalRules, Joints
from calibration.motion.backends import (
    ACCEPT_TIME,
    End,
    ExternalMotion,
    TopicMotion,
    decoded,
    hold,
    make_backend,
    to_duration,
    to_goal,
    to_joint_trajectory,
    verdict,
)
from calibration.motion.stop import DESPERATE, CancelGoals, Stopper
from calibration.process_tree import BACKENDS
from calibration.rclpy_gaps import in_executor
from calibration_core.errors import InputError
from calibration_core.motion.trajectory import Trajectory
from calibration_core.timeseries import NANOSECONDS

JOINTS = ("joint_1", "joint_2", "joint_3")
TRAJECTORY = Trajectory(
    JOINTS,
    np.array([0.0, 0.6, 1.5]),
    np.array([[0.0, 0.1, 0.2], [0.1, 0.1, 0.1], [0.3, 0.1, -0.1]]),
    np.array([[0.0, 0.0, 0.0], [0.2, 0.0, -0.2], [0.0, 0.0, 0.0]]),
    0.2,
)


# --- messages --------------------------------------------------------------------------------------------------------


def test_the_goal_that_every_driver_accepts() -> None:
    message = to_joint_trajectory(TRAJECTORY)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (0, 0)
    assert tuple(message.joint_names) == JOINTS
    times = [p.time_from_start.sec + p.time_from_start.nanosec * 1e-9 for p in message.points]
    assert times == pytest.approx([0.0, 0.6, 1.5])
    for point, q, rate in zip(message.points, TRAJECTORY.position, TRAJECTORY.velocity, strict=True):
        assert point.positions.tolist() == q.tolist()
        assert point.velocities.tolist() == rate.tolist()
    assert list(message.points[-1].velocities) == [0.0] * 3


def test_hold_is_one_point_where_the_robot_comes_to_rest() -> None:
    message = hold(JOINTS, np.array([0.1, 0.2, 0.3]), np.zeros(3), 0.01)
    assert len(message.points) == 1
    assert list(message.points[0].positions) == [0.1, 0.2, 0.3]
    assert list(message.points[0].velocities) == [0.0] * 3
    assert to_duration(1.25).nanosec == 250_000_000


@pytest.mark.parametrize(
    ("code", "found"),
    [(0, ""), (-1, "invalid goal"), (-5, "goal tolerance"), (-100101, "invalid goal, driver's code 101"), (-9, "-9")],
)
def test_error_codes_of_drivers(code: int, found: str) -> None:
    assert found in decoded(code)
    assert (decoded(code) == "") == (code == 0)


def test_success_needs_both_status_and_code() -> None:
    def answer(status: int, code: int) -> Any:
        return SimpleNamespace(status=status, result=SimpleNamespace(error_code=code, error_string="because"))

    assert verdict(answer(4, 0))[0]
    assert not verdict(answer(6, 0))[0]
    success, text = verdict(answer(4, -4))
    assert not success
    assert "path tolerance" in text
    assert "because" in text


def test_follow_joint_trajectory_goal() -> None:
    action = SimpleNamespace(Goal=lambda trajectory: SimpleNamespace(trajectory=trajectory))
    goal = to_goal(action, SimpleNamespace, TRAJECTORY, 0.002)
    assert [t.name for t in goal.goal_tolerance] == list(JOINTS)
    assert {t.position for t in goal.goal_tolerance} == {0.002}
    assert goal.goal_time_tolerance.sec == 10


# --- standing and arriving -------------------------------------------------------------------------------------------


def standing(values: list[float], rate: float = 50.0) -> Joints:
    joints = Joints(ArrivalRules(tolerance=1e-3, speed=1e-3, dwell=0.3))
    for i, value in enumerate(values):
        joints.add(round(i / rate * NANOSECONDS), np.array([0.0, value]))
    return joints


# --- the staged stop -------------------------------------------------------------------------------------------------


def test_the_next_stage_is_taken_until_the_robot_stands(spinning: Any, until: Any) -> None:
    node = spinning.plain()
    held: list[JointTrajectory] = []
    spinning.plain("controller").create_subscription(JointTrajectory, "hold", held.append, 10)
    stopped, told, calls = list[bool](), list[Any](), list[Any]()
    node.diagnostics = SimpleNamespace(report=lambda *words: told.append(words))
    maker = SimpleNamespace(ask=lambda request, _ended: calls.append(request))
    course = (np.array([0.1, 0.2, 0.3]), np.array([0.4, 0.0, -0.2]), 0.0)
    backend: Any = SimpleNamespace(stop=lambda: stopped.append(True))
    stop = Stopper(node, backend, JOINTS, lambda: course, hold_topic="hold", calls=[(maker, "stop")])
    until(lambda: node.count_subscribers("hold"))
    runs_on, stands = (lambda: False), (lambda: True)
    assert not stop.under_way
    stop.advance(0.0, lambda: pytest.fail("nobody has to know whether the robot stands"))
    stop.begin(10.0)
    stop.advance(10.4, runs_on)
    assert (len(stopped), calls) == (1, [])
    stop.advance(10.5, runs_on)
    until(lambda: held)
    assert list(held[0].points[0].positions) == pytest.approx([0.14, 0.2, 0.28])  # in 0.2 s, at 2 rad/s^2
    stop.begin(10.6)  # asked again: stopped again, and no step back
    assert len(stopped) == 2
    stop.advance(11.0, runs_on)
    assert (calls, told) == (["stop"], [])
    stop.advance(11.5, runs_on)
    stop.advance(20.0, runs_on)
    assert told == [("operator", 2, DESPERATE)]
    assert stop.under_way
    stop.advance(20.1, stands)
    assert not stop.under_way


# --- services --------------------------------------------------------------------------------------------------------


def test_service_calls_are_read_and_made() -> None:
    call = parse_call("/switch = std_srvs/srv/SetBool{data: true}".replace(" = ", "="))
    assert call == Call("/switch", "std_srvs/srv/SetBool", {"data": True})
    assert call.request() == SetBool.Request(data=True)
    assert parse_call("/go=std_srvs/srv/Trigger").request() == Trigger.Request()


@pytest.mark.parametrize(
    "text", ["", "/go", "/go=std_srvs/msg/X", "=std_srvs/srv/Trigger", "/go=a/srv/B{x: [}", "/go=a/srv/B{1}{"]
)
def test_service_calls_that_cannot_be_read(text: str) -> None:
    with pytest.raises(InputError, match="name=package/srv/Type"):
        parse_call(text)


def test_service_calls_with_wrong_fields() -> None:
    with pytest.raises(InputError, match="fields of"):
        parse_call("/go=std_srvs/srv/Trigger{speed: 1}").request()
    with pytest.raises(InputError, match="fields of"):
        parse_call("/go=std_srvs/srv/SetBool{data: fast}").request()


@pytest.mark.parametrize(
    ("answer", "good"),
    [
        (SimpleNamespace(success=True, message="on"), True),
        (SimpleNamespace(success=False, message="off"), False),
        (SimpleNamespace(result_code=SimpleNamespace(value=1), message="ready"), True),
        (SimpleNamespace(result_code=SimpleNamespace(value=105), message="not remote"), False),
        (SimpleNamespace(), True),
    ],
)
def test_answers_of_drivers(answer: Any, good: bool) -> None:
    assert succeeded(answer)[0] is good


# --- back ends -------------------------------------------------------------------------------------------------------


def present(backend: Any) -> bool:
    """Wait for the driver."""
    return wait_until(lambda: not backend.missing(), 10.0)


class Driver:
    """A driver that does with a goal what the test wants."""

    def __init__(self, node: Any, *, accept: bool = True, success: bool = True, delay: float = 0.0) -> None:
        self.goals: list[Any] = []
        self.cancelled = threading.Event()
        self.finish = threading.Event()
        self.accept, self.success, self.delay = accept, success, delay
        self.server = ActionServer(
            node, MoveTo, "driver/move_to", self._run, callback_group=ReentrantCallbackGroup(),
            goal_callback=self._judge, cancel_callback=self._cancel,
        )  # fmt: skip

    def _judge(self, goal: Any) -> GoalResponse:
        self.goals.append(goal)
        time.sleep(self.delay)
        return GoalResponse.ACCEPT if self.accept else GoalResponse.REJECT

    def _cancel(self, _goal: Any) -> CancelResponse:
        self.cancelled.set()
        return CancelResponse.ACCEPT

    async def _run(self, goal: Any) -> Any:
        while not self.finish.is_set() and not goal.is_cancel_requested:
            await Soon()
        code = Outcome.OK if self.success else Outcome.BLOCKED
        if goal.is_cancel_requested:
            goal.canceled()
            code = Outcome.CANCELLED
        elif self.success:
            goal.succeed()
        else:
            goal.abort()
        return MoveTo.Result(outcome=Outcome(code=code, text="so it ended"))


class Soon:
    def __await__(self) -> Any:
        yield


def simulated(node: Any, interface: str = "") -> Any:
    return make_backend("simulated", node, JOINTS, **options(interface=interface))


class Ends:
    """What a back end said."""

    def __init__(self) -> None:
        self.said: list[tuple[End, str]] = []

    def __call__(self, how: End, text: str) -> None:
        self.said.append((how, text))


@pytest.fixture
def awake(spinning: Any) -> Any:
    """An executor that looks at its tasks often, as the drivers here wait by looking."""
    node = spinning.plain("driver")
    node.create_timer(0.01, lambda: None)
    return node


def test_a_motion_that_succeeds(spinning: Any, awake: Any, until: Any) -> None:
    driver, ends = Driver(awake), Ends()
    backend = simulated(spinning.plain())
    assert present(backend)
    assert backend.commands
    assert backend.answers
    backend.move(TRAJECTORY, ends)
    until(lambda: driver.goals)
    driver.finish.set()
    until(lambda: ends.said)
    assert ends.said == [(End.SUCCESS, "so it ended")]
    assert len(driver.goals[0].trajectory.points) == 3
    backend.stop()  # nothing is under way
    assert not driver.cancelled.wait(0.2)


def test_a_motion_that_fails(spinning: Any, awake: Any, until: Any) -> None:
    driver, ends = Driver(awake, success=False), Ends()
    driver.finish.set()
    backend = simulated(spinning.plain())
    assert present(backend)
    backend.move(TRAJECTORY, ends)
    until(lambda: ends.said)
    assert ends.said == [(End.FAILURE, "so it ended")]


def test_a_motion_that_is_stopped(spinning: Any, awake: Any, until: Any) -> None:
    driver, ends = Driver(awake), Ends()
    backend = simulated(spinning.plain())
    assert present(backend)
    backend.move(TRAJECTORY, ends)
    until(lambda: driver.goals)
    time.sleep(0.1)
    backend.stop()
    assert driver.cancelled.wait(5.0)
    until(lambda: ends.said)
    assert ends.said[0][0] is End.FAILURE


def test_a_motion_that_somebody_else_cancels(spinning: Any, awake: Any, until: Any) -> None:
    driver, ends = Driver(awake), Ends()
    node = spinning.plain()
    backend = simulated(node)
    assert present(backend)
    backend.move(TRAJECTORY, ends)
    until(lambda: driver.goals)
    canceller = node.create_client(CancelGoal, "driver/move_to/_action/cancel_goal")
    assert canceller.wait_for_service(10.0)
    time.sleep(0.1)
    canceller.call(CancelGoal.Request(), timeout_sec=5.0)
    until(lambda: ends.said)
    assert ends.said[0][0] is End.CANCELLED


def test_a_motion_that_is_stopped_before_it_is_sent_never_is(spinning: Any, awake: Any, until: Any) -> None:
    driver, ends = Driver(awake), Ends()
    node = spinning.plain()
    backend = simulated(node)
    assert present(backend)

    def at_once() -> None:
        backend.move(TRAJECTORY, ends)
        backend.stop()

    in_executor(node, at_once)  # in the thread that would send it
    until(lambda: ends.said)
    assert ends.said == [(End.FAILURE, "stopped before it was sent")]
    time.sleep(0.3)
    assert not driver.goals


def test_a_motion_that_is_stopped_before_it_is_accepted(spinning: Any, awake: Any, until: Any) -> None:
    driver, ends = Driver(awake, delay=0.3), Ends()
    backend = simulated(spinning.plain())
    assert present(backend)
    backend.move(TRAJECTORY, ends)
    until(lambda: driver.goals)  # which it is about to accept
    backend.stop()
    assert driver.cancelled.wait(5.0)
    until(lambda: ends.said)


def test_a_driver_that_rejects(spinning: Any, awake: Any, until: Any) -> None:
    Driver(awake, accept=False)
    ends = Ends()
    backend = simulated(spinning.plain())
    assert present(backend)
    backend.move(TRAJECTORY, ends)
    until(lambda: ends.said)
    assert "rejects" in ends.said[0][1]


def test_a_driver_that_does_not_answer(spinning: Any) -> None:
    ends = Ends()
    backend = simulated(spinning.plain(), "nobody/move_to")
    assert "no action server nobody/move_to" in backend.missing()
    backend.move(TRAJECTORY, ends)
    backend.tick(time.monotonic())
    assert ends.said == []
    backend.tick(time.monotonic() + ACCEPT_TIME + 0.1)
    backend.tick(time.monotonic() + ACCEPT_TIME + 0.2)
    assert ends.said == [(End.FAILURE, "nobody/move_to does not answer")]


def test_motion_by_topic(spinning: Any, until: Any) -> None:
    node = spinning.plain()
    course = [(np.array([0.1, 0.2, 0.3]), np.array([0.8, 0.0, -0.4]), 0.01)]
    backend = TopicMotion(node, JOINTS, lambda: course[0], "controller/joint_trajectory")
    assert "nobody listens" in backend.missing()
    heard: list[JointTrajectory] = []
    spinning.plain("controller").create_subscription(JointTrajectory, "controller/joint_trajectory", heard.append, 10)
    assert present(backend)
    assert not backend.answers
    backend.stop()  # nothing was ever commanded
    backend.move(TRAJECTORY, Ends())
    backend.stop()
    course[0] = (np.array([0.3, 0.2, 0.2]), np.zeros(3), 0.01)
    backend.stop()  # whoever says it again has a reason: the first may have been lost
    until(lambda: len(heard) == 3)
    assert [len(message.points) for message in heard] == [3, 1, 1]
    assert list(heard[1].points[0].positions) == pytest.approx([0.1 + 0.8 * 0.21, 0.2, 0.3 - 0.4 * 0.21])
    assert list(heard[2].points[0].positions) == [0.3, 0.2, 0.2]


def test_a_stop_without_a_driver_leaves_nothing_behind(spinning: Any) -> None:
    stop = CancelGoals(spinning.plain(), "nobody/move", lambda *_: None)
    for now in range(50):
        stop.command(float(now))
    assert len(stop._server._client._pending_requests) == 1
    assert stop.unanswered(50.0)


def test_motion_by_the_operator() -> None:
    asked: list[str] = []
    backend = ExternalMotion(asked.append)
    assert present(backend)
    assert not backend.commands
    backend.move(TRAJECTORY, Ends())
    assert asked == ["move the robot to 17.189, 5.730, -5.730 degrees; only the hand on the pendant stops it"]
    backend.stop()
    assert asked[-1] == "stop the robot: only your hand on the pendant can"


def options(**changes: Any) -> dict[str, Any]:
    return {"interface": "", "tolerance": 2e-3, "course": lambda: None, "ask": lambda _: None} | changes


def test_back_ends_by_name(spinning: Any) -> None:
    node = spinning.plain()
    for name in set(BACKENDS) - {"follow_joint_trajectory"}:
        assert make_backend(name, node, JOINTS, **options()).commands == (name != "external")
    with pytest.raises(InputError, match="simulated"):
        make_backend("telepathy", node, JOINTS, **options())


def test_a_back_end_without_its_messages_says_what_to_install(spinning: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "control_msgs", None)
    with pytest.raises(InputError, match="apt install ros-jazzy-control-msgs"):
        make_backend("follow_joint_trajectory", spinning.plain(), JOINTS, **options())
