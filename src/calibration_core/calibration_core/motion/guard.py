"""May the robot move?  The rule of permission, without clock, messages or threads.

Anything unknown, out of date or not finite is "no".  What takes a permission away is latched until an operator resets
it, and only when its cause is gone; a speed that is too high, a jump of the joints or of the clock is latched even
without a permission to lose.  This is no safety function: the controller's own monitoring has to stand behind it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping

import numpy as np

from calibration_core.errors import TrajectoryError
from calibration_core.motion.clock_watch import Lateness
from calibration_core.motion.robot_status import TEXT, Drives, OperatingMode, Reason, RobotStatus, SafetyState
from calibration_core.motion.speed import SAFETY_RATED_SPEED, SPEED_ERROR, Monitored
from calibration_core.motion.stop_proof import ProofRules, RequestedStop, StopProof
from calibration_core.timeseries import Float1D

ALWAYS_LATCHED = frozenset(
    {Reason.OVER_SPEED, Reason.JOINTS_JUMPED, Reason.CLOCK_JUMPED, Reason.SEQUENCER_SILENT, Reason.TWO_GUARDS}
)
STATE_LASTS = 0.5  # s, of a robot state where nobody says: ten messages of a slow driver, 20 Hz
SHORTEST_STEP = 1e-3  # s, stamps closer than that are not trusted to tell a jump
NEVER_LATCHED = frozenset({Reason.PLANNED_OVER_SPEED, Reason.LATCHED, Reason.NOT_STARTED, Reason.STOP_UNPROVEN})
DURING_PROOF = frozenset({Reason.STOP_UNPROVEN, Reason.JOINTS_FROZEN})  # a robot that is sent where it stands


@dataclasses.dataclass(frozen=True)
class GuardRules:
    """Limits of the guard.

    Attributes:
        allowed_modes: Operating modes in which motion is permitted.
        speed_limit: m/s, of every monitored point (CWA 17384, 7.1).
        joint_error: rad, m where a joint slides: two joint states differ by at most that much more or less than the
            robot has moved between them (quantisation and noise).
        time_error: s, likewise their stamps.
        tracking_error: rad, m where a joint slides: a joint that stands lies at most that far beside its command.
        declared_limit: m/s, safety-rated limit that the cell file declares (`safety.speed_limit`), evidence for modes
            other than manual reduced; None: none.
        max_joints_age: s, of the joint states, from arrival to decision and, by their stamps, before it (`Lateness`).
        stamps_run: Stamps of joint states are made by a clock that runs as fast as the guard's own, as those of a
            simulation do not: these are aged from their arrival alone.
        freeze_time: s, joint states repeat to the bit while the robot is said to be in motion.
        jump_rate: rad/s, no joint is faster between two samples.
        scaling_zero_time: s, the controller may scale the speed to zero for so long.
        max_pause: s, between two decisions while motion is permitted; a longer pause is a jump of the clock.  A guard
            that permits nothing may pause: it is being started on a busy computer.
        clock_tolerance: s, times may lie in the future by so much.
        remote: Whether `motion_possible` speaks of motion that is commanded from outside alone; where the guard cannot
            stop the robot, a hand moves it, and that is not asked for.
        notes: What a reason means with this robot's driver, for a person.
    """

    allowed_modes: frozenset[OperatingMode] = frozenset({OperatingMode.MANUAL_REDUCED})
    speed_limit: float = SAFETY_RATED_SPEED
    joint_error: float = 1e-4  # steps of 0.005 degrees, or a noise of 2e-5 rad in each: drivers are finer as a rule
    time_error: float = 1e-3  # stamps of a thread that is woken by a timer on a kernel without real time
    tracking_error: float = 0.0  # of drivers that integrate it away; a loaded joint without that sags by 1e-4 to 1e-3
    declared_limit: float | None = None
    max_joints_age: float = 0.1
    stamps_run: bool = True
    freeze_time: float = 0.1
    jump_rate: float = 15.0
    scaling_zero_time: float = 0.2
    max_pause: float = 1.0
    clock_tolerance: float = 0.05
    remote: bool = True
    notes: Mapping[Reason, str] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise TrajectoryError on a speed limit above the safety-rated reduced speed."""
        if not 0.0 < self.speed_limit <= SAFETY_RATED_SPEED:
            found, expected = f"{self.speed_limit:g} m/s", f"above 0, at most {SAFETY_RATED_SPEED} m/s"
            raise TrajectoryError("limits", "speed_limit", found, expected)

    @property
    def planned_limit(self) -> float:
        """Speed that no planned motion exceeds, m/s: below the limit by twice the error of a measured speed."""
        return self.speed_limit * (1.0 - 2.0 * SPEED_ERROR)


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
        joints_age: s, as known by arrivals and stamps; NaN: none received.
        details: What a person wants to know of a reason besides its text.
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
    details: Mapping[Reason, str] = dataclasses.field(default_factory=dict)

    @property
    def text(self) -> str:
        """The reasons as one line for a person."""
        more = self.details
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
        self._path_error = monitored.path_error(rules.joint_error, rules.time_error, rules.speed_limit)
        self._window = float(self._path_error.max()) / (SPEED_ERROR * rules.speed_limit)  # s, for a speed that exact
        # sent where it is measured, and held where it is measured, a joint moves by its tracking error each time
        self.proof = StopProof(stop, ProofRules(moved=rules.joint_error + 2.0 * rules.tracking_error))
        self._silent = self._two_guards = False
        self._two_sources = ""
        self._status: RobotStatus | None = None
        self._status_received, self._status_lasts, self._status_of = math.nan, 0.0, ""
        self._scaled_to_zero_since = math.nan
        self._samples: list[_Sample] = []
        self._unchanged_since = self._moving_since = math.nan
        self._fresh_joints, self._late, self._lateness = math.nan, 0.0, Lateness()
        self._bad_joints = self._jumped = self._clock_jumped = self._stopping = False
        self._permitted = False
        self._latched: set[Reason] = set(latched)
        self._last = math.nan

    def on_status(self, status: RobotStatus, now: float, lasts: float = STATE_LASTS, of: str = "") -> None:
        """Take a robot state that arrived at `now`.

        Args:
            status: The state.
            now: s, when the oldest of what it rests on arrived.
            lasts: s, how old that may become.
            of: What that is, for a person.
        """
        self._status, self._status_received, self._status_lasts, self._status_of = status, now, lasts, of
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
        self._late = self._lateness.late(stamp, now) if self._rules.stamps_run and not math.isnan(stamp) else 0.0
        self.proof.on_joints(q, now)
        self._samples.append(_Sample(q, time, now))
        while len(self._samples) > 2 and self._samples[1].time <= time - self._window:
            del self._samples[0]

    def on_new_source(self) -> None:
        """Take note that joint states may come from another sender, with another clock."""
        self._lateness.forget()

    def on_clock_jump(self) -> None:
        """Take note that the clock by which messages are stamped went back or leapt."""
        self._clock_jumped = True
        self._lateness.forget()

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
        speeds, rates, too_fast = self._speeds()
        live = self._live(now, too_fast, planned_speed)
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
            joints_age=now - self._fresh_joints + self._late,
            details=self._details(now),
        )

    def _details(self, now: float) -> dict[Reason, str]:
        age = f"{now - self._status_received:.1f} s, at most {self._status_lasts:g} s"
        return {
            **self._rules.notes,
            Reason.STATE_STALE: f"{self._status_of}: {age}" if self._status_of else age,
            Reason.JOINTS_STALE: f"they arrive {self._late:.2f} s late" if self._late > 0.01 else "",
            Reason.LATCHED: ", ".join(TEXT[reason] for reason in sorted(self._latched)),
            Reason.STOP_UNPROVEN: self.proof.text,
            Reason.TWO_SOURCES: self._two_sources,
        }

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

    def _live(self, now: float, too_fast: bool, planned_speed: float | None) -> set[Reason]:
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
            Reason.JOINTS_STALE: not self._bad_joints
            and self._old(now, self._fresh_joints, rules.max_joints_age - self._late),
            Reason.OVER_SPEED: too_fast,
            Reason.PLANNED_OVER_SPEED: planned_speed is not None and not planned_speed <= rules.planned_limit,
            Reason.STATE_ABSENT: self._status is None,
            Reason.STATE_STALE: self._old(now, self._status_received, self._status_lasts),
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
        until = status.confirmed_until
        confirmed = status.operator_confirmed and until is not None and now < until
        found = {
            Reason.MODE_UNKNOWN: mode is OperatingMode.UNKNOWN,
            Reason.MODE_NOT_ALLOWED: mode is not OperatingMode.UNKNOWN and mode not in rules.allowed_modes,
            Reason.SPEED_LIMIT_MISSING: mode in rules.allowed_modes and not self._slow(status, confirmed),
            Reason.CONFIRMATION_EXPIRED: status.operator_confirmed and not confirmed,
            Reason.DRIVES_UNKNOWN: status.drives is Drives.UNKNOWN,
            Reason.DRIVES_OFF: status.drives is Drives.OFF,
            Reason.SAFETY_UNKNOWN: status.safety is SafetyState.UNKNOWN,
            Reason.SAFETY_STOP: status.safety not in {SafetyState.UNKNOWN, SafetyState.NORMAL, SafetyState.REDUCED},
            Reason.MOTION_NOT_POSSIBLE: status.motion_possible is False
            and not (rules.remote and self.proof.stop is RequestedStop.NONE),
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
        return any(known is not None and 0.0 < known <= limit for known in (status.speed_limit, declared))

    def _old(self, now: float, since: float, limit: float) -> bool:
        """Tell whether `since` is known and longer ago than `limit`, or lies in the future."""
        age = now - since
        return age > limit or age < -self._rules.clock_tolerance

    def _speeds(self) -> tuple[Float1D, Float1D, bool]:
        """Measure how fast the robot is: over as long as an exact speed takes, and over shorter times up to now.

        A mean over a short time is wrong by more than `SPEED_ERROR`.  It tells of an excess that is larger still, and
        sooner: a robot counts as too fast where a mean less its error is above what is planned at most.

        Returns:
            Mean speeds (k,) m/s of the monitored points and joint rates (n,) rad/s, over the longest time or that which
            tells most clearly that the robot is too fast; NaN where there is none yet.  Whether it is.
        """
        count, n = len(self._samples), self._monitored.chain.n
        if count < 2:
            return np.full(len(self._monitored.names), math.nan), np.full(n, math.nan), False
        last, back = self._samples[-1], [2**i for i in range((count - 2).bit_length())] + [count - 1]
        span = np.array([last.time - self._samples[-1 - i].time for i in back])[:, None]
        moved = np.stack([last.q - self._samples[-1 - i].q for i in back])
        speeds = self._monitored.speeds(last.q - 0.5 * moved, moved / span)
        error = np.maximum(self._path_error / span, SPEED_ERROR * self._rules.speed_limit)
        clear = (speeds - error).max(axis=1)
        too_fast = bool(clear.max() > self._rules.planned_limit)
        decides = int(np.argmax(clear)) if too_fast else -1
        return speeds[decides], moved[decides] / span[decides], too_fast
