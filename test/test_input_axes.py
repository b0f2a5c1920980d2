"""Axes of wrenches and of displacements that are not those of the cell file are named, and what takes them back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from input_cases import CELL, REAL, ROOT, Change, columns, deflections, in_other_axes, left_handed
from scipy.spatial.transform import Rotation

from calibration_core.cell import Cell, Pose, load_cell
from calibration_core.files.yaml_file import yaml_text
from calibration_core.input_checks.check import check_inputs
from calibration_core.observations.observe import observe
from calibration_core.timeseries import Readings
from calibration_sim.scenarios.generate import generate
from calibration_sim.scenarios.grid import Scenario
from calibration_sim.scenarios.measure import Noise


@pytest.fixture(scope="module")
def good() -> tuple[Readings, Cell]:
    cell = load_cell(CELL)
    return observe(ROOT / "bags" / "small_loaded", cell), cell


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (columns((2, 1, 0, 3, 4, 5)), "the axes of the forces are z, y, x of"),
        (columns((0, 2, 1, 3, 4, 5)), "the axes of the forces are x, z, y of"),
        (columns((1, 2, 0, 3, 4, 5)), "the axes of the forces are z, x, y of"),
        (columns((1, 0, 2, 4, 3, 5)), "the axes of the wrench are y, x, z of"),
        (columns((0, 1, 2, 3, 4, 5), (-1, 1, 1, 1, 1, 1)), "the axes of the forces are -x, y, z of"),
        (columns((0, 1, 2, 3, 4, 5), (1, -1, 1, 1, -1, 1)), "the axes of the wrench are x, -y, z of"),
        (columns((0, 1, 2, 3, 4, 5), (1, -1, 1, -1, 1, -1)), "the axes of the wrench are x, -y, z of"),
    ],
)
def test_columns_of_the_wrench_that_are_exchanged_or_turned_are_named(
    good: tuple[Readings, Cell], change: Change, words: str
) -> None:
    """They had been called another unit, another robot, or nothing at all."""
    (found,) = check_inputs(*change(*good))
    assert found.kind == "wrench_frame"
    assert words in found.text


def test_axes_of_the_torques_alone_are_named(tmp_path: Path) -> None:
    noise = Noise(1.0, False, 0.0, spherical_claim=False)
    played = generate(Scenario(0, "nothing", "light", "L", 780, (), 0.0, noise))
    (tmp_path / "cell.yaml").write_text(yaml_text(played.cell), encoding="utf-8")
    recorded = played.readings, load_cell(tmp_path / "cell.yaml")
    assert check_inputs(*recorded) == ()
    for order, signs, axes in (
        ((0, 1, 2, 5, 4, 3), (1,) * 6, "z, y, x"),
        ((0, 1, 2, 4, 3, 5), (1,) * 6, "y, x, z"),
        ((0, 1, 2, 3, 4, 5), (1, 1, 1, 1, -1, 1), "x, -y, z"),
        ((0, 1, 2, 3, 4, 5), (1, 1, 1, -1, -1, -1), "-x, -y, -z"),
    ):
        (found,) = check_inputs(*columns(order, signs)(*recorded))
        assert (found.kind, found.axes) == ("wrench_frame", axes)
        assert f"the axes of the torques are {axes} of the recorded ones" in found.text


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_displacements_in_other_axes_are_named(good: tuple[Readings, Cell], stated: bool, seed: int) -> None:
    """Another robot or a joint's zero is not accused; the stated axes heal it."""
    readings, cell = deflections(*good)
    turn = Rotation.random(random_state=seed).as_matrix()
    turned, cell = in_other_axes(readings, cell, turn, stated=stated)
    (found,) = check_inputs(turned, cell)
    assert (found.kind, found.location) == ("no_relation", {"tracker": "tracker"})
    assert "frames.tracker" in found.remedy
    rpy = tuple(map(float, found.axes.removeprefix("rpy [").removesuffix("]").split(",")))
    pose = (cell.frames.tracker or Pose(xyz=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0))).model_copy(update={"rpy": rpy})
    frames = cell.frames.model_copy(update={"tracker": pose})
    assert check_inputs(turned, cell.model_copy(update={"frames": frames})) == ()


@pytest.mark.parametrize("axis", range(3))
def test_mirrored_displacements_are_named(good: tuple[Readings, Cell], axis: int) -> None:
    readings, cell = left_handed(axis)(*deflections(*good))
    (found,) = check_inputs(readings, cell)
    assert (found.kind, found.axes) == ("point_order", f"-{'xyz'[axis]}")
    assert f"turn the sign of {'xyz'[axis]} of all displacements" in found.remedy


def test_mirrored_displacements_in_axes_that_nobody_states(good: tuple[Readings, Cell]) -> None:
    """Which coordinate it is, is not known then; and mirrored displacements may be a wrench of the wrong sign."""
    for axis, kind in ((0, "point_order"), (1, "point_order"), (2, "wrench_sign")):
        (found,) = check_inputs(*left_handed(axis, stated=False)(*deflections(*good)))
        assert (found.kind, found.axes) == (kind, "")


def test_displacements_in_slightly_other_axes_are_left_to_the_diagnosis(good: tuple[Readings, Cell]) -> None:
    readings, cell = deflections(*good)
    turn = Rotation.from_rotvec([0.05, 0.1, -0.08]).as_matrix()
    assert check_inputs(*in_other_axes(readings, cell, turn, stated=True)) == ()


@pytest.mark.skipif(not REAL.is_dir(), reason="the real recordings are not beside the project")
def test_real_displacements_in_other_axes_are_named() -> None:
    cell = load_cell(REAL / "fanuc.cell.yaml")
    readings = observe(REAL / "fanuc.csv", cell)
    for seed in range(3):
        turn = Rotation.random(random_state=seed).as_matrix()
        for mirror, kind in ((np.eye(3), "no_relation"), (np.diag([1.0, -1.0, 1.0]), "point_order")):
            found = check_inputs(*in_other_axes(readings, cell, mirror @ turn, stated=True))
            assert [one.kind for one in found] == [kind]
