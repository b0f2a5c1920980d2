"""A whole measurement at the rates of real drivers, in real time: one beam, 18 configurations, three points."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")

from calibration.process_tree import SIMULATED_CELL
from calibration.topics import PERMISSION
from calibration_core.cell import load_cell
from calibration_core.files.yaml_file import yaml_text
from calibration_core.measurement.session import Session
from calibration_core.recording.bags.bag import read_bag
from calibration_core.timeseries import NANOSECONDS

CELL = Path(__file__).resolve().parents[2] / "config" / "cells" / "demo.cell.yaml"
CONFIGURATIONS, POINTS, STEPS = 18, 3, 2
JOINTS, WRENCH = 500.0, 1000.0  # Hz: UR e series; a sensor of ATI, Bota or SCHUNK
KEEPS_UP = 0.9  # of real time, that the simulated cell lives at least: a machine that is too busy proves nothing
LIMIT = 2400.0  # s, that the measurement may take: some twenty minutes of the cell's time


@pytest.fixture
def two_steps(brisk_plan: Path, tmp_path: Path) -> Path:
    """The plan with the first and the last load step of each configuration."""
    content = yaml.safe_load(brisk_plan.read_text(encoding="utf-8"))
    for one in content["configurations"]:
        one["steps"] = [one["steps"][0], one["steps"][-1]]
    path = tmp_path / "plan.yaml"
    path.write_text(yaml_text(content), encoding="utf-8")
    return path


def test_a_measurement_at_the_rates_of_real_drivers(suite: Any, two_steps: Path, until: Any) -> None:
    from calibration_interfaces.msg import Outcome, SessionEvent

    lost: list[str] = []  # nobody is there who would let the run go on
    kind = SessionEvent.PERMISSION_LOST
    suite.client.create_subscription(
        PERMISSION.message, PERMISSION.relative, lambda one: lost.append(one.text) if one.latched else None, 10
    )
    suite.client.create_subscription(
        SessionEvent, "calibration/event", lambda one: lost.append(one.text) if one.kind == kind else None, 1000
    )
    rates = {"rates.joints": JOINTS, "rates.wrench": WRENCH}
    suite.start_tree(SIMULATED_CELL, {"simulated_cell": rates, "sequencer": {"server_wait": 60.0}}, port=0)
    began = time.monotonic()
    run = suite.run(two_steps)
    until(lambda: run.over or lost, timeout=LIMIT)
    assert lost == [], suite.log("guard")[-1500:]
    result = run.result(1.0)
    took = time.monotonic() - began
    assert (result.outcome.code, result.configurations_done) == (Outcome.OK, CONFIGURATIONS), result.outcome.text
    with Session.look(suite.session) as session:
        assert not any(one.latched for one in session.decisions)
        confirmed = {(one.configuration, one.step, one.point) for one in session.confirmed() if one.configuration}
    assert len(confirmed) == CONFIGURATIONS * STEPS * POINTS
    bag = read_bag(suite.bag, load_cell(CELL))
    assert bag.wrench is not None
    for name, stream, rate in (("joint states", bag.joints, JOINTS), ("wrench", bag.wrench, WRENCH)):
        steps, length = np.diff(stream.time), (stream.time[-1] - stream.time[0]) / NANOSECONDS
        print(f"{name}: {len(stream.time)} in {length:.0f} s of the cell's time, {took:.0f} s of wall time")
        assert length > KEEPS_UP * took
        assert np.all(steps == round(NANOSECONDS / rate)), f"{name}: {np.sum(steps != round(NANOSECONDS / rate))} gaps"
