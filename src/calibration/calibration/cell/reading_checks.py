"""Readings and loads of a run, held against its plan before anything is confirmed: messages in, the core decides.

Step 0 of a configuration is what its other steps are held against: the angles, and what the sensor says unloaded.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from calibration.cell.clients import Measured
from calibration.cell.readings import ReadingError
from calibration.cell.wrench_watch import WrenchWatch
from calibration.motion.arrival import Joints
from calibration_core.cell import Cell
from calibration_core.measurement import messages as m
from calibration_core.measurement.load_check import Felt, LoadCheck
from calibration_core.measurement.posture_check import Stood, posture_fault
from calibration_core.planning.plans.plan import REFERENCE_NUMBER
from calibration_core.planning.plans.tolerances import Tolerances
from calibration_core.timeseries import Float1D


class PostureError(ReadingError):
    """The robot did not stand where it was planned to stand: somebody or something has moved it."""


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
    """What is known of the configuration under way, and what its readings are held against."""

    def __init__(self, cell: Cell, tolerances: Tolerances, joints: Joints, wrench: WrenchWatch | None) -> None:
        """Prepare for a plan.

        Args:
            cell: The cell.
            tolerances: Of the plan.
            joints: The joint states.
            wrench: What pulls now; None: the cell has no sensor, and a load is what the operator says.
        """
        self._tolerances, self._names, self._joints = tolerances, cell.robot.joints, joints
        self._wrench = wrench if LoadCheck.possible(cell) else None
        self._load = LoadCheck(cell, tolerances) if self._wrench is not None else None
        self._first: Float1D | None = None
        self._unloaded: _Unloaded | None = None
        self._overridden: set[tuple[int, int]] = set()

    @property
    def checks_load(self) -> bool:
        """Whether loads are held against a sensor."""
        return self._load is not None

    def begin(self) -> None:
        """Begin an attempt at a configuration: nothing is known of it yet."""
        self._first = self._unloaded = None
        self._overridden = set()

    def override(self, configuration: int, step: int) -> None:
        """Take a load as it is: a named operator answers for it."""
        self._overridden.add((configuration, step))

    # --- readings ----------------------------------------------------------------------------------------------------

    def reading(self, command: m.TakeReading, measured: Measured) -> None:
        """Hold a reading against the plan, and remember it where it is step 0.

        Raises:
            PostureError: The robot stood elsewhere.
            ReadingError: Another load pulled, or nobody knows where the robot stood.
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
        felt = None if measured.wrench is None else Felt(q, measured.wrench.average.mean, measured.wrench.tare)
        self._check_load(command, felt)
        if of_reference:
            return
        if self._first is None:
            self._first = q
        if self._unloaded is None and felt is not None and self._wrench is not None:
            self._unloaded = _Unloaded(felt, command.wrench, self._wrench.tares)

    def _check_load(self, command: m.TakeReading, felt: Felt | None) -> None:
        known = self._unloaded
        if self._load is None or command.configuration == REFERENCE_NUMBER:
            return
        if felt is None or (known is None and not np.any(command.wrench)):
            return
        if (command.configuration, command.step) in self._overridden:
            return
        if known is None:
            raise ReadingError("the sensor was silent before the load: what pulls is not known")
        fault = self._load.fault(command.wrench - known.planned, felt, known.felt)
        if fault:
            raise ReadingError(fault)

    # --- loads -------------------------------------------------------------------------------------------------------

    def load_begins(self) -> None:
        """Remember what the sensor says before the first load, where no unloaded step was read before it."""
        if self._unloaded is None:
            felt = self._feel(0)
            if felt is not None and self._wrench is not None:
                self._unloaded = _Unloaded(felt, np.zeros(6), self._wrench.tares)

    @property
    def silent(self) -> bool:
        """Whether loads are held against a sensor of which nothing is heard."""
        return self._load is not None and self._wrench is not None and self._feel(0) is None

    def load(self, wanted: Float1D) -> str:
        """Say what is wrong with the load that pulls now: wanted, found, what to do; empty if nothing is.

        Args:
            wanted: (6,) N and N*m, base axes, at the wrench point.
        """
        if self._load is None or self._wrench is None:
            return ""
        known = self._unloaded
        felt = self._feel(0 if known is None else known.felt.tare)
        if felt is None:
            return f"no wrench on {self._wrench.topic}: start the sensor, then confirm again"
        if known is None:
            return "the sensor was silent before the load: what pulls is not known; release it, and confirm by override"
        return self._load.fault(wanted - known.planned, felt, known.felt)

    def present(self, wanted: Float1D) -> PresentLoad:
        """Tell what pulls now, for people; `wanted` as for `load`."""
        if self._load is None:
            return PresentLoad()
        known = self._unloaded
        planned = np.zeros(6) if known is None else known.planned
        band = self._load.force_band(wanted - planned)
        felt = None if known is None else self._feel(known.felt.tare)
        if known is None or felt is None:
            return PresentLoad(None, *band)
        fault = self._load.fault(wanted - planned, felt, known.felt)
        return PresentLoad(planned + self._load.acting_load(felt, known.felt), *band, fault)

    def _feel(self, tare: int) -> Felt | None:
        """Return what pulls now; the tare is the known one unless another one was told since."""
        if self._wrench is None or self._joints.latest is None:
            return None
        wrench = self._wrench.now
        if wrench is None:
            return None
        tared = self._unloaded is not None and self._wrench.tares != self._unloaded.tares
        return Felt(self._joints.latest, wrench, self._wrench.tare if tared else tare)
