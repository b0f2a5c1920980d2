"""What the standard demands of a plan, checked."""

from __future__ import annotations

import numpy as np

from calibration_core.cell import Cell
from calibration_core.identification.checks.conditions import (
    MIN_CONFIGURATIONS,
    NEAR_SINGULAR,
    TEST_UNCERTAINTY_RATIO,
)
from calibration_core.identification.result.estimate import OperatingSpace, Precondition
from calibration_core.model.chain import pose_matrix
from calibration_core.model.simulation.simulate import tracker_covariance
from calibration_core.observations.average import coordinate_std
from calibration_core.planning.plans.plan import Plan, PlannedConfiguration
from calibration_core.planning.route import WORKING_DAY
from calibration_core.report.rounding import counted, spread
from calibration_core.report.sections.procedure import rated_force
from calibration_core.timeseries import Float1D

SPARE_SHARE = 0.5  # CWA 17384, 5.1


def full_pulls(planned: tuple[PlannedConfiguration, ...]) -> Float1D:
    """Return the size of each configuration's largest force, N."""
    return np.array([np.linalg.norm(one.steps[:, :3], axis=1).max() for one in planned])


def plan_requirements(plan: Plan, cell: Cell, space: OperatingSpace) -> tuple[Precondition, ...]:
    """Check what the standard demands of a plan."""
    count, spares = len(plan.primary), len(plan.spares)
    weight, rated = float(np.linalg.norm(cell.tool_weight)), rated_force(cell)
    largest = full_pulls(plan.configurations) + weight
    beside = f"with the end effector's weight of {weight:,.0f} N" if weight else "without the end effector's weight"
    worst = int(np.argmin(space.singularity))
    nearest = float(space.singularity[worst])
    near = f"nearest: configuration {int(space.configuration[worst])}, smallest singular value {nearest:.3f}"
    expected = plan.expected
    apart = "not stated" if expected is None else f"{1e3 * expected.spacing:.0f} mm"
    demands = [
        Precondition(
            "5.1", f"at least {MIN_CONFIGURATIONS} configurations", f"{count} configurations",
            count >= MIN_CONFIGURATIONS,
        ),
        Precondition(
            "5.1", "50 % or more configurations in reserve", f"{spares} spares, {100 * spares / count:.0f} %",
            spares >= SPARE_SHARE * count,
        ),
        Precondition(
            "5.1", "configurations evenly spaced in the operating space",
            f"mean distance from a place of the operating space to the nearest configuration: {apart}", None,
        ),
        Precondition(
            "5.1", f"load at most 100 % of the rated load ({cell.robot.rated_load:g} kg, {rated:,.0f} N)",
            f"largest force {largest.max():,.0f} N, {100 * largest.max() / rated:.1f} %, {beside}",
            bool(largest.max() <= 1.0001 * rated),
        ),
        Precondition(
            "5.2", "start-up cycle before the test", f"{counted(len(plan.startup_cycle), 'posture')} planned",
            len(plan.startup_cycle) > 0,
        ),
        *_uncertainty_ratio(cell, space),
        *_working_day(plan),
        Precondition("6.2", "configurations far from kinematic singularities", near, nearest >= NEAR_SINGULAR),
        *_complementary(plan),
    ]  # fmt: skip
    return tuple(demands)


def _complementary(plan: Plan) -> tuple[Precondition, ...]:
    """State the largest share of the complementary stiffness, where the plan knows it."""
    if plan.expected is None or plan.expected.k_csm is None:
        return ()
    found = f"K_CSM moves no point by more than {spread(1e6 * plan.expected.k_csm)} µm under the full pull"
    return (Precondition("6.2", "K_CSM negligible", found, None),)


def _working_day(plan: Plan) -> tuple[Precondition, ...]:
    """Say whether the measurement outlasts a working day, and how many times the cell's references are then due."""
    if plan.expected is None or "total" not in plan.expected.duration:
        return ()
    total = plan.expected.duration["total"]
    wanted = "invariant cell references where the measurement takes longer than a working day (8 h)"
    found = f"about {total / 3600:.1f} h"
    if total <= WORKING_DAY:
        return (Precondition("5.1", wanted, f"{found}: not needed", True),)
    days = int(np.ceil(total / WORKING_DAY))
    text = f"{found}, {days} days: read references fixed to the cell at the beginning and end of each day"
    return (Precondition("5.1", wanted, text, None),)


def _uncertainty_ratio(cell: Cell, space: OperatingSpace) -> tuple[Precondition, ...]:
    """Compare the expected deflections with the tracker's uncertainty; nothing where one of them is not known."""
    frame = cell.frames.tracker
    if (
        space.deflection is None
        or not np.any(space.deflection)
        or (frame is None and cell.instruments.tracker.sigma is None)
    ):
        return ()
    pose = np.eye(4) if frame is None else pose_matrix(np.array(frame.xyz), np.array(frame.rpy))
    points = (np.concatenate(list(space.points.values())) - pose[:3, 3]) @ pose[:3, :3]
    sigma = coordinate_std(tracker_covariance(cell, points))
    size = float(np.sqrt(np.mean(np.sum(space.deflection**2, axis=1))))
    ratio = size / (2 * np.sqrt(2 * 3) * sigma)  # as in `conditions`
    found = f"1:{ratio:.0f} (expected deflection {spread(1e3 * size)} mm rms under the full pull)"
    met = bool(ratio >= TEST_UNCERTAINTY_RATIO)
    return (Precondition("5.3", "test uncertainty ratio not lower than 1:5", found, met),)
