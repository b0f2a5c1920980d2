"""Intervals of what some recordings show otherwise: they do not tell what the robot of the others is like.

What differs is taken off the readings as it was found beside the others, so that a recording that has changed agrees
with them about that parameter, and would count as if it had shown it.  Its share of what is known is taken away again.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from calibration_core.acceptance.comparison import COMPLIANCE
from calibration_core.cell import Cell
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.identification.geometry.named_estimate import model_paths
from calibration_core.identification.result.estimate import Identification, JointStiffness
from calibration_core.identification.result.observability import joint_stiffness
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.outcomes.together.by_themselves import by_themselves
from calibration_core.outcomes.together.prepare import Prepared
from calibration_core.timeseries import Float1D, Float2D


def factors_of(less: Prepared) -> dict[str, float]:
    """Return parameter -> factor on its standard deviation, at least 1, of recordings that are free of what differs."""
    files = [member.file for member in less.members]
    estimates = by_themselves(less.measured)
    found = {}
    for parameter in {one.parameter for one in less.changes}:
        changed = {one.file for one in less.changes if one.parameter == parameter}
        known = {file: _information(one, parameter) for file, one in zip(files, estimates, strict=True)}
        rest = sum(value for file, value in known.items() if file not in changed)
        found[parameter] = float(np.sqrt(sum(known.values()) / rest)) if rest > 0 else np.inf
    return found


def widened(found: Diagnosis, cell: Cell, wider: Mapping[str, float]) -> Diagnosis:
    """Return a diagnosis whose standard deviations are larger by factors, parameter by parameter."""
    by_joint = np.array([wider.get(f"{COMPLIANCE}{joint}", 1.0) for joint in cell.robot.joints])
    covariance = found.compliance_covariance
    return dataclasses.replace(
        found,
        identification=widened_identification(found.identification, cell, wider),
        stiffness={
            joint: (value, std * wider.get(f"{COMPLIANCE}{joint}", 1.0))
            for joint, (value, std) in found.stiffness.items()
        },
        compliance_covariance=None if covariance is None else _scaled(covariance, by_joint),
        estimate=found.estimate.scaled(wider),
    )


def widened_identification(found: Identification, cell: Cell, wider: Mapping[str, float]) -> Identification:
    """Return an identification whose standard deviations are larger by factors, parameter by parameter."""
    paths = model_paths(cell)
    own = {name: wider.get(path, 1.0) for name, path in paths.items()}
    return dataclasses.replace(
        found,
        stiffness=tuple(_joint(one, wider.get(f"{COMPLIANCE}{one.joint}", 1.0)) for one in found.stiffness),
        parameters=tuple(dataclasses.replace(one, std=one.std * own.get(one.name, 1.0)) for one in found.parameters),
        covariance=_scaled(found.covariance, np.array([own.get(name, 1.0) for name in found.names])),
        estimate=found.estimate.scaled(wider),
    )


def _joint(one: JointStiffness, factor: float) -> JointStiffness:
    if factor == 1.0:
        return one
    wide = joint_stiffness(
        one.joint,
        one.compliance,
        factor * one.compliance_std,
        identifiable=one.identifiable,
        reason=one.reason,
        unit=one.unit,
    )
    return dataclasses.replace(wide, extended=None if one.extended is None else _joint(one.extended, factor))


def _scaled(covariance: Float2D, factor: Float1D) -> Float2D:
    return covariance * np.outer(factor, factor)


def _information(estimate: GaussianEstimate, parameter: str) -> float:
    """Return what an estimate knows of a parameter, one over its variance; 0 where it has none."""
    if parameter not in estimate.names:
        return 0.0
    row = estimate.names.index(parameter)
    return float(1.0 / estimate.covariance[row, row])
