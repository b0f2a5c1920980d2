"""Readings and loads of a run, held against its plan before anything is confirmed: messages in, the core decides.

Step 0 of a configuration is what its other steps are held against: the angles, and what the sensor says unloaded.
What the sensor says unloaded is held against its zero, which was proven before and is kept across runs.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np
from calibration_interfaces.msg import Reading

from calibration.cell.clients import Measured
from calibration.cell.watches import WrenchWatch
from calibration.conversions import Mean, to_header, to_point, to_wrench
from calibration.motion.arrival import Joints
from calibration_core.cell import Cell
from calibration_core.errors import beyond, rounded_down
from calibration_core.measurement import messages as m
from calibration_core.measurement.load_check import Felt, LoadCheck
from calibration_core.measurement.posture_check import Stood, posture_fault
from calibration_core.measurement.target_check import PUT_RIGHT, TargetCheck, Targets
from calibration_core.measurement.unloaded import LoadMemory, ProvenZero, Unloaded
from calibration_core.observations.average import average
from calibration_core.planning.plans.plan import REFERENCE_NUMBER, Plan
from calibration_core.planning.plans.tolerances import STANDARD_ACCELERATION
from calibration_core.recording.session_values import ConfirmedReading
from calibration_core.timeseries import Float1D


class ReadingError(Exception):
    """No reading can be made of what was measured; the text says why.

    Attributes:
        resume: What a person has to do before the configuration begins again; empty: the reading is tried again.
    """

    resume = ""


def confirmed_readings(
    configuration: int, step: int, points: Sequence[Mean], wrench: Mean | None, joints: Joints, temperature: float
) -> list[ConfirmedReading]:
    """Return one reading per point: joint angles averaged over the point's own window.

    Args:
        configuration: Its number.
        step: Within the configuration.
        points: Averages of the measurement points, m, tracker frame.
        wrench: Average of the wrench, N and N*m; None without sensor.
        joints: The joint states.
        temperature: degrees Celsius, NaN where unknown.

    Raises:
        ReadingError: A point was measured while no joint states came.
    """
    rows = []
    for mean in points:
        _, q = joints.between(mean.begin, mean.end)
        if not len(q):
            raise ReadingError(f"no joint states while {mean.name} was measured")
        one = mean.average
        rows.append(
            ConfirmedReading(
                configuration=configuration,
                step=step,
                point=mean.name,
                time=(mean.begin + mean.end) // 2,
                q=average(q).mean,
                position=one.mean,
                position_covariance=one.covariance,
                samples=one.samples,
                wrench=None if wrench is None else wrench.average.mean,
                wrench_covariance=None if wrench is None else wrench.average.covariance,
                temperature=temperature,
            )
        )
    return rows


def to_reading(
    reading: ConfirmedReading, session: str, attempt: int, joints: Sequence[str], frame: str, tare: int
) -> Reading:
    """Return a reading as a message."""
    wrench = np.zeros(6) if reading.wrench is None else reading.wrench
    covariance = np.zeros((6, 6)) if reading.wrench_covariance is None else reading.wrench_covariance
    return Reading(
        header=to_header(reading.time, frame),
        session=session,
        configuration=reading.configuration,
        step=reading.step,
        attempt=attempt,
        point=reading.point,
        joints=list(joints),
        q=reading.q.tolist(),
        position=to_point(reading.position),
        position_covariance=reading.position_covariance.ravel(),
        has_wrench=reading.wrench is not None,
        wrench=to_wrench(wrench),
        wrench_covariance=covariance.ravel(),
        temperature=reading.temperature,
        samples=reading.samples,
        tare=tare,
    )


class PostureError(ReadingError):
    """The robot did not stand where it was planned to stand: somebody or something has moved it."""

    resume = "the robot has been moved; resume when it may move back"


class TargetError(ReadingError):
    """Targets or tracker are not where the session and the model have them."""

    resume = PUT_RIGHT


@dataclasses.dataclass(frozen=True, eq=False)
class _Unloaded:
    """What the other steps are held against: what the sensor said, the wrench planned then, tares told until then."""

    felt: Felt
    planned: Float1D
    tares: int


@dataclasses.dataclass(frozen=True, eq=False)
class PresentLoad:
    """What pulls now, against what is wanted.

    Attributes:
        felt: (6,) N and N*m, base axes, at the wrench point, without tool and bias; None: not known.
        band_force: N, by which the size of the force may be missed; NaN: it is not checked.
        band_angle: rad, by which its direction may be missed; NaN: it is not checked.
        fault: Wanted, found, and what to do; empty: nothing is wrong, or nothing is known.
    """

    felt: Float1D | None = None
    band_force: float = math.nan
    band_angle: float = math.nan
    fault: str = ""


class ReadingChecks:
    """What is known of the configuration under way and of the load, and what readings and loads are held against."""

    def __init__(
        self,
        cell: Cell,
        plan: Plan,
        joints: Joints,
        wrench: WrenchWatch | None,
        memory: LoadMemory,
        now: Callable[[], int],
    ) -> None:
        """Prepare for a plan.

        Args:
            cell: The cell.
            plan: What is measured.
            joints: The joint states.
            wrench: What pulls now; None: the cell has no sensor, and a load is what the operator says.
            memory: What is kept of the load between runs.
            now: Returns the cell's time, ns.
        """
        self._cell, self._memory, self._now = cell, memory, now
        self._tolerances, self._names, self._joints = plan.tolerances, cell.robot.joints, joints
        self._wrench = wrench if LoadCheck.possible(cell) else None
        self._load = LoadCheck(cell, plan.tolerances)
        # all that pulls: at most the rated load, or the plan's largest where its condition was overridden
        rated = cell.robot.rated_load * STANDARD_ACCELERATION
        self._most = (1.0 + plan.tolerances.force) * max(rated, plan.largest_force)
        self._zero = Unloaded(self._load, cell, memory.zeros)
        self._seen = False  # in this run, that nothing pulls
        self.targets = TargetCheck(cell)
        self._first: Float1D | None = None
        self._unloaded: _Unloaded | None = None
        self._overridden: set[tuple[int, int]] = set()

    def begin(self) -> None:
        """Begin an attempt at a configuration: nothing is known of it yet."""
        self._first = self._unloaded = None
        self._overridden = set()
        self.targets.begin()

    def override(self, configuration: int, step: int) -> None:
        """Take a load as it is: a named operator answers for it."""
        self._overridden.add((configuration, step))

    # --- readings ----------------------------------------------------------------------------------------------------

    def reading(self, command: m.TakeReading, measured: Measured) -> None:
        """Hold a reading against the plan, and remember it where it is step 0.

        Raises:
            PostureError: The robot stood elsewhere.
            TargetError: A target did, or the tracker.
            ReadingError: Another load pulled, or nobody knows where the robot stood.
            OutputError: The sensor's zero cannot be kept.
        """
        means = [*measured.points, *([] if measured.wrench is None else [measured.wrench])]
        begin, end = min(mean.begin for mean in means), max(mean.end for mean in means)
        stood = Stood(begin, end, *self._joints.between(begin, end))
        of_reference = command.configuration == REFERENCE_NUMBER
        first = None if of_reference else self._first
        fault = posture_fault(stood, command.q, first, self._tolerances, self._names)
        if fault:
            raise (PostureError if len(stood.stamps) else ReadingError)(fault)
        q = stood.q.mean(axis=0)
        felt = None
        if measured.wrench is not None and self._wrench is not None:
            felt = Felt(q, measured.wrench.average.mean, measured.wrench.tare)
            self._check_load(command, felt)
        if of_reference:
            self.targets.begin()
        seen = self._seen_targets(command, q, felt, measured)
        if fault := self.targets.fault(seen):
            raise TargetError(fault)
        if felt is not None and self._wrench is not None:
            if of_reference or self._first is None:
                self._prove(felt, "an unloaded reading")
            if not of_reference and self._unloaded is None:
                self._unloaded = _Unloaded(felt, command.wrench, self._wrench.tares)
        if not of_reference and self._first is None:
            self._first = q
        self.targets.keep(seen)

    def _seen_targets(self, command: m.TakeReading, q: Float1D, felt: Felt | None, measured: Measured) -> Targets:
        known, load = self._unloaded, command.wrench
        believed = (command.configuration, command.step) not in self._overridden
        if felt is not None and known is not None and believed and command.configuration != REFERENCE_NUMBER:
            load = self._load.acting_load(felt, known.felt)
        positions = {mean.name: mean.average.mean for mean in measured.points}
        covariances = {mean.name: mean.average.covariance for mean in measured.points}
        return Targets(q, load, bool(np.any(command.wrench)), positions, covariances)

    def _check_load(self, command: m.TakeReading, felt: Felt) -> None:
        if (command.configuration, command.step) in self._overridden:
            return
        if self._unloaded is None and np.any(command.wrench):
            raise ReadingError("the sensor was silent before the load: what pulls is not known")
        known = None if command.configuration == REFERENCE_NUMBER else self._unloaded
        if fault := self._fault(command.wrench, felt, known):
            raise ReadingError(fault)

    def _fault(self, wanted: Float1D, felt: Felt, known: _Unloaded | None) -> str:
        """Say what is wrong with what pulls: in all, and besides what pulled when the robot was unloaded."""
        in_all = self._zero.fault(felt.q, self._untared(felt), self._most if np.any(wanted) else 0.0)
        if in_all or known is None:
            return in_all
        return self._load.fault(wanted - known.planned, felt, known.felt)

    # --- before a motion ---------------------------------------------------------------------------------------------

    def pulls(self) -> str | None:
        """Say what pulls although nothing should; empty: nothing does.  None: the sensor is silent.

        A run begins only where the sensor's zero speaks of the posture; between two postures of a run that began so
        nothing is loaded, and the next unloaded reading is the next zero.
        """
        if self._wrench is None:
            return ""
        felt = self._feel()
        if felt is None:
            return None
        band = self._zero.pulling(felt.q, self._untared(felt))[1]
        if np.isnan(band):
            return "" if self._seen else "no zero of the sensor is proven in this posture, so what pulls is not known"
        fault = self._zero.fault(felt.q, self._untared(felt))
        self._seen |= not fault
        return fault

    @property
    def unproven(self) -> bool:
        """Whether the sensor speaks, and no zero of it is proven in this posture."""
        felt = self._feel()
        return felt is not None and bool(np.isnan(self._zero.pulling(felt.q, self._untared(felt))[1]))

    def _still_on(self, felt: Felt) -> str:
        """Say what speaks against a person's word that nothing pulls; empty: nothing does."""
        if not self.unproven:
            return self._zero.fault(felt.q, self._untared(felt))
        size = float(np.linalg.norm(felt.wrench[:3]))
        if size <= self._load.floor:
            return ""
        return (
            f"the sensor says {beyond(size, rounded_down(self._load.floor))} N, and no zero of it is proven in this"
            " posture: see that nothing pulls, then tare the sensor, or confirm by override with the reason"
        )

    def load_left(self) -> str:
        """Say why a load may be on, as it is kept between runs; empty: it was released."""
        left = self._memory.left
        return "nothing is known of the load" if left is None else f"a load may be on since {left}" if left else ""

    def loading(self, place: str) -> None:
        """Keep that a load may be on from now on.

        Raises:
            OutputError: It cannot be written.
        """
        self._memory.loading(place)

    def released(self, proof: str = "", *, against: bool = False) -> None:
        """Keep that nothing pulls any more.

        Args:
            proof: Who says so of a load that was left on: what the sensor says now is a zero of its own.
            against: He says so against the sensor: its zeros of before hold no longer.

        Raises:
            OutputError: It cannot be written.
        """
        felt = self._feel() if proof and self._wrench is not None else None
        if felt is None:
            self._memory.released()
            return
        self._prove(felt, proof, anew=against)

    def _prove(self, felt: Felt, proof: str, *, anew: bool = False) -> None:
        self._memory.proven(ProvenZero(self._now(), felt.q, self._untared(felt), proof), anew=anew)
        self._zero, self._seen = Unloaded(self._load, self._cell, self._memory.zeros), True

    # --- loads -------------------------------------------------------------------------------------------------------

    def load_begins(self) -> None:
        """Remember what the sensor says before the first load, where no unloaded step was read before it."""
        if self._unloaded is None:
            felt = self._feel()
            if felt is not None and self._wrench is not None:
                self._unloaded = _Unloaded(felt, np.zeros(6), self._wrench.tares)

    @property
    def silent(self) -> bool:
        """Whether loads are held against a sensor of which nothing is heard."""
        return self._wrench is not None and self._feel() is None

    def load(self, wanted: Float1D, *, left: bool = False) -> str:
        """Say what is wrong with the load that pulls now: wanted, found, what to do; empty if nothing is.

        Args:
            wanted: (6,) N and N*m, base axes, at the wrench point.
            left: It is a load that may have been left on, and is to be released before a motion.
        """
        if self._wrench is None:
            return ""
        felt = self._feel()
        if felt is None:
            return f"no wrench on {self._wrench.topic}: start the sensor, then confirm again"
        if left:
            return self._still_on(felt)
        if self._unloaded is None:
            return "the sensor was silent before the load: what pulls is not known; release it, and confirm by override"
        return self._fault(wanted, felt, self._unloaded)

    def present(self, wanted: Float1D, *, left: bool = False) -> PresentLoad:
        """Tell what pulls now, for people; arguments as for `load`."""
        felt = None if self._wrench is None else self._feel()
        if self._wrench is None:
            return PresentLoad()
        known = self._unloaded
        band = self._load.force_band(wanted if known is None else wanted - known.planned)
        if felt is None:
            return PresentLoad(None, *band)
        if known is not None and not left:
            acting = known.planned + self._load.acting_load(felt, known.felt)
            return PresentLoad(acting, *band, self._fault(wanted, felt, known))
        force, allowed = self._zero.pulling(felt.q, self._untared(felt))
        if np.isnan(allowed):
            return PresentLoad(None, *band, self._still_on(felt) if left else "")
        return PresentLoad(np.concatenate([force, np.zeros(3)]), allowed, math.nan, self._fault(wanted, felt, None))

    def _feel(self) -> Felt | None:
        """Return what the sensor says now, with the tare that holds; None: it is silent.

        A tare of which was told since the unloaded step is another one, even where a sensor's node that was started
        again counts from the beginning.
        """
        if self._wrench is None or self._joints.latest is None:
            return None
        wrench, known = self._wrench.now, self._unloaded
        if wrench is None:
            return None
        tare = known.felt.tare if known is not None and self._wrench.tares == known.tares else self._wrench.tare
        return Felt(self._joints.latest, wrench, tare)

    def _untared(self, felt: Felt) -> Float1D:
        return felt.wrench if self._wrench is None else felt.wrench + self._wrench.bias(felt.tare)
