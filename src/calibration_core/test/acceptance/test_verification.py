"""A model judged on places that it was not identified from."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from acceptance_cases import identified, measured, small, softened

from calibration_core.acceptance.verification import verify, with_fitted_tracker
from calibration_core.commands.evaluation.predict import evaluate
from calibration_core.errors import RecordingError
from calibration_core.identification.identify import identify
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.chain import pose_matrix
from calibration_core.model.identified.calibrated import CalibratedModel
from calibration_core.model.identified.model_file import GivenModel
from calibration_core.model.nominal import nominal_parameters
from calibration_core.outcomes.verification import reservations


def test_the_uncertainty_is_that_of_the_errors() -> None:
    """Of a robot that is as its model says: the stated 95 % intervals of single coordinates hold what is measured."""
    _, model = identified()
    inside = []
    for seed in range(20, 26):
        found = verify(
            measured(nominal_parameters(small()), seed, plan_seed=2, configurations=12), small(), model, 1e-4
        )
        inside.append(np.mean(found.size**2) / np.mean(3 * found.uncertainty**2))
        assert found.with_intervals
        assert set(found.shares) == {"tracker", "wrench", "geometry", "model", "repeatability"}
    assert 0.5 < np.mean(inside) < 1.1  # uncertainty is along the error, where it is largest


def test_a_tolerance_far_above_and_far_below() -> None:
    _, model = identified()
    readings = measured(nominal_parameters(small()), 30, plan_seed=2, configurations=12)
    assert verify(readings, small(), model, 2e-4).decision == "conforming"
    assert verify(readings, small(), model, 2e-5).decision in {"undecided", "not_conforming"}
    soft = measured(softened(nominal_parameters(small()), 1, 0.4), 31, plan_seed=2, configurations=12)
    found = verify(soft, small(), model, 1e-4)
    assert found.decision == "not_conforming"
    assert found.before is not None
    assert len(found.decisions) == len(found.size) == len(soft)


def test_a_covariance_widens_the_decision() -> None:
    _, model = identified()
    readings = measured(nominal_parameters(small()), 33, plan_seed=2, configurations=12)
    bare = verify(readings, small(), CalibratedModel(model.parameters, None, None), 1e-4)
    full = verify(readings, small(), model, 1e-4)
    assert not bare.with_intervals
    assert np.all(bare.shares["model"] == 0.0)
    assert np.mean(full.uncertainty) > np.mean(bare.uncertainty)
    assert not bare.outside.any()


def test_a_tracker_that_was_set_up_anew_is_fitted() -> None:
    _, model = identified()
    moved = nominal_parameters(small())
    moved = moved.replace(tracker=moved.tracker @ pose_matrix(np.array([0.3, -0.2, 0.1]), np.array([0.02, -0.01, 0.5])))
    readings = measured(moved, 34, plan_seed=2, configurations=12)
    as_it_is = verify(readings, small(), model, 1e-4)
    assert as_it_is.decision == "not_conforming"
    assert as_it_is.elsewhere is not None
    assert as_it_is.elsewhere < 0.01 * np.sqrt(np.mean(as_it_is.error**2))
    assert "run verify again with --fit-tracker" in reservations(as_it_is)[0][1]
    fitted = verify(readings, small(), model, 1e-4, fit_tracker=True)
    assert fitted.decision == "conforming"
    assert fitted.fitted
    pose = with_fitted_tracker(readings, small(), model.parameters)
    left = readings.position - predict_readings(readings, small(), pose)
    turned = np.cross(readings.position, left).sum(axis=0)
    assert np.abs(left.sum(axis=0)).max() < 1e-9  # what is left has no shift and no turn
    assert np.abs(turned).max() < 1e-9


def test_positions_alone_that_do_not_agree_name_the_geometry() -> None:
    """`predict` and `verify` agree on a robot whose geometry was never measured, and send nobody to `diagnose`."""
    true = nominal_parameters(small())
    offsets = np.zeros_like(true.geometry)
    offsets[1:5, 5] = (1e-3, -1.5e-3, 2e-3, -1.5e-3)
    true = true.replace(geometry=offsets)
    first = identify(measured(true, 5), small())
    joints = [k for k, name in enumerate(first.estimate.names) if name.startswith("compliance.")]
    estimate = first.estimate.chosen(joints)  # as if the frames were known exactly: they hold the geometry's errors
    model = CalibratedModel(first.model, estimate, None)
    readings = measured(true, 6, plan_seed=2, configurations=12)
    found = verify(readings, small(), model, 1e-4)
    assert found.decision == "not_conforming"
    (text, step), _ = reservations(found)
    given = GivenModel(first.model, "model.yaml", "0" * 64, estimate)
    predicted = evaluate(small(), given, readings).content
    for reason, following in ((text, step), (predicted["reason"], predicted["next_step"])):
        assert "deflections under load agree" in reason
        assert "the model's geometry is nominal" in reason
        assert "calibration plan --for geometry" in following
        assert "diagnose" not in following
    unsure = verify(readings, small(), CalibratedModel(first.model, first.estimate, None), 1e-4)
    if unsure.decision == "undecided":
        assert any("--for geometry" in following for _, following in reservations(unsure)[1])
    soft = measured(softened(true, 1, 0.4), 7, plan_seed=2, configurations=12)
    assert "run diagnose" in reservations(verify(soft, small(), model, 1e-4))[0][1]


def test_places_beyond_the_valid_range_are_named() -> None:
    _, model = identified()
    readings = measured(nominal_parameters(small()), 35, plan_seed=2, configurations=12)
    q = readings.q.copy()
    q[:, 0] = 2.89
    far = dataclasses.replace(readings, q=q)
    assert verify(far, small(), model, 1e-4).outside.all()


def test_displacements_are_judged_without_their_reference() -> None:
    _, model = identified()
    cell = small().model_copy(
        update={
            "measurements": small().measurements.model_copy(update={"points": "displacement"}),
            "instruments": small().instruments.model_copy(
                update={"tracker": small().instruments.tracker.model_copy(
                    update={"sigma": 1e-5, "sigma_range": None, "sigma_angle": None, "sigma_range_per_m": 0.0}
                )}
            ),
        }
    )  # fmt: skip
    readings = measured(nominal_parameters(small()), None, plan_seed=2, configurations=12)
    first = {}
    for k in range(len(readings)):
        first.setdefault((readings.configuration[k], readings.point[k]), readings.position[k])
    position = np.array([
        readings.position[k] - first[readings.configuration[k], readings.point[k]] for k in range(len(readings))
    ])  # fmt: skip
    differences = dataclasses.replace(readings, position=position)
    found = verify(differences, cell, model, 1e-4)
    assert len(found.size) == np.count_nonzero(readings.step > 0)
    assert found.decision == "conforming"
    with pytest.raises(RecordingError, match="to fit the tracker"):
        verify(differences, cell, model, 1e-4, fit_tracker=True)
