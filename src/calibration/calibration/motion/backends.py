"""The ways to move a robot: each takes one trajectory at a time, tells how it ended, and stops.

    follow_joint_trajectory   the action of `control_msgs`, which ros2_control drivers and MotoROS2 offer
    simulated                 the simulated cell's own action, `MoveTo`, which any driver may offer
    joint_trajectory_topic    a controller's topic: nothing is answered, joint states tell of the arrival
    external                  a hand on the pendant: we ask, and see from joint states that the robot came

Trajectories have the form that every driver accepts: stamp zero (begin at once), all joints in the configured order,
the first point where the robot stands, at time zero and at rest, strictly increasing times, positions and velocities
at every point, the last at rest.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from calibration_interfaces.action import MoveTo
from calibration_interfaces.msg import Outcome
from rclpy.node import Node
from rclpy.qos import QoSProfile
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from calibration.asks import Ask, Server
from calibration.node import Declared
from calibration.process_tree import BACKENDS
from calibration.topics import load_type
from calibration_core.errors import InputError, quoted
from calibration_core.motion.trajectory import Trajectory, halt
from calibration_core.timeseries import NANOSECONDS, Float1D

USUAL = {
    "follow_joint_trajectory": "joint_trajectory_controller/follow_joint_trajectory",
    "joint_trajectory_topic": "joint_trajectory_controller/joint_trajectory",
    "simulated": "driver/move_to",
}
"""Action or topic of each back end, where none is given."""
MOTION_INTERFACE = (
    Declared("motion.backend", BACKENDS[0], "How the robot is moved, and stopped.", choices=BACKENDS),
    Declared("motion.interface", "", "Name of the action or topic; empty: the back end's usual one."),
)
"""Parameters that whoever moves the robot and whoever stops it have in common."""
ACTION = "control_msgs/action/FollowJointTrajectory"
ACCEPT_TIME = 2.0  # s, a driver takes to accept or reject a goal
GOAL_TIME = 10.0  # s, that a driver may take beyond a trajectory's end
ERRORS = {
    -1: "invalid goal",
    -2: "invalid joints",
    -3: "old header timestamp",
    -4: "path tolerance violated",
    -5: "goal tolerance violated",
}


class End(enum.Enum):
    """How a trajectory ended, by the driver's word."""

    SUCCESS = "success"  # which is not arrival: whoever moves checks the joint states
    FAILURE = "failure"
    CANCELLED = "cancelled by somebody else"


Done = Callable[[End, str], None]
"""Called once when a trajectory has ended: how, and the driver's words."""
Course = Callable[[], tuple[Float1D, Float1D, float] | None]
"""Returns joint angles (n,) rad, rates (n,) rad/s, and their age, s, as measured; None if nothing is known."""


class Backend(Protocol):
    """A way to move the robot.  Methods return at once; `done` may be called from another thread."""

    def missing(self) -> str:
        """Return what is missing of the driver now; empty if nothing is."""

    def move(self, trajectory: Trajectory, done: Done) -> None:
        """Follow a trajectory; the one before, if any, is over."""

    def stop(self) -> None:
        """Stop what is being followed, at once; nothing if nothing is.  May be called again and from any thread."""

    def tick(self, now: float) -> None:
        """Look for answers that do not come; `now` is s of the steady clock."""

    @property
    def answers(self) -> bool:
        """Whether `done` is ever called."""

    @property
    def goal(self) -> bytes | None:
        """Identifier of the goal under way, 16 bytes, zeros where there are no goals; None: none was accepted yet."""

    @property
    def commands(self) -> bool:
        """Whether the robot moves by our command, so that arrival may be awaited for a limited time only."""


def to_duration(seconds: float) -> Duration:
    """Return s as a message."""
    whole = round(seconds * NANOSECONDS)
    return Duration(sec=whole // NANOSECONDS, nanosec=whole % NANOSECONDS)


def to_joint_trajectory(trajectory: Trajectory) -> JointTrajectory:
    """Return a trajectory as a message."""
    rows = zip(trajectory.time.tolist(), trajectory.position.tolist(), trajectory.velocity.tolist(), strict=True)
    return JointTrajectory(
        joint_names=list(trajectory.joints),
        points=[
            JointTrajectoryPoint(positions=position, velocities=velocity, time_from_start=to_duration(time))
            for time, position, velocity in rows
        ],
    )


def hold(joints: tuple[str, ...], q: Float1D, rate: Float1D, age: float) -> JointTrajectory:
    """Return the trajectory that stops a controller: one point, where the robot comes to rest; arguments of `halt`."""
    where, seconds = halt(q, rate, age)
    point = JointTrajectoryPoint(
        positions=where.tolist(), velocities=[0.0] * len(q), time_from_start=to_duration(seconds)
    )
    return JointTrajectory(joint_names=list(joints), points=[point])


# --- by an action -----------------------------------------------------------------------------------------------------


class ActionMotion:
    """A back end for any action that takes a trajectory."""

    answers = commands = True

    def __init__(
        self,
        node: Node,
        action: Any,
        name: str,
        to_goal: Callable[[Trajectory], Any],
        verdict: Callable[[Any], tuple[bool, str]],
    ) -> None:
        """Listen for the action.

        Args:
            node: Whose executor carries the answers.
            action: The action's class.
            name: Its name.
            to_goal: Makes a goal of a trajectory.
            verdict: Tells from the answer (`.status`, `.result`) whether the driver calls it a success, and its words.
        """
        self._driver, self._to_goal, self._verdict = Server(node, action, name), to_goal, verdict
        self.missing, self.tick = self._driver.missing, self._driver.tick
        self._ask: Ask | None = None

    @property
    def goal(self) -> bytes | None:
        """Identifier of the goal under way; None: it is not accepted yet, or over."""
        return None if self._ask is None else self._ask.goal

    def move(self, trajectory: Trajectory, done: Done) -> None:
        """Send a goal."""

        def ended(answer: Any, text: str) -> None:
            if answer is None:
                done(End.FAILURE, text)
                return
            success, words = self._verdict(answer)
            if answer.status == GoalStatus.STATUS_CANCELED and not one.cancelled:
                done(End.CANCELLED, words or End.CANCELLED.value)
            else:
                done(End.SUCCESS if success else End.FAILURE, words)

        one = self._ask = self._driver.ask(self._to_goal(trajectory), ended, accept=ACCEPT_TIME)

    def stop(self) -> None:
        """Cancel the goal; one that is not accepted yet, as soon as it is; one that is not sent yet never is."""
        if self._ask is not None:
            self._ask.cancel()


def decoded(code: int) -> str:
    """Say an error code.  MotoROS2 packs its own code in front of the standard one: -ECCCCC."""
    if code in ERRORS or code == 0:
        return ERRORS.get(code, "")
    standard = -(abs(code) // 100_000)
    if standard in ERRORS:
        return f"{ERRORS[standard]}, driver's code {abs(code) % 100_000}"
    return f"error code {code}"


def verdict(answer: Any) -> tuple[bool, str]:
    """Read a driver's error code; whatever is not zero is a failure, whoever made it."""
    code, text = int(answer.result.error_code), str(answer.result.error_string)
    success = code == 0 and answer.status == GoalStatus.STATUS_SUCCEEDED
    return success, "; ".join(filter(None, [decoded(code), text]))


def to_goal(action: Any, tolerance_type: Any, trajectory: Trajectory, tolerance: float) -> Any:
    """Return the goal that every driver accepts: every joint has to end within a tolerance, rad."""
    goal = action.Goal(trajectory=to_joint_trajectory(trajectory))
    goal.goal_tolerance = [tolerance_type(name=joint, position=tolerance) for joint in trajectory.joints]
    goal.goal_time_tolerance = to_duration(GOAL_TIME)
    return goal


def simulated_verdict(answer: Any) -> tuple[bool, str]:
    """Read the outcome."""
    outcome = answer.result.outcome
    return outcome.code == Outcome.OK, str(outcome.text)


# --- without an answer ------------------------------------------------------------------------------------------------


class TopicMotion:
    """By a topic: an empty trajectory would leave some controllers running on; one point at rest stops all of them."""

    answers, commands = False, True
    goal = bytes(16)  # there are no goals

    def __init__(self, node: Node, joints: tuple[str, ...], course: Course, name: str) -> None:
        """Open the topic.

        Args:
            node: Who publishes.
            joints: Names, in the order of q.
            course: Tells where the robot is, and how it moves.
            name: Of the topic.
        """
        self._name, self._joints, self._course = name, joints, course
        self._publisher = node.create_publisher(JointTrajectory, name, QoSProfile(depth=10))
        self._commanded = False

    def missing(self) -> str:
        """Look for somebody who listens."""
        return "" if self._publisher.get_subscription_count() else f"nobody listens to {self._name}"

    def move(self, trajectory: Trajectory, done: Done) -> None:  # noqa: ARG002  # nothing is ever answered
        """Publish it."""
        self._commanded = True
        self._publisher.publish(to_joint_trajectory(trajectory))

    def stop(self) -> None:
        """Bring the robot to rest on its way, as often as that is said: nobody tells when a motion has ended."""
        course = self._course()
        if self._commanded and course is not None:
            self._publisher.publish(hold(self._joints, *course))

    def tick(self, now: float) -> None:
        """Nothing is awaited."""


class ExternalMotion:
    """By somebody else, as where a driver moves the robot in automatic mode alone: nothing can be stopped either."""

    answers = commands = False
    goal = None

    def __init__(self, ask: Callable[[str], None]) -> None:
        """Take a function that shows a text to the operator."""
        self._ask = ask

    def missing(self) -> str:
        """Nothing is needed."""
        return ""

    def move(self, trajectory: Trajectory, done: Done) -> None:  # noqa: ARG002  # the joint states tell
        """Ask the operator."""
        angles = ", ".join(f"{angle:.3f}" for angle in np.degrees(trajectory.position[-1]))
        self._ask(f"move the robot to {angles} degrees; only the hand on the pendant stops it")

    def stop(self) -> None:
        """Ask the operator."""
        self._ask("stop the robot: only your hand on the pendant can")

    def tick(self, now: float) -> None:
        """Nothing is awaited."""


def make_backend(
    backend: str,
    node: Node,
    joints: tuple[str, ...],
    *,
    interface: str,
    tolerance: float,
    course: Course,
    ask: Callable[[str], None],
) -> Backend:
    """Return a back end.

    Args:
        backend: One of `BACKENDS`.
        node: Whose executor carries the answers.
        joints: Names, in the order of q.
        interface: Name of the action or topic; empty: the usual one.
        tolerance: rad, of every joint, within which the robot has arrived.
        course: Tells where the robot is, and how it moves.
        ask: Shows a text to the operator.

    Raises:
        InputError: There is no such back end, or its message package is not installed.
    """
    name = interface or USUAL.get(backend, "")
    match backend:
        case "follow_joint_trajectory":
            action, of_joint = load_type(ACTION), load_type("control_msgs/msg/JointTolerance")
            return ActionMotion(node, action, name, lambda path: to_goal(action, of_joint, path, tolerance), verdict)
        case "joint_trajectory_topic":
            return TopicMotion(node, joints, course, name)
        case "external":
            return ExternalMotion(ask)
        case "simulated":
            return ActionMotion(
                node, MoveTo, name, lambda path: MoveTo.Goal(trajectory=to_joint_trajectory(path)), simulated_verdict
            )
    raise InputError("parameters", "motion.backend", quoted(backend), f"one of {', '.join(BACKENDS)}")
