"""The stages of the stop, carried out: cancel, hold, the maker's stop, the operator."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rclpy.qos import QoSProfile
from trajectory_msgs.msg import JointTrajectory

from calibration.motion.base import Backend, Standing
from calibration.motion.messages import hold
from calibration.node import CalibrationNode

STOP_STAGES = 4
DESPERATE = "the robot does not stop: press the emergency stop"


class Stopper:
    """Stops the robot, by one means after the other; every method returns at once."""

    def __init__(
        self,
        node: CalibrationNode,
        backend: Backend,
        joints: tuple[str, ...],
        where: Standing,
        *,
        hold_topic: str,
        calls: Sequence[tuple[Any, Any]],
        trace: str,
    ) -> None:
        """Prepare.

        Args:
            node: Whose publishers and diagnostics are used.
            backend: Its own stop is the first stage.
            joints: Names, in the order of q.
            where: Tells where the robot is.
            hold_topic: Takes a hold trajectory, the second stage; empty: there is none.
            calls: Clients and requests of the maker's stop services, the third stage.
            trace: File for the monotonic clock's ns of every stage taken; empty: none.
        """
        self._node, self._backend, self._joints, self._where, self._calls = node, backend, joints, where, calls
        self._hold = node.create_publisher(JointTrajectory, hold_topic, QoSProfile(depth=1)) if hold_topic else None
        self._trace = Path(trace) if trace else None

    def take(self, stage: int) -> None:
        """Take a stage."""
        where = self._where()
        if stage == 0:
            self._backend.stop()
            self._note("stop")
        elif stage == 1 and self._hold is not None and where is not None:
            self._hold.publish(hold(self._joints, where))
            self._note("hold")
        elif stage == 2:
            for client, request in self._calls:
                client.call_async(request)
                self._note("maker's stop")
        elif stage == 3:
            self._node.diagnostics.report("operator", 2, DESPERATE)
            self._node.get_logger().fatal(DESPERATE)

    def _note(self, what: str) -> None:
        now = time.monotonic_ns()  # before the file is opened, for which a disk may have to be waited
        if self._trace is not None:
            with self._trace.open("a", encoding="utf-8") as file:
                file.write(f"{now},{what}\n")
