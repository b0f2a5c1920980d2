"""Sweeps and postures of the phases before the compliance: wide, alone, free and seen, within the limits."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration_core.cell import Cell
from calibration_core.errors import PlanError
from calibration_core.files.yaml_file import yaml_text
from calibration_core.identification.circle_point.joint_axes import single_joint_sweeps, wrist_sweep
from calibration_core.measurement import messages as m
from calibration_core.measurement.messages import Kind, Outcome
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.motion.speed import Monitored
from calibration_core.motion.trajectory import MotionLimits, plan_path
from calibration_core.planning import phases
from calibration_core.planning.feasible.candidates import Ground
from calibration_core.planning.feasible.collision import CollisionModel
from calibration_core.planning.feasible.space import Site, fitness, joint_range
from calibration_core.planning.phases import PhaseRules, PlannedSweep, best_sweep, with_phases
from calibration_core.planning.plans.plan import Plan, PlannedConfiguration
from calibration_core.planning.plans.plan_file import plan_text, read_plan

Started, Plans = Callable[..., Any], Callable[..., Plan]
RULES = PhaseRules()


@pytest.fixture(scope="module", params=["demo_cell", "small_cell"])
def cell(request: pytest.FixtureRequest) -> Cell:
    """Return one robot described by a URDF, one by DH rows."""
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="module")
def planned(cell: Cell) -> tuple[PlannedConfiguration, ...]:
    """Return the standstills of all phases."""
    return phases_of(cell, seed=3)


def phases_of(cell: Cell, rules: PhaseRules | None = None, seed: int = 0) -> tuple[PlannedConfiguration, ...]:
    """Return the phases before a plan that begins at zero."""
    begin = PlannedConfiguration(1, np.zeros(6), np.zeros((1, 6)))
    plan = Plan(cell.robot.name, cell.robot.joints, (begin,), np.empty((0, 6)))
    return with_phases(plan, cell, rules, seed=seed)[0].preparation


def of(planned: tuple[PlannedConfiguration, ...], phase: str) -> np.ndarray:
    return np.array([one.q for one in planned if one.phase == phase])


def test_the_identification_finds_every_sweep(planned: tuple[PlannedConfiguration, ...]) -> None:
    q = np.array([one.q for one in planned])
    point = np.zeros(len(q), dtype=np.int64)
    sweeps = single_joint_sweeps(q, point)
    found = [(sweep.joints[0], len(sweep.rows)) for sweep in sweeps if len(sweep.rows) == RULES.dwells]
    assert found == [(joint, RULES.dwells) for joint in range(6)]
    wrist = wrist_sweep(q, point, (3, 4, 5))[0]
    assert {planned[row].phase for row in wrist.rows} == {"wrist_centre"}
    assert len(wrist.rows) == RULES.wrist_postures


def test_arcs_are_wide_and_within_the_limits(cell: Cell, planned: tuple[PlannedConfiguration, ...]) -> None:
    low, high = joint_range(chain_of(cell), RULES.space)
    q = np.array([one.q for one in planned])
    assert np.all((q >= low - 1e-9) & (q <= high + 1e-9))
    sweeps = np.concatenate([of(planned, "base_frame"), of(planned, "geometry")]).reshape(6, RULES.dwells, 6)
    arcs = np.ptp(sweeps, axis=1)
    assert np.all(np.count_nonzero(arcs > 1e-9, axis=1) == 1)
    assert np.all(np.diag(arcs) >= RULES.least_arc)
    assert np.all(np.diag(arcs) <= RULES.arc + 1e-9)
    assert np.degrees(np.diag(arcs)).mean() > 150


def test_standstills_are_free_and_seen(cell: Cell, planned: tuple[PlannedConfiguration, ...]) -> None:
    site = Site.of(chain_of(cell), nominal_parameters(cell), cell)
    masks = fitness(site, np.array([one.q for one in planned]), RULES.space)
    for name in ("above the floor", "clear of the arm", "in the tracker's sight"):
        assert masks[name].all(), name
    everywhere = fitness(site, of(planned, "points"), RULES.space)
    assert all(mask.all() for mask in everywhere.values())


def test_a_sweep_keeps_to_the_speed(cell: Cell, planned: tuple[PlannedConfiguration, ...]) -> None:
    monitored = Monitored.of(chain_of(cell), nominal_parameters(cell), None)
    swept = of(planned, "base_frame")[: RULES.dwells]
    assert plan_path(monitored, swept[[0, -1]], MotionLimits()).speed_bound <= 0.25


def test_numbers_are_those_of_the_phase(planned: tuple[PlannedConfiguration, ...]) -> None:
    numbers = [one.number for one in planned]
    assert len(set(numbers)) == len(numbers)
    names = ["base_frame", "geometry", "wrist_centre", "points"]
    assert [names[number // 1000 - 1] for number in numbers] == [one.phase for one in planned]
    assert all(one.steps.shape == (1, 6) and not one.steps.any() for one in planned)


def test_the_same_seed_gives_the_same_phases(cell: Cell, planned: tuple[PlannedConfiguration, ...]) -> None:
    again, other = phases_of(cell, seed=3), phases_of(cell, seed=4)
    assert all(np.array_equal(a.q, b.q) for a, b in zip(planned, again, strict=True))
    assert not all(np.array_equal(a.q, b.q) for a, b in zip(planned, other, strict=True))


def test_the_file_keeps_every_digit(cell: Cell, planned: tuple[PlannedConfiguration, ...], tmp_path: Path) -> None:
    one = PlannedConfiguration(1, np.array(planned[-1].q), np.zeros((1, 6)))
    plan = Plan(cell.robot.name, cell.robot.joints, (one,), np.empty((0, 6)), preparation=planned)
    path = tmp_path / "plan.yaml"
    path.write_text(plan_text(plan))
    back = read_plan(path, cell).preparation
    assert [(c.number, c.phase) for c in back] == [(c.number, c.phase) for c in planned]
    assert all(np.array_equal(a.q, b.q) for a, b in zip(planned, back, strict=True))


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"phase": "lunch"}, "preparation.0.phase"),
        ({"number": 1}, "preparation.0.number"),
        ({"number": -3}, "preparation.0.number"),
        ({"q": [9.0] * 6}, "preparation.0.q.0"),
        ({"speed": 1.0}, "preparation.0.speed"),
    ],
)
def test_a_phase_that_cannot_be_used_is_refused(
    demo_cell: Cell, tmp_path: Path, change: dict[str, object], place: str
) -> None:
    content = {
        "configurations": [{"q": [0.0] * 6, "steps": [[0.0] * 6]}],
        "preparation": [{"number": 1001, "phase": "base_frame", "q": [0.0] * 6} | change],
    }
    path = tmp_path / "plan.yaml"
    path.write_text(yaml_text(content))
    with pytest.raises(PlanError) as error:
        read_plan(path, demo_cell)
    assert error.value.place == place


def test_a_joint_that_cannot_turn_is_named(demo_cell: Cell) -> None:
    with pytest.raises(PlanError, match="joint_1"):
        phases_of(demo_cell, PhaseRules(least_arc=np.radians(359.0), arc=np.radians(359.5)))
    site = Site.of(chain_of(demo_cell), nominal_parameters(demo_cell), demo_cell)
    far = dataclasses.replace(site, tracker=np.array([1e3, 0.0, 0.0]))
    blind = CollisionModel.of(demo_cell, far, RULES.space)
    with pytest.raises(PlanError, match="while the arm stands"):
        phases._wrist(Ground(demo_cell, far, blind, RULES.space), RULES, np.random.default_rng(1), None)
    with pytest.raises(PlanError, match=r"7\.5"):
        phases_of(demo_cell, PhaseRules(space=dataclasses.replace(RULES.space, dexterity=0.9)))


def test_the_wider_arc_is_taken_before_the_larger_circle(demo_cell: Cell) -> None:
    """Joint 6 turns the points on one and the same circle wherever the arm stands: the full arc is to be had."""
    site = Site.of(chain_of(demo_cell), nominal_parameters(demo_cell), demo_cell)
    bodies = CollisionModel.of(demo_cell, site, RULES.space)
    sweep = best_sweep(bodies, 5, RULES, np.random.default_rng(1))
    assert isinstance(sweep, PlannedSweep)
    assert sweep.arc == pytest.approx(RULES.arc)
    assert np.ptp(sweep.q, axis=0) == pytest.approx([0.0] * 5 + [RULES.arc], abs=1e-12)
    assert best_sweep(bodies, 5, dataclasses.replace(RULES, least_arc=6.0), np.random.default_rng(1)) is None


def test_arcs_and_ways_are_free_of_collisions(cell: Cell, planned: tuple[PlannedConfiguration, ...]) -> None:
    site = Site.of(chain_of(cell), nominal_parameters(cell), cell)
    bodies = CollisionModel.of(cell, site, RULES.space)
    q = np.array([one.q for one in planned])
    assert bodies.clear(q).all()
    assert bodies.seen(q).all()
    unclear = sum(not bodies.clear_way(a, b) for a, b in itertools.pairwise(q))
    assert unclear <= 2  # within a phase none; between two, the plan may have to be led by hand


def some_phases(plan: Plan) -> Plan:
    swept = [(1001, "base_frame"), (1002, "base_frame"), (4001, "points")]
    return dataclasses.replace(
        plan,
        preparation=tuple(
            PlannedConfiguration(number, np.full(3, 0.01 * (number % 1000)), np.zeros((1, 6)), phase=phase)  # type: ignore[arg-type]
            for number, phase in swept
        ),
    )


def test_phases_come_first_and_are_announced(started: Started, plan_of: Plans) -> None:
    world = started(some_phases(plan_of()))
    assert world.run().outcome is Outcome.COMPLETED
    assert world.completed == [1001, 1002, 4001, 1, 2, 3, 4]
    begun = [(one.configuration, one.text) for one in world.records if one.kind is Kind.PHASE]
    assert begun == [(1001, "base_frame"), (4001, "points"), (1, "compliance")]
    kinds = [one.kind for one in world.records]
    last_swept = max(i for i, one in enumerate(world.records) if one.configuration > 1000)
    assert Kind.REFERENCE not in kinds[:last_swept]  # nothing else is measured within a sweep
    assert world.visits == [0, 1, 2]


def test_a_standstill_that_is_not_seen_is_left_out(started: Started, plan_of: Plans) -> None:
    world = started(some_phases(plan_of()))
    for action in ("resume_motion", "gain", "heard", "resume_motion"):
        world.act(action)
    while world.finish is None:
        in_the_way = getattr(world.asked, "configuration", 0) == 1002
        world.act("fail" if in_the_way else "answer" if world.asked is not None else "tick")
    assert world.completed == [1001, 4001, 1, 2, 3, 4]  # and no spare of the compliance took its place
    assert world.sequence.queue.given_up == {1002}
    assert (world.finish.outcome, world.finish.text) == (Outcome.INCOMPLETE, "6 of 7 configurations are measured")


def test_a_resumed_plan_goes_on_within_its_phases(started: Started, plan_of: Plans) -> None:
    world = started(some_phases(plan_of()), completed=frozenset({1001, 1002}), given_up=frozenset())
    assert world.run().outcome is Outcome.COMPLETED
    assert world.completed == [4001, 1, 2, 3, 4]


def test_enough_ends_after_the_configuration_under_way(started: Started, plan_of: Plans) -> None:
    world = started()
    for action in ("resume_motion", "gain", "heard", "resume_motion"):
        world.act(action)
    while len(world.completed) < 2:
        world.act("answer" if world.asked is not None else "tick")
    while getattr(world.asked, "configuration", 0) != 3:
        world.act("answer" if world.asked is not None else "tick")
    world.tell(m.Enough(world.now, "every joint within 5 %"))
    finish = world.run()
    assert world.completed == [1, 2, 3]
    assert (finish.outcome, finish.text) == (Outcome.COMPLETED, "3 of 3 configurations are measured")
    assert Kind.ENOUGH in [one.kind for one in world.records]


def test_enough_before_the_first_configuration_measures_none(started: Started) -> None:
    world = started()
    world.tell(m.Enough(world.now, "known already"))
    assert world.run().outcome is Outcome.COMPLETED
    assert world.completed == []
