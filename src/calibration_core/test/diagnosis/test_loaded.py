"""Diagnosis of loaded recordings: what was planted is found and measured, nothing is found where nothing is."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from loaded_cases import TRUE, planted, shifted, true_state
from robots import STIFFNESS, loaded_readings, write_cell

from calibration_core.cell import Cell
from calibration_core.diagnosis.data_checks.noise import moved_with_their_step, whole_steps
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.loaded import diagnose_loaded
from calibration_core.identification.stiffness.predict import from_step_zero, predict_readings
from calibration_core.input_checks.check import check_inputs
from calibration_core.model.identified.model_file import model_text, read_model
from calibration_core.model.nominal import nominal_parameters
from calibration_core.timeseries import Readings


@pytest.mark.parametrize(("seed", "noise"), [(1, 0.7), (2, 1.0), (5, 1.5)])
def test_nothing_is_found_where_nothing_is_whatever_the_noise(cell: Cell, seed: int, noise: float) -> None:
    found = diagnose_loaded(loaded_readings(cell, seed, noise=noise), cell)
    assert found.verdict == "consistent"
    assert found.findings == ()
    assert found.noise == pytest.approx(noise * 2e-5, rel=0.25)  # five steps leave little to see it by: 9 %
    assert found.rms_after == pytest.approx(found.rms_before, rel=0.05)
    kinds = {anomaly.kind for anomaly in found.anomalies}
    assert kinds == ({"noise_understated"} if noise > 1 else set())


def test_an_off_axis_compliance_is_named_measured_and_gives_the_stiffnesses_back(cell: Cell) -> None:
    truth = [2.5e-7, 1.2e-7, 0.5e-7]
    readings = planted(cell, 5, "off_axis_compliance", "before", truth, joint="joint_2")
    found = diagnose_loaded(readings, cell)
    assert found.verdict == "missing_physics"
    assert [(f.effect, dict(f.location)) for f in found.findings] == [("off_axis_compliance", {"joint": "joint_2"})]
    finding = found.findings[0]
    if finding.variant == "before":
        for parameter, value in zip(finding.parameters, truth, strict=True):
            assert abs(parameter.value - value) < 4 * parameter.std
    before = [joint.value for joint in found.identification.stiffness]
    after = [value for value, _ in found.stiffness.values()]
    assert max(abs(np.array(after) / STIFFNESS - 1)) < 0.5 * max(abs(np.array(before) / STIFFNESS - 1))
    assert found.held_out_after < 1.15 * found.noise < 0.6 * found.held_out_before
    assert finding.held_out_gain > 0.5
    assert "joint_2" in finding.explanation
    stated = {joint: float(bias) for joint, bias in re.findall(r"(joint_\d) ([+-]\d+) %", finding.explanation)}
    biases = dict(zip(found.stiffness, 100 * (np.array(before) / after - 1), strict=True))
    assert stated
    assert all(abs(bias - biases[joint]) <= 0.5 for joint, bias in stated.items()), (stated, biases)


def test_an_effect_far_beyond_its_usual_size_is_not_drawn_towards_it(cell: Cell) -> None:
    """A lever arm of 150 mm, 30 times its usual size: sizes and stiffnesses lie in their intervals all the same."""
    truth = [0.0, 0.0, 0.15]
    found = diagnose_loaded(planted(cell, 8, "wrench_point_offset", "lever arm", truth, 8, sensor="force_torque"), cell)
    (finding,) = found.findings
    assert finding.effect == "wrench_point_offset"
    off = [(one.value - value) / one.std for one, value in zip(finding.parameters, truth, strict=True)]
    assert np.abs(off).max() < 2.0
    values = np.array(list(found.stiffness.values()))
    assert np.abs((values[:, 0] - STIFFNESS) / values[:, 1]).max() < 2.0


def test_the_extended_model_is_read_back_and_predicts_another_recording(cell: Cell, tmp_path: Path) -> None:
    truth = [2.5e-7, 1.2e-7, 0.5e-7]
    readings, other = (planted(cell, seed, "off_axis_compliance", "before", truth, joint="joint_2") for seed in (5, 6))
    found = diagnose_loaded(readings, cell, test=other)
    assert found.test is not None
    # the frames are fitted before the bearing is known, which sags by millimetres under the weight
    assert found.test.rms < 1.5 * found.noise < 0.5 * found.test.rms_before
    path = tmp_path / "model.yaml"
    assert found.model is not None
    path.write_text(model_text(found.model, cell))
    model = read_model(path, cell)
    plain = model.replace(effects=(), compliance=found.identification.model.compliance)
    with_effect, without = (
        np.sqrt(np.mean(from_step_zero(other, other.position - predict_readings(other, cell, m)) ** 2))
        for m in (model, plain)
    )
    assert with_effect < 0.6 * without


def test_gross_errors_under_a_strong_effect_are_named_and_good_readings_kept(cell: Cell) -> None:
    readings = planted(cell, 5, "off_axis_compliance", "before", [5e-7, 3e-7, 0.0], joint="joint_2")
    position = readings.position.copy()
    wild = [40, 111]
    position[wild] += [[4e-4, -3e-4, 4e-4], [-5e-4, 2e-4, 3e-4]]
    found = diagnose_loaded(dataclasses.replace(readings, position=position), cell)
    assert [f.effect for f in found.findings] == ["off_axis_compliance"]
    anomaly = next(a for a in found.anomalies if a.kind == "outlier_readings")
    assert "2 readings" in anomaly.text
    for row in wild:
        key = f"{readings.configuration[row]}/{readings.step[row]}/{readings.points[readings.point[row]]}"
        assert key in anomaly.text


def test_a_step_of_which_every_point_is_elsewhere_is_no_gross_error_of_the_tracker(cell: Cell) -> None:
    readings = loaded_readings(cell, 5)
    position = readings.position.copy()
    for configuration in np.unique(readings.configuration)[[2, 4]]:
        elsewhere = (readings.configuration == configuration) & (readings.step == readings.step.max() // 2)
        assert elsewhere.sum() == len(readings.points) == 3
        position[elsewhere] += [4e-4, -3e-4, 4e-4]
    found = diagnose_loaded(dataclasses.replace(readings, position=position), cell)
    assert found.rest.significant
    assert found.verdict == "unexplained"
    assert "all points moved together" in found.rest.text


def test_a_step_set_aside_whole_is_distinguished_from_gross_errors_by_the_shape_of_the_tool(cell: Cell) -> None:
    readings = loaded_readings(cell, 5)
    m = len(readings)
    every, noise = np.arange(m), np.tile(1e-10 * np.eye(3), (m, 1, 1))
    residual = 1e-5 * np.random.default_rng(1).standard_normal((m, 3))
    step = np.flatnonzero((readings.configuration == readings.configuration[0]) & (readings.step == 1))
    lever = readings.position[step] - readings.position[step].mean(axis=0)
    residual[step] += np.cross([2e-3, -1e-3, 3e-3], lever) + np.array([4e-4, -3e-4, 4e-4])
    without = np.setdiff1d(every, step)

    def moved_steps(used: np.ndarray, sound: np.ndarray, moved: np.ndarray = residual) -> list[int]:
        return list(whole_steps(readings, readings.position, moved, noise, used, sound))

    assert moved_steps(without, every) == list(step)
    assert moved_steps(every, every) == []
    assert moved_steps(without, without) == []  # it may not be used at all
    assert moved_steps(np.setdiff1d(every, step[:2]), every) == []
    wild = residual.copy()
    wild[step[1]] += [2e-4, 1e-4, -2e-4]
    assert moved_steps(without, every, wild) == []
    alone = np.setdiff1d(every, np.flatnonzero(readings.configuration == readings.configuration[0]))
    assert moved_steps(alone, every) == []  # nothing is left to compare the step with


def test_what_moved_with_its_step_is_told_from_gross_errors_whatever_the_axes(cell: Cell) -> None:
    """Residuals are in base axes, readings in those of the tracker: the tool's place in the base counts."""
    readings = loaded_readings(cell, 5)
    m, place = len(readings), true_state(readings, cell).point.T
    noise = np.tile(1e-10 * np.eye(3), (m, 1, 1))
    residual = 1e-5 * np.random.default_rng(2).standard_normal((m, 3))
    steps = [np.flatnonzero((readings.configuration == c) & (readings.step == 2)) for c in (2, 5)]
    for step in steps:
        residual[step] += np.cross([2e-3, -1e-3, 3e-3], place[step] - place[step].mean(axis=0))
        residual[step] += [4e-4, -3e-4, 4e-4]
    along = place[steps[1][0]] - place[steps[1][1:]].mean(axis=0)
    residual[steps[1][0]] += 3e-4 * along / np.linalg.norm(along)  # a gross error changes the shape
    aside = np.array([steps[0][0], steps[0][2], steps[1][0]])
    used = np.setdiff1d(np.arange(m), aside)
    found = moved_with_their_step(readings, place, residual, noise, used, aside)
    assert list(found) == [steps[0][0], steps[0][2]]
    assert list(whole_steps(readings, place, residual, noise, np.setdiff1d(used, steps[0]), np.arange(m))) == list(
        steps[0]
    )


def test_a_gross_error_that_turns_the_tool_by_itself_did_not_move_with_its_step(cell: Cell) -> None:
    """Of one point across the plane of three: no length between them changes, but the others stand where they stood."""
    readings = loaded_readings(cell, 5)
    m, place = len(readings), true_state(readings, cell).point.T
    noise = np.tile(1e-10 * np.eye(3), (m, 1, 1))
    residual = 1e-5 * np.random.default_rng(2).standard_normal((m, 3))
    step = np.flatnonzero((readings.configuration == 2) & (readings.step == 2))
    across = np.cross(place[step[1]] - place[step[0]], place[step[2]] - place[step[0]])
    residual[step[1]] += 5e-4 * across / np.linalg.norm(across)
    aside = step[[1]]
    used = np.setdiff1d(np.arange(m), aside)
    assert not len(moved_with_their_step(readings, place, residual, noise, used, aside))
    residual[step[[0, 2]]] += 3e-4
    residual[step[1]] += 3e-4
    assert list(moved_with_their_step(readings, place, residual, noise, used, aside)) == list(aside)


def moved_flange(readings: Readings, cell: Cell, point: int, rows: np.ndarray, shift: np.ndarray) -> Readings:
    """Return the readings with one point displaced in the flange frame, (r, 3) m, in some rows."""
    axes = np.moveaxis(true_state(readings, cell).at.flange, -1, 0)
    rotation = nominal_parameters(cell).tracker[:3, :3]
    chosen = rows & (readings.point == point)
    position = readings.position.copy()
    position[chosen] += np.einsum("mia,mi->ma", axes, np.broadcast_to(shift, (len(readings), 3)))[chosen] @ rotation
    return dataclasses.replace(readings, position=position)


def test_a_target_that_moved_is_located_and_no_physics_is_claimed(cell: Cell) -> None:
    readings = loaded_readings(cell, 31, 18)
    later = readings.configuration >= 8
    found = diagnose_loaded(moved_flange(readings, cell, 1, later, np.array([1e-3, -5e-4, 8e-4])), cell)
    anomaly = next(a for a in found.anomalies if a.kind == "target_moved")
    assert dict(anomaly.location) == {"point": "mp2"}
    assert anomaly.configurations == (8, 18)
    assert anomaly.magnitude == pytest.approx(np.linalg.norm([1e-3, -5e-4, 8e-4]), rel=0.1)
    assert (found.verdict, found.findings) == ("consistent", ())


def test_a_loose_target_is_named_and_not_used(cell: Cell) -> None:
    readings = loaded_readings(cell, 32, 18)
    shake = 1.2e-4 * np.random.default_rng(0).standard_normal((len(readings), 3))
    found = diagnose_loaded(moved_flange(readings, cell, 2, readings.configuration > 0, shake), cell)
    anomaly = next(a for a in found.anomalies if a.kind == "loose_target")
    assert dict(anomaly.location) == {"point": "mp3"}
    assert (found.verdict, found.findings) == ("consistent", ())


def test_a_tracker_that_moved_is_found_from_its_configuration_on(cell: Cell) -> None:
    readings = loaded_readings(cell, 33, 18)
    later = (readings.configuration >= 10)[:, None]
    found = diagnose_loaded(
        dataclasses.replace(readings, position=readings.position + later * np.array([1e-3, 2e-3, -1e-3])), cell
    )
    anomaly = next(a for a in found.anomalies if a.kind == "tracker_moved")
    assert anomaly.configurations == (10, 18)
    assert (found.verdict, found.findings) == ("consistent", ())


def test_frames_that_the_file_has_wrong_are_said(tmp_path: Path) -> None:
    true = write_cell(tmp_path)
    readings = loaded_readings(true, 41, 18)
    other = write_cell(tmp_path, frames={"tracker": {"xyz": [4.0, 1.0, 1.2], "rpy": [0.014, -0.02, -2.9]}})
    found = diagnose_loaded(readings, other)
    assert found.findings == ()  # it turns the deflections by less than the noise
    (note,) = [one for one in found.identification.notes if one.place == "frames.tracker"]
    assert float(note.text.split(" turned by ")[1].split()[0]) == pytest.approx(4.0, rel=0.05)
    np.testing.assert_allclose([1 / v for v, _ in found.stiffness.values()], TRUE, rtol=0.05)


def test_frames_are_not_called_wrong_where_the_tracker_moved(tmp_path: Path) -> None:
    """Absolute positions of two set-ups in one recording show no registration."""
    readings = loaded_readings(write_cell(tmp_path), 41, 18)
    other = write_cell(tmp_path, frames={"tracker": {"xyz": [4.0, 1.0, 1.2], "rpy": [0.014, -0.02, -2.9]}})
    later = (readings.configuration >= 10)[:, None]
    moved = dataclasses.replace(readings, position=readings.position + later * np.array([1e-3, 2e-3, -1e-3]))
    found = diagnose_loaded(moved, other)
    assert "tracker_moved" in {anomaly.kind for anomaly in found.anomalies}
    assert found.findings == ()


def test_a_residual_that_is_large_everywhere_is_never_consistent(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the search says: what is left in the middle of the readings is held against the noise once more."""
    readings = loaded_readings(cell, 1)
    found = diagnose_loaded(readings, cell)
    assert found.verdict == "consistent"
    assert found.compliance_covariance is not None
    left = dataclasses.replace(found, residual=3.0 * found.residual)
    monkeypatch.setattr("calibration_core.diagnosis.diagnose._with_location", lambda *_: left)
    judged = diagnose(readings, cell)
    assert judged.verdict == "unexplained"
    assert judged.rest.significant
    assert judged.rest.rms == pytest.approx(np.sqrt(8.0) * found.noise, rel=0.2)
    assert judged.compliance_covariance is not None
    wider = np.sqrt(np.diag(judged.compliance_covariance) / np.diag(found.compliance_covariance))
    assert np.all((wider > 2.4) & (wider < 3.6))


@pytest.mark.parametrize(
    ("joint", "sizes"),
    [(3, (1.0, 0.6, 0.0)), (4, (0.5, 1.0, 0.2)), pytest.param(5, (1.0, 0.6, 0.0), marks=pytest.mark.slow)],
)
def test_intervals_hold_the_truth_whatever_axes_of_the_wrist_a_bearing_tilts_about(
    cell: Cell, joint: int, sizes: tuple[float, ...]
) -> None:
    """The axes of the wrist meet: a bearing may tilt as another joint turns, and the recording cannot tell them."""
    values = [0.4 * size * TRUE[joint] for size in sizes]
    readings = planted(cell, 1, "off_axis_compliance", "before", values, joint=f"joint_{joint + 1}")
    answer = diagnose(readings, cell)
    assert {finding.effect for finding in answer.findings} == {"off_axis_compliance"}
    assert answer.compliance is not None
    assert answer.compliance_covariance is not None
    off = (answer.compliance - TRUE) / np.sqrt(np.diag(answer.compliance_covariance))
    assert np.abs(off).max() < 2.5


@pytest.mark.parametrize("steps", [2, 5])
@pytest.mark.parametrize(("times", "verdict"), [(1.0, "consistent"), (1.5, "unexplained")])
def test_a_residual_beyond_the_noise_is_seen_beside_the_offsets(
    steps: int, times: float, verdict: str, cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An offset of every configuration and point takes half of the squares of two steps with it."""
    readings = loaded_readings(cell, 3, 16)
    readings = readings.select(readings.step < steps)
    found = diagnose_loaded(readings, cell)
    drawn = times * found.noise * np.random.default_rng(steps).standard_normal((len(readings), 3))
    keys = np.column_stack([readings.configuration, readings.point])
    _, group, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    mean = np.stack([np.bincount(group.reshape(-1), one) / count for one in drawn.T], axis=1)
    left = dataclasses.replace(found, residual=drawn - mean[group.reshape(-1)])
    monkeypatch.setattr("calibration_core.diagnosis.diagnose._with_location", lambda *_: left)
    assert diagnose(readings, cell).verdict == verdict


@pytest.mark.parametrize("steps", [2, 5])
def test_a_wrist_on_soft_belts_is_no_other_robot(steps: int, cell: Cell) -> None:
    """Ten times as soft as stated, and the torque of one joint turns the other nearly as far."""
    readings = loaded_readings(cell, 5, 14)
    readings = readings.select(readings.step < steps)
    state = true_state(readings, cell)
    (first, second), share = 9 * TRUE[4:], 8 * float(np.sqrt(TRUE[4] * TRUE[5]))
    moved = state.joint_column(4, first * state.torque[4] + share * state.torque[5])
    moved += state.joint_column(5, second * state.torque[5] + share * state.torque[4])
    soft = shifted(readings, cell, moved)
    assert check_inputs(soft, cell) == ()
    found = diagnose(soft, cell)
    assert [(one.effect, one.location["joints"]) for one in found.findings] == [
        ("joint_coupling", ("joint_5", "joint_6"))
    ]
