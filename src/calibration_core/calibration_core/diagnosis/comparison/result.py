"""What the comparison of a recording with a simulation of the same measurement says."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Literal

from calibration_core.identification.result.estimate import Anomaly

Side = Literal["simulation", "recording", "either"]
CLEARLY = 3.0  # times worse than the other


def farther_off(recording: float, simulation: float) -> Side:
    """Return the one that is clearly farther off; NaN decides nothing."""
    if recording > CLEARLY * simulation:
        return "recording"
    return "simulation" if simulation > CLEARLY * recording else "either"


@dataclasses.dataclass(frozen=True)
class Difference:
    """Something that differs between two recordings and is no physics: protocol, frames, signs, units, order.

    Attributes:
        kind: Short stable word: `configurations`, `steps`, `points`, `joints_swapped`, `joint_sign`, `joint_zero`,
            `angle_unit`, `length_unit`, `points_swapped`, `mirrored_axes`, `tracker_frame`, `displacements`,
            `wrong_robot_file`, `loads`, `wrench_sign`, `wrench_unit`, `wrench_axes`, `wrench_reference`.
        location: What it concerns, as in a finding.
        side: Which of the two disagrees with the cell file; `either` where that cannot be determined.
        magnitude: Its size.
        unit: Of the size.
        text: One sentence.
        spoils: Whether deflections cannot be compared, and the side's physics not be trusted, because of it.
    """

    kind: str
    location: Mapping[str, str]
    side: Side
    magnitude: float
    unit: str
    text: str
    spoils: bool

    def as_anomaly(self) -> Anomaly:
        """Return it as an anomaly of the diagnosis."""
        return Anomaly(self.kind, self.location, None, self.magnitude, self.unit, self.text)


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
    sentences: tuple[str, ...]

    @property
    def recording_spoiled(self) -> bool:
        """Whether the recording itself is, or may be, the one that is mixed up: no physics can be read from it then.

        Other loads than simulated spoil the comparison, not the recording.
        """
        return any(d.spoils and d.kind != "loads" and d.side != "simulation" for d in self.differences)
