"""The phases of one recording: told apart, with a wrench point that only known configurations saw; result, report."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from robots import STIFFNESS, cell_dict
from test_circle_point import HOME

from calibration_core.cell import Cell
from calibration_core.identification.identify import identify
from calibration_core.identification.standard.kinematic_phases import identify_kinematics, split, without_sensor_noise
from calibration_core.identification.standard.phases import holds_phases, identify_phases
from calibration_core.model.chain import pose_matrix
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.simulation.simulate import simulate_plan
from calibration_core.report.content import build
from calibration_core.report.results.result import result_dict
from calibration_core.timeseries import Readings

POSES = 16
LEVELS = (0.0, 0.5, 1.0)


@dataclasses.dataclass(frozen=True)
class Configuration:
    """One configuration of a plan."""

    number: int
    q: np.ndarray
    steps: np.ndarray


def _cell(**points: list[float]) -> Cell:
    content = cell_dict()
    content["frames"]["measurement_points"] = {**content["frames"]["measurement_points"], **points}
    content["instruments"]["temperature"] = {"sigma": 0.1}
    return Cell.model_validate(content)


def _truth(cell: Cell, seed: int = 4) -> ModelParameters:
    rng = np.random.default_rng(seed)
    nominal = nominal_parameters(cell)
    geometry = 5e-4 * rng.standard_normal((6, 6))
    geometry[0] = 0.0
    tracker = pose_matrix(np.array([3.5, 1.4, 1.0]) + rng.normal(0, 0.2, 3), np.array([0.1, -0.1, -2.7]))
    points = {name: point + rng.normal(0, 3e-3, 3) for name, point in nominal.points.items()}
    return nominal.replace(geometry=geometry, tracker=tracker, points=points, compliance=1 / np.array(STIFFNESS))


def _plan(seed: int = 4) -> list[Configuration]:
    rng = np.random.default_rng(seed)
    free = []
    for joint in range(6):
        q = np.tile(HOME, (POSES, 1))
        q[:, joint] += np.linspace(-1.4, 1.4, POSES)
        free.append(q)
    wrist = np.tile(HOME, (POSES, 1))
    wrist[:, 3:] += rng.uniform(-1.2, 1.2, (POSES, 3))
    known = rng.uniform(-1.5, 1.5, (12, 6))
    plan = [Configuration(k, q, np.zeros((1, 6))) for k, q in enumerate(np.concatenate([*free, wrist, known]), start=1)]
    for number in range(len(plan) + 1, len(plan) + 13):
        pull = np.concatenate([rng.normal(size=3), np.zeros(3)])
        pull *= 2300 / np.linalg.norm(pull)
        q = rng.uniform([-1.5, -0.6, -0.6, -2, -1.5, -2], [1.5, 0.6, 0.9, 2, 1.5, 2])
        plan.append(Configuration(number, q, np.outer(LEVELS, pull)))
    return plan


@pytest.fixture(scope="module")
def cell() -> Cell:
    return _cell(wrench_point=[0.12, -0.08, 0.25])


@pytest.fixture(scope="module")
def readings(cell: Cell) -> Readings:
    """Return all phases; the target at the wrench point was there in the known configurations alone."""
    everything = simulate_plan(_plan(), cell, _truth(cell), seed=4)
    known = np.isin(everything.configuration, np.arange(7 * POSES + 1, 7 * POSES + 13))
    return everything.select((everything.point < 3) | known)


def test_the_phases_are_told_apart(readings: Readings) -> None:
    rows = split(readings)
    assert holds_phases(readings)
    assert rows.sweeps.sum() == 3 * 6 * POSES
    assert rows.wrist.sum() == 3 * POSES
    assert rows.poses.sum() == 4 * 12
    assert rows.loaded.sum() == 3 * 12 * len(LEVELS)
    assert not holds_phases(readings.select(rows.loaded))
    assert not holds_phases(readings.select(rows.kinematic))


def test_noise_of_the_sensor_is_no_load(cell: Cell, readings: Readings) -> None:
    free = without_sensor_noise(readings, cell)
    assert free.wrench is not None
    assert readings.wrench is not None
    rows = split(readings)
    assert not free.wrench[rows.kinematic].any()
    loaded = np.linalg.norm(readings.wrench[:, :3], axis=1) > 100
    np.testing.assert_array_equal(free.wrench[loaded], readings.wrench[loaded])
    assert without_sensor_noise(dataclasses.replace(readings, wrench=None), cell).wrench is None


def test_all_phases_with_a_wrench_point(cell: Cell, readings: Readings) -> None:
    truth = _truth(cell)
    answer = identify_phases(readings, cell)
    errors = (answer.model.compliance - truth.compliance) / [one.compliance_std for one in answer.stiffness]
    assert np.abs(errors).max() < 4
    points = next(one for one in answer.phases if one.phase == "points")
    assert points.names[-3:] == ("wrench_point x", "wrench_point y", "wrench_point z")
    assert answer.model.wrench_point is not None
    np.testing.assert_array_equal(answer.model.wrench_point, answer.model.points["wrench_point"])
    shift = points.values.reshape(4, 3) - np.stack(list(truth.points.values()))
    assert np.abs(shift - shift.mean(axis=0)).max() < 3e-4  # what the flange's hidden errors do to all alike aside
    assert np.all(points.std < 1e-4)
    fitted = {one.name for one in answer.parameters if one.fitted}
    nominal = [one for one in answer.parameters if one.group == "geometry" and not one.fitted]
    assert nominal
    for one in nominal:
        assert one.value == 0.0
        assert one.name not in fitted
        assert any(one.name in item.combination for item in answer.unidentified)
    content = result_dict(answer, cell)
    assert [one["phase"] for one in content["phases"]] == [
        "base_frame", "geometry", "wrist_centre", "points", "stiffness"
    ]  # fmt: skip
    assert json.loads(json.dumps(content)) == content
    headings = [section.heading for section in build(answer, cell).sections]
    for heading in ("Base coordinate system", "Kinematic calibration", "Wrist centre point", "Compliance"):
        assert heading in headings
    captions = [table.caption for table in build(answer, cell).tables()]
    assert "Frame of mp1, mp2, mp3" in captions
    assert "Base coordinate system in the tracker frame" in captions


def test_a_gross_error_in_a_sweep_is_named_and_does_no_harm(cell: Cell, readings: Readings) -> None:
    row = 40
    position = readings.position.copy()
    position[row, 1] += 5e-3
    found = identify_phases(dataclasses.replace(readings, position=position), cell)
    (named,) = found.exclusions
    assert named.configuration == readings.configuration[row]
    assert named.point == readings.points[readings.point[row]]
    assert named.size == pytest.approx(5e-3, rel=0.05)
    assert [one.kind for one in found.anomalies] == ["outlier_readings"]
    errors = (found.model.compliance - _truth(cell).compliance) / [one.compliance_std for one in found.stiffness]
    assert np.abs(errors).max() < 4


def test_the_command_goes_the_same_way(cell: Cell, readings: Readings) -> None:
    small = identify(readings.select(readings.point < 3), cell)
    assert [one.phase for one in small.phases][-1] == "stiffness"
    assert small.decoupled is not None
    assert small.decoupled.measured


def test_the_doubt_of_what_stays_nominal_widens_the_stiffness_intervals(cell: Cell, readings: Readings) -> None:
    from calibration_core.identification.standard.phases import fit_with_prior
    from calibration_core.identification.stiffness.loaded import Options

    some = readings.select(readings.point < 3)
    rows = split(some)
    found = identify_kinematics(some.select(rows.kinematic), cell, nominal_parameters(cell))
    known = found.final.without_compliances()
    assert known.held is not None
    assert set(known.held.term.names) == {one.name for one in found.choice.nominal if one.joint > 0}
    loaded = some.select(rows.loaded)
    with_doubt = fit_with_prior(loaded, cell, Options(), known)
    without = fit_with_prior(loaded, cell, Options(), dataclasses.replace(known, held=None))
    more = np.diag(with_doubt.covariance)[:6] - np.diag(without.covariance)[:6]
    assert np.all(more >= -1e-12 * np.diag(without.covariance)[:6])
    assert more.max() > 0
    # a nominal value that is wrong moves the compliances by what the consider covariance says
    term = known.held.term
    k = term.names.index("d_6")
    step = np.zeros(len(term.names))
    step[k] = 5e-4
    believed = term.moved(nominal_parameters(cell), step)
    other = identify_kinematics(some.select(rows.kinematic), cell, believed)
    moved = fit_with_prior(loaded, cell, Options(), other.final.without_compliances())
    change = moved.prepared.parameters.compliance - with_doubt.prepared.parameters.compliance
    one = dataclasses.replace(known.held, std=np.where(np.arange(len(step)) == k, 5e-4, 0.0))
    said = fit_with_prior(loaded, cell, Options(), dataclasses.replace(known, held=one))
    size = np.sqrt(np.maximum(np.diag(said.covariance)[:6] - np.diag(without.covariance)[:6], 0.0))
    np.testing.assert_allclose(np.abs(change), size, atol=0.15 * size.max())
