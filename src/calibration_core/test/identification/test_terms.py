"""Every column of every term against finite differences of the prediction."""

from __future__ import annotations

import numpy as np
import pytest
from absolute_cases import ELBOW, SEVEN, make_cell, make_problem, make_readings, random_angles, truth_of

from calibration_core.identification.geometry.fit import AbsoluteProblem, whitened
from calibration_core.identification.geometry.terms import (
    CORRECTIONS,
    ElasticityTerm,
    GeometryTerm,
    HarmonicTerm,
    PointTerm,
    Term,
    TrackerTerm,
)
from calibration_core.model.chain import rotation_about
from calibration_core.model.kinematics import posture
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of

POINTS = ("mp1", "mp2", "mp3")


def _numeric(problem: AbsoluteProblem, at: ModelParameters, term: Term, size: float) -> np.ndarray:
    columns = []
    for k in range(len(term.names)):
        step = np.zeros(len(term.names))
        step[k] = size
        columns.append((problem.residual(term.moved(at, -step)) - problem.residual(term.moved(at, step))) / (2 * size))
    return np.stack(columns)


@pytest.fixture(params=[ELBOW, SEVEN], ids=["6 joints", "7 joints"])
def case(request: pytest.FixtureRequest) -> tuple[AbsoluteProblem, ModelParameters]:
    cell = make_cell(request.param, POINTS)
    at = truth_of(cell, 3, geometry=0.05)  # large corrections: the columns must be exact, not only at the nominal ones
    q = random_angles(4, 5, len(request.param))
    return make_problem(cell, make_readings(cell, truth_of(cell, 5), q)), at


def _terms(n: int) -> list[Term]:
    chosen = tuple((joint, kind) for joint in range(n) for kind in range(6))
    labels = tuple(f"{CORRECTIONS[kind]}_{joint}" for joint, kind in chosen)
    return [TrackerTerm(), PointTerm("mp2", 1), PointTerm("mp3", 2, (0, 2)), GeometryTerm(chosen, labels)]


@pytest.mark.parametrize("index", range(4), ids=["tracker", "point", "some axes of a point", "geometry"])
def test_columns_of_a_rigid_robot(case: tuple[AbsoluteProblem, ModelParameters], index: int) -> None:
    problem, at = case
    term = _terms(problem.chain.n)[index]
    columns, residual = whitened(problem, at, [term])
    np.testing.assert_allclose(columns, _numeric(problem, at, term, 1e-6), atol=2e-8)
    np.testing.assert_allclose(residual, problem.residual(at), atol=1e-14)


def test_elasticity_is_exact_on_the_deformed_geometry(case: tuple[AbsoluteProblem, ModelParameters]) -> None:
    problem, at = case
    n = problem.chain.n
    soft = at.replace(compliance=np.full(n, 3e-6))
    term = ElasticityTerm(tuple(range(n)), tuple(f"C{j}" for j in range(n)))
    columns, _ = whitened(problem, soft, [term])
    numeric = _numeric(problem, soft, term, 1e-8)
    np.testing.assert_allclose(columns, numeric, atol=1e-4 * np.abs(numeric).max())


def test_geometry_of_an_elastic_robot_to_the_size_of_its_deflection(
    case: tuple[AbsoluteProblem, ModelParameters],
) -> None:
    problem, at = case
    soft = at.replace(compliance=np.full(problem.chain.n, 3e-7))
    term = _terms(problem.chain.n)[3]
    columns, _ = whitened(problem, soft, [term])
    deflection = np.abs(problem.view(soft, elastic=True).rest.deflection).max()
    assert 1e-5 < deflection < 1e-2
    np.testing.assert_allclose(columns, _numeric(problem, soft, term, 1e-6), atol=5 * deflection)


def test_turned_gravity_builds_the_columns_of_a_robot_that_lies_on_its_side(
    case: tuple[AbsoluteProblem, ModelParameters],
) -> None:
    problem, at = case
    joints = tuple(range(problem.chain.n))
    sideways = (9.81, 0.0, 0.0)
    control, _ = whitened(problem, at, [ElasticityTerm(joints, ("",) * len(joints), sideways, either_sign=True)])
    lying = AbsoluteProblem(
        problem.chain.with_gravity(np.array(sideways)), problem.q, problem.position, problem.names, problem.point, 1.0
    )
    real, _ = whitened(lying, at, [ElasticityTerm(joints, ("",) * len(joints))])
    np.testing.assert_allclose(control, real, atol=1e-9)


def test_harmonics_move_the_joint_by_sine_and_cosine(case: tuple[AbsoluteProblem, ModelParameters]) -> None:
    problem, at = case
    columns, _ = whitened(problem, at, [HarmonicTerm((1,))])
    size = 1e-6
    chain = problem.chain.corrected(at.geometry)
    points = np.stack([at.points[name] for name in problem.names], axis=1)[:, problem.point]
    for column, wave in zip(columns, (np.sin, np.cos), strict=True):
        moved = []
        for sign in (-1, 1):
            q = problem.q.copy()
            q[:, 1] += sign * size * wave(problem.q[:, 1])
            moved.append(posture(chain, q).point(points))
        np.testing.assert_allclose(column, (moved[1] - moved[0]) / (2 * size), atol=1e-8)
    with pytest.raises(TypeError, match="no place in the model"):
        HarmonicTerm((1,)).moved(at, np.ones(2))


def test_rotation_vector() -> None:
    turn = rotation_about(np.array([0.0, 0.0, 0.3]))
    np.testing.assert_allclose(turn[:2, 0], [np.cos(0.3), np.sin(0.3)], atol=1e-15)
    small = np.array([1e-9, -2e-9, 3e-9])
    np.testing.assert_allclose(rotation_about(small) @ rotation_about(-small), np.eye(3), atol=1e-16)


def test_compliance_never_becomes_negative() -> None:
    cell = make_cell()
    at = truth_of(cell, 0, compliance=1e-7)
    moved = ElasticityTerm((0, 2), ("a", "b")).moved(at, np.array([-1e-6, 1e-7]))
    np.testing.assert_allclose(moved.compliance, [0.0, 1e-7, 2e-7, 1e-7, 1e-7, 1e-7])
    assert chain_of(cell).mass is not None
