"""Several recordings of one robot: what is shared is known better, what is each set-up's own stays its own."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from robots import STIFFNESS
from several_cases import measured, setup, together, truth_in

from calibration_core.cell import Cell
from calibration_core.errors import InputError
from calibration_core.identification.identify import identify
from calibration_core.identification.result.estimate import Identification
from calibration_core.identification.several.merge import members_of
from calibration_core.identification.stiffness.loaded import Options
from calibration_core.outcomes.together.evaluate import covered, identify_together
from calibration_core.outcomes.together.prepare import prepare
from calibration_core.timeseries import Readings

TRUE = np.array(STIFFNESS)


def cells_in(folder: Path, points: str = "absolute", sigma: float | None = None) -> list[Cell]:
    return [setup(folder, k, points, sigma) for k in range(3)]


def values(found: Identification) -> np.ndarray:
    return np.array([joint.value for joint in found.stiffness])


def deviations(found: Identification) -> np.ndarray:
    return np.array([joint.std for joint in found.stiffness])


def loaded(cells: list[Cell], seed: int) -> list[Readings]:
    return [measured(cell, k, seed + k) for k, cell in enumerate(cells)]


@pytest.mark.parametrize("points", ["absolute", "displacement"])
def test_what_is_shared_is_recovered_and_known_better(points: str, tmp_path: Path) -> None:
    prepared = together(loaded(cells := cells_in(tmp_path, points), 10), cells)
    found = identify_together(prepared)
    z = (values(found) - TRUE) / deviations(found)
    assert np.abs(z).max() < 3.5
    best = np.min([deviations(alone) for alone in prepared.alone], axis=0)
    information = np.sum([1 / deviations(alone) ** 2 for alone in prepared.alone], axis=0)
    assert np.all(deviations(found) < best)
    assert np.all(deviations(found) * np.sqrt(information) < 1.1)  # what is correlated may gain more
    assert found.together is not None
    assert found.together.disagreements == ()
    assert [one.noise for one in found.together.contributions] == pytest.approx([2e-5, 4e-5, 6e-5])


def test_displacements_and_positions_are_put_together(tmp_path: Path) -> None:
    kinds = ("absolute", "displacement", "absolute")
    cells = [setup(tmp_path, k, points) for k, points in enumerate(kinds)]
    recordings = loaded(cells, 10)
    prepared = together(recordings, cells)
    found = identify_together(prepared)
    assert np.abs((values(found) - TRUE) / deviations(found)).max() < 3.5
    as_positions = [setup(tmp_path, k) for k in range(3)]
    expected = identify_together(together(loaded(as_positions, 10), as_positions))
    np.testing.assert_allclose(values(found), values(expected), rtol=2e-3)  # frames are fitted alone here
    np.testing.assert_allclose(deviations(found), deviations(expected), rtol=0.05)
    assert found.together is not None
    assert found.together.disagreements == ()
    assert [one.tracker is None for one in found.together.contributions] == [False, True, False]
    assert set(found.model.points) == set(cells[0].points)
    assert {"tracker.x", "measurement_points.mp1.x"} <= set(found.estimate.names)


@pytest.mark.parametrize("configurations", [0, 8])
def test_postures_at_rest_beside_displacements_are_refused(configurations: int, tmp_path: Path) -> None:
    cells = [setup(tmp_path, 0, "displacement"), setup(tmp_path, 1)]
    recordings = [measured(cells[0], 0, 1), measured(cells[1], 1, 2, configurations=configurations, rest=20)]
    with pytest.raises(InputError, match=r"^B.csv: step: found postures with one step, expected several steps"):
        together(recordings, cells)


def test_equal_recordings_narrow_the_intervals_by_the_root_of_their_number(tmp_path: Path) -> None:
    cells = cells_in(tmp_path, sigma=2e-5)
    same = [measured(cell, k, 4) for k, cell in enumerate(cells)]  # the same postures and loads, another set-up
    prepared = together(same, cells)
    ratio = deviations(prepared.alone[0]) / deviations(identify_together(prepared))
    assert np.exp(np.mean(np.log(ratio))) == pytest.approx(np.sqrt(3), rel=0.1)  # the points sit elsewhere


def test_each_recording_by_itself_is_what_identify_says_of_it(tmp_path: Path) -> None:
    cells = cells_in(tmp_path)[:2]
    recordings = [measured(cell, k, 20 + k) for k, cell in enumerate(cells)]
    prepared = together(recordings, cells)
    for alone, readings, cell in zip(prepared.alone, recordings, cells, strict=True):
        expected = identify(readings, cell)
        np.testing.assert_allclose(values(alone), values(expected), rtol=1e-9)
        np.testing.assert_allclose(deviations(alone), deviations(expected), rtol=1e-9)


def test_each_set_up_keeps_its_own_frames(tmp_path: Path) -> None:
    cells = cells_in(tmp_path)
    found = identify_together(together(loaded(cells, 30), cells))
    assert found.together is not None
    for k, (cell, one) in enumerate(zip(cells, found.together.contributions, strict=True)):
        assert one.tracker is not None
        truth = truth_in(cell, 30 + k, STIFFNESS, np.zeros((6, 6)))
        np.testing.assert_allclose(one.tracker[:3], truth.tracker[:3, 3], atol=1.5e-4)
    named = {one.name: one.value for one in found.parameters}
    truth = truth_in(cells[1], 31, STIFFNESS, np.zeros((6, 6)))
    assert named["mp2@2 y"] == pytest.approx(truth.points["mp2"][1], abs=1e-4)


def test_the_order_does_not_matter(tmp_path: Path) -> None:
    cells = cells_in(tmp_path)
    recordings = loaded(cells, 50)
    forward = identify_together(together(recordings, cells))
    backward = identify_together(together(recordings[::-1], cells[::-1]))
    np.testing.assert_allclose(values(backward), values(forward), rtol=1e-9)
    np.testing.assert_allclose(deviations(backward), deviations(forward), rtol=1e-9)
    assert forward.together is not None
    assert backward.together is not None
    assert [one.file for one in forward.together.contributions] == ["A.csv", "B.csv", "C.csv"]
    assert [one.file for one in backward.together.contributions] == ["C.csv", "B.csv", "A.csv"]
    assert {one.number for one in backward.together.contributions} == {1, 2, 3}


def test_the_model_belongs_to_the_first_one_named(tmp_path: Path) -> None:
    cells = cells_in(tmp_path)
    recordings = loaded(cells, 60)
    alone = identify(recordings[1], cells[1])
    found = identify_together(together([recordings[1], recordings[0]], [cells[1], cells[0]]))
    np.testing.assert_allclose(found.model.tracker, alone.model.tracker, atol=2e-5)
    assert set(found.model.points) == set(alone.model.points)
    np.testing.assert_allclose(found.model.points["mp3"], alone.model.points["mp3"], atol=2e-5)
    assert "measurement_points.mp3.z" in found.estimate.names
    assert "tracker.yaw" in found.estimate.names
    assert not [name for name in found.estimate.names if "@" in name]


def test_a_joint_that_has_changed_is_said(tmp_path: Path) -> None:
    cells = cells_in(tmp_path)[:2]
    softer = [k * (0.85 if j == 2 else 1.0) for j, k in enumerate(STIFFNESS)]
    recordings = [measured(cells[0], 0, 70), measured(cells[1], 1, 71, stiffness=softer)]
    found = identify_together(together(recordings, cells))
    assert found.together is not None
    (one,) = found.together.disagreements
    assert (one.file, one.location) == ("B.csv", "joint_3")
    assert one.low < -0.15 < one.high
    (anomaly,) = [anomaly for anomaly in found.anomalies if anomaly.kind == "recordings_differ"]
    assert anomaly.location == {"joint": "joint_3", "recording": "B.csv"}
    assert "softer" in anomaly.text


def test_noise_that_is_understated_counts_by_what_it_is(tmp_path: Path) -> None:
    claims = cells_in(tmp_path)[:2]
    noisy = setup(tmp_path, 1, sigma=4e-4)
    recordings = [measured(claims[0], 0, 80), measured(noisy, 1, 81)]
    found = identify_together(together(recordings, [claims[0], setup(tmp_path, 1)]))
    alone = identify(recordings[0], claims[0])
    assert found.together is not None
    assert found.together.contributions[1].scale == pytest.approx(10, rel=0.1)
    (anomaly,) = [one for one in found.anomalies if one.kind == "noise_understated"]
    assert anomaly.location == {"instrument": "tracker", "recording": "B.csv"}
    assert np.all(deviations(found) < deviations(alone))
    assert np.abs((values(found) - TRUE) / deviations(found)).max() < 3.5


def test_recordings_at_rest_share_the_geometry(tmp_path: Path) -> None:
    cells = cells_in(tmp_path, sigma=2e-5)[:2]
    geometry = 4e-4 * np.random.default_rng(3).standard_normal((6, 6))
    recordings = [
        measured(cell, k, 90 + k, configurations=0, rest=40, geometry=geometry) for k, cell in enumerate(cells)
    ]
    prepared = together(recordings, cells)
    found = identify_together(prepared)
    assert found.kind == "absolute"
    fitted = [one for one in found.parameters if one.group == "geometry" and one.fitted]
    assert len(fitted) > 12
    each = [{one.name: one.std for one in alone.parameters} for alone in prepared.alone]
    gain = np.array([min(alone[one.name] for alone in each) / one.std for one in fitted])
    assert np.all(gain > 1)
    assert np.median(gain) == pytest.approx(np.sqrt(2), rel=0.2)
    soft = {joint.joint: joint for joint in found.stiffness if joint.identifiable}
    assert {"joint_2", "joint_3"} <= set(soft)
    for name in ("joint_2", "joint_3"):
        assert soft[name].value == pytest.approx(STIFFNESS[int(name[-1]) - 1], abs=4 * soft[name].std)
    assert found.together is not None
    assert found.together.disagreements == ()


def without_sensor(cell: Cell) -> Cell:
    """Return a cell that says nothing of a force/torque sensor."""
    frames = cell.frames.model_copy(update={"force_torque": None})
    instruments = cell.instruments.model_copy(update={"force_torque": None})
    return cell.model_copy(update={"frames": frames, "instruments": instruments})


def test_the_sensor_is_asked_for_only_where_a_wrench_was_recorded(tmp_path: Path) -> None:
    cells = cells_in(tmp_path)[:2]
    still = [measured(cell, k, 90 + k, configurations=0, rest=25) for k, cell in enumerate(cells)]
    bare = [without_sensor(cell) for cell in cells]
    prepared = together(still, bare)
    assert prepared.merged.readings.wrench is None
    found = identify_together(prepared)
    assert found.kind == "absolute"
    assert covered(prepared, found.model).force == (0.0, 0.0)
    loads = measured(cells[1], 1, 21)
    prepared = together([still[0], loads], [bare[0], cells[1]])
    found = identify_together(prepared)
    assert found.kind == "loaded"
    assert covered(prepared, found.model).force[1] == pytest.approx(2300, rel=0.01)
    with pytest.raises(InputError, match=r"B\.cell\.yaml: frames\.force_torque: found nothing"):
        together([still[0], loads], bare)


def test_a_test_with_loads_asks_for_the_sensor_beside_recordings_at_rest(tmp_path: Path) -> None:
    cells = cells_in(tmp_path)[:2]
    still = [measured(cell, k, 90 + k, configurations=0, rest=25) for k, cell in enumerate(cells)]
    loads = measured(cells[0], 0, 21)
    members = members_of(still, cells)
    prepared = prepare(members, [0, 1], Options(), loads)
    assert prepared.test is not None
    np.testing.assert_allclose(prepared.test.wrench, loads.wrench, atol=1e-9)
    members = members_of(still, [without_sensor(cell) for cell in cells])
    with pytest.raises(InputError, match=r"A\.cell\.yaml: frames\.force_torque: found nothing"):
        prepare(members, [0, 1], Options(), loads)


def test_one_at_rest_and_one_loaded_give_geometry_and_stiffness(tmp_path: Path) -> None:
    cells = cells_in(tmp_path, sigma=2e-5)[:2]
    geometry = 4e-4 * np.random.default_rng(3).standard_normal((6, 6))
    recordings = [
        measured(cells[0], 0, 20, configurations=0, rest=40, geometry=geometry),
        measured(cells[1], 1, 21, geometry=geometry),
    ]
    found = identify_together(together(recordings, cells))
    assert found.kind == "loaded"
    assert np.abs((values(found) - TRUE) / deviations(found)).max() < 3.5
    fitted = [one for one in found.parameters if one.group == "geometry" and one.fitted]
    assert len(fitted) > 12
    assert {"compliance.joint_2", "geometry.joint_3.rx", "measurement_points.mp1.x"} <= set(found.estimate.names)
    assert found.together is not None
    assert [one.kind for one in found.together.contributions] == ["absolute", "loaded"]
    assert [one.rms for one in found.together.contributions] == pytest.approx([2e-5, 2e-5], rel=0.2)
    backward = identify_together(together(recordings[::-1], cells[::-1]))
    np.testing.assert_allclose(values(backward), values(found), rtol=1e-9)
    shared = [name for name in found.estimate.names if name.startswith("geometry.")]
    rows, others = ([one.estimate.names.index(name) for name in shared] for one in (found, backward))
    np.testing.assert_allclose(backward.estimate.value[others], found.estimate.value[rows], rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"rated_load": 200.0}, "robot: found another robot \\(rated_load differ"),
        ({"inertials": None}, "robot: found another robot \\(inertials differ"),
    ],
)
def test_another_robot_is_refused(change: dict[str, object], place: str, tmp_path: Path) -> None:
    first, other = setup(tmp_path, 0), setup(tmp_path, 1, **change)
    with pytest.raises(InputError, match=place):
        members_of([measured(first, 0, 1), measured(other, 1, 2)], [first, other])


def test_what_does_not_fit_together_is_refused(tmp_path: Path) -> None:
    cells = cells_in(tmp_path)
    readings = measured(cells[0], 0, 1)
    with pytest.raises(InputError, match=r"the same content as in A\.csv, expected every recording once"):
        members_of([readings, dataclasses.replace(readings)], [cells[0], cells[0]])


@pytest.mark.slow
def test_intervals_cover_over_many_recordings(tmp_path: Path) -> None:
    cells = cells_in(tmp_path)
    inside = []
    for seed in range(60):
        found = identify_together(together(loaded(cells, 1000 + 10 * seed), cells))
        low, high = np.array([joint.interval for joint in found.stiffness]).T
        inside.append((low < TRUE) & (high > TRUE))
    assert 0.92 <= np.mean(inside) <= 0.98
