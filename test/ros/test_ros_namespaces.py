"""Two cells on one machine, each in its namespace: both measure at once, and neither knows of the other."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

pytest.importorskip("rclpy")

from calibration_core.cell import load_cell
from calibration_core.measurement.session import Session
from calibration_core.planning.plans.plan import REFERENCE_NUMBER
from calibration_core.recording.bags.bag import read_bag

ROOT = Path(__file__).resolve().parents[2]
CELL = ROOT / "config" / "cells" / "demo.cell.yaml"
SPEED = 8.0  # times real time: two of them share the machine
NAMESPACES = {"/left": 1, "/right": 2}  # and the seed of the hidden truth and the noise
PROGRESS = "/calibration/progress"  # worked out behind all others: on a busy machine a short run ends before it
NOISY = ("/tracker/mp1", "/tracker/mp2", "/tracker/mp3", "/force_torque/wrench")  # no two messages are the same


@pytest.fixture
def cells(suite: Any, spinning: Any, source_environment: dict[str, str], tmp_path: Path) -> Iterator[dict[str, Any]]:
    """A suite for every namespace; no process yet."""
    import rclpy

    made: dict[str, Any] = {}
    with contextlib.ExitStack() as ending:
        for namespace in NAMESPACES:
            directory = tmp_path / namespace.strip("/")
            directory.mkdir()
            client = spinning.add(rclpy.create_node("outside", namespace=namespace, context=spinning.context))
            made[namespace] = type(suite)(source_environment, client, directory, namespace=namespace)
            ending.callback(made[namespace].stop)
        yield made


def payloads(bag: Path) -> dict[str, Counter[bytes]]:
    """Raw messages of a bag, by topic."""
    found: dict[str, Counter[bytes]] = {}
    for path in sorted(bag.glob("*.mcap")):
        with path.open("rb") as file:
            for _, channel, message in make_reader(file).iter_messages():
                found.setdefault(channel.topic, Counter())[message.data] += 1
    return found


def replayed(bag: Path, out: Path) -> dict[str, Any]:
    """Identify a bag without ROS."""
    program = Path(sys.executable).parent / "calibration"
    command = [str(program), "identify", str(bag), "--cell", str(CELL), "--out", str(out), "--no-report"]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    return dict(json.loads((out / "result.json").read_text(encoding="utf-8")))


def confirmed(session: Session) -> list[tuple[int, int, str]]:
    """Configuration, step and point of every confirmed reading; visits to the reference are counted.

    Their own numbers have gaps where a visit was repeated, as on a busy machine.
    """
    rows = [(one.configuration, one.step, one.point) for one in session.confirmed()]
    visits = sorted({step for configuration, step, _ in rows if configuration == REFERENCE_NUMBER})
    return [(number, visits.index(step) if number == REFERENCE_NUMBER else step, point) for number, step, point in rows]


def measure_both(cells: dict[str, Any], plan: Path, timeout: float) -> None:
    """Measure a plan in both cells at once, and see that neither took anything from the other."""
    from calibration_interfaces.msg import Outcome, State
    from calibration_interfaces.srv import IdentifyStiffness

    states: dict[str, list[Any]] = {namespace: [] for namespace in cells}
    runs = {}
    for namespace, suite in cells.items():
        suite.start_fast(SPEED, seed=NAMESPACES[namespace])
        suite.start("manager")
        suite.start("identification", recording=suite.bag)
        from calibration.topics import STATE

        suite.client.create_subscription(State, STATE.relative, states[namespace].append, STATE.qos)
    for namespace, suite in cells.items():
        runs[namespace] = suite.run(plan)
    for namespace, suite in cells.items():
        result = runs[namespace].result(timeout)
        assert result.outcome.code == Outcome.OK, (namespace, result.outcome.text, suite.log("sequencer")[-2000:])
        assert result.recording == str(suite.bag)
    live = {}
    for namespace, suite in cells.items():
        answer = suite.call(IdentifyStiffness, "identification/identify_stiffness", patience=60.0)
        assert answer.outcome.code == Outcome.OK, answer.outcome.text
        live[namespace] = json.loads(answer.result_json)
        assert states[namespace][-1].procedure.session == str(suite.session)
        assert {one.name for one in states[namespace][-1].nodes if one.process} >= {"guard", "sequencer", "recorder"}
        suite.stop()
    cell, done, kept, raw = load_cell(CELL), [], [], []
    for namespace, suite in cells.items():
        with Session.look(suite.session) as session:
            done.append((session.completed, confirmed(session)))
            kept.append(len(session.confirmed(all_attempts=True)))  # on a busy machine one is measured again
        raw.append(payloads(suite.bag))
        recorded = read_bag(suite.bag, cell)
        times = recorded.joints.time
        assert (times[1:] > times[:-1]).all()  # those of another cell would stand between them
        offline = replayed(suite.bag, suite.directory / "offline")
        assert {**live[namespace], "recording": None} == {**offline, "recording": None}
        assert live[namespace]["stiffness"] == offline["stiffness"]
    assert done[0] == done[1]  # the same configurations, steps and points
    left, right = raw
    assert set(left) - {PROGRESS} == set(right) - {PROGRESS}
    for topic in NOISY:
        assert len(left[topic]) > 100
        assert not left[topic].keys() & right[topic].keys(), topic
    readings = [sum(one["/calibration/reading"].values()) for one in raw]
    assert readings == kept
    assert live["/left"]["stiffness"] != live["/right"]["stiffness"]


def test_two_cells_at_once(cells: dict[str, Any], short_plan: Path) -> None:
    measure_both(cells, short_plan, 300.0)


@pytest.mark.slow
def test_two_whole_measurements_at_once(cells: dict[str, Any], plan: Path) -> None:
    measure_both(cells, plan, 1800.0)
