"""The one entry: a recording goes in, a diagnosis comes out, whatever kind of recording it is."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.absolute import diagnose_absolute
from calibration_core.diagnosis.finding import Diagnosis, Verdict
from calibration_core.diagnosis.loaded import diagnose_loaded
from calibration_core.identification.identify import is_loaded
from calibration_core.identification.loaded import Options
from calibration_core.timeseries import Bool1D, Readings

ENOUGH = 20  # single-step configurations beside loaded ones from which on their absolute positions are searched too


def diagnose(readings: Readings, cell: Cell, options: Options | None = None, test: Readings | None = None) -> Diagnosis:
    """Say what the model of a recording leaves out.

    A recording may hold configurations with several steps and others with one: the first are searched as loaded data,
    the second as absolute positions, and the findings stand together.

    Args:
        readings: The recording.
        cell: The cell file.
        options: How to evaluate the loaded part.
        test: A second recording of the same kind, predicted but not fitted.

    Raises:
        InputError: The input cannot be used; the message names file, place, what was found and what was expected.
    """
    if not is_loaded(readings):
        return diagnose_absolute(readings, cell, test=test)
    single = _single(readings)
    if len(np.unique(readings.configuration[single])) < ENOUGH or cell.measurements.points == "displacement":
        return diagnose_loaded(readings, cell, options, test)
    loaded = diagnose_loaded(readings.select(~single), cell, options, test)
    still = dataclasses.replace(readings.select(single), wrench=None)
    return together(loaded, diagnose_absolute(still, cell))


def together(loaded: Diagnosis, absolute: Diagnosis) -> Diagnosis:
    """Join the diagnosis of loaded steps and that of single steps of one recording; figures are the loaded one's."""
    known = {(finding.effect, tuple(sorted(finding.location.items()))) for finding in loaded.findings}
    more = tuple(f for f in absolute.findings if (f.effect, tuple(sorted(f.location.items()))) not in known)
    findings = tuple(sorted((*loaded.findings, *more), key=lambda finding: -finding.magnitude))
    seen = {(anomaly.kind, tuple(sorted(anomaly.location.items()))) for anomaly in loaded.anomalies}
    others = tuple(a for a in absolute.anomalies if (a.kind, tuple(sorted(a.location.items()))) not in seen)
    rest = loaded.rest if loaded.rest.significant or not absolute.rest.significant else absolute.rest
    left = rest.significant
    verdict: Verdict = "partly_explained" if findings and left else "missing_physics" if findings else "consistent"
    if left and not findings:
        verdict = "unexplained"
    return dataclasses.replace(
        loaded,
        verdict=verdict,
        findings=findings,
        anomalies=(*loaded.anomalies, *others),
        rest=rest,
        located=(*loaded.located, *absolute.located),
    )


def _single(readings: Readings) -> Bool1D:
    """Return the rows of configurations with one step, (m,)."""
    pairs = np.unique(np.column_stack([readings.configuration, readings.step]), axis=0)
    numbers, counts = np.unique(pairs[:, 0], return_counts=True)
    return np.isin(readings.configuration, numbers[counts == 1])
