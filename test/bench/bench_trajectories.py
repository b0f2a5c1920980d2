"""Speed of every monitored point on 200 random motions, each sampled 100,000 times: never above the limit."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import load_cell
from calibration_core.model.nominal import nominal_parameters, tool_point
from calibration_core.model.robot import chain_of
from calibration_core.motion.speed import Monitored
from calibration_core.motion.trajectory import MotionLimits, plan_motion

CELLS = Path(__file__).parents[2] / "config" / "cells"
MOTIONS, SAMPLES, BLOCK = 200, 100_000, 5000
LIMITS = MotionLimits()


@pytest.mark.parametrize("name", ["demo", "small"])
def test_speed(name: str) -> None:
    cell = load_cell(CELLS / f"{name}.cell.yaml")
    monitored = Monitored.of(chain_of(cell), nominal_parameters(cell), tool_point(cell))
    rng = np.random.default_rng(0)
    fastest, planning, used = 0.0, 0.0, []
    for _ in range(MOTIONS):
        low, high = monitored.chain.limits.T
        start, goal = rng.uniform(low, high), rng.uniform(low, high)
        begin = time.perf_counter()
        trajectory = plan_motion(monitored, start, goal, LIMITS)
        planning += time.perf_counter() - begin
        line = float(np.abs(goal - start).max())
        pace = np.abs(trajectory.velocity).max(axis=1) / line
        cruising = np.abs(np.diff(pace)) / np.diff(trajectory.time) < 0.9 * LIMITS.joint_acceleration / line
        shares, count = 0.0, 0
        for block in np.array_split(np.linspace(0, trajectory.duration, SAMPLES), SAMPLES // BLOCK):
            q, rate = trajectory.at(block)
            speed = monitored.speeds(q, rate).max(axis=1)
            fastest = max(fastest, float(speed.max()))
            interval = np.clip(np.searchsorted(trajectory.time, block, side="right") - 1, 0, len(cruising) - 1)
            by_joint = np.abs(rate).max(axis=1) >= 0.99 * LIMITS.joint_speed
            rows = cruising[interval] & ~by_joint
            shares, count = shares + float(speed[rows].sum()) / LIMITS.speed, count + int(rows.sum())
        if count:
            used.append(shares / count)
    print(
        f"\n{name}: {MOTIONS} motions, {MOTIONS * SAMPLES:.0e} samples: fastest {1e3 * fastest:.1f} mm/s (limit 250), "
        f"cruising at {100 * np.mean(used):.1f} % of it (bar 80), planned in {1e3 * planning / MOTIONS:.0f} ms each"
    )
    assert fastest <= LIMITS.allowed * (1 + 1e-9)
    assert np.mean(used) >= 0.8
