"""A diagnosis in a few lines for the terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration_core.diagnosis.comparison.result import Comparison, ImprovedSimulation, WaterfallStep
from calibration_core.diagnosis.result.finding import Diagnosis, Finding, evidence_words
from calibration_core.model.effects.words import effect_sentence
from calibration_core.report.rounding import counted
from calibration_core.report.sections.together import together_lines
from calibration_core.report.summary import positions_lines, test_lines

SHARED = 0.02  # of the squared difference: shared with other steps, and worth a word
LEAST, NAMED = 0.001, 3  # share of the squared difference that the sentence names, and how many of them
TOGETHER = "several recordings at once have no steps from simulation to noise: diagnose each with its own --simulation"
VERDICTS = {
    "consistent": "nothing is missing: the model explains the recording to its noise",
    "missing_physics": "physics is missing in the model, and the findings explain the recording to its noise",
    "partly_explained": "physics is missing in the model, and nothing in the catalogue explains a significant residual",
    "unexplained": "a significant residual remains, and nothing in the catalogue explains it",
}


def headline(diagnosis: Diagnosis) -> str:
    """Return the verdict in words; nothing is called complete above anomalies, or a claim of noise that is too low."""
    if diagnosis.recording_spoiled:
        return "no physics is claimed before recording and simulation are put right"
    if diagnosis.verdict != "consistent" or not diagnosis.anomalies:
        return VERDICTS[diagnosis.verdict]
    if any(anomaly.kind == "noise_understated" for anomaly in diagnosis.anomalies):
        return "no missing physics is seen, but the recording is noisier than the cell file claims"
    return "no missing physics is seen beside the anomalies"


def diagnosis_summary(diagnosis: Diagnosis) -> str:
    """Return verdict, anomalies, findings, figures and what to measure next, a line each; the report says more."""
    lines = [f"verdict: {diagnosis.verdict}: {headline(diagnosis)}"]
    if diagnosis.identification.together is not None:
        lines += together_lines(diagnosis.identification.together)
    for compared in diagnosis.comparisons:
        lines += [f"simulation of {compared.recording}: {sentence}" for sentence in compared.sentences]
    if diagnosis.comparisons:
        lines.append(TOGETHER)
    lines += [f"anomaly: {anomaly.kind}: {anomaly.text}" for anomaly in diagnosis.anomalies]
    for number, finding in enumerate(diagnosis.findings, start=1):
        lines.append(f"{number}. {_finding(finding)}")
    lines.append(
        f"residual per coordinate {_um(diagnosis.rms_before)} -> {_um(diagnosis.rms_after)}{used_text(diagnosis)}, "
        f"on configurations left out {_um(diagnosis.held_out_before)} -> {_um(diagnosis.held_out_after)}, "
        f"noise {_um(diagnosis.noise)}"
    )
    lines += positions_lines(diagnosis.identification)
    if diagnosis.test is not None:
        lines += test_lines(diagnosis.test)
    lines.append(diagnosis.rest.text)
    if diagnosis.next_measurements:
        first = diagnosis.next_measurements[0].why
        count = counted(len(diagnosis.next_measurements), "configuration")
        lines.append(f"worth measuring next: {count} in next.yaml; the first {first}")
    lines.append(diagnosis.next_text)
    lines += [note.line for note in diagnosis.remarks]
    return "\n".join(line for line in lines if line)


def compared_summary(diagnosis: Diagnosis, compared: Comparison, light: Sequence[str]) -> list[str]:
    """Return the answer of one recording beside its simulation: what differs, how it becomes the noise, what to use."""
    lines = [*light, f"verdict: {diagnosis.verdict}: {headline(diagnosis)}"]
    lines += [one.sentence for one in compared.differences]
    lines += waterfall_lines(compared.waterfall) or list(compared.sentences[-2:])
    if compared.improved is not None:
        lines += improved_lines(compared.improved)
    lines += [one.text for one in compared.witnesses if one.left is not None]
    lines += [compared.pattern] if compared.pattern else []
    shown = " ".join(light)
    lines += [f"anomaly: {one.kind}: {one.text}" for one in diagnosis.anomalies if one.text.rstrip(".") not in shown]
    lines += [diagnosis.rest.text] if diagnosis.rest.significant else []
    return lines + [note.line for note in diagnosis.remarks]


def waterfall_lines(steps: Sequence[WaterfallStep]) -> list[str]:
    """Return how the difference of recording and simulation becomes the noise: one sentence, and a line for a step."""
    if not steps:
        return []
    whole, *between, noise = steps
    largest = sorted((step for step in between if step.share > LEAST), key=lambda step: -step.share)[:NAMED]
    taken = [f"{1e6 * whole.rms * step.share**0.5:.1f} {step.name}" for step in largest]
    sentence = (
        f"of {_um(whole.rms)} between the two: {', '.join([*taken, f'{1e6 * noise.rms:.1f} noise'])} (squares add up)"
    )
    shown = (step for step in between if abs(step.share) > LEAST or any(one.changed for one in step.changed))
    return [sentence, *(f"  {_um(step.rms):>11} {step.name}: {step.what}{_shared(step, whole.rms)}" for step in shown)]


def _shared(step: WaterfallStep, whole: float) -> str:
    """Say how much of a finding's part the steps before it could have left to it."""
    shared = step.share_first - step.share
    return f"; {_um(whole * shared**0.5)} shared with the stiffness" if shared > SHARED else ""


def improved_lines(improved: ImprovedSimulation) -> list[str]:
    """Return what the improved simulation leaves, and what each format of its model cannot hold."""
    tested = f", of the test recording {_um(improved.test_rms)}" if np.isfinite(improved.test_rms) else ""
    losses = "; ".join(
        f"{' with '.join(one.files)} {f'lacks {_um(one.costs)}' if one.effects else 'holds everything'}"
        for one in improved.losses
    )
    return [
        f"  {_um(improved.rms):>11} simulation.csv, by model.yaml: the improved simulation{tested}",
        f"of its model, {losses}",
    ]


def _finding(finding: Finding) -> str:
    """Return a finding in a line: what and where, how large, how sure."""
    others = ((one.effect, one.location) for one in finding.cannot_be_told_from)
    alike = [effect_sentence(effect, place) for effect, place in ((finding.effect, finding.location), *others)]
    law = "" if finding.law_settled else "; the form of its law is open"
    return (
        f"{' or '.join(dict.fromkeys(alike))}: moves the points by {_um(finding.magnitude)} rms; "
        f"{evidence_words(finding.log_bayes_factor)}, and the squared error on configurations left out falls by "
        f"{100 * finding.held_out_gain:z.0f} %{law}"
    )


def used_text(diagnosis: Diagnosis) -> str:
    """Return what the readings leave that were not set aside, in parentheses; empty where none was."""
    used = diagnosis.rms_used
    return "" if used is None else f" ({_um(used)} without the readings set aside)"


def _um(value: float) -> str:
    return f"{1e6 * value:.1f} µm"
