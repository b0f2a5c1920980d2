"""Two hundred simulated calibrations: do the intervals cover, and is the Cramér-Rao bound attained?

The simulated cell shares no kinematics and no statics with the core; truth, configurations, loads and noise are drawn
anew for every seed.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calibration_core.cell import load_cell
from calibration_core.identification.identify import identify
from calibration_sim.cell.configurations import random_protocol
from calibration_sim.cell.table import measure, solve
from calibration_sim.cell.truth import draw_truth

SEEDS = range(1000, 1200)
REPEATS = range(200)
CELL = load_cell(Path(__file__).parents[2] / "config/cells/demo.cell.yaml")


def test_intervals_cover_the_truth() -> None:
    inside, errors, excluded = [], [], 0
    for seed in SEEDS:
        truth = draw_truth(CELL, seed)
        found = identify(measure(solve(CELL, truth, random_protocol(CELL, 18, seed)), CELL, seed), CELL)
        inside.append(
            [j.interval[0] <= k <= j.interval[1] for j, k in zip(found.stiffness, truth.stiffness, strict=True)]
        )
        errors.append([(j.value - k) / k for j, k in zip(found.stiffness, truth.stiffness, strict=True)])
        excluded += len(found.exclusions)
    cover = np.mean(inside, axis=0)
    print(f"\n{len(SEEDS)} seeds: 95 % intervals cover {100 * cover} %; rms error {100 * np.std(errors, axis=0)} %")
    print(f"readings excluded without cause: {excluded} of {len(SEEDS) * 486}")
    assert np.all((cover >= 0.92) & (cover <= 0.98))
    assert excluded <= 0.03 * len(SEEDS)


def test_the_cramer_rao_bound_is_attained() -> None:
    truth = draw_truth(CELL, 1)
    solved = solve(CELL, truth, random_protocol(CELL, 18, 1))
    bound = np.sqrt(np.diag(np.linalg.inv(fisher_information(truth, solved))))
    values, stds = [], []
    for seed in REPEATS:
        found = identify(measure(solved, CELL, seed), CELL)
        values.append([joint.compliance for joint in found.stiffness])
        stds.append([joint.compliance_std for joint in found.stiffness])
    reported, seen = np.mean(stds, axis=0) / bound, np.std(values, axis=0) / bound
    print(f"\nstandard deviation over the Cramér-Rao bound: reported {reported}, seen in {len(REPEATS)} repeats {seen}")
    np.testing.assert_allclose(reported, 1.0, atol=0.1)
    np.testing.assert_allclose(seen, 1.0, atol=0.15)  # the scatter of 200 repeats is itself known to 5 %


def fisher_information(truth, solved) -> np.ndarray:
    """Return the (6, 6) information on the compliances, by differences of the simulator alone.

    Unknown besides: one position per configuration and point.  Noise: tracker per reading, wrench per step, as claimed.
    """
    import dataclasses

    protocol = random_protocol(CELL, 18, 1)
    compliance = 1 / truth.stiffness

    def points(c: np.ndarray, wrench_change: np.ndarray | None = None) -> np.ndarray:
        changed = protocol
        if wrench_change is not None:
            configurations = tuple(
                dataclasses.replace(x, wrenches=x.wrenches + wrench_change) for x in protocol.configurations
            )
            changed = dataclasses.replace(protocol, configurations=configurations)
        return solve(CELL, dataclasses.replace(truth, stiffness=1 / c), changed).states.points

    columns = []
    for j in range(6):
        h = np.zeros(6)
        h[j] = 1e-3 * compliance[j]
        columns.append((points(compliance + h) - points(compliance - h)) / (2 * h[j]))
    derivative = np.stack(columns, axis=-1)  # (s, p, 3, 6)
    loads = []
    for k in range(3):  # forces in base axes have the same covariance as in sensor axes: it is isotropic
        step = np.zeros(6)
        step[k] = 1.0
        loads.append(points(compliance, step) - points(compliance, -step))
    by_force = np.stack(loads, axis=-1) / 2
    information = np.zeros((6, 6))
    sigma, sigma_force = CELL.instruments.tracker.sigma, CELL.instruments.force_torque.sigma_force
    for number in np.unique(solved.configuration):
        rows = solved.configuration == number
        d = derivative[rows]
        s, p = d.shape[:2]
        covariance = np.eye(s * p * 3) * sigma**2
        for step in range(s):
            block = slice(step * p * 3, (step + 1) * p * 3)
            arm = by_force[rows][step].reshape(p * 3, 3) * sigma_force
            covariance[block, block] += arm @ arm.T
        weight = np.linalg.inv(covariance)
        offsets = np.tile(np.eye(p * 3), (s, 1))
        flat = d.reshape(s * p * 3, 6)
        free = np.linalg.solve(offsets.T @ weight @ offsets, offsets.T @ weight @ flat)
        information += flat.T @ weight @ (flat - offsets @ free)
    return information
