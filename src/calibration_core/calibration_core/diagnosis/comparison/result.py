"""What the comparison of a recording with a simulation of the same measurement says."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal

from calibration_core.identification.result.estimate import Anomaly
from calibration_core.timeseries import Bool1D

Side = Literal["simulation", "recording", "either"]
CLEARLY = 3.0  # times worse than the other
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

    What the contract lists as an anomaly has the contract's word.  `configurations`, `steps`, `points`, `loads` and
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
        unit: Of the size.
        text: One sentence.
        spoils: Whether deflections cannot be compared, and the side's physics not be trusted, because of it.
        remedy: How to put the recording right where it is at fault, in words.
        further: `factor`, `joints`, `points` or `axes` of the anomaly, as the contract has them.
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


@dataclasses.dataclass(frozen=True)
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
    """

    reproduced: bool
    loaded_ratio: float
    refitted_ratio: float
    absolute_rms: float
    stiffness_change: Mapping[str, float]
    text: str


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


@dataclasses.dataclass(frozen=True)
class StepByStep:
    """Deflections (loaded) or positions (absolute) of both, row by row, after the named differences are taken out.

    Attributes:
        rms: m per coordinate, of the difference.
        noise: m per coordinate, that two noisy recordings of the same would show.
        slope: Recorded deflection per simulated one, by least squares; NaN for positions.
        by_configuration: Largest difference first.
        by_step: In the order of steps.
        by_point: In the order of the points.
    """

    rms: float
    noise: float
    slope: float
    by_configuration: tuple[PartDifference, ...]
    by_step: tuple[PartDifference, ...]
    by_point: tuple[PartDifference, ...]


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Two recordings of one measurement, one of them simulated.

    Attributes:
        recording: The recording's file.
        simulation: The simulation's file.
        sha256: Of its files, by name.
        readings: How many readings correspond.
        configurations: How many configurations correspond.
        reproduction: Whether the core's model is the simulation's.
        differences: No physics; found before any.
        steps: Row by row; None where the two cannot be compared so.
        postures: Beside deflections, the positions of configurations with one step; None where there are none.
        sentences: The whole in words.
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

    @property
    def recording_spoiled(self) -> bool:
        """Whether the recording itself is, or may be, the one that is mixed up: no physics can be read from it then."""
        return any(difference.of_recording for difference in self.differences)
