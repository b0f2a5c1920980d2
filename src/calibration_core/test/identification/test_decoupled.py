"""Arm and wrist apart: unbiased, with honest intervals, and compared with the joint identification as chance has it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from robots import STIFFNESS, loaded_readings, write_cell

from calibration_core.errors import IdentificationError
from calibration_core.identification.identify import identify
from calibration_core.identification.standard.decoupled import identify_decoupled, wrist_centre_of
from calibration_core.identification.stiffness.loaded import Options, prepare_loaded
from calibration_core.model.robot import chain_of
from calibration_core.report.content import build
from calibration_core.report.results.result import result_dict

TRUE = 1 / np.array(STIFFNESS)


def test_the_wrist_centre_follows_from_the_geometry(tmp_path: Path) -> None:
    chain = chain_of(write_cell(tmp_path))
    np.testing.assert_allclose(wrist_centre_of(chain), [0.0, 0.0, -0.23], atol=1e-12)
    rotation = chain.rotation.copy()
    rotation[5] = np.eye(3)
    assert wrist_centre_of(dataclasses.replace(chain, rotation=rotation)) is None


@pytest.mark.parametrize("seeds", [6, pytest.param(1000, marks=pytest.mark.slow)])
def test_intervals_cover_and_both_ways_agree(tmp_path: Path, seeds: int) -> None:
    cell = write_cell(tmp_path)
    errors, differences, agree, gain = [], [], [], []
    for seed in range(seeds):
        prepared = prepare_loaded(loaded_readings(cell, seed), cell, Options(robust=False))
        found = identify_decoupled(prepared, 1.0)
        assert found.arm == 3
        errors.append((found.compliance - TRUE) / found.std)
        differences.append((found.compliance - found.together) / found.difference_std)
        agree.append(found.agree)
        gain.append(found.std / np.sqrt(np.diag(prepared.fit.solution.covariance)))
        np.testing.assert_allclose(found.together, prepared.fit.compliance, rtol=0.01)
    cover = np.mean(np.abs(errors) <= 1.96, axis=0)
    print(f"\n{seeds} seeds: apart, 95 % intervals cover {100 * cover} %; differences over what chance allows: rms "
          f"{np.sqrt(np.mean(np.square(differences))):.3f}; they agree (1 % level) in {100 * np.mean(agree):.1f} %; "
          f"standard deviations {np.mean(gain, axis=0)} times the joint ones")  # fmt: skip
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1.0, abs=0.35 if seeds < 1000 else 0.03)
    assert np.sqrt(np.mean(np.square(differences))) == pytest.approx(1.0, abs=0.4 if seeds < 1000 else 0.05)
    assert np.min(gain) > 0.98  # the joint identification is never less precise
    if seeds >= 1000:
        assert np.all((cover >= 0.93) & (cover <= 0.97))
        assert np.mean(agree) >= 0.98


def test_what_the_model_leaves_out_shows_in_the_comparison(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    readings = loaded_readings(cell, 3)
    assert readings.wrench is not None
    bend = readings.wrench[:, :1] * np.array([[4e-7, -4e-7, 6e-7]])  # a base that gives way: no joint does this
    bent = dataclasses.replace(readings, position=readings.position + bend)
    prepared = prepare_loaded(bent, cell, Options(robust=False))
    assert not identify_decoupled(prepared, 1.0).agree


def test_result_and_report_show_both(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    answer = identify(loaded_readings(cell, 2), cell)
    content = result_dict(answer, cell)["decoupled"]
    assert [one["part"] for one in content["stiffness"]] == ["arm"] * 3 + ["wrist"] * 3
    assert content["comparison"]["agree"] is True
    assert content["wrist_centre"]["measured"] is False
    assert "Arm and wrist apart" in [table.caption for table in build(answer, cell).tables()]


def test_one_point_or_a_bent_wrist_is_refused(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    readings = loaded_readings(cell, 2)
    one = identify(readings.select(readings.point == 0), cell)
    assert one.decoupled is None
    assert "no step with three points" in one.not_decoupled
    assert "reason" in result_dict(one, cell)["decoupled"]
    prepared = prepare_loaded(readings, cell, Options())
    with pytest.raises(IdentificationError, match="last three axes that meet"):
        identify_decoupled(prepared, 1.0, np.array([0.0, 0.01, -0.23]))
