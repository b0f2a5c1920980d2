"""What one phase of the calibration found (CWA 17384, 7.1 to 7.6), and what arm and wrist give apart (5.2)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from calibration_core.identification.circle_point.joint_axes import AxisGeometry, BaseFrame
from calibration_core.identification.wrist.centre import WristCentre
from calibration_core.timeseries import Float1D, Float2D

BASE_FRAME, GEOMETRY, WRIST_CENTRE, POINTS, STIFFNESS = (
    "base_frame", "geometry", "wrist_centre", "points", "stiffness"
)  # fmt: skip
ANGLES = {"alpha", "theta", "beta", "rx", "ry", "rz"}
CLAUSES = {BASE_FRAME: "7.1", GEOMETRY: "7.2", WRIST_CENTRE: "7.3", POINTS: "7.4, 7.5", STIFFNESS: "7.6"}


@dataclasses.dataclass(frozen=True, eq=False)
class PhaseEstimate:
    """Values with their full covariance, as they stood when the phase was over.

    Attributes:
        phase: `base_frame`, `geometry`, `wrist_centre`, `points` or `stiffness`.
        readings: Number of readings that belong to this phase.
        names: (p,) what was estimated: `tracker x` ... `yaw` (m and rad, pose in the base frame), corrections to the
            geometry (m, rad), `wrist centre x` ..., `mp1 x` ... (m, flange frame), `C joint_1` ... (rad/(N*m)).
        values: (p,) SI units.
        covariance: (p, p), SI units: this phase's readings and all that earlier phases left uncertain.
        scale: Factor by which residuals exceeded the instruments' claim and the covariance was widened (1: not).
        remarks: What limits the result, one sentence each.
    """

    phase: str
    readings: int
    names: tuple[str, ...]
    values: Float1D
    covariance: Float2D
    scale: float = 1.0
    remarks: tuple[str, ...] = ()

    @property
    def clause(self) -> str:
        """Clause of CWA 17384."""
        return CLAUSES[self.phase]

    @property
    def std(self) -> Float1D:
        """(p,) one standard deviation, SI units."""
        return np.sqrt(np.diag(self.covariance))

    def unit(self, index: int) -> str:
        """Return the unit of one value: m, rad or rad/(N*m)."""
        name = self.names[index]
        if name.startswith("C "):
            return "rad/(N*m)"
        angle = name.split()[-1] in {"roll", "pitch", "yaw"} or name.split("_")[0] in ANGLES
        return "rad" if angle else "m"


@dataclasses.dataclass(frozen=True, eq=False)
class Decoupled:
    """Stiffnesses of arm and wrist identified apart, and compared with those identified together.

    Attributes:
        joints: Names.
        arm: Number of joints of the arm; the others are the wrist.
        compliance: (n,) rad/(N*m), arm and wrist apart; not bounded.
        covariance: (n, n) of `compliance`.
        together: (n,) rad/(N*m), identified together from the same displacements of the tool.
        difference_std: (n,) one standard deviation by which the two may differ by chance.
        chi2: Of the differences, all their correlations taken into account.
        freedom: Its degrees of freedom.
        limit: What it exceeds by chance in 1 % of cases.
        wrist_centre: (3,) m, flange frame.
        measured: Whether the wrist centre was measured, or follows from the geometry.
    """

    joints: tuple[str, ...]
    arm: int
    compliance: Float1D
    covariance: Float2D
    together: Float1D
    difference_std: Float1D
    chi2: float
    freedom: int
    limit: float
    wrist_centre: Float1D
    measured: bool

    @property
    def std(self) -> Float1D:
        """(n,) of `compliance`."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def agree(self) -> bool:
        """Whether the two identifications differ by no more than chance (1 % level)."""
        return self.chi2 <= self.limit


@dataclasses.dataclass(frozen=True, eq=False)
class StandardGeometry:
    """Results of the standard's methods, each where the recording follows its protocol.

    Attributes:
        base: Base coordinate system by circle points; None if joints 1 and 2 were not swept alone.
        axes: Joint axes by circle points; None if no joint beyond the second was swept as well.
        wrist: Wrist centre by spheres; None if the wrist was not moved while the arm stood.
        points_fitted: Whether the wrist centre stands on points that this recording determined, not on nominal ones.
        reasons: `base_frame`, `joint_axes`, `wrist_centre` -> why there is none.
    """

    base: BaseFrame | None
    axes: AxisGeometry | None
    wrist: WristCentre | None
    points_fitted: bool
    reasons: Mapping[str, str]

    def __post_init__(self) -> None:
        """Freeze the mapping."""
        object.__setattr__(self, "reasons", MappingProxyType(dict(self.reasons)))
