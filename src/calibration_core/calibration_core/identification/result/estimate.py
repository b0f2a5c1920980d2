"""What an identification says: values with uncertainty, what was excluded, what cannot be known, and why."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from calibration_core.identification.circle_point.joint_axes import AxisGeometry, BaseFrame
from calibration_core.identification.result.tested import TestResult
from calibration_core.identification.wrist import WristCentre
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Int1D, Note, Readings

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


# --- what several recordings of one robot contribute to a common identification, and whether they agree ---------------


@dataclasses.dataclass(frozen=True, eq=False)
class Contribution:
    """What one of several recordings that are evaluated together contributes.

    Attributes:
        file: The recording, as its user named it.
        number: From 1; its points are called POINT@NUMBER.
        kind: What it holds: `loaded` or `absolute`.
        configurations: Number of its configurations.
        numbers: First and last number that they have beside those of the others.
        first_number: What was added to the numbers that they have in their own file.
        steps: Number of its steps.
        readings: Number of its readings.
        excluded: Number of those that were not used.
        points: Its measurement points, as in its own file.
        noise: Standard deviation of one coordinate that its instrument claims, m.
        scale: Factor on it with which it stands beside the others (>= 1): where its own audit shows more noise.
        rms: Root mean square per coordinate of what the common model leaves of it, m.
        tracker: (6,) x, y, z (m), roll, pitch, yaw (rad) of its tracker in the base frame; None for displacements.
        stiffness: Joint -> (value, standard deviation) that it shows by itself, N*m/rad (N/m where the joint slides).
        sha256: File -> SHA-256 of its files.
    """

    file: str
    number: int
    cell: str
    cell_sha256: str
    kind: str
    configurations: int
    numbers: tuple[int, int]
    first_number: int
    steps: int
    readings: int
    excluded: int
    points: tuple[str, ...]
    noise: float
    scale: float
    rms: float
    tracker: tuple[float, ...] | None
    stiffness: Mapping[str, tuple[float, float]]
    sha256: Mapping[str, str]


@dataclasses.dataclass(frozen=True)
class Disagreement:
    """A parameter of the robot that one recording shows otherwise than the others.

    Attributes:
        change: Against the others: of a stiffness relative, else in `unit`.
        low: Lower end of its 95 % interval.
        high: Upper end.
        unit: Of the change.
        or_else: Joints whose change would explain nearly as much.
    """

    file: str
    parameter: str
    location: str
    change: float
    low: float
    high: float
    unit: str
    or_else: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True, eq=False)
class Together:
    """Several recordings of one robot, and whether they agree.

    Attributes:
        contributions: One for each recording, in the order in which they were named.
        compared: Parameters that were compared between recordings.
        disagreements: What a recording shows otherwise than the others; empty where they agree.
        taken_off: What was taken off the readings of recordings that differ, so that the common values are those of the
            others; empty where nothing was.
    """

    contributions: tuple[Contribution, ...]
    compared: tuple[str, ...]
    disagreements: tuple[Disagreement, ...]
    taken_off: tuple[Disagreement, ...] = ()


# --- what an identification says --------------------------------------------------------------------------------------


DECLARED_RIGID = "declared rigid in the cell file: not asked for"  # the reason of a joint of which nothing is asked


@dataclasses.dataclass(frozen=True)
class JointStiffness:
    """Stiffness of one joint (CWA 17384, Table 2).

    Attributes:
        joint: Name of the joint.
        value: Stiffness in `unit`; at a compliance of zero the median of what is possible; infinite for a rigid joint.
        std: One standard deviation, N*m/rad (to first order; infinite where the recording tells nothing).
        interval: 95 % interval, N*m/rad; from 0 to infinity where the recording tells nothing.
        compliance: rad/(N*m), not negative.
        compliance_std: One standard deviation, rad/(N*m).
        identifiable: Whether this recording determines it.
        reason: Why not, or what limits it; empty if there is nothing to say.
        unit: Of the stiffness: `N*m/rad`, or `N/m`.
        extended: The same joint in the model that holds what the standard's leaves out; None where nothing is left out.
    """

    joint: str
    value: float
    std: float
    interval: tuple[float, float]
    compliance: float
    compliance_std: float
    identifiable: bool
    reason: str = ""
    unit: str = "N*m/rad"
    extended: JointStiffness | None = None

    @property
    def open(self) -> bool:
        """Whether the stiffness was asked for, and this recording does not determine it."""
        return not self.identifiable and self.reason != DECLARED_RIGID


@dataclasses.dataclass(frozen=True)
class ParameterEstimate:
    """One fitted parameter other than a stiffness: frame, point or geometry.

    Attributes:
        name: For example `tracker x`, `mp1 z`, `a_2`, `theta_5`.
        group: `tracker`, `point`, `geometry`.
        value: Fitted value (for geometry: the correction to the nominal value), m or rad.
        std: One standard deviation.
        unit: `m` or `rad`.
        nominal: What the cell file says; None if it says nothing.
        fitted: False where it could not be identified and stays nominal.
    """

    name: str
    group: Literal["tracker", "point", "geometry"]
    value: float
    std: float
    unit: Literal["m", "rad"]
    nominal: float | None
    fitted: bool = True


@dataclasses.dataclass(frozen=True)
class Exclusion:
    """A reading that was not used, and why.

    Attributes:
        step: Its step.
        size: Length of its residual when predicted from the others, m.
        times_sigma: The same in standard deviations.
    """

    configuration: int
    step: int
    point: str
    reason: str
    size: float
    times_sigma: float


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """Root mean squares per coordinate, m, over all readings after the best frames.

    Attributes:
        rms_before: Model with the values believed so far, frames refitted; rigid where no stiffness is stated.
        rms_after: Identified model.
        held_out_rms_before: As `rms_before`, every configuration predicted from the others.
        held_out_rms_after: As `rms_after`, every configuration predicted from the others.
        noise: Standard deviation of one coordinate expected from the instruments.
        held_out_mean_after: Mean length of the 3-d prediction error of held-out readings, m.
        held_out_max_after: Largest such length, m.
        rms_used: As `rms_after`, over the readings that were used (exclusions left out).
        chi2: Weighted sum of squares over the readings used.
        degrees_of_freedom: Readings used times three, less offsets and parameters.
        positions: Root mean square per coordinate, m, of what the absolute positions of a loaded recording leave, with
            tracker and targets fitted and the geometry not; NaN where there are none.
    """

    rms_before: float
    rms_after: float
    held_out_rms_before: float
    held_out_rms_after: float
    noise: float
    held_out_mean_after: float
    held_out_max_after: float
    rms_used: float = float("nan")
    chi2: float = float("nan")
    degrees_of_freedom: int = 0
    positions: float = float("nan")


TRIANGLE, REPEATS = "rigid triangle", "repeats of a posture"
MODEL_FREE = frozenset({TRIANGLE, REPEATS})


@dataclasses.dataclass(frozen=True)
class NoiseCheck:
    """One way of seeing the noise without, or with, the model.

    Attributes:
        source: `rigid triangle`, `zero return`, `window scatter` or `residual`.
        seen: Standard deviation of one coordinate, m.
        degrees_of_freedom: On how much it rests.
    """

    source: str
    seen: float
    degrees_of_freedom: int


@dataclasses.dataclass(frozen=True)
class NoiseAudit:
    """Claimed against seen noise.

    Attributes:
        claimed: Standard deviation of one coordinate that the cell file states, m.
        checks: What was seen, in several ways.
        scale: Factor on the claimed standard deviations that the uncertainties of this result use (>= 1).
        understated: Whether the claim is rejected at the 1 % level.
        text: One sentence for a person.
    """

    claimed: float
    checks: tuple[NoiseCheck, ...]
    scale: float
    understated: bool
    text: str

    @property
    def left(self) -> NoiseCheck:
        """What the fit leaves."""
        return next(check for check in self.checks if check.source == "residual")

    @property
    def seen_without_model(self) -> float | None:
        """The largest noise that readings show by themselves, m; None where they show none."""
        return max((check.seen for check in self.checks if check.source in MODEL_FREE), default=None)


@dataclasses.dataclass(frozen=True)
class Precondition:
    """One requirement of the standard, checked on the recording.

    Attributes:
        clause: Clause of CWA 17384, for example `5.1`.
        requirement: What the clause demands.
        found: What the recording shows, with figures.
        met: True, False, or None where the recording cannot tell.
        name: A stable word for those that are watched while measuring; empty for the others.
        shall: Whether the standard demands it (`shall`); otherwise it recommends it (`should`).
        override: Who let the measurement go on although it was violated, and why; empty if nobody did.
    """

    clause: str
    requirement: str
    found: str
    met: bool | None
    name: str = ""
    shall: bool = True
    override: str = ""


@dataclasses.dataclass(frozen=True)
class Unidentified:
    """A joint or combination of parameters that this recording cannot determine.

    Attributes:
        combination: Parameter name -> weight, the largest being 1.
        reason: Why, in one sentence.
    """

    combination: Mapping[str, float]
    reason: str


@dataclasses.dataclass(frozen=True)
class Stage:
    """One stage of the model selection for absolute recordings: kept only if held-out configurations say so.

    Attributes:
        name: `nominal`, `frames`, `geometry` or `elasticity`.
        parameters: Number of free parameters up to and including this stage.
        rms: 3-d root mean square over all readings, m.
        held_out_rms: The same on configurations left out, m.
        kept: Whether the result contains it.
        reason: Why, with figures.
    """

    name: str
    parameters: int
    rms: float
    held_out_rms: float
    kept: bool
    reason: str


@dataclasses.dataclass(frozen=True)
class Anomaly:
    """Something wrong with the data that is no physics of the robot.

    Attributes:
        kind: One of the kinds, e.g. `noise_understated`, `unsettled`, `outlier_readings`.
        location: For example {"point": "mp1"}.
        configurations: First and last configuration concerned; None if all.
        magnitude, unit: How large, and in which unit.
        text, remedy: What is seen, in one sentence, and what to do about it; empty where the text says it.
        further: `factor`, `joints`, `points` or `axes` where they apply.
    """

    kind: str
    location: Mapping[str, str | int]
    configurations: tuple[int, int] | None
    magnitude: float
    unit: str
    text: str
    remedy: str = ""
    further: Mapping[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True, eq=False)
class Residuals:
    """Measured against predicted, reading by reading (same rows as `readings`).

    Attributes:
        measured: (m, 3) m, base axes.  Loaded: deflection under the external load alone, less the fitted offset of its
            configuration and point (displacement recordings: relative to step 0).  Absolute: position, base frame.
        predicted: (m, 3) m, as `measured`.
        residual: (m, 3) m, measured - predicted.
        held_out: (m, 3) m, measured - predicted when the whole configuration was left out of the fit.
        sigma: (m, 3) m, standard deviation expected per coordinate, after the noise audit.
        load: (m,) N, size of the force at this reading (0 where no load is known).
        excluded: (m,) whether the reading was not used.
    """

    measured: Float2D
    predicted: Float2D
    residual: Float2D
    held_out: Float2D
    sigma: Float2D
    load: Float1D
    excluded: Bool1D


@dataclasses.dataclass(frozen=True, eq=False)
class OperatingSpace:
    """The investigated operating space in Cartesian representation (CWA 17384, 8 g), base frame, m.

    Attributes:
        configuration: (k,) numbers of the configurations.
        joint_origins: (k, N + 2, 3) base, origins of all N moving joints, flange: the arm as a polyline.
        flange: (k, 3); points: measurement point -> (k, 3); wrench_point: (k, 3) or None.
        force: (k, 3) N, largest force applied at that configuration, base axes; None for absolute recordings.
        deflection: (k, 3) m, deflection of the first point under that force; None for absolute recordings.
        q: (k, n) rad, the configurations of Table 1.
        joint_deflection: (k, n) rad (m: sliding), of the joints under that force; None for absolute recordings.
        singularity: (k,) smallest singular value of the Jacobian at the wrist, scaled by the reach: 0 is singular.
        k_csm_share: (k,) m, how far neglecting K_CSM moves the predicted point (clause 6.2); None for absolute ones.
        tracker: (3,) where the tracker stands; None where that is not shown.
        boxes: (b, 8, 3) corners of what stands in the cell, x fastest, z slowest; None where that is not shown.
    """

    configuration: Int1D
    joint_origins: Float3D
    flange: Float2D
    points: Mapping[str, Float2D]
    wrench_point: Float2D | None
    force: Float2D | None
    deflection: Float2D | None
    q: Float2D
    singularity: Float1D
    k_csm_share: Float1D | None
    tracker: Float1D | None = None
    boxes: Float3D | None = None
    joint_deflection: Float2D | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Identification:
    """The complete answer of `calibration identify`.

    Attributes:
        kind: `loaded` (stiffness from loads) or `absolute` (frames, geometry, gravity).
        method: How, in words, e.g. `equilibrium, point deflections, instrument weights, robust`.
        readings: What was evaluated.
        stiffness: One per joint; empty if none was to be had.
        parameters: Frames, points and geometry.
        names: Names of the rows of `covariance`: compliances (`C joint_1`, ...) and fitted parameters.
        covariance: (p, p), SI units.
        condition_number: Of the column-scaled observation matrix of the compliances (or of all parameters).
        fit: The figures.
        noise: Claimed against seen.
        stages: Stages of the model selection of an absolute recording; empty for loaded ones.
        unidentified: What cannot be determined.
        preconditions: The standard's demands, checked.
        model: The identified model, as `predict` uses it.
        test: Result on a second recording, if one was given.
        notes: Further remarks, those of the readings included.
        standard: Base frame, joint axes and wrist centre by the standard's methods; None for a loaded recording.
        given: The model that was handed in to start from, whose effects were taken off the readings; None without.
        phases: What the phases of the calibration found one after another; empty for a recording of one phase.
        decoupled: Stiffnesses of arm and wrist identified apart, beside the joint identification; None without.
        not_decoupled: Why there is none; empty if there is one.
        estimate: Everything identified in `model`, with its joint covariance, as the model file has it.
        together: Of which recordings it was identified, where there were several; None: one.
        basis: The fit that it says in words, which a search for missing physics begins from; None: of several phases.
    """

    kind: Literal["loaded", "absolute"]
    method: str
    readings: Readings
    stiffness: tuple[JointStiffness, ...]
    parameters: tuple[ParameterEstimate, ...]
    names: tuple[str, ...]
    covariance: Float2D
    condition_number: float
    fit: Fit
    noise: NoiseAudit
    stages: tuple[Stage, ...]
    unidentified: tuple[Unidentified, ...]
    exclusions: tuple[Exclusion, ...]
    anomalies: tuple[Anomaly, ...]
    preconditions: tuple[Precondition, ...]
    residuals: Residuals
    space: OperatingSpace
    model: ModelParameters
    test: TestResult | None = None
    notes: tuple[Note, ...] = ()
    standard: StandardGeometry | None = None
    given: GivenModel | None = None
    phases: tuple[PhaseEstimate, ...] = ()
    decoupled: Decoupled | None = None
    not_decoupled: str = ""
    estimate: GaussianEstimate = dataclasses.field(default_factory=GaussianEstimate.nothing)
    together: Together | None = None
    basis: object = None
