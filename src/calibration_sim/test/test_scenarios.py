"""The grid, and what becomes of a scenario."""

from __future__ import annotations

import collections
import dataclasses
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import load_cell
from calibration_core.files.yaml_file import yaml_text
from calibration_core.recording.tables.table import read_table, write_table
from calibration_sim.cell.truth import draw_truth
from calibration_sim.effects import GENERATORS
from calibration_sim.effects.draw import MAGNITUDES, ROBOTS, Draw, robot_cell
from calibration_sim.scenarios.generate import generate
from calibration_sim.scenarios.grid import ALIAS_SNR, AMPLITUDES, SINGLES, Scenario, grid, recording_name, sample
from calibration_sim.scenarios.influence import background, signal, softer
from calibration_sim.scenarios.measure import Noise, lagging_sensor, look
from calibration_sim.scenarios.protocols import KINDS, make_protocol, points_of
from calibration_sim.scenarios.world import World, play


def test_the_grid_is_the_one_that_is_promised() -> None:
    scenarios = grid(1)
    groups = collections.Counter(s.group for s in scenarios)
    assert groups["single"] == 480
    assert groups["nothing"] + groups["clutter"] == 200
    assert 60 <= groups["clutter"] <= 70
    assert {k: groups[k] for k in ("pair", "triple", "outside", "alias")} == {
        "pair": 150,
        "triple": 50,
        "outside": 90,
        "alias": 30,
    }
    cells = collections.Counter(
        (s.planned[0].name, s.planned[0].amplitude, s.robot, s.protocol[0]) for s in scenarios if s.group == "single"
    )
    assert len(cells) == len(SINGLES) * len(AMPLITUDES) * len(ROBOTS) * 2
    assert set(cells.values()) == {2}
    assert len(SINGLES) == 20
    assert all(0.7 <= s.noise.factor <= 1.5 for s in scenarios)
    assert len({s.seed for s in scenarios}) == len(scenarios)


def test_names_are_unique_and_do_not_follow_the_order() -> None:
    scenarios = grid(1)
    names = [recording_name(s, len(scenarios)) for s in scenarios]
    assert len(set(names)) == len(names)
    assert abs(float(np.corrcoef(np.arange(len(names)), np.argsort(np.argsort(names)))[0, 1])) < 0.1


def test_samples_are_subsets_in_order() -> None:
    scenarios = grid(1)
    some = sample(scenarios, 60)
    assert len(some) == 60
    assert [s.number for s in some] == sorted({s.number for s in some})
    assert len({s.group for s in some}) >= 6
    assert set(sample(scenarios, 20)) < set(some)
    assert {s.group for s in sample(scenarios, None, ["alias", "pair"])} == {"alias", "pair"}
    assert all(s.planned[0].name == "creep" for s in sample(scenarios, 5, ["creep"]))


def _one(group: str, **changes: object) -> Scenario:
    return dataclasses.replace(next(s for s in grid(2) if s.group == group), **changes)  # type: ignore[arg-type]


def test_a_recording_is_reproduced_to_the_bit_and_read_by_the_core(tmp_path: Path) -> None:
    scenario = _one("pair")
    first, again = generate(scenario), generate(scenario)
    assert np.array_equal(first.readings.position, again.readings.position)
    assert first.label == again.label
    write_table(tmp_path / "measurements.csv", first.readings)
    (tmp_path / "cell.yaml").write_text(yaml_text(first.cell))
    cell = load_cell(tmp_path / "cell.yaml")
    back = read_table(tmp_path / "measurements.csv", cell)
    assert np.array_equal(back.position, first.readings.position)
    assert all(snr >= 12.0 * 0.95 for snr in first.label["snr"])
    assert len(first.label["effects"]) == 2


def test_the_truth_differs_from_the_file_as_promised() -> None:
    made = [generate(dataclasses.replace(_one("nothing"), seed=seed)) for seed in range(12)]
    stated = np.array(robot_cell(made[0].label["robot"]).robot.stiffness)
    ratio = np.log(np.array([m.label["stiffness"] for m in made]) / stated)
    assert float(np.std(ratio)) == pytest.approx(0.15, rel=0.25)
    assert all(m.label["effects"] == [] for m in made)


def test_outside_and_alias_effects_are_scaled_to_be_seen() -> None:
    outside = _one("outside")
    assert generate(outside).label["snr"][0] == pytest.approx(outside.planned[0].snr, rel=0.15)
    assert generate(_one("alias")).label["snr"][0] == pytest.approx(ALIAS_SNR, rel=0.15)


def test_absolute_recordings_have_no_load_and_no_sensor() -> None:
    made = generate(next(s for s in grid(2) if s.protocol == "A"))
    assert made.readings.wrench is None
    assert "wrench_point" not in made.cell["frames"]
    assert len(np.unique(made.readings.configuration)) == len(made.readings) // 3 == 60


@pytest.mark.parametrize("kind", KINDS)
def test_protocols(kind: str) -> None:
    cell = robot_cell("heavy")
    protocol = make_protocol(cell, kind, 1)
    steps = [len(c.wrenches) for c in protocol.configurations]
    expected = {"L": [9] * 18, "R": [17] * 18, "W": [4] * 18, "S": [2] * 12, "A": [1] * 60}
    assert steps == expected.get(kind, expected[kind[0]] + [1] * 36)
    assert [c.number for c in protocol.configurations] == list(range(1, len(steps) + 1))
    assert len(points_of(cell, kind)) == (1 if kind in {"W", "S"} else 3)


@pytest.mark.parametrize("robot", ROBOTS)
def test_points_follow_a_softer_joint_as_the_difference_of_two_played_worlds(robot: str) -> None:
    cell = robot_cell(robot)
    world, protocol, share = World(cell, draw_truth(cell, 5)), make_protocol(cell, "RA", 5), 1e-3
    played = play(world, protocol)
    columns = softer(world, protocol, played)
    for joint, column in enumerate(columns.T):
        stiffness = np.array(world.truth.stiffness)
        stiffness[joint] /= 1.0 + share
        other = dataclasses.replace(world, truth=dataclasses.replace(world.truth, stiffness=stiffness))
        difference = (play(other, protocol).points - played.points).ravel() / share
        assert np.linalg.norm(column - difference) < 1e-5 * np.linalg.norm(difference)


def test_a_joint_law_besides_the_springs_is_no_derivative_of_their_balance() -> None:
    cell = robot_cell("light")
    draw = Draw(MAGNITUDES["light"], np.array(cell.robot.stiffness), 1.0, np.random.default_rng(0), 2, plain=True)
    world, protocol = World(cell, draw_truth(cell, 5)), make_protocol(cell, "L", 5)
    world = world.with_effects(GENERATORS["nonlinear_stiffness"](draw))
    with pytest.raises(ValueError, match="not balanced by springs, weight and wrench"):
        softer(world, protocol, play(world, protocol))


def test_the_robot_is_left_as_it_rests_where_instruments_and_frames_alone_differ() -> None:
    cell = robot_cell("middle")
    world, protocol = World(cell, draw_truth(cell, 7), (lagging_sensor(cell),)), make_protocol(cell, "LA", 7)
    known, left = background(world, protocol, 1e-5), set()
    for name in SINGLES:
        rng = np.random.default_rng(1)
        effect = GENERATORS[name](Draw(MAGNITUDES["middle"], np.array(cell.robot.stiffness), 1.0, rng))
        if not world.with_effects(effect).rests_like(world):
            continue
        left.add(name)
        again, anew = known.with_effects(effect), play(world.with_effects(effect), protocol)
        for part in ("points", "wrench", "torque"):
            np.testing.assert_array_equal(getattr(again, part), getattr(anew, part))
    frames = {"tracker_frame_misalignment", "measurement_point_offset", "wrench_frame_misalignment"}
    assert left == {"wrench_gain", "wrench_crosstalk", "wrench_point_offset", *frames}


@pytest.mark.parametrize(("one", "other"), [(2, 3), (4, 5), (0, None)])
def test_exact_aliases_cannot_be_told_apart(one: int, other: int | None) -> None:
    """What one explains of the other, amplitude fitted, leaves less than five nats at the scenarios' loudness."""
    for robot in ROBOTS if one != 2 else ("heavy",):
        cell = robot_cell(robot)
        world, protocol = World(cell, draw_truth(cell, 3)), make_protocol(cell, "R", 3)
        known = background(world, protocol, 2e-5)

        def column(name: str, place: int | None) -> np.ndarray:
            stiffness = np.array(robot_cell(robot).robot.stiffness)  # noqa: B023
            draw = Draw(MAGNITUDES[robot], stiffness, 1.0, np.random.default_rng(0), place, plain=True)  # noqa: B023
            return signal(known, play(world.with_effects(GENERATORS[name](draw)), protocol))  # noqa: B023

        a = column("off_axis_compliance", one)
        b = column("base_compliance", None) if other is None else column("off_axis_compliance", other)
        a = a * ALIAS_SNR / np.linalg.norm(a)
        rest = a - b * float(a @ b) / float(b @ b)
        assert np.linalg.norm(rest) < np.sqrt(2.0 * 5.0)


def test_fifty_small_effects_are_as_loud_as_asked() -> None:
    """Together fifty effects of equal loudness add up in squares, within what the few that are capped leave."""
    scenario = next(s for s in grid(2) if s.group == "clutter" and s.clutter == 3.0 and s.protocol == "L")
    made = generate(scenario)
    cell = robot_cell(scenario.robot)
    without = generate(dataclasses.replace(scenario, clutter=0.0, group="nothing"))
    change = made.readings.position - without.readings.position
    sigma = float(cell.instruments.tracker.sigma or 0.0)
    steps = change.reshape(18, 9, 3, 3)
    loud = float(np.linalg.norm((steps - steps.mean(axis=1, keepdims=True)) / sigma))
    assert loud > 3.0 * np.sqrt(50.0) * 0.4


@pytest.mark.parametrize("correlated", [False, True])
def test_tracker_noise_is_spherical_and_as_large_as_claimed(correlated: bool) -> None:
    cell = robot_cell("heavy")
    world, protocol = World(cell, draw_truth(cell, 0)), make_protocol(cell, "L", 0)
    played = play(world, protocol)
    names = points_of(cell, "L")
    noise = Noise(correlated=correlated)
    errors = np.array([look(world, played, names, noise, seed).position for seed in range(40)])
    errors = errors - played.points.reshape(-1, 3)
    sigma = float(cell.instruments.tracker.sigma or 0.0)
    assert float(np.sqrt(np.mean(errors**2))) == pytest.approx(sigma, rel=0.05)
    sight = played.points.reshape(-1, 3)
    sight = sight / np.linalg.norm(sight, axis=1, keepdims=True)
    along = np.einsum("kij,ij->ki", errors, sight)
    assert float(np.std(along)) == pytest.approx(0.5 * sigma, rel=0.05)
    steps = along.reshape(40, -1, 3)
    shared = float(np.mean(steps[:, :, 0] * steps[:, :, 1]) / np.mean(steps**2))
    assert shared == pytest.approx(0.5 if correlated else 0.0, abs=0.05)
