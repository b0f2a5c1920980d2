"""The proof of `compare`: pairs of recordings of the simulated cell, measured, identified and compared."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from calibration_core.acceptance.comparison import Measurement, compare
from calibration_core.acceptance.joint_laws import joint_laws, reference_torques
from calibration_core.cell import Cell, load_cell
from calibration_core.identification.identify import identify
from calibration_core.identification.result.estimate import Identification
from calibration_core.model.effects.candidate import typical
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.timeseries import Readings
from calibration_sim.cell.configurations import random_protocol
from calibration_sim.cell.table import simulate_readings
from calibration_sim.cell.truth import nominal_truth

CELLS = Path(__file__).parents[1] / "config" / "cells"
SIMULATED, DRAWN = 150, 850  # pairs of either kind, with a change and without


def as_measurement(readings: Readings, found: Identification, cell: Cell, reference: np.ndarray) -> Measurement:
    estimate = found.estimate
    chosen = [k for k, name in enumerate(estimate.names) if name.startswith("compliance.")]
    laws = joint_laws(readings, cell, found.model, reference, found.noise.scale)
    return Measurement("one", None, 18, estimate.chosen(chosen), laws)


@pytest.mark.slow
def test_ageing_of_1000_pairs() -> None:
    """One stiffness less by 6.5 standard deviations of one measurement, or 5 % where that is more.

    150 pairs with a change and 150 without are measured in MuJoCo, which shares no kinematics with the identification,
    and identified; 850 of each are drawn from the covariance that such an identification states.
    """
    cell = load_cell(CELLS / "small.cell.yaml")
    truth = nominal_truth(cell)
    protocol = random_protocol(cell, 18, seed=4)
    limit = typical("backlash", cell.robot.rated_load)

    def measured(stiffness: np.ndarray, seed: int) -> tuple[Readings, Identification]:
        readings = simulate_readings(cell, dataclasses.replace(truth, stiffness=stiffness), protocol, seed)
        return readings, identify(readings, cell)

    readings, first = measured(truth.stiffness, 1000)
    estimate = first.estimate.chosen([k for k, n in enumerate(first.estimate.names) if n.startswith("compliance.")])
    share = np.maximum(6.5 * estimate.std / estimate.value, 0.05)
    reference = reference_torques(readings, cell, first.model)
    hits, alarms, pairs = 0, 0, 0
    for k in range(SIMULATED):
        joint = k % 6
        softer = truth.stiffness.copy()
        softer[joint] *= 1 - share[joint]
        three = [
            as_measurement(*measured(stiffness, 3 * k + i), cell, reference)
            for i, stiffness in enumerate((truth.stiffness, truth.stiffness, softer))
        ]
        alarms += any(one.verdict == "changed" for one in compare(three[:2], limit)[0])
        hits += compare([three[0], three[2]], limit)[0][joint].verdict == "changed"
        pairs += 1
    print(f"simulated: {hits} of {pairs} found, {alarms} of {pairs} false")
    assert hits >= 0.88 * pairs
    root, rng = estimate.root(), np.random.default_rng(77)

    def drawn(value: np.ndarray) -> Measurement:
        noisy = dataclasses.replace(estimate, value=value + root @ rng.standard_normal(6))
        return Measurement("one", None, 18, noisy, GaussianEstimate.nothing())

    for k in range(DRAWN):
        joint = k % 6
        changed = estimate.value.copy()
        changed[joint] /= 1 - share[joint]
        one = drawn(estimate.value)
        alarms += any(row.verdict == "changed" for row in compare([one, drawn(estimate.value)], limit)[0])
        hits += compare([one, drawn(changed)], limit)[0][joint].verdict == "changed"
        pairs += 1
    print(f"all: {hits} of {pairs} found, {alarms} of {pairs} false")
    assert pairs == 1000
    assert hits >= 900
    assert alarms <= 10
