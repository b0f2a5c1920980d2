"""A driver between sequencer and robot that can misbehave: it cancels late, or moves where it should stand."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from calibration_interfaces.action import MoveTo
from calibration_interfaces.msg import Outcome
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

ACTION, TOPIC = "middle/move_to", "middle/joint_trajectory"
STILL = 1e-6  # rad, a goal that moves no joint by more holds the position
CREEP = 0.02  # rad, by which the last joint moves while it should stand
ARRIVED = 2e-3  # rad


class Middleman:
    """Passes trajectories on to the simulated robot.

    Attributes:
        deaf: s, a cancelled goal goes on before it ends.
        creeps: Whether the robot moves a little while its position is to be held.
        goals: How many came.
    """

    def __init__(self, node: Any) -> None:
        """Offer an action and a topic on a node whose executor has several threads, or lets callbacks await."""
        self.node, self.deaf, self.creeps, self.goals = node, 0.0, False, 0
        self._q = np.empty(0)
        group = ReentrantCallbackGroup()
        self._out = node.create_publisher(JointTrajectory, "driver/joint_trajectory", 10)
        node.create_subscription(JointState, "joint_states", self._on_joints, 10, callback_group=group)
        node.create_subscription(JointTrajectory, TOPIC, self._pass, 10, callback_group=group)
        self._server = ActionServer(
            node, MoveTo, ACTION, self._on_goal, callback_group=group, cancel_callback=lambda _: CancelResponse.ACCEPT
        )

    def _on_joints(self, message: Any) -> None:
        self._q = np.array(message.position)

    def _pass(self, trajectory: JointTrajectory) -> None:
        q = np.array([point.positions for point in trajectory.points])
        if self.creeps and len(q) > 1 and np.ptp(q, axis=0).max() < STILL:
            for point, share in zip(trajectory.points, np.linspace(0.0, 1.0, len(q)), strict=True):
                point.positions[-1] += share * CREEP
        self._out.publish(trajectory)

    def _hold(self, names: Any) -> None:
        here = JointTrajectoryPoint(positions=self._q.tolist(), time_from_start=Duration())
        self._out.publish(JointTrajectory(joint_names=names, points=[here]))

    async def _on_goal(self, goal: Any) -> Any:
        self.goals += 1
        trajectory = goal.request.trajectory
        last = trajectory.points[-1]
        wanted, end = np.array(last.positions), last.time_from_start.sec + 1e-9 * last.time_from_start.nanosec
        self._pass(trajectory)
        began, cancelled = time.monotonic(), 0.0
        while True:
            now = time.monotonic()
            if goal.is_cancel_requested and not cancelled:
                cancelled = now
            if cancelled and now - cancelled >= self.deaf:
                self._hold(trajectory.joint_names)
                goal.canceled()
                return MoveTo.Result(outcome=Outcome(code=Outcome.CANCELLED))
            if now - began > end + 0.5 and np.abs(wanted - self._q).max() < ARRIVED:
                goal.succeed()
                return MoveTo.Result(outcome=Outcome(code=Outcome.OK))
            await _Turn()


class _Turn:
    """Awaits the executor's next turn."""

    def __await__(self) -> Any:
        time.sleep(0.002)
        yield
