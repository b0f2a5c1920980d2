"""Whether recordings that are evaluated together show the same robot: each is compared with all the others.

The parameters that a recording shows by itself differ from what the others show together by d, normal about a change
with the sum of both covariances; changes are looked for joint by joint as between measurements of different times
(`acceptance.comparison`), at the same level for all recordings together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration_core.acceptance.comparison import COMPLIANCE, COVERAGE, STIFFNESS_LEVEL, changes, critical_size
from calibration_core.identification.result.estimate import Anomaly
from calibration_core.identification.result.together import Disagreement
from calibration_core.model.identified.gaussian import GaussianEstimate

GEOMETRY = "geometry."
GROUPS = (COMPLIANCE, GEOMETRY)


def agreement(
    files: Sequence[str], estimates: Sequence[GaussianEstimate]
) -> tuple[tuple[str, ...], tuple[Disagreement, ...]]:
    """Compare every recording with the others.

    Compliances are compared joint by joint where two recordings know them; corrections of the geometry among
    recordings that fit the same ones and the same compliances, since each depends on which others are fitted.

    Args:
        files: The recordings.
        estimates: What each shows by itself.

    Returns:
        compared: Names of the parameters that were compared.
        disagreements: What differs, recording by recording.
    """
    compared: list[str] = []
    found: list[Disagreement] = []
    for group in GROUPS:
        parts = [_known(estimate, group) for estimate in estimates]
        if group == GEOMETRY:
            sets = [{name for name in one.names if name.startswith(GROUPS)} for one in estimates]
            parts = [p if sets.count(s) > 1 else GaussianEstimate.nothing() for p, s in zip(parts, sets, strict=True)]
        members = [k for k, part in enumerate(parts) if part.names]
        if len(members) < 2:
            continue
        judged = members if len(members) > 2 else members[-1:]  # of two, the later one has changed
        for k in judged:
            others = _combined([parts[j] for j in members if j != k])
            names = [name for name in parts[k].names if name in others.names]
            compared += [name for name in names if name not in compared]
            found += _differences(files[k], parts[k], others, names, STIFFNESS_LEVEL / len(GROUPS) / len(judged))
    return tuple(compared), tuple(found)


def as_anomalies(disagreements: Sequence[Disagreement]) -> tuple[Anomaly, ...]:
    """Return what differs between recordings as anomalies of the answer."""
    return tuple(
        Anomaly(
            "recordings_differ",
            {"joint": one.location, "recording": one.file},
            None,
            abs(one.change),
            one.unit,
            described(one),
            "evaluate the recordings apart, and find out what was done to the robot between them",
        )
        for one in disagreements
    )


def described(one: Disagreement) -> str:
    """Return a disagreement in words."""
    if one.parameter.startswith(COMPLIANCE):
        word = "softer" if one.change < 0 else "stiffer"
        low, high = sorted((abs(one.low), abs(one.high)))
        size = f"{one.location} is {100 * abs(one.change):.1f} % {word} ({100 * low:.1f} to {100 * high:.1f} %)"
    else:
        factor, unit = (1e3, "mm") if one.unit == "m" else (1e3, "mrad")
        size = (
            f"{one.parameter.removeprefix(GEOMETRY)} stands {factor * one.change:+z.3f} {unit} "
            f"({factor * one.low:+z.3f} to {factor * one.high:+z.3f} {unit}) elsewhere"
        )
    where = f"; the change may as well be at {' or '.join(one.or_else)}" if one.or_else else ""
    cause = "the robot has changed, or the model leaves something out"
    return f"in {one.file}, {size} than in the other recordings: {cause}{where}"


def _known(estimate: GaussianEstimate, group: str) -> GaussianEstimate:
    rows = [
        k
        for k, (name, std) in enumerate(zip(estimate.names, estimate.std, strict=True))
        if name.startswith(group) and np.isfinite(std) and std > 0
    ]
    return estimate.chosen(rows)


def _combined(parts: Sequence[GaussianEstimate]) -> GaussianEstimate:
    """Return what independent estimates say together, by generalised least squares in units of the first one's."""
    names = list(dict.fromkeys(name for part in parts for name in part.names))
    units = {name: unit for part in parts for name, unit in zip(part.names, part.units, strict=True)}
    scale = np.array([max(part.std[part.names.index(n)] for part in parts if n in part.names) for n in names])
    matrix, vector = np.zeros((len(names),) * 2), np.zeros(len(names))
    for part in parts:
        rows = [names.index(name) for name in part.names]
        own = scale[rows]
        precision = np.linalg.inv(part.covariance / np.outer(own, own))
        matrix[np.ix_(rows, rows)] += precision
        vector[rows] += precision @ (part.value / own)
    covariance = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    return GaussianEstimate(
        tuple(names), tuple(units[n] for n in names), scale * (covariance @ vector), covariance * np.outer(scale, scale)
    )


def _differences(
    file: str, one: GaussianEstimate, others: GaussianEstimate, names: Sequence[str], level: float
) -> list[Disagreement]:
    own, rest = (part.chosen([part.names.index(name) for name in names]) for part in (one, others))
    difference, covariance = own.value - rest.value, own.covariance + rest.covariance
    found = []
    for k, near in changes(difference, covariance, critical_size(level, len(names))).items():
        std = float(np.sqrt(covariance[k, k]))
        ends = [float(difference[k]) + side * COVERAGE * std for side in (-1, 1)]
        change, unit, alike = float(difference[k]), own.units[k], tuple(_joint(names[j]) for j in near)
        if names[k].startswith(COMPLIANCE):  # K = 1/C: a compliance that grows is a stiffness that falls
            change, *ends = (-d / (rest.value[k] + d) for d in (difference[k], *reversed(ends)))
            unit = "1"
        low, high = (float(end) for end in ends)
        found.append(Disagreement(file, names[k], _joint(names[k]), float(change), low, high, unit, alike))
    return found


def _joint(name: str) -> str:
    return name.removeprefix(COMPLIANCE) if name.startswith(COMPLIANCE) else name.split(".")[1]
