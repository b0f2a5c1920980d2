"""Motions of whole plans, followed by the simulated robot: its own truth never exceeds 250 mm/s, and wastes little.

The trajectories are bounded on the kinematics of the cell file; the robot that follows them is MuJoCo's, looked at
every millisecond: link origins, flange, sensor, wrench point and measurement points.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.model.nominal import nominal_parameters, tool_point
from calibration_core.model.robot import chain_of
from calibration_core.motion.speed import Monitored
from calibration_core.motion.trajectory import MotionLimits, plan_motion
from calibration_core.planning.loaded import make_plan
from calibration_sim.cell.truth import nominal_truth
from calibration_sim.living_cell.live import LiveCell
from calibration_sim.living_cell.live import Path as Way
from calibration_sim.living_cell.motion_log import MotionLog, true_speeds

CELLS = Path(__file__).resolve().parents[1] / "config" / "cells"
LIMIT = 0.25
CONFIGURATIONS = 12


def speeds(cell: Cell, seed: int, log: Path) -> np.ndarray:
    """Drive through a plan with its start-up cycle; return the fastest point's speed at every millisecond, m/s."""
    plan = make_plan(cell, configurations=CONFIGURATIONS, spares=0.0, seed=seed)
    monitored = Monitored.of(chain_of(cell), nominal_parameters(cell), tool_point(cell))
    way = [*plan.startup_cycle, *(configuration.q for configuration in plan.configurations)]
    live = LiveCell(cell, nominal_truth(cell), way[0])
    with MotionLog(log) as motion_log:
        for goal in way[1:]:
            trajectory = plan_motion(monitored, live.q, goal, MotionLimits())
            live.follow(Way(trajectory.time, trajectory.position, trajectory.velocity))
            while live.moving:
                motion_log.add(*live.advance(live.time + 0.1))
            np.testing.assert_allclose(live.q, goal, atol=1e-9)
            motion_log.add(*live.advance(live.time + 0.1))
    return true_speeds(log, live)[:, 1]


@pytest.mark.parametrize(
    ("name", "plans"),
    [("demo", 1), pytest.param("demo", 25, marks=pytest.mark.slow), pytest.param("small", 25, marks=pytest.mark.slow)],
)
def test_no_point_is_ever_too_fast(tmp_path: Path, name: str, plans: int) -> None:
    cell = load_cell(CELLS / f"{name}.cell.yaml")
    fastest, used, cruising = [], [], []
    for seed in range(plans):
        found = speeds(cell, seed, tmp_path / f"{seed}.log")
        fastest.append(found.max())
        used.append(found.mean() / LIMIT)
        cruising.append(found[found > 0.5 * LIMIT].mean() / LIMIT)
    print(
        f"\n{name}: {plans} plans, fastest {1e3 * max(fastest):.1f} mm/s, "
        f"cruising at {np.mean(cruising):.2f} of the limit, {np.mean(used):.2f} with starts and stops"
    )
    assert max(fastest) <= LIMIT
    assert np.mean(cruising) >= 0.8
    if name == "demo":  # the small robot moves so little that starts and stops are a large part
        assert np.mean(used) >= 0.8
