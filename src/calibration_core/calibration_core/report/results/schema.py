"""The schema of result.json: what evaluating commands write, for programs and the reference.

Further keys may follow those of the schema; a program that does not know them passes over them.
"""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

Number = float | None  # None: not finite, or not known


class _Open(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True)


class RecordingEntry(_Open):
    """What was evaluated, planned or written."""

    file: str = Field(description="Path as the command was given it.")
    configurations: int
    steps: int = Field(description="Configurations times load steps.")
    points: list[str] = Field(description="Names of the measurement points.")
    loaded: bool = Field(description="Whether it carries loaded-minus-unloaded differences.")


class StiffnessEntry(_Open):
    """Stiffness of one joint."""

    joint: str
    value: Number = Field(description="In `unit`; null where it is not finite.")
    std: Number = Field(description="One standard deviation, in `unit`.")
    unit: Literal["N*m/rad", "N/m"]
    identifiable: bool = Field(description="Whether the recording determines it.")


class FitEntry(_Open):
    """Root mean squares per coordinate, over all readings, after the best frames; held out: whole configurations."""

    rms_before: Number = Field(description="Without the findings; identification: with the cell file's stiffness.")
    rms_after: Number
    held_out_rms_before: Number
    held_out_rms_after: Number
    noise: Number = Field(description="Standard deviation of one coordinate that the instruments explain.")
    unit: Literal["m"]
    held_out_freedom: int | None = Field(
        default=None, description="Independent coordinates behind `held_out_rms_*`: offsets are taken out of them."
    )
    positions_rms: Number = Field(
        default=None,
        description="Of absolute positions beside loads: tracker and targets fitted, geometry as in the model.",
    )


class ParameterEntry(_Open):
    """One parameter of a finding."""

    name: str
    value: float
    std: Number
    unit: str


class EvidenceEntry(_Open):
    """How sure a finding is, and how large."""

    log_bayes_factor: float = Field(description="Natural logarithm, against the model without it.")
    held_out_gain: float = Field(description="Share by which the squared error on configurations left out falls.")
    magnitude: float = Field(description="Root mean square motion of the measured points, m.")
    unit: Literal["m"]


class AlternativeEntry(_Open):
    """Another effect that the recording cannot distinguish from the finding."""

    effect: str
    location: dict[str, str | list[str]]
    log_bayes_factor: float


class FindingEntry(_Open):
    """One effect that the model leaves out."""

    effect: str = Field(description="Name in the catalogue of effects.")
    family: str
    location: dict[str, str | list[str]] = Field(description='For example {"joint": "joint_2"}; empty: open.')
    parameters: list[ParameterEntry]
    evidence: EvidenceEntry
    cannot_be_told_from: list[AlternativeEntry] = Field(description="At most five, nearest first.")
    explanation: str
    separate_by: str = Field(description="The measurement that would decide, or confirm it.")


class AnomalyEntry(_Open):
    """Something wrong with the data that is no physics of the robot."""

    kind: str
    location: dict[str, str | int | list[str]]
    configurations: list[int] | None = Field(description="First and last one concerned; null: all.")
    magnitude: Number
    unit: str


class UnexplainedEntry(_Open):
    """What remains after the findings."""

    rms: float = Field(description="Excess over the noise, per coordinate, m.")
    significant: bool
    where: dict[str, object]


class MeasurementEntry(_Open):
    """A proposed next measurement."""

    q: list[float] = Field(description="rad (m where a joint slides).")
    wrench: list[float] = Field(description="N and N*m, base axes, at the wrench point.")
    why: str


class ResultFile(_Open):
    """result.json."""

    model_config = ConfigDict(extra="allow", strict=True, title="result.json")

    schema_: Literal[1] = Field(alias="schema")
    command: str
    robot: str = Field(description="Name of the robot in the cell file.")
    recording: RecordingEntry
    stiffness: list[StiffnessEntry]
    fit: FitEntry
    verdict: Literal["consistent", "missing_physics", "partly_explained", "unexplained"]
    findings: list[FindingEntry] = Field(description="Largest motion of the measured points first.")
    anomalies: list[AnomalyEntry]
    unexplained: UnexplainedEntry
    next_measurements: list[MeasurementEntry]
    usable: Literal["yes", "with_reservations", "no"] | None = Field(
        default=None, description="The traffic light; of commands that evaluate or judge a recording."
    )
    reason: str | None = Field(default=None, description="Why it is usable or not.")
    reasons: list[str] | None = Field(default=None, description="The reservations that `reason` joins.")
    next_step: str | None = Field(default=None, description="What to do next; empty: nothing.")
    summary: list[str] | None = Field(default=None, description="The lines that the terminal prints.")
