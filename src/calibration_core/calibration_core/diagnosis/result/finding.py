"""What a diagnosis says."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

import numpy as np

from calibration_core.diagnosis.comparison.result import Comparison
from calibration_core.diagnosis.location import Located
from calibration_core.identification.result.estimate import Anomaly, Identification
from calibration_core.identification.result.tested import TestResult
from calibration_core.model.effects import effect_named
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.effects.words import effect_sentence, effect_words
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import NO_INTERVALS, Bool1D, Float1D, Float2D, Note

Location = Mapping[str, str | tuple[str, ...]]
EMPIRICAL = "empirical"  # family of a law that fits and is no physics
HANDED_OUT, FRAMES = "model", "frames"
ANSWERED = frozenset({NO_INTERVALS, HANDED_OUT, FRAMES})  # kinds of notes that belong to the answer
Verdict = Literal["consistent", "missing_physics", "partly_explained", "unexplained"]


@dataclasses.dataclass(frozen=True)
class FoundParameter:
    """One parameter of a finding.

    Attributes:
        value: In its unit.
        std: Standard deviation; zero for what is no estimate.
        least: The smallest value that physics allows.
    """

    name: str
    value: float
    std: float
    unit: str
    least: float = -math.inf

    @property
    def interval(self) -> tuple[float, float]:
        """The values that physics allows within 1.96 standard deviations."""
        return max(self.value - 1.96 * self.std, self.least), self.value + 1.96 * self.std


@dataclasses.dataclass(frozen=True)
class Alternative:
    """Another hypothesis that the recording cannot tell from the finding.

    Attributes:
        log_bayes_factor: nats, beside that of the finding.
    """

    effect: str
    family: str
    location: Location
    log_bayes_factor: float


@dataclasses.dataclass(frozen=True)
class Finding:
    """One effect that is missing in the model.

    Attributes:
        location: Where; a joint or link is left open (empty) where too many come into question.
        variant: Form of the law, as in the catalogue.
        parameters: With 95 % = 1.96 std intervals.
        log_bayes_factor: Against the model without it, nats.
        held_out_gain: Share by which the squared error on configurations left out falls.
        magnitude: Root mean square of the shift that it causes at the measured points, m.
        explanation: For a person: what, where, how sure, how much.
        separate_by: The measurement that would decide, or confirm it.
        cannot_be_told_from: At most five, nearest first.
        stiffness_change: Joint -> relative change of its stiffness once the effect is in the model.
        refinements: Further terms of the same cause (other law, neighbour), by effect name and location.
        law_settled: Whether the form of the law is settled; where not, joint and kind are.
        shared_size: Standard deviation that the parameters of a family share; None where there is none.
    """

    effect: str
    family: str
    location: Location
    variant: str
    parameters: tuple[FoundParameter, ...]
    log_bayes_factor: float
    held_out_gain: float
    magnitude: float
    explanation: str
    separate_by: str
    cannot_be_told_from: tuple[Alternative, ...] = ()
    stiffness_change: Mapping[str, float] = dataclasses.field(default_factory=dict)
    refinements: tuple[str, ...] = ()
    law_settled: bool = True
    shared_size: FoundParameter | None = None


def by_size(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings in order: largest effect on the measured points first."""
    return tuple(sorted(findings, key=lambda finding: -finding.magnitude))


@dataclasses.dataclass(frozen=True)
class Rest:
    """What remains after the findings.

    Attributes:
        rms: Excess over the noise, per coordinate, m.
        significant: Whether noise does not explain it.
        where: Words and numbers on where and when it is largest.
        text: One sentence.
    """

    rms: float
    significant: bool
    where: Mapping[str, object]
    text: str

    def also(self, text: str, where: Mapping[str, object], rms: float = 0.0) -> Rest:
        """Return what remains with something else that noise does not explain: said, where, and how large, m."""
        before = f"{self.text} " if self.significant else ""
        return Rest(max(self.rms, rms), True, where, f"{before}{text}")

    def verdict(self, *, found: bool) -> Verdict:
        """Return what is said of a recording in which something is found, or nothing, and this remains."""
        if found:
            return "partly_explained" if self.significant else "missing_physics"
        return "unexplained" if self.significant else "consistent"


@dataclasses.dataclass(frozen=True)
class ProposedMeasurement:
    """A proposed next measurement.

    Attributes:
        q: Joint angles, rad.
        wrench: Base axes at the wrench point, N and N*m.
        why: What it would decide, and by how much.
        steps: The wrenches of its load steps, the first unloaded.
        gain: What it is expected to bring.
        gain_at_random: What a configuration taken at random is expected to bring (median).
        gain_unit: `nats` of log Bayes factor, or `%` of a value's standard deviation.
    """

    q: tuple[float, ...]
    wrench: tuple[float, ...]
    why: str
    steps: tuple[tuple[float, ...], ...] = ()
    gain: float = 0.0
    gain_at_random: float = 0.0
    gain_unit: str = ""


@dataclasses.dataclass(frozen=True, eq=False)
class Diagnosis:
    """The complete answer of `calibration diagnose`.

    Attributes:
        verdict: One of the verdicts of result.json.
        findings: Largest effect on the measured point first; empirical laws among them are no physics.
        anomalies: Found before any physics.
        rest: What remains.
        next_measurements: What would separate what is confounded now.
        identification: The null model: what `identify` says of the recording.
        stiffness: Joint -> (value, std) in the extended model, N*m/rad.
        rms_before, rms_after: Per coordinate over all readings (under load those used), m; before is the refitted null
            model.
        held_out_before, held_out_after: The same on configurations left out.
        noise: Standard deviation of one coordinate, as used, m.
        level: Signal-to-noise ratio of the small effects allowed for.
        located: Sentences of the model-free location.
        residual: (m, 3) m, what the extended model leaves.
        shift: (m, 3) m, what the findings explain.
        moved: (m, 3) m, tracker axes, of readings after tracker or target moved; None where offsets hide it.
        used: (m,) readings that were not set aside; None: those that the identification used.
        compliance: (n,) rad/(N*m) of the extended model.
        blocks: Kind of block left out (`time`, `posture`) -> 3-d rms before and after, m; absolute recordings only.
        test: Result on a recording that was not fitted, if one was given.
        model: The extended model, as it is written to a file; None where there is none.
        estimate: Everything accepted in `model`, with its joint covariance.
        aliases: What this kind of recording can never tell apart, in sentences.
        further_figures: More figures of the fit for result.json, by name.
        comparisons: Of a recording with a simulation of the same measurement, as far as simulations were given.
        residual_before: (m, 3) m, what the null model leaves, without offsets where these are free.
        where: The location without a hypothesis, in numbers.
        next_text: What no further measurement of this kind can decide, or why none is proposed.
        compliance_covariance: (n, n) of `compliance`, (rad/(N*m))^2; None where it was not fitted.
        rms_used: As `rms_after`, without the readings set aside, m; None where these are no part of it.
    """

    verdict: Verdict
    findings: tuple[Finding, ...]
    anomalies: tuple[Anomaly, ...]
    rest: Rest
    next_measurements: tuple[ProposedMeasurement, ...]
    identification: Identification
    stiffness: Mapping[str, tuple[float, float]]
    rms_before: float
    rms_after: float
    held_out_before: float
    held_out_after: float
    noise: float
    level: float
    located: tuple[str, ...]
    residual: Float2D
    shift: Float2D
    compliance: Float1D
    blocks: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    test: TestResult | None = None
    model: ModelParameters | None = None
    aliases: tuple[str, ...] = ()
    moved: Float2D | None = None
    used: Bool1D | None = None
    further_figures: Mapping[str, float] = dataclasses.field(default_factory=dict)
    comparisons: tuple[Comparison, ...] = ()
    residual_before: Float2D | None = None
    where: Located | None = None
    next_text: str = ""
    compliance_covariance: Float2D | None = None
    rms_used: float | None = None
    estimate: GaussianEstimate = dataclasses.field(default_factory=GaussianEstimate.nothing)

    @property
    def recording_spoiled(self) -> bool:
        """Whether a recording is, or may be, mixed up against its simulation."""
        return any(one.recording_spoiled for one in self.comparisons)

    @property
    def noise_known(self) -> float:
        """Standard deviation of one coordinate: as used, or as the readings show it where they were claimed better."""
        return max((a.magnitude for a in self.anomalies if a.kind == "noise_understated"), default=self.noise)

    @property
    def handed_out(self) -> tuple[ModelParameters, GaussianEstimate]:
        """The model that is written for use, with its uncertainty: the extended one, else the standard's."""
        if self.model is None:
            return self.identification.model, self.identification.estimate
        return self.model, self.estimate

    @property
    def remarks(self) -> tuple[Note, ...]:
        """Notes that belong to the answer: which model is written, what the cell file has elsewhere."""
        return tuple(note for note in self.identification.notes if note.kind in ANSWERED)

    @property
    def physics(self) -> tuple[Finding, ...]:
        """Findings that are effects of the catalogue, not empirical laws."""
        return tuple(finding for finding in self.findings if finding.family != EMPIRICAL)


SCALE = ((100.0, "overwhelming"), (5.0, "very strong"), (3.0, "strong"), (1.0, "positive"))
UNSETTLED = " The joint and the kind of cause are settled, the form of its law is not: another law remains beside it."
OF_ANY_LAW = (
    " The joint and the kind of cause are settled, the form of its law is not: it is none of the catalogue's, or an "
    "error of the joint's gear is part of it."
)
MOST = 1_000  # of odds, of which nobody needs the number


def evidence_words(log_bayes_factor: float) -> str:
    """Return for example `very strong evidence`."""
    return next((word for least, word in SCALE if log_bayes_factor >= least), "hardly any") + " evidence"


def odds_words(log_bayes_factor: float) -> str:
    """Return by what a log Bayes factor, nats, changes the odds of two explanations, for example `12-fold`."""
    if log_bayes_factor > math.log(MOST):
        return f"more than {MOST:,}-fold"
    factor = math.exp(log_bayes_factor)
    return f"{factor:.0f}-fold" if factor >= 10.0 else f"{factor:.1f}-fold"


# --- what findings of every kind are made of --------------------------------------------------------------------------


def found_parameters(
    candidate: Candidate, value: Float1D, covariance: Float2D, suffix: str = ""
) -> tuple[FoundParameter, ...]:
    """Return the parameters of an effect.

    Args:
        candidate: The effect.
        value: (k,) in the units of its parameters.
        covariance: (k, k).
        suffix: Of their names.
    """
    std = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    return tuple(
        FoundParameter(p.name + suffix, float(v), float(s), p.unit, 0.0 if p.positive else -math.inf)
        for p, v, s in zip(candidate.parameters, value, std, strict=True)
    )


def opening(effect: str, location: Location, more: str = "") -> str:
    """Return an effect and its place as the beginning of a sentence."""
    words = effect_sentence(effect, location) + more
    return words[0].upper() + words[1:]


def confounded_with(alternatives: Sequence[Alternative]) -> str:
    """Return what the recording cannot distinguish from a finding, as a further sentence; empty where nothing is."""
    if not alternatives:
        return ""
    names = "; ".join(effect_sentence(one.effect, one.location) for one in alternatives)
    return f" This recording cannot distinguish it from: {names}."


def separating(effects: Iterable[str]) -> str:
    """Return the measurements that would decide between effects, by name."""
    return "; ".join(f"{effect_words(name)}: {effect_named(name).reveal}" for name in dict.fromkeys(effects))
