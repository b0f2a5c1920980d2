"""The second grid: own weight beside loads, laws of other shapes, other robots and names."""

from __future__ import annotations

import collections
import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration_core.cell import load_cell
from calibration_core.recording.tables.table import read_table, write_table
from calibration_sim.cell.truth import draw_truth
from calibration_sim.effects import CATALOGUE, EVERYWHERE, OTHER_SHAPES
from calibration_sim.effects.draw import MAGNITUDES, MORE_ROBOTS, Draw, robot_cell
from calibration_sim.effects.effect import At, Effect, Label
from calibration_sim.effects.joints import JointLaw
from calibration_sim.effects.other_shapes import (
    Sliding,
    opening,
    soft_flank,
    softer_beyond,
    to_the_power,
    wave,
)
from calibration_sim.effects.structure import Base, Beam, Bearing, Tool, coupling, waving
from calibration_sim.scenarios.generate import generate
from calibration_sim.scenarios.grid import ALL_ROBOTS, LOUDER, SECOND_KINDS, Planned, second_grid
from calibration_sim.scenarios.influence import background, beyond, signal_to_noise
from calibration_sim.scenarios.look_alikes import look_alikes
from calibration_sim.scenarios.names import NAMES, renamed
from calibration_sim.scenarios.protocols import make_protocol
from calibration_sim.scenarios.world import World, play
from calibration_sim.scenarios.yielding import yielding

ANY = Label("structure", "any", {})
GRID = second_grid(3)


def _first(kind: str, **changes: object) -> object:
    return dataclasses.replace(next(s for s in GRID if s.group == kind), **changes)  # type: ignore[arg-type]


def test_the_grid_has_every_kind_robot_and_name_and_at_most_1000_recordings() -> None:
    assert len(GRID) <= 1000
    assert {s.group for s in GRID} == set(SECOND_KINDS)
    assert min(collections.Counter(s.group for s in GRID).values()) >= 26
    assert {s.robot for s in GRID} == {*ALL_ROBOTS, "column"}
    assert {s.names for s in GRID} == set(NAMES)
    assert {p.name for s in GRID for p in s.planned} >= {*OTHER_SHAPES, *EVERYWHERE}
    assert len({s.seed for s in GRID}) == len(GRID)
    assert second_grid(3) == GRID
    assert all(a.seed != b.seed for a, b in zip(GRID, second_grid(4), strict=True))


@pytest.mark.parametrize("robot", MORE_ROBOTS)
def test_a_recording_of_every_robot_is_read_by_the_core(robot: str, tmp_path: Path) -> None:
    scenario = next(s for s in GRID if s.robot == robot and s.group == "mixed")
    made = generate(dataclasses.replace(scenario, protocol="L3A40"))
    write_table(tmp_path / "measurements.csv", made.readings)
    (tmp_path / "cell.yaml").write_text(yaml.safe_dump(made.cell))
    back = read_table(tmp_path / "measurements.csv", load_cell(tmp_path / "cell.yaml"))
    assert np.array_equal(back.position, made.readings.position)
    assert made.label["snr"][0] >= 0.95 * LOUDER
    steps = np.unique(np.column_stack([back.configuration, back.step]), axis=0)
    assert set(np.bincount(steps[:, 0])[1:]) == {1, 9}


def test_names_change_nothing_else() -> None:
    plain = _first("other_robot", names="plain", protocol="L3")
    other = dataclasses.replace(plain, names="odd")  # type: ignore[type-var]
    a, b = generate(plain), generate(other)  # type: ignore[arg-type]
    assert np.array_equal(a.readings.position, b.readings.position)
    assert np.array_equal(a.readings.q, b.readings.q)
    assert a.cell["robot"]["joints"] != b.cell["robot"]["joints"]
    assert tuple(b.cell["frames"]["measurement_points"]) == b.readings.points != a.readings.points
    assert renamed(a.label, "odd") == b.label
    assert "joint_1" not in str(b.label)


def test_gross_errors_do_not_count_as_noise_and_everything_else_does() -> None:
    scenario = _first("nothing_else", protocol="L3")
    seen = []
    for rate in (0.0, 0.05):
        noise = dataclasses.replace(scenario.noise, outlier_rate=rate, outlier_size=5e-3)  # type: ignore[attr-defined]
        seen.append(generate(dataclasses.replace(scenario, noise=noise)).label["noise_seen"])  # type: ignore[type-var]
    assert 0.75 * seen[0] < seen[1] < 1.05 * seen[0]


@pytest.mark.parametrize(
    ("kind", "count"), [("L2A40", (2, 40)), ("A", (0, 60)), ("R9A24", (9, 24)), ("L18A1", (18, 1))]
)
def test_protocols_mix_loads_and_single_steps(kind: str, count: tuple[int, int]) -> None:
    steps = [len(c.wrenches) for c in make_protocol(robot_cell("heavy"), kind, 1).configurations]
    assert (sum(s > 1 for s in steps), sum(s == 1 for s in steps)) == count


@pytest.mark.parametrize("kind", ["", "B", "LL", "5A", "A-1"])
def test_protocols_that_are_none_are_refused(kind: str) -> None:
    with pytest.raises(ValueError, match="protocol"):
        make_protocol(robot_cell("heavy"), kind, 1)


def test_a_first_axis_that_slides_is_counted(tmp_path: Path) -> None:
    plan = (Planned("backlash", 3.0, 0), Planned("joint_coupling", 1.0, 3), Planned("link_bending", 1.0, 1))
    made = generate(_first("prismatic", protocol="L2", planned=plan))  # type: ignore[arg-type]
    write_table(tmp_path / "measurements.csv", made.readings)
    (tmp_path / "cell.yaml").write_text(yaml.safe_dump(made.cell))
    cell = load_cell(tmp_path / "cell.yaml")
    assert read_table(tmp_path / "measurements.csv", cell).q.shape[1] == 7
    assert cell.robot.joint_types is not None
    assert cell.robot.joint_types[0] == "prismatic"
    backlash, coupling, beam = made.label["effects"]
    assert backlash["location"] == {"joint": "joint_2"}
    assert coupling["location"] == {"joints": ["joint_5", "joint_6"]}
    assert beam["location"] == {"link": "link_3"}
    assert backlash["equivalent"] == []


def test_an_effect_farther_out_acts_on_the_joints_that_it_names() -> None:
    draw = Draw(MAGNITUDES["column"], np.full(6, 1e4), 1.0, np.random.default_rng(0), 2)
    law = OTHER_SHAPES["one_sided"](dataclasses.replace(draw, first=1))
    at = At(0, 1, 0, 0.0, 20.0, np.zeros(7), np.zeros(7), np.full(7, 1e-4))
    moved = [float(np.abs(law.deflect(None, sign * np.ones(7), at)).max()) for sign in (-1.0, 1.0)]  # type: ignore[arg-type]
    assert law.label.location == {"joint": "joint_4"}
    assert max(moved) > 0.0
    assert np.flatnonzero(law.deflect(None, np.sign(moved[1] - moved[0]) * np.ones(7), at)).tolist() == [3]  # type: ignore[arg-type]


SMALL = 1e-3  # of the typical size: a spring's first order


@pytest.mark.parametrize("robot", ["heavy", "tiny", "middle"])
def test_columns_are_what_a_small_spring_does(robot: str) -> None:
    """Both weight and load bear on every place, and each column is the simulator's own answer to first order."""
    cell = robot_cell(robot)
    world, protocol = World(cell, draw_truth(cell, 2)), make_protocol(cell, "L2A6", 2)
    known = background(world, protocol, 1e-5)
    size, beam = MAGNITUDES[robot], MAGNITUDES[robot].beams[1]
    c = SMALL * size.bearing
    effects: dict[tuple[str, str], tuple[Effect, list[float]]] = {
        ("off_axis_compliance", "joint_3"): (Bearing(ANY, 2, (c, 2.0 * c)), []),
        ("link_bending", f"link_{beam + 1}"): (Beam(ANY, beam, (c, c), 0.3 * c), []),
        ("base_compliance", "base"): (Base(ANY, (c, 0.5 * c, 0.2 * c), (c, c, 0.0)), []),
        ("tool_compliance", "tool"): (Tool(ANY, (c, 0.0, 0.0), (0.0, c, c)), []),
        ("pose_dependent_stiffness", "joint_2"): (waving(ANY, 1, 1e-4, 2e-4), []),
    }
    pair = ("joint_2", "joint_3")
    blocks = yielding(world, protocol).blocks
    for (effect, place), (law, _) in effects.items():
        ((_, columns),) = [(key, value) for key, value in blocks.items() if key[0] == effect and key[1][0][1] == place]
        moved = (play(world.with_effects(law), protocol).points - known.played.points).ravel()
        best, *_ = np.linalg.lstsq(columns, moved, rcond=None)
        assert np.linalg.norm(moved - columns @ best) < 0.01 * np.linalg.norm(moved), effect
    columns = blocks["joint_coupling", (("joints", pair),)]
    moved = (play(world.with_effects(coupling(ANY, (1, 2), c)), protocol).points - known.played.points).ravel()
    assert columns[:, 0] * c == pytest.approx(moved, abs=0.02 * float(np.abs(moved).max()))


def test_what_looks_alike_is_listed_and_nothing_else() -> None:
    cell = robot_cell("heavy")
    world, protocol = World(cell, draw_truth(cell, 4)), make_protocol(cell, "L9A40", 4)
    known = background(world, protocol, 2e-5, geometry=True)
    blocks = yielding(world, protocol).blocks
    rocking = Base(ANY, (3e-8, 3e-8, 0.0), (0.0, 0.0, 0.0))
    moved = (play(world.with_effects(rocking), protocol).points - known.played.points).reshape(-1, 1)
    alike = look_alikes(known, blocks, beyond(known, moved)[:, 0])
    said = {(item["effect"], *item["location"].values()) for item in alike}
    below = {("off_axis_compliance", "joint_1"), ("base_compliance", "base"), ("link_bending", "link_1")}
    assert said == below  # the first link stands nearly upright on the base


def test_geometry_takes_its_share_of_what_weight_shows() -> None:
    cell = robot_cell("heavy")
    world, protocol = World(cell, draw_truth(cell, 1)), make_protocol(cell, "A", 1)
    draw = Draw(MAGNITUDES["heavy"], np.array(cell.robot.stiffness), 1.0, np.random.default_rng(1), 1)
    played = play(world.with_effects(CATALOGUE["off_axis_compliance"](draw)), protocol)
    free, tied = background(world, protocol, 2e-5, geometry=True), background(world, protocol, 2e-5)
    assert 0.0 < signal_to_noise(free, played) < 0.9 * signal_to_noise(tied, played)


def _walk(law: JointLaw, torques: list[float]) -> list[float]:
    at = At(0, 1, 0, 0.0, 20.0, np.zeros(6), np.zeros(6), np.full(6, 1e-6))
    memory = law.arrive(law.begin(6), at)
    seen = []
    for torque in torques:
        seen.append(law.extra(memory, torque, at))
        memory = law.settle(memory, np.array([torque, 0, 0, 0, 0, 0]), at)
    return seen


def test_wedge_friction_opens_its_loop_with_the_load() -> None:
    law = Sliding(ANY, 0, 100.0, 1, opening(5e-5, 1000.0))
    up = _walk(law, [0.0, 500.0, 1000.0])
    down = _walk(law, [0.0, 1500.0, 1000.0, 500.0])
    assert up[1:] == pytest.approx([-2.5e-5, -5e-5])
    assert down[2:] == pytest.approx([5e-5, 2.5e-5])


def test_dahl_friction_approaches_its_width() -> None:
    law = Sliding(ANY, 0, 200.0, 1, lambda *_: 5e-5, gradual=True)
    seen = _walk(law, [0.0, 2000.0, 1800.0, 0.0])
    assert seen[1] == pytest.approx(-5e-5, rel=1e-3)
    assert seen[2] == pytest.approx(-5e-5 * (2.0 * np.exp(-1.0) - 1.0), rel=1e-3)
    assert seen[3] == pytest.approx(5e-5, rel=1e-3)


def test_uneven_friction_holds_back_more_in_one_direction() -> None:
    law = Sliding(ANY, 0, 200.0, 1, lambda _, state: (5e-5, 2e-5)[state < 0.0])
    assert _walk(law, [0.0, 500.0, 400.0, 300.0, 0.0])[1:] == pytest.approx([-5e-5, -2.5e-5, 0.0, 2e-5], abs=1e-12)


def test_other_knees_and_waves_follow_their_formulas() -> None:
    at = At(0, 1, 0, 0.0, 20.0, np.array([0.4, 0, 0, 0, 0, 0]), np.zeros(6), np.full(6, 1e-6))
    assert to_the_power(0.1, 1000.0, 2.0)(-500.0, 1e-6) == pytest.approx(-0.1 * 1e-3 * 0.25)
    assert softer_beyond(0.5, 300.0)(200.0, 1e-6) == 0.0
    assert softer_beyond(0.5, 300.0)(-500.0, 1e-6) == pytest.approx(-1e-4)
    assert soft_flank(0.2, -1.0)(500.0, 1e-6) == 0.0
    assert soft_flank(0.2, -1.0)(-500.0, 1e-6) == pytest.approx(-1e-4)
    torque = np.array([500.0, 0, 0, 0, 0, 0])
    twice, soft = wave(ANY, 0, 0.1, 2, 0.1), wave(ANY, 0, 0.1, 0, 0.4)
    assert twice.deflect(None, torque, at)[0] == pytest.approx(0.1 * np.sin(0.9) * 5e-4)
    assert soft.deflect(None, torque, at)[0] == pytest.approx(0.1 * 5e-4)


@pytest.mark.parametrize("name", [*OTHER_SHAPES, *EVERYWHERE])
def test_labels_name_the_catalogue(name: str) -> None:
    cell = robot_cell("heavy")
    draw = Draw(MAGNITUDES["heavy"], np.array(cell.robot.stiffness), 1.0, np.random.default_rng(0))
    label = {**OTHER_SHAPES, **EVERYWHERE}[name](draw).label
    assert label.effect in CATALOGUE
    assert (name in OTHER_SHAPES) == bool(label.kinds)
    assert set(label.kinds) <= set(CATALOGUE)
    assert (label.location == {"joints": "all"}) == (name in EVERYWHERE)


@pytest.mark.parametrize("name", EVERYWHERE)
def test_what_every_joint_has_shows_at_every_joint_that_carries(name: str) -> None:
    cell = robot_cell("heavy")
    world, protocol = World(cell, draw_truth(cell, 1)), make_protocol(cell, "L4A9", 1)
    effect = EVERYWHERE[name](Draw(MAGNITUDES["heavy"], np.array(cell.robot.stiffness), 1.0, np.random.default_rng(0)))
    if name == "every_spring":
        softer = effect.change_truth(world.truth).stiffness / world.truth.stiffness
        assert len(set(softer)) == 6
        assert "stiffness" not in effect.change_file({"robot": {"stiffness": [1.0]}})["robot"]
        return
    known = background(world, protocol, 2e-5)
    ratio = signal_to_noise(known, play(world.with_effects(effect), protocol))
    ratios = [signal_to_noise(known, play(world.with_effects(part), protocol)) for part in effect.parts]  # type: ignore[attr-defined]
    assert len(ratios) >= 5
    assert all(own > 1.0 for own in ratios)
    assert ratio > max(ratios)


def test_an_effect_is_drawn_elsewhere_before_its_size_becomes_absurd() -> None:
    """The last joint's bearing carries next to nothing at rest: no recording tells of it."""
    scenario = _first("rest", robot="heavy", planned=(Planned("off_axis_compliance", 1.0, snr=LOUDER, at_least=True),))
    for seed in range(3):
        (effect,) = generate(dataclasses.replace(scenario, seed=seed)).label["effects"]  # type: ignore[type-var]
        assert effect["amplitude"] <= 5.0
        assert effect["location"] != {"joint": "joint_6"}


def test_an_effect_that_no_robot_could_carry_is_drawn_elsewhere() -> None:
    """At the first place that this scenario draws, the clearance that is loud enough leaves the robot without rest."""
    scenario = next(one for one in second_grid(20265) if one.number == 406)
    label = generate(scenario).label
    assert label["effects"][0]["effect"] == "backlash"
    assert label["snr"][0] >= 0.9 * LOUDER
