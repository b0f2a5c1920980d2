"""result.json holds the fixed keys and is JSON that every program can read."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from calibration_core.cell import Cell, Safety
from calibration_core.identification.result.estimate import Identification, NoiseCheck
from calibration_core.report.results.result import correlation, result_dict, result_json

CONTRACT = [
    "schema", "command", "robot", "recording", "stiffness", "fit", "verdict", "findings", "anomalies", "unexplained",
    "next_measurements",
]  # fmt: skip


def strict(content: bytes) -> dict[str, object]:
    def refuse(name: str) -> None:
        pytest.fail(f"{name} is no JSON")

    return json.loads(content, parse_constant=refuse)


def test_the_contracts_keys_come_first_and_in_order(loaded: Identification, cell: Cell) -> None:
    content = result_dict(loaded, cell)
    assert list(content)[: len(CONTRACT)] == CONTRACT
    assert list(content["recording"])[:5] == ["file", "configurations", "steps", "points", "loaded"]
    assert content["recording"]["configurations"] == 18
    assert content["recording"]["steps"] == 162
    assert list(content["stiffness"][0])[:5] == ["joint", "value", "std", "unit", "identifiable"]
    fit = ["rms_before", "rms_after", "held_out_rms_before", "held_out_rms_after", "noise", "unit"]
    assert list(content["fit"])[:6] == fit
    assert list(content["unexplained"]) == ["rms", "significant", "where"]


def test_values_are_the_identifications(loaded: Identification, cell: Cell) -> None:
    content = result_dict(loaded, cell)
    first = content["stiffness"][0]
    assert first["value"] == loaded.stiffness[0].value
    assert first["interval_95"] == list(loaded.stiffness[0].interval)
    assert content["condition_number"] == loaded.condition_number
    assert [item["file"] for item in content["input"]["sha256"]] == [
        "demo_0.mcap", "metadata.yaml", str(cell.path), "demo_2_0.mcap",
    ]  # fmt: skip


def test_the_declared_speed_limit_is_told(loaded: Identification, cell: Cell) -> None:
    assert result_dict(loaded, cell)["safety_rated_speed"] is None
    declaring = cell.model_copy(update={"safety": Safety(speed_limit=0.2, source="checksum 8A3F")})
    told = {"value": 0.2, "unit": "m/s", "source": "checksum 8A3F"}
    assert result_dict(loaded, declaring)["safety_rated_speed"] == told


def test_verdict_follows_the_residual(loaded: Identification, cell: Cell) -> None:
    assert result_dict(loaded, cell)["verdict"] == "consistent"
    noise = dataclasses.replace(loaded.noise, checks=(NoiseCheck("residual", 9e-5, 1272),))
    worse = result_dict(dataclasses.replace(loaded, noise=noise), cell)
    assert worse["verdict"] == "unexplained"
    assert worse["unexplained"]["significant"] is True
    assert worse["unexplained"]["rms"] == pytest.approx(np.sqrt(9e-5**2 - 2e-5**2))
    assert worse["findings"] == []


def test_the_same_answer_gives_the_same_bytes(loaded: Identification, cell: Cell) -> None:
    assert result_json(result_dict(loaded, cell)) == result_json(result_dict(loaded, cell))


def test_what_is_not_finite_is_null(hostile: tuple[Identification, Cell]) -> None:
    content = strict(result_json(result_dict(*hostile)))
    last = content["stiffness"][5]
    assert last["value"] is None
    assert last["interval_95"] == [4e4, None]
    assert content["condition_number"] is None
    assert content["correlation"]["matrix"][5][0] is None
    assert content["robot"] == hostile[1].robot.name


def test_correlation_has_ones_on_its_diagonal(loaded: Identification) -> None:
    matrix = correlation(loaded)
    np.testing.assert_allclose(np.diag(matrix), 1.0)
    np.testing.assert_allclose(matrix, matrix.T)
    std = np.sqrt(np.diag(loaded.covariance))
    np.testing.assert_allclose(matrix * np.outer(std, std), loaded.covariance, rtol=1e-12)


def test_correlation_of_what_has_no_variance_is_unknown(loaded: Identification) -> None:
    covariance = np.array(loaded.covariance)
    covariance[2] = covariance[:, 2] = 0.0
    matrix = correlation(dataclasses.replace(loaded, covariance=covariance))
    assert np.isnan(matrix[2]).all()
    assert np.isfinite(np.delete(np.delete(matrix, 2, 0), 2, 1)).all()


def test_an_absolute_result(absolute: Identification, absolute_cell: Cell) -> None:
    content = strict(result_json(result_dict(absolute, absolute_cell, "identify")))
    assert content["recording"]["loaded"] is False
    assert content["stiffness"] == []
    assert [stage["kept"] for stage in content["stages"]] == [True, True, True, False]
