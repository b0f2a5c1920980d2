"""A diagnosis in a few lines for the terminal."""

from __future__ import annotations

from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.report.rounding import counted
from calibration_core.report.sections.together import together_lines
from calibration_core.report.summary import test_lines
from calibration_core.timeseries import NO_INTERVALS

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
    """Return verdict, findings, anomalies and figures, at most a screen long."""
    lines = [f"verdict: {diagnosis.verdict}: {headline(diagnosis)}"]
    if diagnosis.identification.together is not None:
        lines += together_lines(diagnosis.identification.together)
    for compared in diagnosis.comparisons:
        whose = "simulation" if diagnosis.identification.together is None else f"simulation of {compared.recording}"
        lines += [f"{whose}: {sentence}" for sentence in compared.sentences]
    lines += [f"anomaly: {anomaly.kind}: {anomaly.text}" for anomaly in diagnosis.anomalies]
    for number, finding in enumerate(diagnosis.findings, start=1):
        lines.append(f"{number}. {finding.explanation}")
        lines.append(f"   held-out squared error falls by {100 * finding.held_out_gain:z.0f} %")
    where = () if diagnosis.where is None else diagnosis.where.sentences
    lines += [f"where: {sentence}" if sentence in where else sentence for sentence in diagnosis.located]
    lines.append(
        f"residual per coordinate {_um(diagnosis.rms_before)} -> {_um(diagnosis.rms_after)}{used_text(diagnosis)}, "
        f"on configurations left out {_um(diagnosis.held_out_before)} -> {_um(diagnosis.held_out_after)}, "
        f"noise {_um(diagnosis.noise)}"
    )
    if diagnosis.test is not None:
        lines += test_lines(diagnosis.test)
    lines.append(diagnosis.rest.text)
    if diagnosis.next_measurements:
        lines.append(f"next: {counted(len(diagnosis.next_measurements), 'measurement')} proposed")
        lines += [f"   {proposal.why}" for proposal in diagnosis.next_measurements]
    lines.append(diagnosis.next_text)
    notes = diagnosis.identification.notes
    lines += [note.line for note in notes if note.kind == NO_INTERVALS]
    return "\n".join(line for line in lines if line)


def used_text(diagnosis: Diagnosis) -> str:
    """Return what the readings leave that were not set aside, in parentheses; empty where none was."""
    used = diagnosis.rms_used
    return "" if used is None else f" ({_um(used)} without the readings set aside)"


def _um(value: float) -> str:
    return f"{1e6 * value:.1f} µm"
