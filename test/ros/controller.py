"""A controller with the action of the real `control_msgs`: passes trajectories on to the simulated robot.

It answers as ros2_control's joint trajectory controller does: a goal that is cancelled is CANCELED at once, and the
robot brakes and holds; a new goal takes the place of the old one.
"""

from __future__ import annotations

import sys
import threading
import time
from typing import Any

import numpy as np
import rclpy
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

ACTION = "joint_trajectory_controller/follow_joint_trajectory"
ARRIVED = 1e-3  # rad
PERIOD = 0.01  # s


class Controller(Node):
    """The node."""

    def __init__(self) -> None:
        super().__init__("controller")
        group = ReentrantCallbackGroup()
        self._names: list[str] = []
        self._q = np.empty(0)
        self._newest: Any = None
        self._lock = threading.Lock()
        self._out = self.create_publisher(JointTrajectory, "driver/joint_trajectory", 10)
        self.create_subscription(JointState, "joint_states", self._on_joints, 10, callback_group=group)
        self._server = ActionServer(
            self, FollowJointTrajectory, ACTION, self._follow, callback_group=group, cancel_callback=self._on_cancel
        )

    def _on_joints(self, message: Any) -> None:
        self._names, self._q = list(message.name), np.array(message.position)

    def _on_cancel(self, _goal: Any) -> Any:
        here = JointTrajectoryPoint(positions=self._q.tolist())
        self._out.publish(JointTrajectory(joint_names=self._names, points=[here]))
        return CancelResponse.ACCEPT

    def _follow(self, goal: Any) -> Any:
        with self._lock:
            self._newest = goal
        trajectory = goal.request.trajectory
        self._out.publish(trajectory)
        last = trajectory.points[-1]
        wanted = dict(zip(trajectory.joint_names, last.positions, strict=True))
        seconds = last.time_from_start.sec + 1e-9 * last.time_from_start.nanosec
        began, result = time.monotonic(), FollowJointTrajectory.Result()
        while True:
            if goal.is_cancel_requested:
                goal.canceled()
                return result
            if self._newest is not goal:
                break
            late = time.monotonic() - began - seconds
            off = np.abs([wanted[name] - q for name, q in zip(self._names, self._q, strict=True)]).max()
            if late > 0.0 and off < ARRIVED:
                goal.succeed()
                return result
            if late > 5.0:
                result.error_code = FollowJointTrajectory.Result.GOAL_TOLERANCE_VIOLATED
                break
            time.sleep(PERIOD)
        goal.abort()
        return result


def main() -> None:
    rclpy.init(args=sys.argv)
    executor = MultiThreadedExecutor(num_threads=4)
    executor.add_node(Controller())
    executor.spin()


if __name__ == "__main__":
    main()
