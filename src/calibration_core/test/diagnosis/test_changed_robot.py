"""Several recordings of a robot that has changed between them: the change is named, and is no missing physics."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robots import STIFFNESS
from several_cases import measured, setup, together

from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.identification.identify import fit_freed
from calibration_core.identification.result.estimate import Identification
from calibration_core.model.parameters import AppliedEffect
from calibration_core.outcomes.together.agreement import agreement, by_themselves, without_changes
from calibration_core.outcomes.together.diagnose import diagnose_together
from calibration_core.timeseries import Readings

SOFTER = 0.7  # times the stiffness of before
TILT = AppliedEffect(
    "off_axis_compliance",
    {"joint": "joint_2"},
    "before",
    {"compliance_x": 2e-7, "compliance_y": 1e-7, "compliance_xy": 1e-8},
)
GAIN = AppliedEffect("wrench_gain", {"sensor": "force_torque"}, "fx", {"gain_fx": 0.08})


def recorded(
    folder: Path, seed: int, *, of_third: dict[str, Any] | None = None, **of_all: Any
) -> tuple[list[Readings], list[Any]]:
    """Return three recordings and their cells; the third one is made with changes of its own."""
    cells = [setup(folder, k) for k in range(3)]
    own = [{}, {}, of_third or {}]
    return [measured(cell, k, seed + k, **of_all, **own[k]) for k, cell in enumerate(cells)], cells


def softened(joint: int) -> list[float]:
    return [k * SOFTER if j == joint else k for j, k in enumerate(STIFFNESS)]


def effects(found: Diagnosis) -> list[tuple[str, dict[str, Any]]]:
    """Return what is said to be missing."""
    return [(one.effect, dict(one.location)) for one in found.findings]


def differing(found: Diagnosis) -> list[tuple[str, str]]:
    assert found.identification.together is not None
    return [(one.file, one.parameter) for one in found.identification.together.disagreements]


@pytest.mark.parametrize("joint", [pytest.param(2, marks=pytest.mark.slow), 3])
def test_a_joint_that_has_become_softer(tmp_path: Path, joint: int) -> None:
    """By themselves a sensor that couples its axes, and gross errors, explain most of it in that recording."""
    recordings, cells = recorded(tmp_path, 100, of_third={"stiffness": softened(joint)})
    found = diagnose_together(together(recordings, cells))
    assert effects(found) == []
    assert not found.rest.significant
    assert [one.kind for one in found.anomalies] == ["recordings_differ"]
    assert differing(found) == [("C.csv", f"compliance.joint_{joint + 1}")]
    assert found.identification.together is not None
    (change,) = found.identification.together.disagreements
    assert change.low < SOFTER - 1 < change.high
    assert [note.kind for note in found.identification.notes].count("recordings_differ") == 1
    true = 1 / np.array(STIFFNESS)
    assert found.compliance is not None
    assert found.compliance_covariance is not None
    off = (found.compliance - true) / np.sqrt(np.diag(found.compliance_covariance))
    assert np.abs(off).max() < 3.5  # those of the robot as the others show it


@pytest.mark.slow
def test_a_joint_whose_zero_has_changed(tmp_path: Path) -> None:
    """Two of the recordings do not prove that the geometry is to be corrected; they say what they know of it."""
    geometry = np.zeros((6, 6))
    geometry[2, 5] = 1e-3
    recordings, cells = recorded(tmp_path, 200, of_third={"geometry": geometry}, rest=14)
    found = diagnose_together(together(recordings, cells))
    assert effects(found) == []
    assert differing(found) == [("C.csv", "geometry.joint_3.rz")]
    assert found.identification.together is not None
    (change,) = found.identification.together.disagreements
    assert change.low < 1e-3 < change.high


def test_recordings_that_have_not_changed_are_not_evaluated_again(tmp_path: Path) -> None:
    prepared = together(*recorded(tmp_path, 100, of_third={"stiffness": softened(3)}))
    changes = agreement(["A.csv", "B.csv", "C.csv"], by_themselves(prepared))[1]
    assert [(one.file, one.parameter) for one in changes] == [("C.csv", "compliance.joint_4")]
    less = without_changes(prepared, changes)
    assert [one is before for one, before in zip(less.alone, prepared.alone, strict=True)] == [True, True, False]


def test_a_sensor_that_is_wrong_in_one_recording_is_no_change_of_the_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Less what was found, its stiffnesses are the others' again; what each shows beside it is evaluated once."""
    recordings, cells = recorded(tmp_path, 300, of_third={"effects": (GAIN,)})
    prepared = together(recordings, cells)
    evaluated: list[int] = []

    def counted(some: Readings, *rest: Any) -> Identification:
        evaluated.append(len(some))
        return fit_freed(some, *rest)

    monkeypatch.setattr("calibration_core.outcomes.together.agreement.fit_freed", counted)
    found = diagnose_together(prepared)
    assert effects(found) == [("wrench_gain", {"sensor": "force_torque", "recording": "C.csv"})]
    assert "in recording 3" in found.findings[0].explanation
    assert found.model is not None
    assert found.model.effects == ()  # of the set-up of A, which was named first
    assert differing(found) == []
    assert evaluated == [len(one) for one in recordings]


@pytest.mark.slow
def test_the_recording_that_was_named_first_has_changed(tmp_path: Path) -> None:
    """A test recording is of the first one's set-up and of its robot: it is freed of the change, too."""
    recordings, cells = recorded(tmp_path, 100, of_third={"stiffness": softened(2)})
    test = measured(cells[2], 2, 102, configurations=14, stiffness=softened(2))
    order = [2, 0, 1]
    prepared = together([recordings[k] for k in order], [cells[k] for k in order], test=test)
    found = diagnose_together(prepared)
    assert differing(found) == [("C.csv", "compliance.joint_3")]
    assert found.test is not None
    assert found.test.rms < 1.3 * cells[2].instruments.tracker.sigma


@pytest.mark.slow
def test_a_change_beside_physics_that_is_missing(tmp_path: Path) -> None:
    recordings, cells = recorded(tmp_path, 600, of_third={"stiffness": softened(2)}, effects=(TILT,))
    found = diagnose_together(together(recordings, cells))
    assert effects(found) == [("off_axis_compliance", {"joint": "joint_2"})]
    assert differing(found) == [("C.csv", "compliance.joint_3")]
