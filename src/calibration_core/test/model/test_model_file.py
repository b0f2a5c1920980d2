"""The identified-model file: read back exactly, refused with one line when it is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import write_cell

from calibration_core.errors import ModelFileError
from calibration_core.files.yaml_file import yaml_text
from calibration_core.model.model_file import model_dict, model_text, read_model
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters


def _parameters(tmp_path: Path) -> tuple[ModelParameters, object]:
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


def test_a_rigid_joint_has_no_stiffness(tmp_path: Path) -> None:
    parameters, cell = _parameters(tmp_path)
    content = model_dict(parameters.replace(compliance=np.zeros(6)), cell)
    assert content["stiffness"] == [None] * 6


@pytest.mark.parametrize(
    ("key", "value", "place"),
    [
        ("schema", 2, "schema"),
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
