"""The cube of ISO 9283 and the places of a task are where is measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell
from calibration_core.errors import PlanError
from calibration_core.model.nominal import nominal_parameters
from calibration_core.planning.feasible.candidates import Ground, brought, places_of
from calibration_core.planning.feasible.operating_space import CUBE_SIDES, iso_cube, read_task
from calibration_core.planning.feasible.space import SpaceRules, joint_range
from calibration_core.planning.loaded import PlanningRules, ground_of, make_plan


@pytest.fixture(scope="module")
def ground(demo_cell: Cell) -> Ground:
    return ground_of(demo_cell, nominal_parameters(demo_cell), SpaceRules(), None)


def test_postures_are_brought_to_places(ground: Ground) -> None:
    low, high = joint_range(ground.site.chain, ground.rules)
    rng = np.random.default_rng(0)
    wanted = places_of(ground.site, rng.uniform(low, high, (200, 6)))
    q = brought(ground.site, rng.uniform(low, high, (200, 6)), wanted, low, high)
    off = np.linalg.norm(places_of(ground.site, q) - wanted, axis=1)
    assert np.mean(off < 2e-3) > 0.5  # others end at a limit or are folded
    assert np.all((q >= low) & (q <= high))


def test_the_cube_is_one_of_the_standard_and_all_of_it_is_measured(demo_cell: Cell, ground: Ground) -> None:
    box = iso_cube(ground)
    sides = np.ptp(np.array(box), axis=1)
    assert sides == pytest.approx(np.full(3, sides[0]))
    assert sides[0] in [pytest.approx(side) for side in CUBE_SIDES]
    plan = make_plan(demo_cell, configurations=12, spares=0.5, rules=PlanningRules(SpaceRules(box=box), postures=300))
    low, high = np.array(box).T
    place = places_of(ground.site, plan.table1()[1])
    assert np.all((place >= low) & (place <= high))
    octant = {tuple(row) for row in (place > (low + high) / 2).tolist()}
    assert len(octant) >= 5  # spread over the cube


def test_a_cube_that_does_not_fit_is_said(ground: Ground) -> None:
    with pytest.raises(PlanError, match="4000 mm"):
        iso_cube(ground, 4.0)


@pytest.mark.parametrize("form", ["xyz", "q", "theta"])
def test_a_task_is_read_in_every_form(tmp_path: Path, ground: Ground, form: str) -> None:
    q = np.array([[0.1, 0.5, 0.2, 0.0, 0.6, 0.0], [0.3, 0.6, 0.1, 0.2, 0.7, 0.1]])
    place = places_of(ground.site, q)
    values = {"xyz": place, "q": q, "theta": np.degrees(q)}[form]
    head = "x,y,z" if form == "xyz" else ",".join(f"{form}{'_' * (form == 'theta')}{i}" for i in range(1, 7))
    rows = [f"{k},{','.join(map(repr, row.tolist()))}" for k, row in enumerate(values)]
    path = tmp_path / "task.csv"
    path.write_text("\n".join([f"No,{head}", *rows]))
    np.testing.assert_allclose(read_task(path, ground), place, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "place", "found"),
    [
        ("a,b\n1,2\n", "line 1", "a,b"),
        ("x,y,z\n", "", "0 rows"),
        ("", "line 1", ""),
        ("x,y,z\n1,2\n", "line 2", "2 fields"),
        ("x,y,z\n1,2,3\n1,wide,3\n", "line 3, y", "wide"),
        ("x,y,z\n1,nan,3\n", "line 2, y", "nan"),
    ],
)
def test_a_faulty_task_gets_one_line(tmp_path: Path, ground: Ground, text: str, place: str, found: str) -> None:
    path = tmp_path / "task.csv"
    path.write_text(text)
    with pytest.raises(PlanError) as caught:
        read_task(path, ground)
    assert caught.value.place == place
    assert found in caught.value.found
    assert "\n" not in str(caught.value)


def test_a_plan_of_a_task_stays_near_it(demo_cell: Cell, ground: Ground) -> None:
    task = places_of(ground.site, np.array([[0.1, 0.5, 0.2, 0.0, 0.6, 0.0], [0.8, 0.4, 0.1, 0.2, 0.7, 0.1]]))
    rules = PlanningRules(SpaceRules(task_radius=0.2), postures=300)
    plan = make_plan(demo_cell, configurations=12, spares=0.0, rules=rules, task=task)
    place = places_of(ground.site, plan.table1()[1])
    assert np.linalg.norm(place[:, None] - task[None], axis=2).min(axis=1).max() <= 0.2 + 1e-9
