"""The identified-model file: read back exactly, refused with one line when it is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import write_cell

from calibration_core.cell import Cell
from calibration_core.cell.identity import robot_sha256
from calibration_core.errors import ModelFileError
from calibration_core.files.yaml_file import yaml_text
from calibration_core.model.identified.calibrated import ValidRange
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.identified.model_file import model_dict, model_text, read_calibrated, read_model
from calibration_core.model.identified.named_values import value_of
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect, ModelParameters

RANGE = ValidRange(np.array([[-1.0, 2.0]] * 6), (0.0, 2300.0), (1.0, 90.0), (19.5, 21.25))
NAMES = (
    "compliance.joint_2",
    "geometry.joint_3.rx",
    "tracker.yaw",
    "measurement_points.mp1.z",
    "wrench_point.x",
    "force_torque.roll",
    "effects.0.compliance_x",
    "compliance.joint_6",
)


def _parameters(tmp_path: Path) -> tuple[ModelParameters, Cell]:
    cell = write_cell(tmp_path)
    rng = np.random.default_rng(1)
    nominal = nominal_parameters(cell)
    return nominal.replace(geometry=rng.normal(0, 1e-3, (6, 6)), compliance=rng.uniform(0, 1e-6, 6)), cell


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    parameters, cell = _parameters(tmp_path)
    path = tmp_path / "model.yaml"
    path.write_text(model_text(parameters, cell))
    again = read_model(path, cell)
    for name in ("compliance", "geometry", "wrench_point"):
        np.testing.assert_array_equal(getattr(again, name), getattr(parameters, name))
    for name in ("tracker", "force_torque"):
        np.testing.assert_allclose(getattr(again, name), getattr(parameters, name), atol=1e-15)
    assert again.points.keys() == parameters.points.keys()
    assert model_text(again, cell) == model_text(read_model(path, cell), cell)


def _estimated(tmp_path: Path) -> tuple[ModelParameters, GaussianEstimate, Cell]:
    """Return a model with an effect, and an estimate of a few of its numbers, the last of which is unknown."""
    parameters, cell = _parameters(tmp_path)
    effect = AppliedEffect("off_axis_compliance", {"joint": "joint_2"}, "before", {"compliance_x": 2e-7})
    parameters = parameters.replace(effects=(effect,))
    p = len(NAMES)
    root = np.random.default_rng(3).normal(0, 1e-4, (p, p))
    covariance = root @ root.T
    covariance[-1] = covariance[:, -1] = 0.0
    covariance[-1, -1] = np.inf
    value = np.array([value_of(parameters, name) for name in NAMES])
    return parameters, GaussianEstimate(NAMES, ("m",) * p, value, covariance), cell


def test_uncertainty_and_range_are_read_back_to_the_bit(tmp_path: Path) -> None:
    parameters, estimate, cell = _estimated(tmp_path)
    path = tmp_path / "model.yaml"
    path.write_text(model_text(parameters, cell, estimate, RANGE))
    again = read_calibrated(path, cell)
    assert again.estimate is not None
    assert again.valid_range is not None
    assert (again.estimate.names, again.estimate.units) == (estimate.names, estimate.units)
    np.testing.assert_array_equal(again.estimate.covariance, estimate.covariance)
    np.testing.assert_allclose(again.estimate.value, estimate.value, rtol=1e-12)
    assert again.estimate.unknown == ("compliance.joint_6",)
    np.testing.assert_array_equal(again.valid_range.joints, RANGE.joints)
    assert (again.valid_range.force, again.valid_range.torque) == (RANGE.force, RANGE.torque)
    assert again.valid_range.temperature == RANGE.temperature
    path.write_text(model_text(again.parameters, cell, again.estimate, again.valid_range))
    twice = read_calibrated(path, cell)
    assert twice.estimate is not None
    np.testing.assert_array_equal(twice.estimate.covariance, estimate.covariance)
    np.testing.assert_array_equal(twice.parameters.geometry, parameters.geometry)


def test_a_file_that_states_no_parameter_has_no_intervals(tmp_path: Path) -> None:
    parameters, cell = _parameters(tmp_path)
    path = tmp_path / "model.yaml"
    path.write_text(model_text(parameters, cell))
    again = read_calibrated(path, cell)
    assert (again.estimate, again.valid_range) == (None, None)
    np.testing.assert_array_equal(again.parameters.geometry, parameters.geometry)


def test_another_robot_is_refused_and_another_setup_is_not(tmp_path: Path) -> None:
    parameters, cell = _parameters(tmp_path)
    path = tmp_path / "model.yaml"
    path.write_text(model_text(parameters, cell))
    (tmp_path / "other").mkdir()
    for changes in ({"frames": {"wrench_point": [0.0, 0.1, 0.3]}}, {"robot": {"stiffness": [2e6] * 6}}):
        other = write_cell(tmp_path / "other", **changes)
        assert robot_sha256(other) == robot_sha256(cell)
        read_model(path, other)
    coupled = write_cell(tmp_path / "other", robot={"joint_coupling": {"joint_3": {"joint_2": 1.0}}})
    assert robot_sha256(coupled) != robot_sha256(cell)
    rated = write_cell(tmp_path / "other", robot={"rated_load": 210.0})
    with pytest.raises(ModelFileError) as caught:
        read_model(path, rated)
    assert caught.value.place == "robot_sha256"


def _spoiled(content: dict, key: str, place: str, value: object) -> dict:
    """Return the content with one value replaced, by its place below a key."""
    holder, parts = content[key], place.split(".") if place else []
    if not parts:
        return {**content, key: value}
    for part in parts[:-1]:
        holder = holder[int(part) if isinstance(holder, list) else part]
    last = int(parts[-1]) if isinstance(holder, list) else parts[-1]
    holder[last] = value
    return content


@pytest.mark.parametrize(
    ("key", "place", "value", "named"),
    [
        ("robot_sha256", "", "0" * 64, "robot_sha256"),
        ("parameters", "", None, "parameters"),
        ("parameters", "1", "rx", "parameters.1"),
        ("parameters", "1.name", "geometry.joint_9.rx", "parameters.1.name"),
        ("parameters", "1.name", "geometry.joint_3.q", "parameters.1.name"),
        ("parameters", "1.name", "effects.7.compliance_x", "parameters.1.name"),
        ("parameters", "1.name", ["a"], "parameters.1.name"),
        ("parameters", "2.name", "compliance.joint_2", "parameters.2.value"),
        ("parameters", "1.unit", 3, "parameters.1.unit"),
        ("parameters", "1.value", 7.0, "parameters.1.value"),
        ("parameters", "1.value", float("nan"), "parameters.1.value"),
        ("covariance", "", {}, "covariance"),
        ("covariance", "", [[1.0]], "covariance"),
        ("covariance", "1", [1.0], "covariance.1"),
        ("covariance", "1.1", -1e-9, "covariance.1"),
        ("covariance", "1.0", float("inf"), "covariance.1"),
        ("covariance", "1.0", 1.0, "covariance"),
        ("covariance", "7.0", 1e-9, "covariance.7"),
        ("covariance", "1.1", "x", "covariance.1"),
        ("valid_range", "", [], "valid_range"),
        ("valid_range", "joints", {}, "valid_range.joints"),
        ("valid_range", "joints.joint_2", [1.0, -1.0], "valid_range.joints.joint_2"),
        ("valid_range", "force", [0.0, float("inf")], "valid_range.force"),
        ("valid_range", "temperature", [1.0], "valid_range.temperature"),
    ],
)
def test_every_fault_of_the_uncertainty_is_named(
    tmp_path: Path, key: str, place: str, value: object, named: str
) -> None:
    parameters, estimate, cell = _estimated(tmp_path)
    path = tmp_path / "model.yaml"
    path.write_text(yaml_text(_spoiled(model_dict(parameters, cell, estimate, RANGE), key, place, value)))
    with pytest.raises(ModelFileError) as caught:
        read_calibrated(path, cell)
    assert caught.value.place == named
    assert "\n" not in str(caught.value)


def test_a_rigid_joint_has_no_stiffness(tmp_path: Path) -> None:
    parameters, cell = _parameters(tmp_path)
    content = model_dict(parameters.replace(compliance=np.zeros(6)), cell)
    assert content["stiffness"] == [None] * 6


@pytest.mark.parametrize(
    ("key", "value", "place"),
    [
        ("schema", 3, "schema"),
        ("schema", True, "schema"),
        ("schema", None, "schema"),
        ("joints", ["a", "b"], "joints"),
        ("joints", None, "joints"),
        ("compliance", [1e-6] * 5, "compliance"),
        ("compliance", [1e-6] * 5 + [float("nan")], "compliance"),
        ("compliance", [1e-6] * 5 + [-1e-9], "compliance"),
        ("compliance", [True] * 6, "compliance"),
        ("geometry", [{}] * 6, "geometry.0"),
        ("geometry", "none", "geometry"),
        ("tracker", None, "tracker"),
        ("tracker", {"xyz": [0, 0, 0], "rpy": [0, 0]}, "tracker.rpy"),
        ("measurement_points", {}, "measurement_points"),
        ("measurement_points", {"mp1": [0, 0, "x"]}, "measurement_points.mp1"),
        ("wrench_point", [0, 0], "wrench_point"),
        ("force_torque", [1], "force_torque"),
        ("effects", [{"effect": "magic", "location": {}, "variant": "", "parameters": {}}], "effects.0.effect"),
        ("effects", [{"effect": "creep"}], "effects.0"),
        ("surprise", 1, "surprise"),
    ],
)
def test_every_fault_is_named(tmp_path: Path, key: str, value: object, place: str) -> None:
    parameters, cell = _parameters(tmp_path)
    path = tmp_path / "model.yaml"
    path.write_text(yaml_text({**model_dict(parameters, cell), key: value}))
    with pytest.raises(ModelFileError) as caught:
        read_model(path, cell)
    assert caught.value.place == place
    assert "\n" not in str(caught.value)


@settings(max_examples=60, deadline=None)
@given(junk=st.one_of(st.binary(max_size=300), st.text(max_size=300).map(str.encode)))
def test_rubbish_is_refused_with_one_line(tmp_path_factory: pytest.TempPathFactory, junk: bytes) -> None:
    folder = tmp_path_factory.mktemp("model")
    cell = write_cell(folder)
    path = folder / "model.yaml"
    path.write_bytes(junk)
    with pytest.raises(ModelFileError) as caught:
        read_model(path, cell)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match="No such file"):
        read_model(tmp_path / "none.yaml", write_cell(tmp_path))
