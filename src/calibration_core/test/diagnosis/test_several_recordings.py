"""Several recordings diagnosed together: a cause at the robot is shared, one in a set-up names its recording."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from robots import STIFFNESS
from several_cases import measured, setup, together

from calibration_core.commands.evaluation.candidate_measurements import offers_for
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.evidence.extended import loaded_state
from calibration_core.diagnosis.findings.loaded import TARGETS
from calibration_core.diagnosis.proposals.choose import Offer
from calibration_core.identification.stiffness.loaded import prepare_loaded
from calibration_core.model.effects import candidates
from calibration_core.model.effects.words import effect_sentence
from calibration_core.model.parameters import AppliedEffect
from calibration_core.outcomes.together.agreement import agreement
from calibration_core.outcomes.together.diagnose import diagnose_together
from calibration_core.timeseries import Readings

SIZES = {"compliance_x": 6e-8, "compliance_y": 5e-8, "compliance_xy": 1e-8}  # rad/(N*m)
TILT = AppliedEffect("off_axis_compliance", {"joint": "joint_2"}, "before", SIZES)


def test_a_cause_at_the_robot_is_shared_by_displacements_and_positions(tmp_path: Path) -> None:
    cells = [setup(tmp_path, k, points, sigma=2e-5) for k, points in enumerate(("displacement", "absolute"))]
    recordings = [measured(cell, k, 40 + k, effects=(TILT,)) for k, cell in enumerate(cells)]
    offers = offers_for(recordings[0], cells[0])
    found = diagnose_together(together(recordings, cells, test=recordings[0]), offers)
    (finding,) = [one for one in found.findings if one.family == "structure"]
    assert (finding.effect, dict(finding.location)) == ("off_axis_compliance", {"joint": "joint_2"})
    for parameter in finding.parameters:
        assert parameter.value == pytest.approx(TILT.parameters[parameter.name], abs=4 * parameter.std)
    assert not found.rest.significant
    assert found.model is not None
    assert [one.effect for one in found.model.effects] == ["off_axis_compliance"]
    assert set(found.model.points) == {"mp1", "mp2", "mp3"}
    assert found.test is not None
    assert found.test.rms < 1.2 * found.noise
    assert len(found.next_measurements) == 3


@pytest.mark.slow
def test_a_test_recording_of_both_kinds_is_judged_part_by_part(tmp_path: Path) -> None:
    cells = [setup(tmp_path, k, sigma=2e-5) for k in range(2)]
    recordings = [measured(cell, k, 40 + k, effects=(TILT,)) for k, cell in enumerate(cells)]
    other = measured(cells[0], 0, 77, configurations=5, rest=9, effects=(TILT,))  # its tracker stands elsewhere
    test = diagnose_together(together(recordings, cells, test=other)).test
    assert test is not None
    assert [(part.kind, part.configurations) for part in test.parts] == [("loaded", 5), ("at_rest", 9)]
    loaded, at_rest = test.parts
    assert loaded.rms < 1.2 * 2e-5 < loaded.rms_before
    assert at_rest.rms < 1.3 * 2e-5  # by its own weight the robot shows this bearing no better than the noise


def test_a_point_that_stands_elsewhere_than_stated_names_its_recording(tmp_path: Path) -> None:
    cells = [setup(tmp_path, k, sigma=2e-5) for k in range(2)]
    wrong = cells[1].frames.measurement_points["mp2"]
    points = {**cells[1].frames.measurement_points, "mp2": (wrong[0], wrong[1] + 0.02, wrong[2])}
    stated = cells[1].model_copy(update={"frames": cells[1].frames.model_copy(update={"measurement_points": points})})
    recordings = [measured(cell, k, 50 + k) for k, cell in enumerate(cells)]
    found = diagnose_together(together(recordings, [cells[0], stated]))
    (alone,) = [one for one in diagnose(recordings[1], stated).identification.notes if one.place == TARGETS]
    (note,) = [one for one in found.identification.notes if one.place == f"B.csv: {TARGETS}"]
    assert (note.kind, note.text) == ("frames", alone.text)
    assert note.text.startswith("mp2 is ")
    assert (found.verdict, found.findings) == ("consistent", ())


def test_a_target_that_moved_names_its_recording(tmp_path: Path) -> None:
    cells = [setup(tmp_path, k, sigma=2e-5) for k in range(2)]
    recordings = [measured(cells[0], 0, 55), measured(cells[1], 1, 56, slipped=(8, 1.5e-3))]
    found = diagnose_together(together(recordings, cells))
    (anomaly,) = [one for one in found.anomalies if one.kind == "target_moved"]
    assert anomaly.location == {"point": "mp2", "recording": "B.csv"}


def test_effects_of_a_set_up_are_each_recordings_own(tmp_path: Path) -> None:
    cells = [setup(tmp_path, k) for k in range(2)]
    prepared = together([measured(cell, k, 60 + k, configurations=4) for k, cell in enumerate(cells)], cells)
    merged = prepared.merged
    loaded = prepare_loaded(merged.readings, merged.cell, prepared.options)
    state = loaded_state(loaded.problem, merged.cell, loaded.fit.compliance)
    offered = candidates(state)
    for effect in ("wrench_gain", "tracker_drift"):
        several = [one for one in offered if one.effect == effect]
        assert {one.location["recording"] for one in several} == {"1", "2"}
        for one in several:
            own = merged.readings.recording == int(str(one.location["recording"])) - 1
            columns = one.columns(state)
            assert np.abs(columns[own]).max() > 0
            assert np.all(columns[~own] == 0)
    assert not [one for one in offered if one.family == "structure" and "recording" in one.location]
    assert effect_sentence("tracker_drift", {"tracker": "tracker", "recording": "2"}).endswith(" in recording 2")


def test_a_recording_at_rest_and_a_loaded_one_are_one_estimate(tmp_path: Path) -> None:
    cells = [setup(tmp_path, k, sigma=2e-5) for k in range(2)]
    geometry = 4e-4 * np.random.default_rng(3).standard_normal((6, 6))
    recordings = [
        measured(cells[0], 0, 20, configurations=0, rest=30, geometry=geometry),
        measured(cells[1], 1, 21, configurations=12, geometry=geometry),
    ]
    prepared = together(recordings, cells)
    found = diagnose_together(prepared)
    assert not found.rest.significant
    assert {one.family for one in found.findings} <= {"point chain"}  # points stand elsewhere than stated
    assert {"compliance.joint_2", "geometry.joint_3.rx"} <= set(found.estimate.names)
    best = min(alone.stiffness[1].std for alone in prepared.alone if alone.stiffness)
    value, std = found.stiffness["joint_2"]
    assert std < best
    assert value == pytest.approx(STIFFNESS[1], abs=4 * std)


def test_what_is_left_out_is_no_noise_of_its_recording(tmp_path: Path) -> None:
    cells = [setup(tmp_path, k, sigma=2e-5) for k in range(2)]
    counts = ((14, 0), (0, 24))
    recordings = [
        measured(cell, k, 60 + k, configurations=loaded, rest=rest, effects=(TILT,))
        for k, (cell, (loaded, rest)) in enumerate(zip(cells, counts, strict=True))
    ]
    found = diagnose_together(together(recordings, cells))
    assert ("off_axis_compliance", {"joint": "joint_2"}) in [(one.effect, dict(one.location)) for one in found.findings]
    assert found.identification.together is not None
    assert [one.scale for one in found.identification.together.contributions] == pytest.approx([1.0, 1.0], abs=0.1)
    assert found.noise == pytest.approx(2e-5, rel=0.1)
    assert found.rms_after == pytest.approx(found.noise, rel=0.1)


def test_what_is_proposed_for_the_first_set_up_is_worth_what_it_says(tmp_path: Path) -> None:
    cells = [setup(tmp_path, k, sigma=2e-5) for k in range(2)]
    recordings = [measured(cell, k, 70 + k) for k, cell in enumerate(cells)]
    offers = offers_for(recordings[0], cells[0])
    assert offers
    found = diagnose_together(together(recordings, cells), offers)
    proposal = found.next_measurements[0]
    assert "the stiffness of joint_6" in proposal.why
    assert proposal.gain_at_random < proposal.gain
    assert found.next_text == "To be measured in the set-up of A.csv."
    offer = Offer(0, np.array(proposal.q), np.array(proposal.steps))
    further = offers.expected([offer], found.identification.model)
    longer = added(recordings[0], further)
    again = diagnose_together(together([longer, recordings[1]], cells))
    before, after = found.stiffness["joint_6"], again.stiffness["joint_6"]
    quieter = again.noise / found.noise  # readings without noise lower the noise that is seen
    gained = 100 * (before[1] / before[0] - after[1] / after[0] / quieter)
    assert gained == pytest.approx(proposal.gain, rel=0.2)


@pytest.mark.parametrize("loaded", [0, pytest.param(10, marks=pytest.mark.slow)])
def test_postures_are_proposed_for_what_recordings_at_rest_show(loaded: int, tmp_path: Path) -> None:
    cells = [setup(tmp_path, k, sigma=2e-5) for k in range(2)]
    wave = AppliedEffect("transmission_error", {"joint": "joint_3"}, "order 2", {"cosine": 4e-4, "sine": -2e-4})
    recordings = [
        measured(cells[0], 0, 30, configurations=0, rest=60, effects=(wave,)),
        measured(cells[1], 1, 31, configurations=loaded, rest=60, effects=(wave,)),
    ]
    found = diagnose_together(together(recordings, cells), offers_for(recordings[0], cells[0]))
    assert "transmission_error" in {one.effect for one in found.physics}
    assert len(found.next_measurements) == 3
    assert all(proposal.gain > proposal.gain_at_random > 0 for proposal in found.next_measurements)


def added(readings: Readings, further: Readings) -> Readings:
    """Return a recording with further readings at its end."""
    last = int(readings.configuration.max())
    more = dataclasses.replace(further, configuration=further.configuration + last)
    arrays = {
        field.name: np.concatenate([getattr(readings, field.name), getattr(more, field.name)])
        for field in dataclasses.fields(Readings)
        if isinstance(getattr(readings, field.name), np.ndarray)
    }
    return dataclasses.replace(readings, **arrays)


def test_what_the_standard_leaves_out_is_no_difference_between_recordings(tmp_path: Path) -> None:
    """Each recording's own postures turn one gear error into other parameters of the standard's model."""
    cells = [setup(tmp_path, k, sigma=2e-5) for k in range(3)]
    wave = AppliedEffect("transmission_error", {"joint": "joint_3"}, "order 2", {"cosine": 4e-4, "sine": -2e-4})
    recordings = [
        measured(cell, k, 140 + k, configurations=0, rest=60, effects=(wave,)) for k, cell in enumerate(cells)
    ]
    prepared = together(recordings, cells)
    _, differing = agreement([one.file for one in prepared.members], [one.estimate for one in prepared.alone])
    assert differing
    found = diagnose_together(prepared)
    assert [one.effect for one in found.findings] == ["transmission_error"]
    assert found.model is not None
    assert found.model.effects[0].parameters["cosine"] == pytest.approx(4e-4, abs=4e-5)
    assert found.identification.together is not None
    assert "geometry.joint_3.rz" in found.identification.together.compared
    assert found.identification.together.disagreements == ()
    assert not [one for one in found.anomalies if one.kind == "recordings_differ"]


@pytest.mark.slow
def test_a_joint_that_has_changed_is_said_beside_what_is_left_out(tmp_path: Path) -> None:
    cells = [setup(tmp_path, k, sigma=2e-5) for k in range(3)]
    softer = [value * (0.85 if joint == 1 else 1.0) for joint, value in enumerate(STIFFNESS)]
    recordings = [
        measured(cell, k, 40 + k, effects=(TILT,), stiffness=softer if k == 2 else None) for k, cell in enumerate(cells)
    ]
    found = diagnose_together(together(recordings, cells))
    differing = [one for one in found.anomalies if one.kind == "recordings_differ"]
    assert {"joint": "joint_2", "recording": "C.csv"} in [dict(one.location) for one in differing]
