"""A diagnosis that starts from the model of an earlier one, on absolute recordings and on loaded ones."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from absolute_cases import make_cell, make_readings, random_angles, truth_of
from robots import STIFFNESS, loaded_readings, write_cell

from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.identification.identify import identify
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect, ModelParameters
from calibration_core.timeseries import Readings

SEED = 5
TILTING = AppliedEffect(
    "off_axis_compliance",
    {"joint": "joint_2"},
    "before",
    {"compliance_x": 2.5e-7, "compliance_y": 1.2e-7, "compliance_xy": 5e-8},
)
WAVE = AppliedEffect("transmission_error", {"joint": "joint_2"}, "order 2", {"sine": 2e-4, "cosine": 1e-4})


def given(model: ModelParameters) -> GivenModel:
    return GivenModel(model, "model.yaml", "0" * 64)


def test_an_absolute_recording_diagnosed_again_has_nothing_more() -> None:
    cell = make_cell(points=("mp1", "mp2", "mp3"))
    q = random_angles(SEED, 60, 6)
    extra = np.zeros_like(q)
    extra[:, 1] = 1.5e-4 * np.sin(2 * q[:, 1] + 0.5)
    seen = make_readings(cell, truth_of(cell, SEED), q + extra, seed=SEED)
    readings = dataclasses.replace(seen, q=np.repeat(q, 3, axis=0))
    first = diagnose(readings, cell)
    assert [finding.effect for finding in first.findings] == ["transmission_error"]
    assert first.model is not None
    second = diagnose(readings, cell, given=given(first.model))
    assert (second.verdict, second.findings) == ("consistent", ())
    assert second.model is not None
    assert second.model.effects == first.model.effects
    np.testing.assert_allclose(second.rms_before, first.rms_after, rtol=0.02)
    np.testing.assert_allclose(second.model.geometry, first.model.geometry, atol=2e-5)
    known = identify(readings, cell, given=given(first.model))
    assert known.fit.rms_after < 0.7 * identify(readings, cell).fit.rms_after
    assert known.model.effects == first.model.effects
    assert known.stages[0].reason == "what the given model predicts"


def test_a_second_recording_is_predicted_with_what_is_known(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    model = nominal_parameters(cell).replace(compliance=1 / np.array(STIFFNESS), effects=(TILTING,))
    bare = model.replace(effects=())
    readings, other = (
        dataclasses.replace(
            one, position=one.position + predict_readings(one, cell, model) - predict_readings(one, cell, bare)
        )
        for one in (loaded_readings(cell, 5), loaded_readings(cell, 6))
    )
    found = diagnose(readings, cell, test=other, given=given(model))
    assert (found.verdict, found.findings) == ("consistent", ())
    assert found.test is not None
    assert found.test.rms < 1.2 * found.noise
    assert found.test.rms_before < 1.2 * found.noise  # the stiffness of the given model is right, so is its effect
    assert found.handed_out[0].effects == (TILTING,)
    assert found.identification.model.effects == (TILTING,)


def joined(loaded: Readings, single: Readings) -> Readings:
    """Return both recordings as one; the second one's configurations are counted on from the first one's."""
    last = int(loaded.configuration.max())
    parts = {
        name: np.concatenate([getattr(loaded, name), getattr(single, name)])
        for name in ("step", "point", "q", "position", "wrench", "temperature")
    }
    return dataclasses.replace(
        loaded,
        **parts,
        configuration=np.concatenate([loaded.configuration, single.configuration + last]),
        time=np.arange(len(loaded) + len(single), dtype=float),
    )


def test_loads_and_single_steps_in_one_recording_are_both_freed_of_what_is_known(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    single = loaded_readings(cell, 6, 40)
    readings = joined(loaded_readings(cell, 5), single.select(single.step == 0))
    model = nominal_parameters(cell).replace(compliance=1 / np.array(STIFFNESS), effects=(TILTING, WAVE))
    moved = predict_readings(readings, cell, model) - predict_readings(readings, cell, model.replace(effects=()))
    readings = dataclasses.replace(readings, position=readings.position + moved)
    bare = diagnose(readings, cell)
    assert {"off_axis_compliance", "transmission_error"} <= {finding.effect for finding in bare.findings}
    assert bare.model is not None
    assert {"off_axis_compliance", "transmission_error"} <= {effect.effect for effect in bare.model.effects}
    alone = readings.select(readings.configuration > 14)  # single steps, which the loaded part knows nothing of
    error = alone.position - predict_readings(alone, cell, bare.model)
    assert np.sqrt(np.mean(error**2)) < 2 * cell.instruments.tracker.sigma  # noise, and the doubt of the sag
    found = diagnose(readings, cell, given=given(model))
    assert (found.verdict, found.findings) == ("consistent", ())


def test_a_gross_error_and_understated_noise_are_said_of_loads_and_single_steps_together(tmp_path: Path) -> None:
    cell = write_cell(tmp_path)
    single = loaded_readings(cell, 6, 40, noise=2.0)
    readings = joined(loaded_readings(cell, 5, noise=2.0), single.select(single.step == 0))
    position = readings.position.copy()
    position[-60] += [0.0, 2e-3, 0.0]
    found = diagnose(dataclasses.replace(readings, position=position), cell)
    said = {anomaly.kind: anomaly for anomaly in found.anomalies}
    assert set(said) == {"noise_understated", "outlier_readings"}
    claimed = cell.instruments.tracker.sigma
    assert 1.8 * claimed < said["noise_understated"].magnitude < 2.2 * claimed
    assert said["outlier_readings"].configurations == (readings.configuration[-60],) * 2
    assert found.findings == ()
