"""Has it been seen that the guard can stop the robot?  The rule of the proof, without clock, messages or threads.

Whoever moves the robot sends it where it stands already.  The guard stops that, by the path by which it would stop a
motion.  The goal has to end as cancelled in time, and no joint may move.  Until that has been seen nothing else moves.
"""

from __future__ import annotations

import dataclasses
import enum
import math

import numpy as np

from calibration_core.timeseries import Float1D

MILLIRADIANS = 1e3


class RequestedStop(enum.Enum):
    """How the guard stops a motion."""

    CANCEL = "the motion's goal is cancelled"
    HOLD = "the position is held; nothing says that the motion has ended"
    NONE = "only the hand on the pendant stops the robot"


@dataclasses.dataclass(frozen=True)
class ProofRules:
    """What is seen as a proof.

    Attributes:
        hold: s, for which the robot is sent where it stands.
        before: s, that this goes on before it is stopped.
        within: s, in which the goal has to end, and for which the joints are watched from the stop on.
        moved: rad, no joint may move farther meanwhile.
    """

    hold: float = 2.0
    before: float = 0.2
    within: float = 0.5
    moved: float = 1e-4


class StopProof:
    """One proof after another.  All times are s on one clock.

    Attributes:
        stop: How a motion is stopped; nothing has to be proven where the guard has no means.
        proven: Whether the last one succeeded.
        running: Whether one is under way.
        text: Why there is no proof; empty if there is.
    """

    def __init__(self, stop: RequestedStop, rules: ProofRules | None = None) -> None:
        self.stop, self._rules = stop, rules or ProofRules()
        self.proven, self.running = stop is RequestedStop.NONE, False
        self.text = "" if self.proven else "not tried yet"
        self._began = self._stopped = self._ended = math.nan
        self._q: Float1D | None = None  # where the robot stood
        self._moved = 0.0
        self._seen = -math.inf  # last joint states

    def begin(self, now: float) -> None:
        """Take note that the robot is being sent where it stands; nothing is proven any more."""
        if self.stop is RequestedStop.NONE:
            return
        self.proven, self.running, self.text = False, True, "being tried"
        self._began, self._stopped, self._ended = now, math.nan, math.nan
        self._q, self._moved, self._seen = None, 0.0, -math.inf

    def void(self, why: str) -> None:
        """Forget what was proven, for a reason."""
        if self.stop is not RequestedStop.NONE:
            self.proven, self.running, self.text = False, False, why

    def on_joints(self, q: Float1D, now: float) -> None:
        """Take joint angles (n,) rad, all finite."""
        if not self.running:
            return
        if self._q is None:
            self._q = np.array(q)
        self._moved = max(self._moved, float(np.abs(q - self._q).max()))
        self._seen = now

    def on_ended(self, now: float, *, cancelled: bool) -> None:
        """Take note that the goal has ended."""
        if self.running and math.isnan(self._stopped):
            self.void("the goal ended before it was cancelled")
        elif self.running and not cancelled:
            self.void("the goal did not end as cancelled")
        elif self.running:
            self._ended = now

    def step(self, now: float, against: str) -> bool:
        """Go on; return whether the robot is to be stopped now.

        Args:
            now: s.
            against: What speaks against any motion besides the missing proof; empty: nothing.
        """
        if not self.running:
            return False
        rules = self._rules
        if against:
            self.void(against)
        elif self._moved > rules.moved:
            found, allowed = MILLIRADIANS * self._moved, MILLIRADIANS * rules.moved
            self.void(f"a joint moved by {found:.3g} mrad while the robot was to stand: {allowed:.3g} is its bound")
        elif math.isnan(self._stopped):
            if now - self._began >= rules.before and self._q is not None:
                self._stopped = now
                return True
            if now - self._began > rules.hold:
                self.void("no joint states have arrived")
        elif self._ended - self._stopped > rules.within:
            self.void(f"the goal took {self._ended - self._stopped:.2f} s to end")
        elif now - self._stopped > rules.within:
            self._judge()
        return False

    def _judge(self) -> None:
        if self.stop is RequestedStop.CANCEL and math.isnan(self._ended):
            self.void(f"the goal was not cancelled within {self._rules.within:g} s")
        elif self._seen <= self._stopped:
            self.void("no joint states arrived after the stop")
        else:
            self.proven, self.running, self.text = True, False, ""
