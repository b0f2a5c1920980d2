"""A recording of loaded configurations and postures at rest, any number of either: one set-up."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from robots import STIFFNESS
from several_cases import measured, setup, truth_in

from calibration_core.cell import Cell
from calibration_core.commands.evaluation.diagnose import evaluate_all as diagnose_all
from calibration_core.commands.evaluation.identify import Identified, evaluate_all
from calibration_core.commands.shared.inputs import Refusal
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.errors import IdentificationError
from calibration_core.identification.identify import identify
from calibration_core.identification.result.estimate import Identification
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import AppliedEffect
from calibration_core.observations.kinds import single_steps
from calibration_core.timeseries import Readings

TRUE = np.array(STIFFNESS)
GEOMETRY = 4e-4 * np.random.default_rng(3).standard_normal((6, 6))
SAME = 1e-9
SET_UP = 0.15  # what a search that knows of one set-up says more than one that knows of two
TILT = AppliedEffect(
    "off_axis_compliance",
    {"joint": "joint_2"},
    "before",
    {"compliance_x": 6e-8, "compliance_y": 5e-8, "compliance_xy": 1e-8},
)
LARGE = dataclasses.replace(TILT, parameters={name: 8 * value for name, value in TILT.parameters.items()})


def cell_in(folder: Path) -> Cell:
    return setup(folder, 0, sigma=2e-5)


def mixed(cell: Cell, loaded: int, rest: int, seed: int = 21, **changes: object) -> Readings:
    return measured(cell, 0, seed, configurations=loaded, rest=rest, geometry=GEOMETRY, **changes)  # type: ignore[arg-type]


def in_two_files(readings: Readings) -> list[Readings]:
    """Return the loaded configurations and the postures at rest as two recordings."""
    rest = single_steps(readings)

    def named(rows: np.ndarray, name: str) -> Readings:
        provenance = dataclasses.replace(readings.provenance, path=name, sha256={name: name})
        return dataclasses.replace(readings.select(rows), provenance=provenance)

    return [named(~rest, "loaded.csv"), named(rest, "rest.csv")]


def answered(recordings: list[Readings], cell: Cell, options: Options | None = None) -> Identified:
    answer = evaluate_all(recordings, [cell] * len(recordings), options or Options())
    assert not isinstance(answer, Refusal)
    return answer


def values(found: Identification) -> np.ndarray:
    return np.array([joint.value for joint in found.stiffness])


def deviations(found: Identification) -> np.ndarray:
    return np.array([joint.std for joint in found.stiffness])


def interleaved(readings: Readings) -> Readings:
    """Return the same configurations in a drawn order, numbered anew."""
    numbers = np.unique(readings.configuration)
    order = np.random.default_rng(5).permutation(numbers)
    rows = np.concatenate([np.flatnonzero(readings.configuration == number) for number in order])
    some = readings.select(rows)
    return dataclasses.replace(some, configuration=np.argsort(order)[np.searchsorted(numbers, some.configuration)] + 1)


@pytest.mark.parametrize(
    ("loaded", "rest", "effects", "mix"),
    [
        pytest.param(14, 40, (), True, marks=pytest.mark.slow),
        pytest.param(14, 12, (), False, marks=pytest.mark.slow),
        (2, 40, (), False),
        pytest.param(12, 30, (TILT,), True, marks=pytest.mark.slow),
    ],
)
def test_one_file_says_what_two_files_say_and_knows_that_nothing_moved_between(
    loaded: int, rest: int, effects: tuple[AppliedEffect, ...], mix: bool, tmp_path: Path
) -> None:
    cell = cell_in(tmp_path)
    readings = mixed(cell, loaded, rest, effects=effects)
    readings = interleaved(readings) if mix else readings
    one, two = (answered(recordings, cell) for recordings in ([readings], in_two_files(readings)))
    shift = (values(one.identification) - values(two.identification)) / deviations(two.identification)
    assert np.abs(shift).max() < 0.3
    for key in ("verdict", "usable", "reason"):
        assert one.content[key] == two.content[key]
    for first, second in zip(one.content["stiffness"], two.content["stiffness"], strict=True):
        assert first["identifiable"] == second["identifiable"]
        assert first["std"] == pytest.approx(second["std"], rel=SET_UP)
    found, other = ([(f["effect"], f["evidence"]["magnitude"]) for f in x.content["findings"]] for x in (one, two))
    assert [effect for effect, _ in found] == [effect for effect, _ in other]
    assert [size for _, size in found] == pytest.approx([size for _, size in other], rel=SET_UP)


def test_the_answer_is_that_of_one_recording(tmp_path: Path) -> None:
    cell = cell_in(tmp_path)
    readings = interleaved(mixed(cell, 14, 40))
    answer = answered([readings], cell)
    found, content = answer.identification, answer.content
    assert found.kind == "loaded"
    assert found.together is None
    assert np.abs((values(found) - TRUE) / deviations(found)).max() < 3.5
    assert content["recording"]["configurations"] == 54
    assert content["recording"]["points"] == ["mp1", "mp2", "mp3"]
    assert "recordings" not in content
    assert "@" not in str(content)
    assert set(found.model.points) == {"mp1", "mp2", "mp3"}
    assert found.model.setups is None
    assert {"compliance.joint_2", "geometry.joint_3.rx", "tracker.x", "measurement_points.mp1.x"} <= set(
        found.estimate.names
    )
    rest = single_steps(readings)
    for rows in (rest, ~rest):  # each reading has a residual of the size of the noise
        assert np.sqrt(np.mean(found.residuals.residual[rows] ** 2)) == pytest.approx(2e-5, rel=0.2)
    assert found.fit.rms_after == pytest.approx(2e-5, rel=0.15)
    assert found.fit.rms_before > 10 * found.fit.rms_after
    assert set(answer.files(report=True)) >= {"result.json", "model.yaml", "table2.csv", "report.html", "report.pdf"}


@pytest.mark.parametrize("rest", [1, 2, 3, 11])
def test_few_postures_at_rest_share_the_set_up_of_the_loaded_configurations(rest: int, tmp_path: Path) -> None:
    cell = cell_in(tmp_path)
    answer = answered([mixed(cell, 14, rest)], cell)
    found = answer.identification
    assert np.abs((values(found) - TRUE) / deviations(found)).max() < 3.5
    assert [one.name for one in found.parameters if one.group == "geometry" and one.fitted]
    assert answer.content["verdict"] == "consistent"


def test_postures_at_rest_that_say_nothing_leave_the_loaded_configurations(tmp_path: Path) -> None:
    cell = cell_in(tmp_path)
    readings = mixed(cell, 2, 1)
    readings = readings.select(readings.point == 0)
    found = identify(readings, cell)
    (note,) = [note for note in found.notes if note.kind == "loaded_alone"]
    assert "the postures at rest are not used: A.csv: found 9 coordinates" in note.text
    assert np.all(np.isfinite(values(found)))


def test_one_loaded_configuration_leaves_the_postures_at_rest(tmp_path: Path) -> None:
    cell = cell_in(tmp_path)
    readings = mixed(cell, 1, 40)
    answer = answered([readings], cell)
    found = answer.identification
    assert found.kind == "absolute"
    assert "few_loaded" in {note.kind for note in found.notes}
    soft = {joint.joint: joint for joint in found.stiffness if joint.identifiable}
    assert {"joint_2", "joint_3"} <= set(soft)
    for name in ("joint_2", "joint_3"):
        assert soft[name].value == pytest.approx(TRUE[int(name[-1]) - 1], abs=4 * soft[name].std)
    with pytest.raises(IdentificationError, match=r"^A.csv: configuration: found 2 configurations, expected at least"):
        identify(mixed(cell, 1, 1), cell)


def test_a_point_that_was_measured_at_rest_alone_is_in_the_model(tmp_path: Path) -> None:
    cell = cell_in(tmp_path)
    readings = mixed(cell, 14, 40)
    some = readings.select(single_steps(readings) | (readings.point != 2))
    found = identify(some, cell)
    truth = truth_in(cell, 21, STIFFNESS, GEOMETRY)
    assert np.abs((values(found) - TRUE) / deviations(found)).max() < 3.5
    np.testing.assert_allclose(found.model.points["mp3"], truth.points["mp3"], atol=5e-4)


def test_a_reading_is_named_and_taken_back_as_in_the_recording(tmp_path: Path) -> None:
    cell = cell_in(tmp_path)
    readings = mixed(cell, 14, 40)
    position = readings.position.copy()
    rows = [7, len(readings) - 4]  # of a loaded configuration, and of a posture at rest
    position[rows] += 3e-3
    wrong = dataclasses.replace(readings, position=position)
    keys = {(int(readings.configuration[k]), int(readings.step[k]), readings.points[readings.point[k]]) for k in rows}
    found = identify(wrong, cell)
    assert {(one.configuration, one.step, one.point) for one in found.exclusions} == keys
    (stated,) = [one for one in found.anomalies if one.kind == "outlier_readings"]
    assert all("/".join(map(str, key)) in stated.text for key in keys)
    assert stated.text.startswith("2 readings do not fit the others (")
    assert stated.magnitude == max(one.size for one in found.exclusions)
    assert set(np.flatnonzero(found.residuals.excluded)) == set(rows)
    taken = identify(wrong, cell, Options(readmit=frozenset(keys)))
    assert not taken.exclusions


def test_a_further_recording_is_predicted(tmp_path: Path) -> None:
    cell = cell_in(tmp_path)
    readings = mixed(cell, 20, 40)
    kept = readings.configuration > 6
    found = identify(readings.select(kept), cell, test=readings.select(~kept))
    assert found.test is not None
    assert found.test.rms < 1.2 * 2e-5


@pytest.mark.parametrize("effects", [(), pytest.param((TILT,), marks=pytest.mark.slow), (LARGE,)])
def test_identify_and_diagnose_say_the_same_of_one_file(effects: tuple[AppliedEffect, ...], tmp_path: Path) -> None:
    cell = cell_in(tmp_path)
    readings = mixed(cell, 14, 40, effects=effects)
    diagnosed = diagnose_all([readings], [cell], Options())
    assert not isinstance(diagnosed, Refusal)
    identified = answered([readings], cell)
    for key in ("verdict", "findings", "anomalies"):
        assert diagnosed.content[key] == identified.content[key]
    for searched, stated in zip(diagnosed.content["stiffness"], identified.content["stiffness"], strict=True):
        low, high = stated["interval_95"]
        assert low * (1 - SAME) <= searched["interval_95"][0] < searched["interval_95"][1] <= high * (1 + SAME)
        if effects:
            assert stated["extended"] == {key: searched[key] for key in ("value", "std", "interval_95")}
    assert diagnosed.content["verdict"] == ("missing_physics" if effects else "consistent")
    assert [one["effect"] for one in diagnosed.content["findings"]] == [one.effect for one in effects]


def test_what_is_not_used_is_counted_alike_everywhere(tmp_path: Path) -> None:
    """In one file and in two: the list, the anomaly, the terminal, what each recording contributes, and the numbers."""
    cell = cell_in(tmp_path)
    readings = mixed(cell, 14, 30)
    position = readings.position.copy()
    rows = [7, len(readings) - 4]  # of a loaded configuration, and of a posture at rest
    position[rows] += 3e-3
    wrong = dataclasses.replace(readings, position=position)
    for recordings in ([wrong], in_two_files(wrong)):
        answer = answered(recordings, cell)
        content = answer.content
        count = len(content["exclusions"])
        assert count >= len(rows)
        (outliers,) = [one for one in content["anomalies"] if one["kind"] == "outlier_readings"]
        assert outliers["text"].startswith(f"{count} readings do not fit the others (")
        assert outliers["magnitude"] == max(one["size"] for one in content["exclusions"])
        for one in content["exclusions"]:
            assert f"{one['configuration']}/{one['step']}/{one['point']}" in outliers["text"]
        kind = "loaded recording" + "s" * (len(recordings) > 1)
        assert f"{kind}: 44 configurations (30 of them postures at rest), 300 readings" in answer.summary
        if len(recordings) == 1:
            counts = {"configurations": 44, "postures_at_rest": 30, "steps": 100, "readings": 300}
            assert {key: content["recording"][key] for key in counts} == counts
        else:
            assert [one["configurations"] for one in content["recordings"]] == [14, 30]
            assert [one["steps"] for one in content["recordings"]] == [70, 30]
            assert [one["readings"] for one in content["recordings"]] == [210, 90]
            excluded = [one["excluded"] for one in content["recordings"]]
            assert min(excluded) >= 1
            assert sum(excluded) == count


def test_the_steps_from_a_simulation_are_free_of_what_moved(tmp_path: Path) -> None:
    """A target that was knocked is named, and no step has to explain it."""
    cell = cell_in(tmp_path)
    readings = mixed(cell, 0, 38, slipped=(12, 2e-3))
    exact = dataclasses.replace(readings, position=predict_readings(readings, cell, nominal_parameters(cell)))
    found = diagnose(readings, cell, simulation=exact)
    assert [one.kind for one in found.anomalies] == ["target_moved"]
    assert found.comparisons[0].waterfall[-1].rms < 1.2 * found.noise_known
