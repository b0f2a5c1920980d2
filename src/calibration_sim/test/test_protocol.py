"""Plans read from files, and configurations drawn at random."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell
from calibration_core.errors import PlanError
from calibration_core.files.yaml_file import yaml_text
from calibration_sim.cell import configurations
from calibration_sim.cell.configurations import random_protocol
from calibration_sim.cell.protocol import FOUR_STEPS, NINE_STEPS, oblique_direction, pull, rated_force, read_plan
from calibration_sim.mechanics.chain import read_chain
from calibration_sim.mechanics.statics import Mechanism
from calibration_sim.mechanics.transforms import placement

ROW = {"number": 1, "q": [0.1, 0.2, 0.3, 0.4, 0.5, 0.6], "spare": False, "steps": [[0] * 6, [0, 0, -500.0, 0, 0, 0]]}

# A few hundred bytes that nest into 9^10 elements.
BOMB = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 10)
)
BOMB += "configurations: *a9\n"


def _write(folder: Path, content: object) -> Path:
    path = folder / "plan.yaml"
    path.write_text(content if isinstance(content, str) else yaml_text(content))
    return path


def test_a_plan_is_read_in_order_without_spares(demo: Cell, tmp_path: Path) -> None:
    rows = [{**ROW, "number": 5}, {**ROW, "number": 2, "spare": True}, {**ROW, "number": 3, "why": "far away"}]
    protocol = read_plan(_write(tmp_path, {"configurations": rows, "order": [5, 3]}), demo)
    assert [configuration.number for configuration in protocol.configurations] == [5, 3]
    assert protocol.steps == 4
    assert protocol.configurations[1].q.tolist() == ROW["q"]
    assert protocol.configurations[0].wrenches[1].tolist() == [0, 0, -500.0, 0, 0, 0]


@pytest.mark.parametrize(
    ("content", "place"),
    [
        ("configurations: [", ""),
        ({"plans": []}, "configurations"),
        ({"configurations": []}, "configurations"),
        ({"configurations": ["home"]}, "configurations.0"),
        ({"configurations": [{**ROW, "q": [0.0] * 5}]}, "configurations.0.q"),
        ({"configurations": [{**ROW, "q": [0.0] * 5 + [float("nan")]}]}, "configurations.0.q"),
        ({"configurations": [{**ROW, "q": [0.0] * 5 + ["east"]}]}, "configurations.0.q"),
        ({"configurations": [{**ROW, "steps": []}]}, "configurations.0.steps"),
        ({"configurations": [{**ROW, "steps": [[0.0] * 3]}]}, "configurations.0.steps.0"),
        ({"configurations": [{**ROW, "number": "one"}]}, "configurations.0.number"),
        ({"configurations": [ROW, ROW]}, "configurations.1.number"),
        ({"configurations": [{**ROW, "spare": True}]}, "configurations"),
        (BOMB, ""),
    ],
)
def test_faults_of_a_plan_are_named(demo: Cell, tmp_path: Path, content: object, place: str) -> None:
    with pytest.raises(PlanError) as caught:
        read_plan(_write(tmp_path, content), demo)
    assert caught.value.place.startswith(place)
    assert "plan.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_plan_is_named(demo: Cell, tmp_path: Path) -> None:
    with pytest.raises(PlanError, match=r"none\.yaml"):
        read_plan(tmp_path / "none.yaml", demo)


def test_pulls_follow_their_levels() -> None:
    wrenches = pull([0.0, 3.0, -4.0], 1000.0, NINE_STEPS)
    assert wrenches.shape == (9, 6)
    assert wrenches[4] == pytest.approx([0.0, 600.0, -800.0, 0.0, 0.0, 0.0])
    assert np.array_equal(wrenches[1], wrenches[7])
    assert not wrenches[[0, 8]].any()


@pytest.mark.parametrize("gravity", [[0, 0, -9.8], [9.8, 0, 0], [3.0, -4.0, 2.0]])
def test_oblique_pulls_point_down_and_aside(gravity: list[float]) -> None:
    rng = np.random.default_rng(0)
    down = np.array(gravity) / np.linalg.norm(gravity)
    directions = np.array([oblique_direction(rng, gravity) for _ in range(200)])
    tilt = np.degrees(np.arccos(directions @ down))
    assert np.linalg.norm(directions, axis=1) == pytest.approx(1.0)
    assert 25.0 <= tilt.min() < 30.0
    assert 60.0 < tilt.max() <= 65.0


@pytest.mark.parametrize("name", ["demo", "small"])
def test_random_configurations_could_be_measured(name: str, request: pytest.FixtureRequest) -> None:
    cell: Cell = request.getfixturevalue(name)
    chain = read_chain(cell)
    protocol = random_protocol(cell, 18, 4, levels=FOUR_STEPS)
    q = np.array([configuration.q for configuration in protocol.configurations])
    assert [configuration.number for configuration in protocol.configurations] == list(range(1, 19))
    assert np.all(q > chain.limits[:, 0])
    assert np.all(q < chain.limits[:, 1])
    forces = np.array(
        [np.linalg.norm(configuration.wrenches[:, :3], axis=1) for configuration in protocol.configurations]
    )
    assert forces.max() == pytest.approx(rated_force(cell))
    assert np.all(forces <= rated_force(cell) * (1 + 1e-12))
    mechanism = Mechanism(chain, np.ones(6), cell.gravity)
    points = np.array(list(cell.frames.measurement_points.values()))
    tracker = placement(cell.frames.tracker)
    for angles in q:
        seen = mechanism.forward(angles).apply(points)
        assert np.all(seen[:, 2] > 0.0)
        in_front = tracker.inverse_apply(seen)
        assert np.all(in_front[:, 0] > 0.5)
        assert np.linalg.svd(mechanism.jacobian(angles), compute_uv=False)[-1] > 0.02
    gaps = np.linalg.norm(q[:, None] - q[None], axis=2)[np.triu_indices(18, 1)]
    assert gaps.min() > 0.5


def test_protocols_follow_their_seed(demo: Cell) -> None:
    first, again, other = (random_protocol(demo, 3, seed).configurations for seed in (1, 1, 2))
    assert all(
        np.array_equal(a.q, b.q) and np.array_equal(a.wrenches, b.wrenches) for a, b in zip(first, again, strict=True)
    )
    assert not any(np.array_equal(a.q, b.q) for a, b in zip(first, other, strict=True))


def test_a_cell_that_sees_nothing_is_refused(demo: Cell, changed: Callable[..., Cell]) -> None:
    narrow = changed(
        demo, robot__joint_limits=[[-0.01, 0.01], [-0.01, 0.01], [-1.58, -1.57], [-1, 1], [-1, 1], [-1, 1]]
    )
    with pytest.raises(PlanError, match="0 configurations"):
        random_protocol(narrow, 2, 0)


def test_configurations_do_not_depend_on_how_many_are_looked_at_together(
    demo: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not only the configurations: the directions of the pulls are drawn from the same numbers after them."""
    together = random_protocol(demo, 12, 5)
    monkeypatch.setattr(configurations, "BLOCK", 1)
    for one, other in zip(together.configurations, random_protocol(demo, 12, 5).configurations, strict=True):
        np.testing.assert_array_equal(one.q, other.q)
        np.testing.assert_array_equal(one.wrenches, other.wrenches)
