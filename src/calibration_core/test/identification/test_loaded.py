"""Loaded recordings: derivatives, recovery of a known truth, outliers, noise audit, methods, refusals."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path

import numpy as np
import pytest
from robots import STIFFNESS, loaded_readings, write_cell

from calibration_core.errors import CellError, IdentificationError
from calibration_core.identification.identify import identify
from calibration_core.identification.stiffness.fit import fit_compliance, held_out_compliance
from calibration_core.identification.stiffness.loaded import Options, prepare_loaded
from calibration_core.identification.stiffness.problem import build_problem
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Note, Readings


def _replace(readings: Readings, **changes: object) -> Readings:
    return dataclasses.replace(readings, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize("method", ["equilibrium", "linear"])
@pytest.mark.parametrize("axes", ["sensor", "base"])
def test_columns_and_wrench_noise_against_finite_differences(tmp_path: Path, method: str, axes: str) -> None:
    where = "sensor" if axes == "sensor" else "wrench_point"
    cell = write_cell(tmp_path, measurements={"wrench_axes": axes, "wrench_at": where})
    readings = loaded_readings(cell, 1, configurations=3)
    chain = chain_of(cell)
    believed = nominal_parameters(cell)

    def predicted(compliance: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        some = _replace(readings, wrench=wrench)
        return build_problem(some, cell, chain, believed, method=method).linearise(compliance).predicted

    compliance, wrench = 1 / np.array(STIFFNESS), readings.wrench
    linear = build_problem(readings, cell, chain, believed, method=method).linearise(compliance)
    for j in range(6):
        h = np.zeros(6)
        h[j] = 1e-10
        numeric = (predicted(compliance + h, wrench) - predicted(compliance - h, wrench)) / 2e-10
        np.testing.assert_allclose(linear.columns[:, :, j], numeric, atol=3e-6 * np.abs(numeric).max())
    sigma = np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
    covariance = np.zeros((len(readings), 3, 3))
    for k in range(6):
        h = np.zeros(6)
        h[k] = 1.0
        column = (predicted(compliance, wrench + h) - predicted(compliance, wrench - h)) / 2 * sigma[k]
        covariance += column[:, :, None] * column[:, None, :]
    shared = linear.rows.shared
    np.testing.assert_allclose(shared @ shared.transpose(0, 2, 1), covariance, atol=1e-6 * covariance.max())


@pytest.mark.parametrize("deflections", ["points", "pose"])
def test_a_known_truth_is_recovered(tmp_path: Path, deflections: str) -> None:
    cell = write_cell(tmp_path)
    found = identify(loaded_readings(cell, 2), cell, Options(deflections=deflections))
    z = [(joint.value - true) / joint.std for joint, true in zip(found.stiffness, STIFFNESS, strict=True)]
    assert np.abs(z).max() < 3.5
    assert all(joint.identifiable for joint in found.stiffness)
    assert found.fit.rms_after < 2.2e-5 < found.fit.rms_before
    assert not found.noise.understated
    assert not found.exclusions
    np.testing.assert_allclose(found.model.tracker[:3, 3], [4.0, 1.0, 1.2], atol=2e-4)


def test_many_gross_errors_cost_few_fits(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    clean = loaded_readings(cell, 4, configurations=14)
    rows = np.flatnonzero(clean.configuration == clean.configuration[0])[1::2]  # one is set aside after the other
    position = clean.position.copy()
    position[rows] += np.random.default_rng(4).normal(0.0, 3e-3, (len(rows), 3))
    spoilt, spent = _replace(clean, position=position), []
    for readings in (clean, spoilt):
        begun = time.process_time()
        prepared = [prepare_loaded(readings, cell, Options()) for _ in range(3)][-1]
        spent.append(time.process_time() - begun)
    assert np.flatnonzero(~prepared.rejection.used).tolist() == rows.tolist()
    assert spent[1] < 4 * spent[0]
    kept = prepared.problem.select(np.flatnonzero(prepared.rejection.used))
    again = fit_compliance(kept, 1 / np.array(STIFFNESS))
    np.testing.assert_allclose(prepared.fit.compliance, again.compliance, rtol=1e-9)


def test_without_noise_the_truth_is_exact(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    found = identify(loaded_readings(cell, 3, noise=0.0), cell, Options(robust=False))
    np.testing.assert_allclose([joint.value for joint in found.stiffness], STIFFNESS, rtol=1e-6)
    assert found.fit.rms_after < 1e-9


@pytest.mark.parametrize(("seeds", "within"), [(20, 0.06), pytest.param(60, 0.035, marks=pytest.mark.slow)])
def test_intervals_cover_and_the_bound_is_attained(tmp_path: Path, seeds: int, within: float) -> None:
    cell = write_cell(tmp_path)
    values, stds, inside = [], [], np.zeros(6)
    base = loaded_readings(cell, 4)  # the same configurations and loads
    clean = loaded_readings(cell, 4, noise=0.0)
    for seed in range(100, 100 + seeds):
        noise = np.random.default_rng(seed).normal(0, 2e-5, base.position.shape)
        found = identify(_replace(clean, position=clean.position + noise), cell)
        values.append([joint.compliance for joint in found.stiffness])
        stds.append([joint.compliance_std for joint in found.stiffness])
        inside += [j.interval[0] <= k <= j.interval[1] for j, k in zip(found.stiffness, STIFFNESS, strict=True)]
    assert inside.mean() / seeds == pytest.approx(0.95, abs=within)
    np.testing.assert_allclose(np.std(values, axis=0) / np.mean(stds, axis=0), 1.0, atol=10 * within)


def test_frames_are_refitted_and_may_be_unknown(tmp_path: Path) -> None:
    truth = write_cell(tmp_path)
    readings = loaded_readings(truth, 5)
    expected = identify(readings, truth)
    wrong = {name: [x + 2e-3 for x in point] for name, point in truth.frames.measurement_points.items()}
    moved = write_cell(tmp_path, frames={"measurement_points": wrong, "tracker": None})
    found = identify(readings, moved)
    for a, b in zip(found.stiffness, expected.stiffness, strict=True):
        assert a.value == pytest.approx(b.value, abs=0.05 * b.std)


def test_a_gross_error_is_named_and_can_be_readmitted(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    clean = loaded_readings(cell, 6)
    position = clean.position.copy()
    row = 3 * 5 * 4 + 3 * 2 + 1  # configuration 5, step 2, mp2
    position[row] += [3e-4, 0.0, -2e-4]
    spoiled = _replace(clean, position=position)
    found = identify(spoiled, cell)
    (one,) = found.exclusions
    assert (one.configuration, one.step, one.point) == (5, 2, "mp2")
    assert one.size == pytest.approx(np.hypot(3e-4, 2e-4), rel=0.4)
    assert "outlier_readings" in [anomaly.kind for anomaly in found.anomalies]
    assert found.residuals.excluded.sum() == 1
    reference = identify(clean, cell)
    for a, b in zip(found.stiffness, reference.stiffness, strict=True):
        assert a.value == pytest.approx(b.value, abs=0.5 * b.std)
    again = identify(spoiled, cell, Options(readmit=frozenset({(5, 2, "mp2")})))
    assert not again.exclusions
    assert again.fit.rms_after > found.fit.rms_used


def test_understated_noise_is_seen_without_the_model_and_widens_the_intervals(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    modest = identify(loaded_readings(cell, 7), cell)
    found = identify(loaded_readings(cell, 7, noise=1.6), cell)
    assert found.noise.understated
    assert found.noise.scale == pytest.approx(1.6, rel=0.1)
    assert "noise_understated" in [anomaly.kind for anomaly in found.anomalies]
    assert found.stiffness[0].std / modest.stiffness[0].std == pytest.approx(1.6, rel=0.15)


def test_a_rest_that_is_not_noise_is_not_blamed_on_the_tracker(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    readings = loaded_readings(cell, 8)
    force = np.linalg.norm(readings.wrench[:, :3], axis=1)
    rotation = 3e-5 * (force / force.max()) ** 3  # rigid and nonlinear in the load: no spring does this
    position = readings.position + rotation[:, None] * [3.0, -2.0, 1.0]
    found = identify(_replace(readings, position=position), cell)
    assert not found.noise.understated
    assert found.noise.scale > 1.2
    assert "is as good as stated" in found.noise.text


def test_held_out_compliances_equal_a_refit(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    readings = loaded_readings(cell, 9, configurations=6)
    chain = chain_of(cell)
    believed = nominal_parameters(cell)
    problem = build_problem(readings, cell, chain, believed)
    fit = fit_compliance(problem, believed.compliance)
    quick = held_out_compliance(fit, problem.configuration)
    rest = problem.select(np.flatnonzero(problem.configuration != 3))
    refit = fit_compliance(rest, believed.compliance)
    std = np.sqrt(np.diag(refit.solution.covariance))
    np.testing.assert_allclose(quick[3], refit.compliance, atol=0.01 * std.min())


def test_displacements_relative_to_step_zero(tmp_path: Path) -> None:
    absolute = write_cell(tmp_path)
    readings = loaded_readings(absolute, 10)
    keys = np.column_stack([readings.configuration, readings.point])
    first = {tuple(key): p for key, p, s in zip(keys, readings.position, readings.step, strict=True) if s == 0}
    moved = readings.position - np.stack([first[tuple(key)] for key in keys])
    cell = write_cell(tmp_path, measurements={"points": "displacement"})
    found = identify(_replace(readings, position=moved), cell)
    reference = identify(readings, absolute)
    for a, b in zip(found.stiffness, reference.stiffness, strict=True):
        assert a.value == pytest.approx(b.value, abs=0.1 * b.std)
    assert not found.residuals.residual[readings.step == 0].any()


def test_a_second_recording_is_predicted(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    found = identify(loaded_readings(cell, 11), cell, test=loaded_readings(cell, 12, configurations=5))
    assert found.test is not None
    assert found.test.rms < 2.2e-5 < found.test.rms_before


def test_unsettled_notes_become_anomalies(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    note = Note("unsettled", "configuration 3, step 1, mp2", "it never settled", 1)
    found = identify(loaded_readings(cell, 13).with_notes(note), cell)
    assert ("unsettled", "it never settled") in [(a.kind, a.text) for a in found.anomalies]


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"wrench": None}, "fx ... tz"),
        ({"step": np.zeros(210, dtype=np.int64)}, "step"),
        ({"wrench": np.full((210, 6), 7.0)}, "fx ... tz"),
    ],
)
def test_recordings_without_loads_are_refused(tmp_path: Path, change: dict, place: str) -> None:
    cell = write_cell(tmp_path)
    with pytest.raises(IdentificationError) as caught:
        prepare_loaded(_replace(loaded_readings(cell, 14), **change), cell, Options())
    assert caught.value.place == place


def test_a_missing_sensor_frame_is_named(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    readings = loaded_readings(cell, 15)
    bare = write_cell(tmp_path, frames={"force_torque": None})
    with pytest.raises(CellError, match=r"frames\.force_torque"):
        identify(readings, bare)


def test_pose_needs_three_points_off_one_line(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    readings = loaded_readings(cell, 16)
    two = readings.select(readings.point < 2)
    with pytest.raises(IdentificationError, match="three such points"):
        identify(two, cell, Options(deflections="pose"))


def test_one_loaded_configuration_is_refused(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    readings = loaded_readings(cell, 17)
    with pytest.raises(IdentificationError, match="at least 2"):
        identify(readings.select(readings.configuration == 4), cell)
