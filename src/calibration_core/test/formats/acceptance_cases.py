"""Plans, recordings and calibrated models for tests of acceptance, made by the model itself."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np

from calibration_core.cell import Cell, load_cell
from calibration_core.identification.identify import identify
from calibration_core.identification.result.estimate import Identification
from calibration_core.model.identified.calibrated import CalibratedModel, range_of
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.simulation.simulate import simulate_plan
from calibration_core.planning.loaded import make_plan
from calibration_core.planning.plans.plan import Plan
from calibration_core.timeseries import Readings

CELLS = Path(__file__).parents[4] / "config" / "cells"


@functools.cache
def small() -> Cell:
    return load_cell(CELLS / "small.cell.yaml")


@functools.cache
def plan(configurations: int, seed: int) -> Plan:
    return make_plan(small(), configurations=configurations, seed=seed)


def measured(parameters: ModelParameters, seed: int | None, configurations: int = 18, plan_seed: int = 1) -> Readings:
    return simulate_plan(plan(configurations, plan_seed).primary, small(), parameters, seed)


def softened(parameters: ModelParameters, joint: int, share: float) -> ModelParameters:
    """The same robot, the stiffness of one joint less by a share."""
    compliance = parameters.compliance.copy()
    compliance[joint] /= 1 - share
    return parameters.replace(compliance=compliance)


@functools.cache
def identified() -> tuple[Identification, CalibratedModel]:
    readings = measured(nominal_parameters(small()), 5)
    found = identify(readings, small())
    return found, CalibratedModel(found.model, found.estimate, range_of(readings, small(), found.model))


def shares_of_one(found: Identification) -> np.ndarray:
    """Standard deviation of every stiffness over its value."""
    estimate = found.estimate
    rows = [k for k, name in enumerate(estimate.names) if name.startswith("compliance.")]
    return estimate.std[rows] / estimate.value[rows]
