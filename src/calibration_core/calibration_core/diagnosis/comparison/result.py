"""What the comparison of a recording with a simulation of the same measurement says."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, Literal

from calibration_core.identification.result.estimate import Anomaly
from calibration_core.model.parameters import ModelParameters
from calibration_core.policy import CLEARLY
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Int1D, Readings

Side = Literal["simulation", "recording", "either"]
WHOSE: Mapping[Side, str] = {
    "simulation": "The recording agrees with the cell file, the simulation does not.",
    "recording": "The simulation agrees with the cell file, the recording does not.",
    "either": "Which of the two disagrees with the cell file cannot be determined.",
}


def farther_off(recording: float, simulation: float) -> Side:
    """Return the one that is clearly farther off; NaN decides nothing."""
    if recording > CLEARLY * simulation:
        return "recording"
    return "simulation" if simulation > CLEARLY * recording else "either"


@dataclasses.dataclass(frozen=True)
class Difference:
    """Something that differs between two recordings and is no physics: protocol, frames, signs, units, order.

    What is an anomaly of the input has its word.  `configurations`, `steps`, `points`, `loads` and
    `tracker_frame` are differences between the two and no anomaly of either.

    Attributes:
        kind: `joint_order`, `angle_unit`, `position_unit`, `point_order` (mirrored axes, too), `wrench_sign`,
            `wrench_unit`, `wrench_frame` (axes or reference point), `no_relation` (displacements beside positions),
            `wrong_robot_file` (another robot, or another sign or zero of a joint); of the simulation alone also
            `target_moved`, `loose_target`, `tracker_moved`, `outlier_readings`, `noise_understated`, `unsettled`; or
            one of the words above.
        location: What it concerns, as in a finding.
        side: Which of the two disagrees with the cell file; `either` where that cannot be determined.
        magnitude: Its size.
        text: One sentence.
        spoils: Whether deflections cannot be compared, and the side's physics not be trusted, because of it.
        remedy: How to put right the one that is at fault, in words; the recording where it may be either.
        further: `factor`, `joints`, `points` or `axes` of the anomaly.
    """

    kind: str
    location: Mapping[str, str]
    side: Side
    magnitude: float
    unit: str
    text: str
    spoils: bool
    remedy: str = ""
    further: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def of_recording(self) -> bool:
        """Whether the recording itself is, or may be, at fault: no physics can be read from it then.

        Other loads than simulated spoil the comparison, not the recording.
        """
        return self.spoils and self.kind != "loads" and self.side != "simulation"

    @property
    def sentence(self) -> str:
        """The text, and which of the two disagrees with the cell file where it matters."""
        return f"{self.text} {WHOSE[self.side]}" if self.spoils and self.kind != "loads" else self.text

    def as_anomaly(self) -> Anomaly:
        """Return it as an anomaly of the recording."""
        where, further = dict(self.location), dict(self.further)
        return Anomaly(self.kind, where, None, self.magnitude, self.unit, self.sentence, self.remedy, further)


@dataclasses.dataclass(frozen=True, eq=False)
class OwnFaults:
    """What is wrong with a simulation by itself: anomalies that a recording might have, too.

    Attributes:
        differences: The anomalies, said of the simulation.
        sound: (m,) readings of the simulation that can be compared.
        noise: m per coordinate, seen in the simulation where that is more than claimed; None: as claimed.
        note: Why nothing was looked for; empty where it was.
    """

    differences: tuple[Difference, ...]
    sound: Bool1D
    noise: float | None
    note: str = ""

    @property
    def nothing(self) -> bool:
        """Whether there is nothing to say."""
        return not self.differences and not self.note


@dataclasses.dataclass(frozen=True, eq=False)
class Reproduction:
    """Whether the core's model, with the cell file's values, gives what the simulation says.

    Attributes:
        reproduced: To the claimed noise.
        loaded_ratio: rms of what the cell file's model leaves of the deflections, in units of the claimed noise; NaN
            without loaded steps.
        refitted_ratio: The same after the stiffnesses are fitted to the simulation; NaN where that was not needed.
        absolute_rms: m per coordinate, distance of the positions from the cell file's; NaN for displacements.
        stiffness_change: Joint -> simulation's stiffness over the cell file's, less one; where they differ.
        text: One or two sentences.
        compliance: (n,) rad/(N*m) of the simulation, where the cell file's is another one and no more differs.
    """

    reproduced: bool
    loaded_ratio: float
    refitted_ratio: float
    absolute_rms: float
    stiffness_change: Mapping[str, float]
    text: str
    compliance: Float1D | None = None


@dataclasses.dataclass(frozen=True)
class PartDifference:
    """How recording and simulation differ in one configuration or step, or at one point.

    Attributes:
        name: Number or name.
        rms: m per coordinate.
        largest: m, longest difference of one reading.
        measured: m per coordinate, rms of what was recorded (deflection; 0 where nothing bends).
    """

    name: str
    rms: float
    largest: float
    measured: float


@dataclasses.dataclass(frozen=True, eq=False)
class StepByStep:
    """Deflections (loaded) or positions (absolute) of both, row by row, after the named differences are taken out.

    Attributes:
        rms: m per coordinate, of the difference.
        noise: m per coordinate, that two noisy recordings of the same would show.
        slope: Recorded deflection per simulated one, by least squares; NaN for positions.
        by_configuration: Largest difference first.
        by_step: In the order of steps.
        by_point: In the order of the points.
        grid: (c, s) m per coordinate, of every configuration in every step, both in order; NaN where nothing was read.
    """

    rms: float
    noise: float
    slope: float
    by_configuration: tuple[PartDifference, ...]
    by_step: tuple[PartDifference, ...]
    by_point: tuple[PartDifference, ...]
    grid: Float2D | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class ChangedNumber:
    """A number of the model before and after its step.

    Attributes:
        name: As in the model file; of a joint's stiffness `stiffness.JOINT`.
        before: What the cell file, or the simulation's model, says.
        after: What the whole model says.
        low, high: 95 % interval of `after`; NaN where none is known.
        unit: SI.
    """

    name: str
    before: float
    after: float
    low: float
    high: float
    unit: str

    @property
    def changed(self) -> bool:
        """Whether what stood before lies outside the interval."""
        return bool(self.before < self.low or self.before > self.high)


@dataclasses.dataclass(frozen=True, eq=False)
class WaterfallStep:
    """One step from the simulation to the noise.

    Attributes:
        name: `simulation`, `frames`, `geometry`, `stiffness`, a finding's effect, `noise`.
        what: In words.
        rms: m per coordinate that is left after it.
        held_out_rms: The same on configurations that the fit did not use; NaN where nothing is fitted.
        test_rms: The same on the test recording; NaN without one.
        share: Of the squared difference, that this step takes away; of `noise`, that is left at the end.
        changed: Its numbers.
        share_first: Of a finding, that it takes away where it comes before the stiffness and the other findings: what
            it has beyond `share`, others can take as well.  NaN for other steps.
        arrows: Configuration and point -> (3,) m, base axes: what is left at the largest load, less that at the least;
            of a position by itself.
    """

    name: str
    what: str
    rms: float
    held_out_rms: float
    test_rms: float
    share: float
    changed: tuple[ChangedNumber, ...] = ()
    share_first: float = float("nan")
    arrows: Mapping[tuple[int, str], Float1D] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True, eq=False)
class ComparedChannel:
    """One thing that both recordings say.

    Attributes:
        name: `fx` to `tz`, a joint, `temperature` or `time`.
        gain: Recorded over simulated, by least squares; NaN where that says nothing.
        rms: Of recorded less simulated.
        unit: Of it.
    """

    name: str
    gain: float
    rms: float
    unit: str


@dataclasses.dataclass(frozen=True)
class Witness:
    """What the two say differently of the same measurement, and which of them the measured positions contradict.

    Attributes:
        what: `wrench`, `joint angles`, `temperature` or `time`.
        wrong: Which of the two.
        channels: One by one.
        left: m per coordinate that the model leaves of configurations left out, with what the recording says and with
            what the simulation says; None where positions cannot judge.
        text: One sentence.
    """

    what: str
    wrong: Side
    channels: tuple[ComparedChannel, ...]
    left: tuple[float, float] | None
    text: str


@dataclasses.dataclass(frozen=True)
class FormatLoss:
    """What the files for one kind of simulator cannot hold of the improved model.

    Attributes:
        effects: What they leave out, in words.
        costs: m per coordinate that this adds to what the whole model leaves, squares added.
    """

    files: tuple[str, ...]
    effects: tuple[str, ...]
    costs: float


@dataclasses.dataclass(frozen=True, eq=False)
class ImprovedSimulation:
    """The recording simulated once more, by the model that is handed out.

    Attributes:
        rms: m per coordinate, recording less this simulation.
        test_rms: The same of the test recording; NaN without one.
        left_by: Returns `rms` of another model.
        losses: What each format of the model leaves out.
    """

    rms: float
    test_rms: float
    left_by: Callable[[ModelParameters], float]
    losses: tuple[FormatLoss, ...] = ()


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison:
    """Two recordings of one measurement, one of them simulated.

    Attributes:
        readings: How many readings correspond.
        configurations: How many configurations correspond.
        reproduction: Whether the core's model is the simulation's.
        differences: No physics; found before any.
        steps: Row by row; None where the two cannot be compared so.
        postures: Beside deflections, the positions of configurations with one step; None where there are none.
        sentences: The whole in words.
        witnesses: What the two say differently of loads, angles and conditions.
        rows: Rows of the recording that correspond.
        simulated: What the simulation says at these, as it was read.
        waterfall: From the simulation to the noise; empty where the two cannot be compared so.
        pattern: The strongest pattern of the difference in words; empty where there is none.
        improved: The simulation by the model that is handed out; None without a waterfall.
    """

    recording: str
    simulation: str
    sha256: Mapping[str, str]
    readings: int
    configurations: int
    reproduction: Reproduction
    differences: tuple[Difference, ...]
    steps: StepByStep | None
    postures: StepByStep | None
    sentences: tuple[str, ...]
    witnesses: tuple[Witness, ...]
    rows: Int1D
    simulated: Readings
    waterfall: tuple[WaterfallStep, ...] = ()
    pattern: str = ""
    improved: ImprovedSimulation | None = None

    @property
    def recording_spoiled(self) -> bool:
        """Whether the recording itself is, or may be, the one that is mixed up: no physics can be read from it then."""
        return any(difference.of_recording for difference in self.differences)
