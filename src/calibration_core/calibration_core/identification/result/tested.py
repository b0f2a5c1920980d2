"""How a model does on a second recording that was not used in the fit, as a whole and part by part."""

from __future__ import annotations

import dataclasses
from collections.abc import Container, Mapping, Sequence
from typing import Literal

import numpy as np

from calibration_core.timeseries import Float2D, Readings

PartKind = Literal["loaded", "at_rest"]
MISFIT = 1.5  # times the noise: an error on what was not fitted that is none
WORSE = 1.05  # times the error of the model that it is compared with
PARTS: Mapping[PartKind, str] = {"loaded": "differences under load", "at_rest": "postures at rest"}


@dataclasses.dataclass(frozen=True, eq=False)
class TestPart:
    """How two models do on the part of a second recording that shows one kind of thing.

    Figures that the part does not allow are NaN.

    Attributes:
        kind: `loaded`: differences under load, in configurations with several steps; `at_rest`: positions of postures
            with one step, after tracker pose and targets of this recording were fitted to them.
        configurations: Number of configurations.
        readings: Number of readings that count.
        rms: Per coordinate, m.
        mean, maximum: Of the 3-d error, m.
        rms_before: Per coordinate with the model that it is compared with, m.
        mean_before: Mean 3-d error with that model, m.
        reason: Why the figures are missing or say nothing, or what else is to be known of them; empty otherwise.
    """

    __test__ = False

    kind: PartKind
    configurations: int
    readings: int
    rms: float
    mean: float
    maximum: float
    rms_before: float
    mean_before: float
    reason: str = ""

    @classmethod
    def of(cls, kind: PartKind, configurations: int, after: Float2D, before: Float2D) -> TestPart:
        """Sum up what two models leave of a part, (m, 3) m each."""
        return cls(kind, configurations, len(after), *_sizes(after, before))

    @classmethod
    def without_figures(cls, kind: PartKind, configurations: int, readings: int, reason: str) -> TestPart:
        """Return a part that says nothing, and why."""
        nothing = float("nan")
        return cls(kind, configurations, readings, nothing, nothing, nothing, nothing, nothing, reason)


@dataclasses.dataclass(frozen=True)
class TestResult:
    """How the identified model does on a second recording that was not used in the fit (`--test`).

    Attributes:
        readings: Number of readings.
        rms: Per coordinate, m, after the best offsets (loaded) or with the fitted frames (absolute); frames that only
            loaded steps have shown are fitted to postures at rest again.
        mean, maximum: Of the 3-d error, m.
        rms_before: Per coordinate with the cell file's model, m; a diagnosis: with the null model's stiffness.
        mean_before: Mean 3-d error with that model, m.
        sha256: File name -> SHA-256 hex digest of every file of the second recording.
        parts: Its loaded part and its postures at rest, each by itself.
        reason: What of it says nothing, and why; empty where all of it does.
        own_frames: Whether its tracker or targets stand elsewhere, so that all figures are with its own.
    """

    __test__ = False

    file: str
    readings: int
    rms: float
    mean: float
    maximum: float
    rms_before: float
    mean_before: float
    sha256: Mapping[str, str] = dataclasses.field(default_factory=dict)
    parts: tuple[TestPart, ...] = ()
    reason: str = ""
    own_frames: bool = False

    @classmethod
    def of(
        cls, readings: Readings, parts: Sequence[TestPart], after: Float2D, before: Float2D, *, own_frames: bool
    ) -> TestResult:
        """Sum up what two models leave of a recording.

        Args:
            readings: The recording.
            parts: Its parts by themselves.
            after: (m, 3) m, left by the identified model, of the readings that count.
            before: (m, 3) m, left by the model that it is compared with.
            own_frames: Whether they are with frames of the recording's own, which stand elsewhere.
        """
        return cls(
            readings.provenance.path,
            len(after),
            *_sizes(after, before),
            sha256=readings.provenance.sha256,
            parts=tuple(parts),
            reason="; ".join(f"{PARTS[part.kind]}: {part.reason}" for part in parts if part.reason),
            own_frames=own_frames,
        )

    def beyond(self, noise: float, kinds: Container[PartKind]) -> TestPart | None:
        """Return the part that shows most clearly that a model leaves more than noise; None where none does.

        Args:
            noise: Standard deviation of a coordinate, m.
            kinds: Of the parts that the fitted recording speaks of.
        """
        parts = [one for one in self.parts if one.kind in kinds and one.rms > MISFIT * noise]
        return max(parts, key=lambda one: one.rms, default=None)

    def worse(self, standard: TestResult, noise: float) -> tuple[TestPart, TestPart] | None:
        """Return a part that the model predicts worse than the standard's does, beyond the noise, as both predict it.

        The errors of both hold the same noise, so that their squares are compared: the noise makes their difference
        uncertain by 2 sigma |difference| over all coordinates (here: sigma times the larger).

        Args:
            standard: What the standard's model does on the same recording.
            noise: Standard deviation of a coordinate, m.
        """
        for one, other in zip(self.parts, standard.parts, strict=True):
            uncertain = 2 * noise * one.rms / np.sqrt(3 * one.readings)
            if one.rms > WORSE * other.rms and one.rms**2 - other.rms**2 > 2 * uncertain:
                return one, other
        return None


def _sizes(after: Float2D, before: Float2D) -> tuple[float, float, float, float, float]:
    """Return rms, mean, maximum, and rms and mean before, of errors of two models, (m, 3) m each."""
    lengths, nominal = np.linalg.norm(after, axis=1), np.linalg.norm(before, axis=1)
    return (
        float(np.sqrt(np.mean(after**2))),
        float(lengths.mean()),
        float(lengths.max()),
        float(np.sqrt(np.mean(before**2))),
        float(nominal.mean()),
    )
