"""An input that is not what it claims to be: of which kind it is, what shows it, and how to put it right."""

from __future__ import annotations

import dataclasses
from typing import Any

ROBOT = "robot"
OF_ROBOT = frozenset({"wrong_robot_file", "joint_order", "no_relation", "angle_unit", "joint_coupling"})


@dataclasses.dataclass(frozen=True)
class InputAnomaly:
    """One thing about the input that has to be put right.

    Attributes:
        kind: One of the kinds, e.g. `wrench_sign`.
        text: One sentence: what is seen, with the figures as recorded and with the fault put right.
        remedy: What to do, in words.
        magnitude: Share of the motion that the recording as it stands leaves unexplained, or the size of what is wrong.
        unit: Its unit.
        factor: What to multiply with, where it is a unit.
        joints: The joints concerned.
        points: The measurement points concerned.
        axes: What to read the wrench in, where it is a frame.
        place: Where it is; empty: what the kind says.
        recording: Of several recordings, the file of the one that it concerns; empty: one alone.
    """

    kind: str
    text: str
    remedy: str
    magnitude: float
    unit: str = "1"
    factor: float | None = None
    joints: tuple[str, ...] = ()
    points: tuple[str, ...] = ()
    axes: str = ""
    place: str = ""
    recording: str = ""

    @property
    def blocks(self) -> bool:
        """Whether nothing may be claimed before it is put right."""
        return self.kind != "noise_overstated"

    def of_recording(self, file: str) -> InputAnomaly:
        """Return the same of one of several recordings, which its sentences name."""
        text, remedy = (f"in {file}, {sentence}" for sentence in (self.text, self.remedy))
        return dataclasses.replace(self, recording=file, text=text, remedy=remedy)

    @property
    def location(self) -> dict[str, str]:
        """Where it is, as in a finding."""
        usual = "sensor" if self.kind.startswith("wrench") else ROBOT if self.kind in OF_ROBOT else "tracker"
        where = self.place or usual
        return {where: where} | ({"recording": self.recording} if self.recording else {})

    def record(self) -> dict[str, Any]:
        """Return it as result.json has it; keys that do not apply are left out."""
        content: dict[str, Any] = {
            "kind": self.kind,
            "location": self.location,
            "configurations": None,
            "magnitude": self.magnitude,
            "unit": self.unit,
            "text": self.text,
            "remedy": self.remedy,
        }
        further = {
            "factor": self.factor,
            "joints": list(self.joints),
            "points": list(self.points),
            "axes": self.axes,
        }
        return {**content, **{key: value for key, value in further.items() if value not in (None, [], "")}}
