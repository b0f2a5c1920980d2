"""What several recordings of one robot contribute to a common identification, and whether they agree."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping


@dataclasses.dataclass(frozen=True, eq=False)
class Contribution:
    """What one of several recordings that are evaluated together contributes.

    Attributes:
        file: The recording, as its user named it.
        number: From 1; its points are called POINT@NUMBER.
        cell: Its cell file.
        cell_sha256: Digest of that file.
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
        file: The recording.
        parameter: Name, as in the model file.
        location: Its joint.
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
