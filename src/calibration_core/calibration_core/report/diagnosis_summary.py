"""A diagnosis in a few lines for the terminal."""

from __future__ import annotations

from calibration_core.diagnosis.finding import Diagnosis
from calibration_core.report.rounding import counted

VERDICTS = {
    "consistent": "nothing is missing: the model explains the recording to its noise",
    "missing_physics": "physics is missing in the model, and the findings explain the recording to its noise",
    "partly_explained": "physics is missing in the model, and a rest remains that nothing in the catalogue explains",
    "unexplained": "a significant rest remains, and nothing in the catalogue explains it",
}


def diagnosis_summary(diagnosis: Diagnosis) -> str:
    """Return verdict, findings, anomalies and figures, at most a screen long."""
    lines = [f"verdict: {diagnosis.verdict}: {VERDICTS[diagnosis.verdict]}"]
    if diagnosis.comparison is not None:
        lines += [f"simulation: {sentence}" for sentence in diagnosis.comparison.sentences]
    lines += [f"anomaly: {anomaly.kind}: {anomaly.text}" for anomaly in diagnosis.anomalies]
    for number, finding in enumerate(diagnosis.findings, start=1):
        lines.append(f"{number}. {finding.explanation}")
        lines.append(f"   held-out squared error falls by {100 * finding.held_out_gain:.0f} %")
    lines += [f"where: {sentence}" for sentence in diagnosis.located]
    lines.append(
        f"residual per coordinate {_um(diagnosis.rms_before)} -> {_um(diagnosis.rms_after)}, on configurations left "
        f"out {_um(diagnosis.held_out_before)} -> {_um(diagnosis.held_out_after)}, noise {_um(diagnosis.noise)}"
    )
    lines.append(diagnosis.rest.text)
    if diagnosis.next_measurements:
        lines.append(f"next: {counted(len(diagnosis.next_measurements), 'measurement')} proposed")
        lines += [f"   {proposal.why}" for proposal in diagnosis.next_measurements]
    lines.append(diagnosis.next_text)
    return "\n".join(line for line in lines if line)


def _um(value: float) -> str:
    return f"{1e6 * value:.1f} µm"
