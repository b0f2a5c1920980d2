"""Which parameters are chosen, what hides the others, and that the stated combinations are indeed invisible."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from absolute_cases import ELBOW, POINTS, SEVEN, make_cell, make_problem, make_readings, random_angles, truth_of

from calibration_core.cell import Cell
from calibration_core.identification.geometry.fit import AbsoluteProblem, normal_equations
from calibration_core.identification.geometry.identifiability import (
    ParameterSelection,
    candidates,
    columns_rest,
    select_frames,
    select_identifiable,
)
from calibration_core.identification.geometry.terms import GeometryTerm, Term, names_of
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters


def _choice(cell: Cell, q: np.ndarray) -> tuple[AbsoluteProblem, ModelParameters, list[Term], ParameterSelection]:
    nominal = nominal_parameters(cell)
    problem = make_problem(cell, make_readings(cell, nominal, q))
    frames, _ = select_frames(problem, nominal)
    return problem, nominal, frames, select_identifiable(problem, nominal, frames, candidates(cell))


def test_parallel_axes_take_the_second_rotation_and_lose_an_offset() -> None:
    _, _, frames, choice = _choice(make_cell(), random_angles(0, 200, 6))
    assert len(names_of(frames)) + len(choice.chosen) == 27
    assert "beta_3" in choice.term.names
    assert {c.name for c in choice.nominal} == {"d_1", "theta_1", "d_3", "d_6", "theta_6"}
    reasons = {u.reason for u in choice.unidentified}
    assert "d_3 cannot be distinguished from d_2; it stays nominal" in reasons
    assert "d_1 cannot be distinguished from tracker z; it stays nominal" in reasons


@pytest.mark.parametrize("rows", [ELBOW, SEVEN], ids=["6 joints", "7 joints"])
@pytest.mark.parametrize("points", [("mp1",), tuple(POINTS)], ids=["1 point", "3 points"])
def test_the_chosen_columns_are_independent_and_span_everything(rows: tuple, points: tuple[str, ...]) -> None:
    cell = make_cell(rows, points)
    problem, nominal, frames, choice = _choice(cell, random_angles(0, 200, len(rows)))
    n = len(rows)
    pairs = tuple((joint, kind) for joint in range(n) for kind in range(6))
    everything = [*frames, GeometryTerm(pairs, tuple(map(str, pairs)))]
    full = normal_equations(problem, nominal, everything).matrix
    chosen = normal_equations(problem, nominal, [*frames, choice.term]).matrix
    scales = [1 / np.sqrt(np.diag(matrix)) for matrix in (full, chosen)]
    values = [np.linalg.eigvalsh(m * np.outer(s, s)) for m, s in zip((full, chosen), scales, strict=True)]
    assert np.sqrt(values[1][-1] / values[1][0]) < 300
    assert int(np.sum(values[0] > 1e-9 * values[0][-1])) == len(chosen)


def test_the_stated_combination_does_not_show() -> None:
    cell = make_cell()
    problem, nominal, frames, choice = _choice(cell, random_angles(0, 100, 6))
    offered = candidates(cell)
    everything = [*frames, GeometryTerm(tuple((c.joint, c.kind) for c in offered), tuple(c.name for c in offered))]
    names = names_of(everything)
    matrix = normal_equations(dataclasses.replace(problem, whitening=1.0), nominal, everything).matrix
    scale = 1 / np.sqrt(np.diag(matrix))
    for unidentified in choice.unidentified:
        vector = np.array([unidentified.combination.get(name, 0.0) for name in names])
        shown = vector @ (matrix * np.outer(scale, scale)) @ vector
        assert np.abs(vector).max() == pytest.approx(1.0)
        assert np.sqrt(max(shown, 0.0)) < 0.1  # parts below a tenth are not named


def test_a_flange_that_never_turns_leaves_the_point_nominal() -> None:
    cell = make_cell()
    q = random_angles(0, 100, 6)
    q[:, 3:] = 0.0
    q[:, 2] = -q[:, 1]  # the flange only turns about the vertical
    nominal = nominal_parameters(cell)
    frames, hidden = select_frames(make_problem(cell, make_readings(cell, nominal, q)), nominal)
    assert len(names_of(frames)) == 8
    assert len(hidden) == 1
    assert "tracker z" in hidden[0].combination


def test_names_follow_the_cell_file() -> None:
    standard = {(c.joint, c.kind): c for c in candidates(make_cell())}
    assert (standard[1, 0].name, standard[1, 0].nominal) == ("a_1", 0.33)
    assert (standard[1, 5].name, standard[1, 3].name, standard[1, 4].name) == ("theta_2", "alpha_1", "beta_2")
    assert {joint for joint, kind in standard if kind in (0, 3)} == {1, 2, 3, 4, 5}
    modified = {(c.joint, c.kind): c for c in candidates(make_cell(robot={"modified_dh": True}))}
    assert (modified[1, 0].name, modified[1, 0].nominal) == ("a_2", 1.15)
    assert modified[0, 3].name == "alpha_1"


def test_few_configurations_choose_fewer_parameters() -> None:
    counts = [len(_choice(make_cell(), random_angles(0, count, 6))[3].chosen) for count in (4, 6, 40)]
    assert counts[0] < counts[1] < counts[2]
    assert counts[0] + 9 < 3 * 4


def test_rest_of_a_column() -> None:
    a = np.array([[1.0, 1.0], [0.0, 1e-2]])
    assert columns_rest(a.T @ a, 1) == pytest.approx(1e-2, rel=1e-3)
    assert truth_of(make_cell(), 0).geometry.any()
