"""Shows the guard that it can stop the robot: sends the robot where it stands, and has the guard stop that."""

from __future__ import annotations

import math
import threading
import time
from typing import Any

import numpy as np
from calibration_interfaces.msg import Outcome
from calibration_interfaces.srv import ProveStop
from rclpy.node import Node

from calibration.asks import Server
from calibration.motion.backends import Backend, Course, End
from calibration_core.motion.stop_proof import ProofRules
from calibration_core.motion.trajectory import Trajectory
from calibration_core.timeseries import NANOSECONDS, Float1D

SERVICE = "guard/prove_stop"
PATIENCE = 5.0  # s of wall time, from the goal to the guard's verdict
ATTEMPTS = 5  # on a busy machine a goal may end before it is cancelled
REST = 0.5  # s of wall time after a proof that failed: what was sent to stop its goal must not meet the next one
LOOK = 0.2  # s of wall time, over which it is seen how fast the robot's clock goes
FASTEST = 100.0  # times the steady clock; what is faster is a leap


class Prover:
    """One proof after another; called by one thread, answered by another.

    Attributes:
        proven: Whether the guard has seen that it can stop the robot.
        running: Whether a proof is under way.
        fault: Why there is none after the last try; empty: none was tried, or there is one.
    """

    def __init__(self, node: Node, backend: Backend, joints: tuple[str, ...], course: Course) -> None:
        """Take who moves the robot, the joints in the order of q, and what tells where the robot is."""
        self._node, self._backend, self._joints, self._course = node, backend, joints, course
        self._guard = Server(node, ProveStop, SERVICE) if backend.commands else None
        self.proven, self.running, self.fault = not backend.commands, False, ""
        self._tries = 0
        self._begun = self._ended = -math.inf  # s of the steady clock
        self._number = 0  # of the proof under way, or of the last one
        self._over = True  # its goal is
        self._asked = False
        self._lock = threading.Lock()
        self._answer: tuple[bool, str] | None = None
        self._looked: tuple[float, int] | None = None  # steady clock, s, and the robot's, ns
        self._haste: float | None = None

    def reset(self) -> None:
        """Want a new proof, for instance of a new run."""
        self.proven, self.fault, self._tries = not self._backend.commands, "", 0
        self._looked = self._haste = None

    def rested(self, now: float) -> bool:
        """Tell whether a proof may begin at `now`, s of the steady clock: nothing of the one before is under way."""
        self._look_at_clock(now)
        since = now - self._ended
        gone = self._over or not self._backend.answers or since > PATIENCE
        return not self.running and since > REST and gone and self._haste is not None

    def _look_at_clock(self, now: float) -> None:
        """See how much faster than the steady clock the robot's own goes; the guard has its own time.

        The clock of a simulated robot stands still while its computer is busy: its fastest pace counts.
        """
        clock = self._node.now_ns()
        if self._looked is None:
            self._looked = now, clock
        elif now - self._looked[0] >= LOOK:
            pace = (clock - self._looked[1]) / NANOSECONDS / (now - self._looked[0])
            self._looked = now, clock
            self._haste = min(max(self._haste or 1.0, pace), FASTEST)

    def begin(self, now: float) -> None:
        """Send the robot where it stands, at `now`, s of the steady clock."""
        course = self._course()
        if course is None or self._guard is None:
            return
        self.running, self.fault, self._begun, self._asked, self._answer = True, "", now, False, None
        self._number, self._over = self._number + 1, False
        number = self._number
        trajectory = held(self._joints, course[0], ProofRules().hold * (self._haste or 1.0))
        self._backend.move(trajectory, lambda how, text: self._on_end(number, how, text))

    def tick(self, now: float) -> None:
        """Go on with a proof under way."""
        if not self.running:
            return
        self._look_at_clock(now)
        goal = self._backend.goal
        if goal is not None and not self._asked and self._guard is not None:
            self._asked = True
            self._guard.drop()
            self._guard.ask(ProveStop.Request(goal=np.frombuffer(goal, dtype=np.uint8)), self._on_answer)
        with self._lock:
            answer = self._answer
        if answer is None and now - self._begun > PATIENCE:
            answer = (False, "the guard does not answer")
        if answer is not None:
            self._end(*answer)

    def _on_answer(self, answer: Any, text: str) -> None:
        success = answer is not None and answer.outcome.code == Outcome.OK
        with self._lock:
            self._answer = (success, text if answer is None else str(answer.outcome.text))

    def _on_end(self, number: int, how: End, text: str) -> None:
        """The goal of a proof is over: rejected at once, or cancelled by the guard, as it should be."""
        if number != self._number:
            return  # of an earlier one
        self._over = True
        if how is End.FAILURE and not self._asked:
            with self._lock:
                self._answer = (False, text or "the driver does not take the goal")

    def _end(self, success: bool, text: str) -> None:
        self.running, self.proven = False, success
        self._tries += 1
        if not success:
            self._ended = time.monotonic()
            self._backend.stop()
            if self._tries >= ATTEMPTS:
                self.fault, self._tries = text or "no reason is given", 0


def held(joints: tuple[str, ...], q: Float1D, seconds: float) -> Trajectory:
    """Return the trajectory that keeps a robot where it stands, q (n,) rad, for a while."""
    middle = 0.5 * seconds
    position = np.tile(q, (3, 1))
    return Trajectory(joints, np.array([0.0, middle, seconds]), position, np.zeros_like(position), 0.0)
