"""From the simulation to the noise: the steps add up, the cause has its bar, what is left out agrees with a refit."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from loaded_cases import planted
from robots import STIFFNESS, loaded_readings

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison.result import WaterfallStep
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.identification.stiffness.predict import from_step_zero, predict_readings
from calibration_core.model.nominal import nominal_parameters
from calibration_core.report.diagnosis_summary import waterfall_lines
from calibration_core.report.results.diagnosis import comparison_dict
from calibration_core.report.results.result import plain
from calibration_core.report.view3d.space import space_view
from calibration_core.timeseries import Readings

BENT = [5e-7, 3e-7, 0.0]  # rad/(N*m), joint 3 about other axes than its own


def simulated(recorded: Readings, cell: Cell) -> Readings:
    """What the cell file's model says of the same angles and wrenches."""
    return dataclasses.replace(recorded, position=predict_readings(recorded, cell, nominal_parameters(cell)))


def bent(cell: Cell, seed: int) -> Readings:
    return planted(cell, seed, "off_axis_compliance", "before", BENT, 18, joint="joint_3")


@pytest.fixture(scope="module")
def recorded(cell: Cell) -> Readings:
    return bent(cell, 3)


@pytest.fixture(scope="module")
def found(cell: Cell, recorded: Readings) -> Diagnosis:
    return diagnose(recorded, cell, simulation=simulated(recorded, cell), test=bent(cell, 99))


def steps_of(found: Diagnosis) -> dict[str, WaterfallStep]:
    (compared,) = found.comparisons
    return {step.name: step for step in compared.waterfall}


def test_the_steps_lead_from_the_simulation_to_the_noise(found: Diagnosis) -> None:
    steps = steps_of(found)
    assert list(steps) == ["simulation", "frames", "geometry", "stiffness", "off_axis_compliance", "noise"]
    assert sum(step.share for step in steps.values()) == pytest.approx(1.0, abs=1e-6)
    assert steps["simulation"].rms == pytest.approx(found.comparisons[0].steps.rms, rel=0.01)  # type: ignore[union-attr]
    last = steps["noise"]
    assert last.rms < 1.2 * found.noise
    assert last.held_out_rms < 1.3 * found.noise
    assert last.test_rms < 1.3 * found.noise
    assert steps["stiffness"].test_rms > 3 * last.test_rms
    bent = steps["off_axis_compliance"]
    assert bent.share_first > bent.share  # the springs of the joints took a part of it
    assert np.isnan(steps["stiffness"].share_first)


def test_the_view_shows_what_each_step_leaves(found: Diagnosis, recorded: Readings, cell: Cell) -> None:
    (compared,) = found.comparisons
    view = space_view(found.identification.space, cell, compared.waterfall)
    kinds = [kind for kind in view.kinds if kind.name not in {"force", "deflection"}]
    steps = list(steps_of(found))[:-1]
    assert [kind.name for kind in kinds] == ["difference", *(f"after {k}, {steps[k]}" for k in range(1, len(steps)))]
    assert [kind.shown for kind in kinds] == [True, False, False, False, True]
    length = {kind.name: [np.linalg.norm(a.vector) for a in view.arrows if a.kind == kind.name] for kind in kinds}
    assert {len(own) for own in length.values()} == {18 * len(recorded.points)}
    assert np.mean(length["difference"]) > 5 * np.mean(length[kinds[-1].name])
    difference = recorded.position - simulated(recorded, cell).position
    own = (recorded.configuration == 1) & (recorded.point == 0)
    load = np.linalg.norm(recorded.wrench[own, :3], axis=1)  # type: ignore[index]
    way = difference[own][load.argmax()] - difference[own][load.argmin()]
    way = nominal_parameters(cell).tracker[:3, :3] @ way
    drawn = next(one.vector for one in view.arrows if one.kind == "difference" and one.posture == 0)
    assert drawn @ way == pytest.approx(np.linalg.norm(drawn) * np.linalg.norm(way))


def test_each_number_is_said_before_and_after(found: Diagnosis, cell: Cell) -> None:
    changes = {one.name: one for one in steps_of(found)["stiffness"].changed}
    before = nominal_parameters(cell).compliance
    for joint, nominal, true in zip(cell.robot.joints, before, STIFFNESS, strict=True):
        one = changes[f"stiffness.{joint}"]
        assert one.before == pytest.approx(1 / nominal)
        assert one.low < one.after < one.high
        assert one.after == pytest.approx(true, rel=0.1)
        assert one.changed == (not one.low <= 1 / nominal <= one.high)


def test_the_model_that_is_handed_out_leaves_what_the_last_step_says(
    found: Diagnosis, recorded: Readings, cell: Cell
) -> None:
    assert found.model is not None
    left = recorded.position - predict_readings(recorded, cell, found.model)
    key = [f"{c}/{p}" for c, p in zip(recorded.configuration, recorded.point, strict=True)]
    for name in set(key):
        rows = np.array([one == name for one in key])
        left[rows] -= left[rows].mean(axis=0)
    assert np.sqrt(np.mean(left**2)) == pytest.approx(steps_of(found)["noise"].rms, rel=0.02)


def test_nothing_is_missing_and_the_stiffness_takes_all(cell: Cell) -> None:
    readings = loaded_readings(cell, 3)
    steps = steps_of(diagnose(readings, cell, simulation=simulated(readings, cell)))
    assert list(steps) == ["simulation", "frames", "geometry", "stiffness", "noise"]
    assert steps["stiffness"].share > 0.97
    assert np.isnan(steps["noise"].test_rms)


def test_the_strongest_pattern_is_named_and_none_where_there_is_none(cell: Cell) -> None:
    readings, nominal = loaded_readings(cell, 3), nominal_parameters(cell)
    exact = simulated(readings, cell)
    noise = 2e-5 * np.random.default_rng(7).standard_normal(exact.position.shape)
    softer = nominal.replace(compliance=nominal.compliance * [1.0, 1.0, 1.5, 1.0, 1.0, 1.0])
    for model, words in ((softer, "about the axis of joint_3"), (nominal, "")):
        recorded = dataclasses.replace(readings, position=predict_readings(readings, cell, model) + noise)
        (compared,) = diagnose(recorded, cell, simulation=exact).comparisons
        assert words in compared.pattern
        assert bool(compared.pattern) == bool(words)
        assert compared.steps is not None
        assert compared.steps.grid is not None
        assert compared.steps.grid.shape == (len(compared.steps.by_configuration), len(compared.steps.by_step))


def test_displacements_have_the_same_steps(found: Diagnosis, recorded: Readings, cell: Cell) -> None:
    own = cell.model_copy(update={"measurements": cell.measurements.model_copy(update={"points": "displacement"})})
    readings = dataclasses.replace(recorded, position=from_step_zero(recorded, recorded.position))
    steps = steps_of(diagnose(readings, own, simulation=simulated(readings, own)))
    assert steps["off_axis_compliance"].rms == pytest.approx(steps_of(found)["off_axis_compliance"].rms, rel=0.1)


def test_what_is_mixed_up_has_no_steps(recorded: Readings, cell: Cell) -> None:
    assert recorded.wrench is not None
    turned = dataclasses.replace(recorded, wrench=-recorded.wrench)
    (compared,) = diagnose(turned, cell, simulation=simulated(recorded, cell)).comparisons
    assert compared.waterfall == ()
    assert waterfall_lines(compared.waterfall) == []


def test_result_and_terminal_hold_the_steps(found: Diagnosis, tmp_path: Path) -> None:
    (compared,) = found.comparisons
    file = tmp_path / "comparison.json"
    file.write_text(json.dumps(plain(comparison_dict(compared)), allow_nan=False))
    steps = json.loads(file.read_text())["steps"]
    assert [step["name"] for step in steps] == [step.name for step in compared.waterfall]
    assert {"name", "what", "rms", "held_out_rms", "test_rms", "share", "changed"} <= set(steps[0])
    assert steps[0]["held_out_rms"] is None
    lines = waterfall_lines(compared.waterfall)
    assert len(lines) <= 12
    assert max(map(len, lines)) <= 120
    assert "off_axis_compliance" in lines[0]
