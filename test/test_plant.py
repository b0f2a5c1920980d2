from __future__ import annotations

import csv
import json
from collections import Counter
from pathlib import Path

import numpy as np
from plant import DAMAGES, HEALTHY, STRONG, TYPES, plant, true_stiffness, write_plant

from calibration_core.cell import load_cell
from calibration_core.observations.observe import observe


def test_a_plant_has_its_share_of_every_damage() -> None:
    recordings = plant(1, 600, 3, 0.03)
    robots = {one.robot.name: one.robot for one in recordings}
    assert len(recordings) == 1800
    assert Counter(robot.damage for robot in robots.values()) == {HEALTHY: 576, **dict.fromkeys(DAMAGES, 6)}
    assert {robot.type for robot in robots.values()} == set(TYPES)
    assert {robot.type for robot in robots.values() if robot.damage == "soft_base"} <= set(STRONG)
    faults = Counter(one.fault for one in recordings)
    assert 5 <= faults["broken"] <= 35
    assert 2 <= faults["wrong_cell"] <= 20


def test_a_damage_is_there_from_its_date_on() -> None:
    (softer,) = {one.robot for one in plant(1, 100, 3, 0.03) if one.robot.damage == "softer_joint"}
    values = [true_stiffness(one)[softer.joint] for one in plant(1, 100, 3, 0.03) if one.robot == softer]
    expected = [0.85 if date >= softer.since else 1.0 for date in range(3)]
    assert np.allclose(np.array(values) / values[0], expected)


def test_what_is_written_is_the_same_however_many_processes_write_it(tmp_path: Path) -> None:
    recordings = plant(3, 6, 1, 0.03)
    manifests = [write_plant(recordings, tmp_path / str(jobs), jobs) for jobs in (1, 2)]
    rows = list(csv.DictReader(manifests[0].open(encoding="utf-8")))
    assert [row["type"] for row in rows] == list(TYPES)
    for row in rows:
        one, other = (manifest.parent / row["recording"] for manifest in manifests)
        assert one.read_bytes() == other.read_bytes()
    truth = json.loads((tmp_path / "1" / "truth.json").read_text(encoding="utf-8"))
    good = next(one for one in truth if not one["fault"])
    folder = (tmp_path / "1" / good["recording"]).parent
    assert len(observe(folder / "measurements.csv", load_cell(folder / "cell.yaml"))) > 100
