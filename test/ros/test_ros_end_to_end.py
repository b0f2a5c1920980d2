"""A whole measurement in the simulated cell, through the installed executables alone."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")

from calibration_core.cell import load_cell
from calibration_core.measurement.session import Session
from calibration_core.observations.observe import observe
from calibration_core.planning.plans.plan import REFERENCE_NUMBER
from calibration_core.recording.session_values import as_readings
from calibration_core.timeseries import NANOSECONDS, Readings
from calibration_sim.cell.truth import draw_truth
from calibration_sim.living_cell.live import LiveCell
from calibration_sim.living_cell.motion_log import true_speeds

ROOT = Path(__file__).resolve().parents[2]
CELL = ROOT / "config" / "cells" / "demo.cell.yaml"
FAST = ROOT / "config" / "simulation.yaml"
SPEED, LIMIT = 20.0, 0.25
LONG = 60.0  # s, an answer may take on a busy machine
IDENTIFIED = 2.0  # s, stiffnesses and report may take where nothing else runs
BRISK = 30.0  # times real time, asked for where SPEED is to be reached
FIRST, STEPS = 3, 4  # configurations of the short plan, load steps


def offline(bag: Path, out: Path, *arguments: str) -> dict[str, Any]:
    """Identify a bag with the installed program; return its result."""
    program = Path(sys.executable).parent / "calibration"
    command = [str(program), "identify", str(bag), "--cell", str(CELL), "--out", str(out), *arguments]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    return dict(json.loads((out / "result.json").read_text(encoding="utf-8")))


def speeds(suite: Any) -> np.ndarray:
    """Return times (s) and speeds (m/s) of the fastest point, from the simulated robot's own angles."""
    cell = load_cell(CELL)
    live = LiveCell(cell, draw_truth(cell, 1), np.zeros(len(cell.robot.joints)))
    return true_speeds(suite.directory / "motion.log", live)


def places(readings: Readings) -> dict[tuple[int, int, int], int]:
    """Return the row of every configuration, step and point."""
    keys = zip(readings.configuration.tolist(), readings.step.tolist(), readings.point.tolist(), strict=True)
    return {key: row for row, key in enumerate(keys)}


def test_a_short_measurement(suite: Any, short_plan: Path) -> None:
    """A few configurations: what is confirmed, what the bag holds and what was announced agree."""
    from calibration_interfaces.msg import Outcome, Reading

    readings: list[Any] = []
    suite.client.create_subscription(Reading, "calibration/reading", readings.append, 1000)
    suite.start_fast()
    told: list[Any] = []
    result = suite.run(short_plan, feedback=told.append).result(150.0)
    assert (result.outcome.code, result.outcome.text) == (Outcome.OK, f"{FIRST} of {FIRST} configurations are measured")
    assert result.configurations_done == FIRST
    assert result.recording == str(suite.bag)
    assert told
    assert told[-1].feedback.share_done > 0.3
    cell = load_cell(CELL)
    with Session.look(suite.session) as session:
        confirmed = session.confirmed()
        assert len(session.completed) == FIRST
        assert session.runs[0]["cell_sha256"] == cell.sha256
        assert any(decision.permitted for decision in session.decisions)
        kinds = {event.kind for event in session.events}
    assert {"started", "warm_up", "configuration_done", "load_applied", "finished"} <= kinds
    assert len(confirmed) == result.readings == len(readings)
    measured = [row for row in confirmed if row.configuration != REFERENCE_NUMBER]
    assert len(measured) == FIRST * STEPS * len(cell.points)
    codes = suite.stop()
    assert set(codes.values()) == {0}, codes
    replayed = observe(suite.bag, cell)
    aside = {note.place for note in replayed.notes if note.kind == "unsettled"}
    assert len(aside) <= 1, aside  # one reading of some thousands seems to drift by chance, and its note says so
    kept = [row for row in confirmed if f"configuration {row.configuration}, step {row.step}, {row.point}" not in aside]
    assert len(kept) == len(confirmed) - len(aside)
    live = as_readings(kept, cell.points, "")
    mine, its = places(live), places(replayed)  # points of a step that settle later stand behind the others
    assert set(mine) == set(its)
    assert len(mine) == len(live) == len(its) == len(replayed)
    rows, same = [mine[place] for place in mine], [its[place] for place in mine]
    # the phases between markers are a little longer than the windows averaged live
    assert np.abs(replayed.position[same] - live.position[rows]).max() < 2e-4
    assert np.abs(replayed.q[same] - live.q[rows]).max() < 1e-9
    speed = speeds(suite)
    assert speed[:, 1].max() <= LIMIT


@pytest.mark.slow
def test_the_whole_measurement(suite: Any, plan: Path) -> None:
    """18 configurations after a start-up cycle; the stiffnesses, live and offline, to the bit."""
    from calibration_interfaces.msg import Outcome
    from calibration_interfaces.srv import IdentifyStiffness

    suite.start_fast(speed=BRISK)
    suite.start("identification", recording=suite.bag)
    began = time.monotonic()
    result = suite.run(plan).result(600.0)
    took = time.monotonic() - began
    assert result.outcome.code == Outcome.OK, result.outcome.text
    assert (result.configurations_done, result.configurations_skipped) == (18, 0)
    for name in set(suite.processes) - {"identification"}:  # a cell at so many times real time leaves no processor free
        suite.end(name)
    asked = time.monotonic()
    answer = suite.call(
        IdentifyStiffness, "identification/identify_stiffness", patience=LONG, cell=str(CELL),
        out=str(suite.directory / "live"),
    )  # fmt: skip
    identified = time.monotonic() - asked
    print(f"\nmeasured in {took:.0f} s, identified in {identified:.1f} s")
    assert answer.outcome.code == Outcome.OK, answer.outcome.text
    assert identified <= IDENTIFIED
    suite.stop()
    replayed = offline(suite.bag, suite.directory / "offline")
    live = json.loads(answer.result_json)
    assert {**live, "recording": None} == {**replayed, "recording": None}
    assert live["stiffness"] == replayed["stiffness"]
    truth = draw_truth(load_cell(CELL), 1).stiffness
    found = np.array([entry["value"] for entry in live["stiffness"]])
    std = np.array([entry["std"] for entry in live["stiffness"]])
    deviation = np.abs(found - truth) / std
    print("deviations from the truth, in standard deviations:", np.round(deviation, 1))
    assert deviation.max() < 4.0
    assert np.sqrt(np.mean(deviation**2)) < 2.0
    speed = speeds(suite)
    cruising = speed[speed[:, 1] > 0.5 * LIMIT, 1]
    print(f"fastest point {1e3 * speed[:, 1].max():.1f} mm/s, cruising at {cruising.mean() / LIMIT:.2f} of the limit")
    assert speed[:, 1].max() <= LIMIT
    assert cruising.mean() >= 0.8 * LIMIT
    with Session.look(suite.session) as session:
        times = [event.time for event in session.events]
    factor = (max(times) - min(times)) / NANOSECONDS / took
    print(f"{factor:.1f} times real time")
    assert factor >= SPEED


@pytest.mark.slow
def test_what_cannot_be_measured_is_refused_before_anything_moves(suite: Any, plan: Path) -> None:
    from calibration_interfaces.msg import Outcome

    suite.start("simulated_cell", FAST, speed=SPEED)
    suite.start("sequencer", FAST, server_wait=5.0)
    content = yaml.safe_load(plan.read_text(encoding="utf-8"))
    content["configurations"][0]["q"][0] = 9.0
    wrong = suite.directory / "wrong.yaml"
    wrong.write_text(yaml.safe_dump(content), encoding="utf-8")
    for path, found in ((suite.directory / "no.yaml", "no.yaml"), (wrong, "joint's limits")):
        assert found in suite.rejected(path)
    outcome = suite.run(plan).result(60.0).outcome
    assert outcome.code == Outcome.NO_DATA
    assert "no action server tracker/measure; no action server force_torque/measure" in outcome.text
    assert not suite.session.exists()
    Session.create(suite.session, plan.read_text(encoding="utf-8"), load_cell(CELL)).close()
    assert "resume" in suite.rejected(plan)
