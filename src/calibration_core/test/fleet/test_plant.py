"""A plant drawn from estimates alone: damaged robots are found, healthy ones are left in peace."""

from __future__ import annotations

import dataclasses
import datetime as dt
import json
import math
from pathlib import Path

import numpy as np
import pytest

from calibration_core.acceptance.comparison import Measurement, trends
from calibration_core.commands.fleet.results import fleet_files
from calibration_core.fleet.findings import found_in
from calibration_core.fleet.next_robot.population_file import population_text, read_population
from calibration_core.fleet.plant import CONSPICUOUS, UNKNOWN, Plant, evaluate_plant
from calibration_core.fleet.proposals import proposals
from calibration_core.fleet.recordings.rows import FAILED, MEASURED, Row
from calibration_core.fleet.tables import joints
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.outcomes.comparison import described_trend
from calibration_core.report.writing.output import REPORT_HTML

DATES = ("2026-01-12", "2026-07-13", "2027-01-11")
JOINTS = tuple(f"joint_{k}" for k in range(1, 7))
STIFFNESS = np.array([1.4e6, 2.6e6, 1.8e6, 5e5, 3.5e5, 2.5e5])
TYPES = ("ten kg", "sixty kg")
Drawn = tuple[list[Row], set[str], Plant]  # rows, names of the damaged robots, what is said of them
LAWS = tuple(f"{kind}.{joint}" for joint in JOINTS for kind in ("backlash", "hysteresis"))


def rows_of(rng: np.random.Generator, kind: str, robot: str, damage: str, spread: float = 0.03) -> list[Row]:
    """Three dates of one robot; the damage is there from the second one on."""
    stiffness = STIFFNESS * np.exp(spread * rng.standard_normal(6))
    joint = int(rng.integers(5))
    made = []
    for k, date in enumerate(DATES):
        true, laws = stiffness.copy(), np.full(len(LAWS), 5e-6)
        if k >= 1 and damage == "softer":
            true[joint] *= 0.85
        if k >= 1 and damage == "exchanged":
            true[joint] *= 1.05
        if damage == "backlash":
            laws[2 * joint] += 1e-4 * (k + 1)
        relative = 0.01 * np.exp(0.2 * rng.standard_normal(6)) if damage != "exchanged" else np.full(6, 0.008)
        std = np.full(len(LAWS), 3e-6)
        effects = ("base_compliance",) if damage == "base" and k >= 1 else ()
        compliance = np.exp(relative * rng.standard_normal(6)) / true
        made.append(Row(
            recording=f"/{kind}/{robot}/{date}.csv", cell="/cell.yaml", robot=robot, type=kind, date=date,
            status=MEASURED, key=f"{kind}{robot}{date}", usable="yes", verdict="consistent", configurations=18,
            joints=JOINTS, units=("rad/(N*m)",) * 6, compliance=tuple(compliance.tolist()),
            covariance=tuple(np.diag((relative * compliance) ** 2).ravel().tolist()),
            law_names=LAWS, law_values=tuple((laws + std * rng.standard_normal(len(LAWS))).tolist()),
            law_stds=tuple(std.tolist()), effects=effects, locations=("base",) * len(effects),
            magnitudes=(1e-4,) * len(effects), evidence=(80.0,) * len(effects),
        ))  # fmt: skip
    return made


def drawn(seed: int, robots: int) -> tuple[list[Row], set[str]]:
    """Rows of a plant, and the names of its damaged robots: 4 of 100."""
    rng = np.random.default_rng(seed)
    kinds = ("softer", "backlash", "base", "exchanged")
    rows: list[Row] = []
    damaged = set()
    for number in range(robots):
        damage = kinds[number // 25 % 4] if number % 25 == 0 else ""
        name = f"r{number:04d}"
        damaged |= {name} if damage else set()
        rows += rows_of(rng, TYPES[number // 2 % 2], name, damage)
    return rows, damaged


@pytest.fixture(scope="module")
def plant() -> Drawn:
    rows, damaged = drawn(1, 600)
    return rows, damaged, evaluate_plant(rows)


def test_damaged_robots_are_found_and_healthy_ones_are_not_accused(plant: Drawn) -> None:
    _, damaged, found = plant
    accused = {robot.robot for robot in found.robots if robot.state == CONSPICUOUS}
    assert len(damaged) == 24
    assert len(damaged & accused) / len(damaged) >= 0.95
    assert len(accused - damaged) / (600 - len(damaged)) <= 0.005


def test_the_ranking_gives_reasons(plant: Drawn) -> None:
    _, damaged, found = plant
    first = [robot for robot in found.robots if robot.robot in damaged][:10]
    assert [robot.robot for robot in found.robots[:10]] == [robot.robot for robot in first]
    texts = [reason.text for robot in found.robots for reason in robot.reasons]
    assert any("stiffness of joint" in text and "between 2026-01-12 and 2026-07-13" in text for text in texts)
    assert any("backlash of joint" in text and "mrad" in text for text in texts)
    assert any("the base gives way" in text for text in texts)


def test_raw_and_pooled_stand_side_by_side(plant: Drawn) -> None:
    _, _, found = plant
    members = [state for state in found.states if state.kind == "stiffness"]
    assert len(members) == 600 * 6
    assert any(state.is_pooled and state.pooled != state.raw for state in members)
    assert all(state.pooled == state.raw for state in members if not state.is_pooled)
    width = [
        math.log(state.pooled_high / state.pooled_low) / math.log(state.raw_high / state.raw_low) for state in members
    ]
    assert np.median(width) < 1.0


def test_a_robot_may_stand_for_itself(plant: Drawn) -> None:
    rows, _, _ = plant
    found = evaluate_plant([row for row in rows if row.robot < "r0100"], alone=["r0003"])
    states = [state for state in found.states if state.robot == "r0003"]
    assert states
    assert not any(state.is_pooled for state in states)


def test_the_page_stays_small(plant: Drawn) -> None:
    """At 600 robots within 3 MB: 5 MB at 1,000, for what it holds is per robot."""
    rows, _, found = plant
    page = fleet_files(found, rows, "plant.csv", report=True)[REPORT_HTML]
    assert isinstance(page, bytes)
    assert len(page) <= 3e6
    text = page.decode()
    assert 'id="search"' in text
    data = json.loads(text.split('id="fleet-data">')[1].split("</script>")[0])
    assert len(data["robots"]) == 600
    assert len(data["robots"][0][8]) == 18


def test_names_from_outside_stay_names(plant: Drawn) -> None:
    rows, _, _ = plant
    evil = "</script><b>r</b>"
    named = [
        dataclasses.replace(row, robot=evil) if row.robot == "r0000" else row for row in rows if row.robot < "r0030"
    ]
    files = fleet_files(evaluate_plant(named), named, "plant.csv", report=True)
    assert evil not in files[REPORT_HTML].decode()  # type: ignore[union-attr]


def test_failures_are_named_and_measured_next(plant: Drawn) -> None:
    rows, _, _ = plant
    few = [row for row in rows if row.robot < "r0050"]
    lost = [
        dataclasses.replace(row, status=FAILED, error="file: found nothing") if row.robot == "r0001" else row
        for row in few
    ]
    found = evaluate_plant(lost)
    (robot,) = [one for one in found.robots if one.robot == "r0001"]
    assert robot.state == UNKNOWN
    assert proposals(found)[0].robot == "r0001"
    assert found.failed == 3


def test_the_population_is_read_back_with_its_provenance(plant: Drawn, tmp_path: Path) -> None:
    _, _, found = plant
    path = tmp_path / "population.yaml"
    path.write_text(population_text(found, "plant.csv", "abc"), encoding="utf-8")
    one = read_population(path, "ten kg", JOINTS)
    assert one.source == "300 robots of plant.csv"
    for joint, stiffness in zip(JOINTS, STIFFNESS, strict=True):
        known = one.joints[joint]
        assert math.exp(known.mean) == pytest.approx(stiffness, rel=0.01)
        assert known.spread == pytest.approx(0.03, rel=0.25)


def test_a_damage_that_was_clearly_seen_counts_although_the_last_recording_does_not_show_it() -> None:
    first, second, last = rows_of(np.random.default_rng(3), TYPES[0], "r1", "")
    name = "backlash.joint_3"
    place = LAWS.index(name)

    def seen(row: Row, evidence: float, clearance: float) -> Row:
        laws = [*row.law_values[:place], clearance, *row.law_values[place + 1 :]]
        effects = ("backlash",) if evidence else ()
        return dataclasses.replace(
            row, effects=effects, locations=("joint_3",) * len(effects), evidence=(evidence,) * len(effects),
            law_values=tuple(laws),
        )  # fmt: skip

    def said(*rows: Row) -> list[str]:
        return [text for text, _ in found_in(rows, {})]

    quiet = seen(last, 0.0, 3e-5)
    words = f"joint 3 has backlash (seen on {second.date})"
    assert said(first, seen(second, 17.0, 3e-5), quiet) == [words]
    assert said(first, seen(second, 9.0, 3e-5), quiet) == []  # by chance, in one of many recordings
    assert said(first, seen(second, 17.0, 9e-5), quiet) == []  # it has been repaired
    assert said(seen(first, 17.0, 3e-5), seen(last, 6.0, 3e-5)) == ["joint 3 has backlash (its last recording)"]
    assert said() == []


def test_a_plant_and_a_comparison_state_the_same_yearly_change() -> None:
    """A stiffness that has fallen by 10.6 % in two years falls by 5.4 % a year, whoever says so."""
    dates, share = ("2024-01-01", "2025-01-01", "2026-01-01"), (1.0, 0.9457, 0.8944)
    names, units = tuple(f"compliance.{joint}" for joint in JOINTS), ("rad/(N*m)",) * 6
    rows, measurements = [], []
    for row, date, left in zip(rows_of(np.random.default_rng(1), "ten kg", "one", ""), dates, share, strict=True):
        stiffness = STIFFNESS * np.where(np.arange(6) == 1, left, 1.0)
        covariance = np.diag((1e-3 / stiffness) ** 2)
        rows.append(dataclasses.replace(
            row, date=date, compliance=tuple((1 / stiffness).tolist()), covariance=tuple(covariance.ravel().tolist())
        ))  # fmt: skip
        estimate = GaussianEstimate(names, units, 1 / stiffness, covariance)
        day = dt.datetime.fromisoformat(date).replace(tzinfo=dt.UTC)
        measurements.append(Measurement(date, day, 18, estimate, GaussianEstimate.nothing()))
    (trend,) = (one for one in trends(measurements) if one.location == "joint_2")
    plant = evaluate_plant(rows)
    (record,) = (one for one in joints(plant) if (one["quantity"], one["joint"]) == ("stiffness", "joint_2"))
    assert trend.slope == pytest.approx(-0.0543, abs=1e-4)
    assert (1 + trend.slope) ** 2 == pytest.approx(0.8944, abs=1e-3)
    assert [record[key] for key in ("per_year", "per_year_low", "per_year_high")] == pytest.approx(
        [trend.slope, trend.low, trend.high], rel=1e-3
    )
    assert record["per_year_unit"] == trend.unit == "1/year"
    assert "-5.42 % per year" in described_trend(trend)
    assert "stiffness of joint 2 changes by -5.4 % a year" in [one.text for one in plant.robots[0].reasons]
