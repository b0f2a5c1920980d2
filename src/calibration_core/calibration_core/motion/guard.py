"""May the robot move?  The rule of permission, without clock, messages or threads.

Anything unknown, out of date or not finite is "no".  What takes a permission away is latched until an operator resets
it, and only when its cause is gone; a speed that is too high, a jump of the joints or of the clock is latched even
without a permission to lose.  This is no safety function: the controller's own monitoring has to stand behind it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable

import numpy as np

from calibration_core.errors import TrajectoryError
from calibration_core.motion.robot_status import TEXT, Drives, OperatingMode, Reason, RobotStatus, SafetyState
from calibration_core.motion.speed import SAFETY_RATED_SPEED, Monitored
from calibration_core.motion.stop_proof import RequestedStop, StopProof
from calibration_core.timeseries import Float1D

ALWAYS_LATCHED = frozenset(
    {Reason.OVER_SPEED, Reason.JOINTS_JUMPED, Reason.CLOCK_JUMPED, Reason.SEQUENCER_SILENT, Reason.TWO_GUARDS}
)
SHORTEST_STEP = 1e-3  # s, stamps closer than that are not trusted to tell a jump
NEVER_LATCHED = frozenset({Reason.PLANNED_OVER_SPEED, Reason.LATCHED, Reason.NOT_STARTED, Reason.STOP_UNPROVEN})
DURING_PROOF = frozenset({Reason.STOP_UNPROVEN, Reason.JOINTS_FROZEN})  # a robot that is sent where it stands


@dataclasses.dataclass(frozen=True)
class GuardRules:
    """Limits of the guard.

    Attributes:
        allowed_modes: Operating modes in which motion is permitted.
        speed_limit: m/s, of every monitored point (CWA 17384, 7.1).
        tolerance: A measured speed up to (1 + tolerance) times the limit is no fault.
        declared_limit: m/s, safety-rated limit that the cell file declares (`safety.speed_limit`), evidence for modes
            other than manual reduced; None: none.
        max_state_age: s, of the robot state.
        max_joints_age: s, of the joint states.
        freeze_time: s, joint states repeat to the bit while the robot is said to be in motion.
        speed_window: s, over which the measured speed is taken (at least between two samples).
        jump_rate: rad/s, no joint is faster between two samples.
        scaling_zero_time: s, the controller may scale the speed to zero for so long.
        max_pause: s, between two decisions while motion is permitted; a longer pause is a jump of the clock.  A guard
            that permits nothing may pause: it is being started on a busy computer.
        clock_tolerance: s, times may lie in the future by so much.
    """

    allowed_modes: frozenset[OperatingMode] = frozenset({OperatingMode.MANUAL_REDUCED})
    speed_limit: float = SAFETY_RATED_SPEED
    tolerance: float = 0.1
    declared_limit: float | None = None
    max_state_age: float = 0.5
    max_joints_age: float = 0.1
    freeze_time: float = 0.1
    speed_window: float = 0.04
    jump_rate: float = 15.0
    scaling_zero_time: float = 0.2
    max_pause: float = 1.0
    clock_tolerance: float = 0.05

    def __post_init__(self) -> None:
        """Raise TrajectoryError on a speed limit above the safety-rated reduced speed."""
        if not 0.0 < self.speed_limit <= SAFETY_RATED_SPEED:
            found, expected = f"{self.speed_limit:g} m/s", f"above 0, at most {SAFETY_RATED_SPEED} m/s"
            raise TrajectoryError("limits", "speed_limit", found, expected)


@dataclasses.dataclass(frozen=True, eq=False)
class GuardDecision:
    """What the guard decided.

    Attributes:
        time: s.
        permitted: Whether motion is permitted.
        reasons: Why not, in the order of their numbers; empty if permitted.
        latched: Faults that wait for the operator's reset.
        speed: m/s, of the fastest monitored point; NaN: not known.
        speed_point: Its name.
        speeds: (k,) m/s, of all monitored points; NaN: not known.
        rates: (n,) rad/s, that the speeds rest on; NaN: not known.
        state_age: s; NaN: none received.
        joints_age: s; NaN: none received.
        stop: Why it is not known that the guard can stop the robot; empty if it is.
        sources: What is published by two, with their names; empty if nothing is.
    """

    time: float
    permitted: bool
    reasons: tuple[Reason, ...]
    latched: tuple[Reason, ...]
    speed: float
    speed_point: str
    speeds: Float1D
    rates: Float1D
    state_age: float
    joints_age: float
    stop: str = ""
    sources: str = ""

    @property
    def text(self) -> str:
        """The reasons as one line for a person."""
        more = {
            Reason.LATCHED: ", ".join(TEXT[reason] for reason in self.latched),
            Reason.STOP_UNPROVEN: self.stop,
            Reason.TWO_SOURCES: self.sources,
        }
        texts = [TEXT[reason] + (f" ({more[reason]})" if more.get(reason) else "") for reason in self.reasons]
        return "; ".join(texts) or "motion is permitted"


@dataclasses.dataclass(frozen=True, eq=False)
class _Sample:
    q: Float1D
    time: float  # of the measurement
    received: float


class Guard:
    """Collects what arrives and decides.

    All times are s on one clock; `now` is handed in.  Hand over every robot state and joint state as it arrives, and
    call `decide` at a fixed rate and after every arrival that matters.

    Args:
        monitored: Points whose speed is watched.
        rules: Limits and ages.
        stop: How the robot is stopped.
        latched: What another guard before this one had latched: only a reset ends it.

    Attributes:
        proof: Whether it is known that the guard can stop the robot.
    """

    def __init__(
        self, monitored: Monitored, rules: GuardRules, stop: RequestedStop, latched: Iterable[Reason] = ()
    ) -> None:
        self._monitored, self._rules = monitored, rules
        self.proof = StopProof(stop)
        self._silent = self._two_guards = False
        self._two_sources = ""
        self._status: RobotStatus | None = None
        self._status_received = math.nan
        self._scaled_to_zero_since = math.nan
        self._samples: list[_Sample] = []
        self._unchanged_since = self._moving_since = math.nan
        self._fresh_joints = math.nan
        self._bad_joints = self._jumped = self._clock_jumped = self._stopping = False
        self._permitted = False
        self._latched: set[Reason] = set(latched)
        self._last = math.nan

    def on_status(self, status: RobotStatus, now: float) -> None:
        """Take a robot state that arrived at `now`."""
        self._status, self._status_received = status, now
        if status.in_motion is not True:
            self._moving_since = math.nan
        elif math.isnan(self._moving_since):
            self._moving_since = now
        if status.speed_scaling != 0.0:
            self._scaled_to_zero_since = math.nan
        elif math.isnan(self._scaled_to_zero_since):
            self._scaled_to_zero_since = now

    def on_joints(self, q: Float1D, now: float, stamp: float = math.nan) -> None:
        """Take joint angles (n,) rad that arrived at `now`.

        Args:
            q: In the order of the robot's joints; NaN for a joint that is missing.
            now: s.
            stamp: s, when they were measured, by the sender's clock; NaN where it does not say.  A repeated stamp is no
                new measurement, however often it arrives; nor is one that is a little older than the one before.
        """
        q = np.array(q, dtype=float)
        if q.shape != (self._monitored.chain.n,) or not np.isfinite(q).all():
            self._bad_joints, self._unchanged_since = True, math.nan
            self._samples.clear()
            return
        self._bad_joints = False
        time = now if math.isnan(stamp) else stamp
        before = self._samples[-1] if self._samples else None
        if before is not None:
            elapsed = time - before.time
            if -self._rules.clock_tolerance <= elapsed <= 0.0:
                return
            if elapsed < 0.0 or elapsed > self._rules.max_pause:
                self._samples.clear()  # the sender's clock went back, or nothing came for long: begin anew
                self.proof.void("joint states paused: the driver may be another one")
            if np.abs(q - before.q).max() > self._rules.jump_rate * max(elapsed, SHORTEST_STEP):
                self._jumped = True
        if before is None or not np.array_equal(q, before.q):
            self._unchanged_since = now
        self._fresh_joints = now
        self.proof.on_joints(q, now)
        self._samples.append(_Sample(q, time, now))
        while len(self._samples) > 2 and self._samples[1].time <= time - self._rules.speed_window:
            del self._samples[0]

    def on_clock_jump(self) -> None:
        """Take note that the clock by which messages are stamped went back or leapt."""
        self._clock_jumped = True

    def on_silence(self) -> None:
        """Take note that the sequencer fell silent while its motion was under way."""
        self._silent = True

    def on_second_guard(self) -> None:
        """Take note that another guard is heard."""
        self._two_guards = True

    def on_sources(self, text: str) -> None:
        """Take note of what is published by more than one, with their names; empty: nothing is."""
        self._two_sources = text

    def stop(self) -> None:
        """Permit nothing any more: the guard is being shut down."""
        self._stopping = True

    def decide(self, now: float, planned_speed: float | None = None) -> GuardDecision:
        """Decide at `now`.

        Args:
            now: s.
            planned_speed: m/s, bound of the motion that is asked for or running; None if there is none.
        """
        since = now - self._last  # NaN at first
        if since < -self._rules.clock_tolerance or (self._permitted and since > self._rules.max_pause):
            self._clock_jumped = True
        self._last = now
        speeds, rates = self._speeds()
        live = self._live(now, speeds, planned_speed)
        lost = live - NEVER_LATCHED if self._permitted else live & ALWAYS_LATCHED
        self._latched |= lost
        self._jumped = self._clock_jumped = self._silent = self._two_guards = False
        reasons = live | ({Reason.LATCHED} if self._latched else set())
        self._permitted = not reasons
        fastest = int(np.argmax(speeds)) if np.isfinite(speeds).all() else -1
        return GuardDecision(
            time=now,
            permitted=self._permitted,
            reasons=tuple(sorted(reasons)),
            latched=tuple(sorted(self._latched)),
            speed=float(speeds[fastest]) if fastest >= 0 else math.nan,
            speed_point=self._monitored.names[fastest] if fastest >= 0 else "",
            speeds=speeds,
            rates=rates,
            state_age=now - self._status_received,
            joints_age=now - self._fresh_joints,
            stop=self.proof.text,
            sources=self._two_sources,
        )

    def prove(self, decision: GuardDecision) -> bool:
        """Go on with a proof of the stop under way; return whether the robot is to be stopped for it now."""
        against = set(decision.reasons) - DURING_PROOF
        return self.proof.step(decision.time, ", ".join(TEXT[reason] for reason in sorted(against)))

    def reset(self, now: float, planned_speed: float | None = None) -> GuardDecision:
        """Release latched faults on an operator's word, if nothing else speaks against motion; decide.

        That it has not been seen that the guard can stop the robot is no obstacle: it cannot be shown before.
        """
        decision = self.decide(now, planned_speed)
        if not set(decision.reasons) - {Reason.LATCHED, Reason.PLANNED_OVER_SPEED, Reason.STOP_UNPROVEN}:
            self._latched.clear()
            decision = self.decide(now, planned_speed)
        return decision

    def _live(self, now: float, speeds: Float1D, planned_speed: float | None) -> set[Reason]:
        """Return what speaks against motion at this moment."""
        rules = self._rules
        found = {
            Reason.STOPPING: self._stopping,
            Reason.CLOCK_JUMPED: self._clock_jumped,
            Reason.JOINTS_JUMPED: self._jumped,
            Reason.JOINTS_NOT_FINITE: self._bad_joints,
            Reason.JOINTS_ABSENT: not self._bad_joints and math.isnan(self._fresh_joints),
            Reason.SPEED_UNKNOWN: not self._bad_joints
            and not math.isnan(self._fresh_joints)
            and len(self._samples) < 2,
            Reason.JOINTS_STALE: not self._bad_joints and self._old(now, self._fresh_joints, rules.max_joints_age),
            Reason.OVER_SPEED: bool(np.any(speeds > rules.speed_limit * (1.0 + rules.tolerance))),
            Reason.PLANNED_OVER_SPEED: planned_speed is not None and not planned_speed <= rules.speed_limit,
            Reason.STATE_ABSENT: self._status is None,
            Reason.STATE_STALE: self._old(now, self._status_received, rules.max_state_age),
            Reason.STOP_UNPROVEN: not self.proof.proven,
            Reason.SEQUENCER_SILENT: self._silent,
            Reason.TWO_GUARDS: self._two_guards,
            Reason.TWO_SOURCES: bool(self._two_sources),
        }
        reasons = {reason for reason, holds in found.items() if holds}
        return reasons if self._status is None else reasons | self._of_status(self._status, now)

    def _of_status(self, status: RobotStatus, now: float) -> set[Reason]:
        rules = self._rules
        mode = status.operating_mode
        confirmed = status.operator_confirmed and now < status.confirmed_until
        found = {
            Reason.MODE_UNKNOWN: mode is OperatingMode.UNKNOWN,
            Reason.MODE_NOT_ALLOWED: mode is not OperatingMode.UNKNOWN and mode not in rules.allowed_modes,
            Reason.SPEED_LIMIT_MISSING: mode in rules.allowed_modes and not self._slow(status, confirmed),
            Reason.CONFIRMATION_EXPIRED: status.operator_confirmed and not confirmed,
            Reason.DRIVES_UNKNOWN: status.drives is Drives.UNKNOWN,
            Reason.DRIVES_OFF: status.drives is Drives.OFF,
            Reason.SAFETY_UNKNOWN: status.safety is SafetyState.UNKNOWN,
            Reason.SAFETY_STOP: status.safety not in {SafetyState.UNKNOWN, SafetyState.NORMAL, SafetyState.REDUCED},
            Reason.MOTION_NOT_POSSIBLE: status.motion_possible is False,
            Reason.IN_ERROR: status.in_error is True,
            Reason.JOINTS_FROZEN: self._old(now, self._unchanged_while_moving(), rules.freeze_time),
            Reason.SPEED_SCALING_ZERO: self._old(now, self._scaled_to_zero_since, rules.scaling_zero_time),
        }
        return {reason for reason, holds in found.items() if holds}

    def _unchanged_while_moving(self) -> float:
        """Return since when the joint states repeat although the robot is said to move; NaN where they do not."""
        if math.isnan(self._moving_since) or math.isnan(self._unchanged_since):
            return math.nan
        return max(self._moving_since, self._unchanged_since)

    def _slow(self, status: RobotStatus, confirmed: bool) -> bool:
        """Tell whether there is evidence that the controller itself keeps the speed limit in this mode."""
        mode, limit = status.operating_mode, self._rules.speed_limit
        if mode is OperatingMode.MANUAL_REDUCED:
            return True
        if mode is OperatingMode.MANUAL_UNSPECIFIED and confirmed:
            return True
        declared = self._rules.declared_limit
        return 0.0 < status.speed_limit <= limit or (declared is not None and 0.0 < declared <= limit)

    def _old(self, now: float, since: float, limit: float) -> bool:
        """Tell whether `since` is known and longer ago than `limit`, or lies in the future."""
        age = now - since
        return age > limit or age < -self._rules.clock_tolerance

    def _speeds(self) -> tuple[Float1D, Float1D]:
        """Return the mean speeds (k,) of the monitored points over the window, and the joint rates (n,)."""
        if len(self._samples) < 2:
            return np.full(len(self._monitored.names), math.nan), np.full(self._monitored.chain.n, math.nan)
        first, last = self._samples[0], self._samples[-1]
        rates = (last.q - first.q) / (last.time - first.time)
        speeds = self._monitored.speeds((0.5 * (first.q + last.q))[None], rates[None])[0]
        return speeds, rates
