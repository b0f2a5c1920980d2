"""Recording beside simulation: what is no physics is named, with the side that is off, before any physics."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from robots import STIFFNESS, loaded_readings, write_cell

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison.recordings import compare, sensor_axes
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.diagnosis.simulated import compare_checked
from calibration_core.identification.stiffness.predict import from_step_zero, predict_readings
from calibration_core.model.chain import pose_matrix
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Readings


@pytest.fixture(scope="module")
def simulated(cell: Cell, recorded: Readings) -> Readings:
    """What the cell file's model says of the same angles and wrenches, without noise."""
    return dataclasses.replace(recorded, position=predict_readings(recorded, cell, nominal_parameters(cell)))


@pytest.fixture(scope="module")
def alone(cell: Cell, recorded: Readings) -> Diagnosis:
    """What is said of the recording without a simulation."""
    return diagnose(recorded, cell)


def by_model(readings: Readings, cell: Cell, **changes: object) -> Readings:
    model = nominal_parameters(cell).replace(**changes)
    return dataclasses.replace(readings, position=predict_readings(readings, cell, model))


def kinds(recorded: Readings, simulated: Readings, cell: Cell) -> dict[str, str]:
    return {d.kind: d.side for d in compare(recorded, simulated, cell).differences}


def test_a_simulation_by_the_same_model_differs_by_physics_alone(
    cell: Cell, recorded: Readings, simulated: Readings
) -> None:
    found = compare(recorded, simulated, cell)
    assert found.differences == ()
    assert found.reproduction.reproduced
    assert found.reproduction.loaded_ratio < 1e-6
    assert (found.configurations, found.readings) == (14, len(recorded))
    assert found.steps is not None
    assert found.steps.slope == pytest.approx(1.15, abs=0.02)  # the cell file is 15 % too stiff
    assert found.steps.rms > 3 * found.steps.noise
    assert found.steps.by_configuration[0].rms == max(part.rms for part in found.steps.by_configuration)
    middle = [part.rms for part in found.steps.by_step]
    assert middle[2] > middle[0]  # the full pull is step 2


def test_the_true_simulation_leaves_noise_alone(cell: Cell, recorded: Readings) -> None:
    found = compare(recorded, by_model(recorded, cell, compliance=1 / np.array(STIFFNESS)), cell)
    assert found.steps is not None
    assert found.steps.rms < found.steps.noise
    assert not found.reproduction.reproduced
    assert found.reproduction.refitted_ratio < 0.1
    for change in found.reproduction.stiffness_change.values():
        assert change == pytest.approx(1 / 1.15 - 1, abs=1e-3)


CONVENTIONS: dict[str, tuple[Callable[[Readings], dict[str, np.ndarray]], str]] = {
    "joint_order": (lambda one: {"q": one.q[:, [0, 2, 1, 3, 4, 5]]}, "joint_2, joint_3"),
    "angle_unit": (lambda one: {"q": np.degrees(one.q)}, ""),
    "position_unit": (lambda one: {"position": 1e3 * one.position}, ""),
    "point_order": (lambda one: {"position": one.position.reshape(-1, 3, 3)[:, [1, 0, 2]].reshape(-1, 3)}, "mp1, mp2"),
    "point_order, mirrored": (lambda one: {"position": one.position * [1, -1, 1]}, ""),
    "wrench_sign": (lambda one: {"wrench": -np.array(one.wrench)}, ""),
}


@pytest.mark.parametrize("off", ["simulation", "recording"])
@pytest.mark.parametrize("convention", CONVENTIONS)
def test_whose_convention_is_off(
    cell: Cell, recorded: Readings, simulated: Readings, off: str, convention: str
) -> None:
    change, place = CONVENTIONS[convention]
    pair = {"recording": recorded, "simulation": simulated}
    pair[off] = dataclasses.replace(pair[off], **change(pair[off]))
    found = compare(pair["recording"], pair["simulation"], cell)
    assert {d.kind: d.side for d in found.differences} == {convention.partition(",")[0]: off}
    assert not place or place in found.differences[0].location.values()
    assert not any("holds physics" in sentence for sentence in found.sentences)


@pytest.mark.parametrize("off", ["simulation", "recording"])
def test_a_joint_of_opposite_sign_and_one_of_another_zero(
    cell: Cell, recorded: Readings, simulated: Readings, off: str
) -> None:
    pair = {"recording": recorded, "simulation": simulated}
    q = pair[off].q * [1, 1, -1, 1, 1, 1] + [0, 0, 0, 0, np.pi / 2, 0]
    pair[off] = dataclasses.replace(pair[off], q=q)
    found = compare(pair["recording"], pair["simulation"], cell)
    assert [(d.kind, d.side) for d in found.differences] == [("wrong_robot_file", off)] * 2
    sign, zero = found.differences
    assert sign.location == {"joint": "joint_3"}
    assert (zero.location, zero.magnitude) == ({"joint": "joint_5"}, pytest.approx(np.pi / 2, abs=1e-6))
    assert found.recording_spoiled is (off == "recording")


@pytest.mark.parametrize("off", ["simulation", "recording"])
@pytest.mark.parametrize(("joint", "zero"), [(0, 0.3), (1, 0.005), (4, 0.01)])
def test_whose_zero_is_off(
    cell: Cell, recorded: Readings, simulated: Readings, off: str, joint: int, zero: float
) -> None:
    pair = {"recording": recorded, "simulation": simulated}
    pair[off] = dataclasses.replace(pair[off], q=pair[off].q + zero * np.eye(6)[joint])
    (difference,) = compare(pair["recording"], pair["simulation"], cell).differences
    assert (difference.kind, difference.side) == ("wrong_robot_file", off)
    assert difference.location == {"joint": f"joint_{joint + 1}"}
    assert difference.sentence.endswith(
        "The recording agrees with the cell file, the simulation does not."
        if off == "simulation"
        else "The simulation agrees with the cell file, the recording does not."
    )


def test_points_that_exchanged_their_names_on_the_way(cell: Cell, recorded: Readings, simulated: Readings) -> None:
    """Two targets that were put into each other's nests, or taken for each other: no physics of what follows."""
    position, numbers = recorded.position.copy(), np.unique(recorded.configuration)[-5:]
    later = np.isin(recorded.configuration, numbers)
    rows = [np.flatnonzero(later & (recorded.point == k)) for k in (0, 1)]
    position[np.concatenate(rows)] = position[np.concatenate(rows[::-1])]
    found = compare_checked(dataclasses.replace(recorded, position=position), simulated, cell)
    (one,) = [difference for difference in found.differences if difference.spoils]
    assert (one.kind, one.side, one.location["point"]) == ("point_order", "recording", "mp1, mp2")
    assert f"in configurations {', '.join(map(str, numbers))}" in one.text
    assert found.recording_spoiled


def test_another_tracker_frame_is_said_and_taken_out(cell: Cell, recorded: Readings, simulated: Readings) -> None:
    pose = pose_matrix(np.array([1.0, 2.0, -0.5]), np.array([0.1, 0.2, 1.5]))
    off = dataclasses.replace(simulated, position=simulated.position @ pose[:3, :3].T + pose[:3, 3])
    found = compare(recorded, off, cell)
    assert [(d.kind, d.side) for d in found.differences] == [("tracker_frame", "simulation")]
    plain = compare(recorded, simulated, cell)
    assert found.steps is not None
    assert plain.steps is not None
    assert found.steps.rms == pytest.approx(plain.steps.rms, rel=1e-3)
    assert not found.reproduction.reproduced


def test_another_robot(cell: Cell, recorded: Readings, simulated: Readings) -> None:
    geometry = np.zeros((6, 6))
    geometry[1, 0] = 0.15
    off = by_model(simulated, cell, geometry=geometry)
    found = compare(recorded, off, cell)
    assert [(d.kind, d.side) for d in found.differences if d.spoils] == [("wrong_robot_file", "simulation")]


def in_base_axes(readings: Readings, cell: Cell) -> np.ndarray:
    axes = sensor_axes(readings, cell, chain_of(cell))
    assert readings.wrench is not None
    return np.hstack([np.einsum("mij,mj->mi", axes, part) for part in np.hsplit(readings.wrench, 2)])


def test_wrenches(cell: Cell, recorded: Readings, simulated: Readings) -> None:
    w = np.array(simulated.wrench)
    changed = {
        "wrench_sign": [-w],
        "wrench_unit": [w / 1e3, w * 9.80665, np.hstack([w[:, :3], w[:, 3:] * 1e3])],
        "wrench_frame": [
            w[:, [1, 0, 2, 4, 3, 5]],
            in_base_axes(simulated, cell),
            np.hstack([w[:, :3], w[:, 3:] + np.cross([0.1, 0.2, 0.3], w[:, :3])]),
        ],
        "loads": [0 * w, np.random.default_rng(0).permutation(w)],
    }
    for kind, wrenches in changed.items():
        for wrench in wrenches:
            assert set(kinds(recorded, dataclasses.replace(simulated, wrench=wrench), cell)) == {kind}


def test_numbers_in_another_order_and_missing_steps(cell: Cell, recorded: Readings, simulated: Readings) -> None:
    other = simulated.select(simulated.step != 4)
    other = dataclasses.replace(other, configuration=30 - other.configuration)
    found = compare(recorded, other.select(other.configuration > 18), cell)
    assert {d.kind for d in found.differences} == {"configurations", "steps"}
    assert found.configurations == 11
    assert found.steps is not None
    assert found.steps.slope == pytest.approx(1.15, abs=0.02)


def test_steps_of_what_one_of_the_two_alone_holds_are_not_compared(
    cell: Cell, recorded: Readings, simulated: Readings
) -> None:
    """As visits to the reference posture, which are numbered like steps."""
    first = int(recorded.configuration.min())
    visits = dataclasses.replace(recorded, step=np.where(recorded.configuration == first, 7, recorded.step))
    found = kinds(visits, simulated.select(simulated.configuration != first), cell)
    assert "steps" not in found
    assert "configurations" in found


def test_nothing_in_common(cell: Cell, recorded: Readings) -> None:
    other = loaded_readings(cell, 99)
    found = compare(recorded, other, cell)
    assert found.readings == 0
    assert found.steps is None
    assert "configurations" in {d.kind for d in found.differences}


def test_displacements_against_positions(cell: Cell, recorded: Readings, simulated: Readings) -> None:
    off = dataclasses.replace(simulated, position=from_step_zero(simulated, simulated.position))
    assert kinds(recorded, off, cell)["no_relation"] == "simulation"


def in_flange_axes(readings: Readings, cell: Cell, vector: tuple[float, float, float]) -> np.ndarray:
    """Return (m, 3) m, tracker axes, of a vector that is constant in the flange's."""
    pose = nominal_parameters(cell).tracker[:3, :3]
    turns = posture(chain_of(cell), readings.q).flange
    return np.einsum("iam,i->ma", turns, vector) @ pose


FAULTS = ("tracker_moved", "target_moved", "outlier_readings", "noise_understated")


def with_fault(readings: Readings, cell: Cell, kind: str, size: float = 1.0) -> Readings:
    """Return readings with a tracker or target that moved by 2.3 mm, an outlier of 3 m or 0.1 mm of noise."""
    later = (readings.configuration > 9)[:, None]
    shift = (2e-3, -1e-3, 6e-4)
    added = {
        "tracker_moved": later * np.array(shift),
        "target_moved": later * (readings.point == 1)[:, None] * in_flange_axes(readings, cell, shift),
        "outlier_readings": (np.arange(len(readings)) == 40)[:, None] * np.array([3.0, 0.0, 0.0]),
        "noise_understated": 1e-4 * np.random.default_rng(1).standard_normal((len(readings), 3)),
    }[kind]
    return dataclasses.replace(readings, position=readings.position + size * added)


@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_of_the_simulation_is_its_own(cell: Cell, recorded: Readings, simulated: Readings, kind: str) -> None:
    found = compare_checked(recorded, with_fault(simulated, cell, kind), cell)
    (fault,) = found.differences
    assert (fault.kind, fault.side, fault.spoils) == (kind, "simulation", False)
    assert fault.text.startswith("In the simulation, ")
    assert fault.text.endswith("not compared.") is kind.endswith("moved")
    assert fault.text in found.sentences
    assert not found.recording_spoiled
    clean = compare(recorded, simulated, cell)
    assert found.steps is not None
    assert clean.steps is not None
    assert found.steps.slope == pytest.approx(1.15, abs=0.02)
    assert found.steps.noise == pytest.approx(1.02e-4 if kind == "noise_understated" else clean.steps.noise, rel=0.1)


@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_of_the_simulation_changes_nothing_in_what_is_said_of_the_recording(
    cell: Cell, recorded: Readings, simulated: Readings, alone: Diagnosis, kind: str
) -> None:
    beside = diagnose(recorded, cell, simulation=with_fault(simulated, cell, kind, 10.0))
    assert (beside.verdict, beside.findings, beside.anomalies) == (alone.verdict, alone.findings, alone.anomalies)
    np.testing.assert_array_equal(beside.compliance, alone.compliance)
    assert [d.side for d in beside.comparisons[0].differences] == ["simulation"]


@pytest.mark.parametrize("share", [0.1, 1.0])
def test_physics_of_a_simulation_is_no_fault(cell: Cell, recorded: Readings, simulated: Readings, share: float) -> None:
    assert recorded.wrench is not None
    bent = simulated.position - by_model(dataclasses.replace(simulated, wrench=0 * recorded.wrench), cell).position
    more = share * bent * (simulated.step > 2)[:, None]  # bends farther when the load goes down
    found = compare_checked(recorded, dataclasses.replace(simulated, position=simulated.position + more), cell)
    assert found.differences == ()
    assert found.readings == len(recorded)


@pytest.mark.parametrize("points", ["absolute", "displacement"])
def test_a_gross_error_of_a_simulation_of_one_point(
    tmp_path: Path, recorded: Readings, simulated: Readings, points: str
) -> None:
    cell = write_cell(tmp_path, measurements={"points": points})
    ours, theirs = (readings.select(readings.point == 0) for readings in (recorded, simulated))
    if points == "displacement":
        ours, theirs = (dataclasses.replace(r, position=from_step_zero(r, r.position)) for r in (ours, theirs))
    position = theirs.position + 0.05 * (np.arange(len(theirs)) == 22)[:, None]
    found = compare_checked(ours, dataclasses.replace(theirs, position=position), cell)
    assert [(d.kind, d.side) for d in found.differences] == [("outlier_readings", "simulation")]
    assert found.steps is not None
    assert found.steps.slope == pytest.approx(1.15, abs=0.03)


def test_a_simulation_too_small_to_be_searched_is_compared_all_the_same(cell: Cell, recorded: Readings) -> None:
    still = dataclasses.replace(recorded.select((recorded.step == 0) & (recorded.configuration <= 2)), wrench=None)
    found = compare_checked(still, by_model(still, cell), cell)
    assert found.steps is not None
    assert any(s.startswith("The simulation cannot be searched for faults of its own: ") for s in found.sentences)


@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_of_a_simulation_at_rest_is_its_own(cell: Cell, kind: str) -> None:
    whole = loaded_readings(cell, 5, 40)
    still = dataclasses.replace(whole.select(whole.step == 0), wrench=None)
    exact = by_model(still, cell)
    found = compare_checked(still, with_fault(exact, cell, kind), cell)
    assert [(d.kind, d.side) for d in found.differences] == [(kind, "simulation")]
    plain = compare_checked(still, exact, cell)
    assert plain.differences == ()
    assert found.steps is not None
    assert plain.steps is not None
    if kind != "noise_understated":
        assert found.steps.rms < 1.3 * plain.steps.rms


def mixed_pair(cell: Cell) -> tuple[Readings, Readings]:
    """Return a recording of 14 loaded configurations and 10 postures at rest, and what the cell file says of it."""
    whole = loaded_readings(cell, 4, 24)
    mixed = whole.select((whole.configuration <= 14) | (whole.step == 0))
    return mixed, by_model(mixed, cell)


def test_postures_at_rest_beside_loaded_configurations_are_compared(cell: Cell) -> None:
    recorded, simulated = mixed_pair(cell)
    plain = compare(recorded, simulated, cell)
    assert plain.steps is not None
    assert plain.postures is not None
    assert [len(one.by_configuration) for one in (plain.steps, plain.postures)] == [14, 10]
    assert plain.steps.slope == pytest.approx(1.15, abs=0.02)
    loaded = recorded.configuration <= 14
    alone = compare(recorded.select(loaded), simulated.select(loaded), cell)
    assert alone.postures is None
    assert alone.steps is not None
    assert plain.steps.rms == pytest.approx(alone.steps.rms, rel=1e-6)  # not thinned by postures that do not bend
    geometry = np.zeros((6, 6))
    geometry[2, 5] = 1e-3
    other = compare(recorded, by_model(simulated, cell, geometry=geometry), cell)
    assert other.postures is not None
    assert other.postures.rms > 3 * plain.postures.rms
    assert any("10 common configurations with one step" in sentence for sentence in other.sentences)


def test_postures_at_rest_are_compared_in_the_frame_that_fits_them(cell: Cell) -> None:
    recorded, simulated = mixed_pair(cell)
    pose = pose_matrix(np.array([1.0, 2.0, -0.5]), np.array([0.1, 0.2, 1.5]))
    turned = dataclasses.replace(simulated, position=simulated.position @ pose[:3, :3].T + pose[:3, 3])
    plain, found = (compare(recorded, one, cell).postures for one in (simulated, turned))
    assert plain is not None
    assert found is not None
    assert found.rms == pytest.approx(plain.rms, rel=1e-6)


def test_what_the_cell_file_alone_leaves_open_its_check_decides(cell: Cell, recorded: Readings) -> None:
    without = cell.model_copy(update={"robot": cell.robot.model_copy(update={"stiffness": None})})
    simulated = by_model(recorded, cell)
    turned = dataclasses.replace(simulated, wrench=-np.array(simulated.wrench))
    assert kinds(recorded, turned, without) == {"wrench_sign": "simulation"}
    assert kinds(turned, recorded, without) == {"wrench_sign": "recording"}
    heavier = dataclasses.replace(simulated, wrench=9.80665 * np.array(simulated.wrench))
    open_still = compare(recorded, heavier, without)
    assert [(d.kind, d.side) for d in open_still.differences] == [("wrench_unit", "either")]
    assert open_still.recording_spoiled
    assert any(s.endswith("disagrees with the cell file cannot be determined.") for s in open_still.sentences)


def test_positions_without_loads_are_compared_too(cell: Cell, recorded: Readings) -> None:
    still = dataclasses.replace(recorded.select(recorded.step == 0), wrench=None)
    geometry = np.zeros((6, 6))
    geometry[2, 5] = 1e-3
    found = compare(still, by_model(still, cell, geometry=geometry), cell)
    assert found.differences == ()
    assert found.steps is not None
    assert np.isnan(found.steps.slope)
    assert found.steps.rms > 1e-4
    assert not found.reproduction.reproduced


def test_no_physics_is_claimed_of_a_recording_that_is_mixed_up(
    cell: Cell, recorded: Readings, simulated: Readings
) -> None:
    off = dataclasses.replace(recorded, wrench=-np.array(recorded.wrench))
    found = diagnose(off, cell, simulation=simulated)
    assert (found.verdict, found.findings) == ("unexplained", ())
    assert [(a.kind, dict(a.further)) for a in found.anomalies][:1] == [("wrench_sign", {"factor": -1.0})]
    assert found.anomalies[0].remedy == "turn the sign of all forces and torques"
    good = diagnose(recorded, cell, simulation=dataclasses.replace(simulated, wrench=-np.array(simulated.wrench)))
    assert (good.verdict, good.anomalies) == ("consistent", ())
    assert good.held_out_after == pytest.approx(good.noise, rel=0.2)
    (compared,) = good.comparisons
    assert Path(compared.simulation).name == "simulated.csv"


# --- a simulation with another tool, with noise, or mixed up: what is said of it is true ------------------------------


@pytest.mark.parametrize("which", [("mp1", "mp2", "mp3"), ("mp2",)])
def test_another_tool_is_no_other_robot(
    cell: Cell, recorded: Readings, simulated: Readings, which: tuple[str, ...]
) -> None:
    points = dict(nominal_parameters(cell).points)
    points |= {name: points[name] + [0.02, 0.0, 0.015] for name in which}
    found = compare(recorded, by_model(simulated, cell, points=points), cell)
    assert [(d.kind, d.side) for d in found.differences] == [("points", "simulation")]
    (difference,) = found.differences
    assert difference.location == {"point": ", ".join(which)}
    assert difference.magnitude == pytest.approx(0.025, rel=0.1)
    plain = compare(recorded, simulated, cell)
    assert found.steps is not None
    assert plain.steps is not None
    assert found.steps.rms == pytest.approx(plain.steps.rms, rel=0.2)


def test_noise_of_a_simulation_is_no_physics_of_it(cell: Cell, recorded: Readings, simulated: Readings) -> None:
    noise = 6e-5 * np.random.default_rng(5).standard_normal(simulated.position.shape)
    found = compare_checked(recorded, dataclasses.replace(simulated, position=simulated.position + noise), cell)
    assert [d.kind for d in found.differences] == ["noise_understated"]
    assert found.reproduction.reproduced
    assert "to the noise seen in it" in found.sentences[0]
