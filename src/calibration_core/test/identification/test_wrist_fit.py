"""The wrist centre against the Cramér-Rao bound; the right one of two intersections; motions that fix nothing (7.3)."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from robots import cell_dict
from test_circle_point import HOME, SIGMA, _readings

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.wrist import fit_wrist, identify_wrist_centre
from calibration_core.model.chain import Chain, rotation_about
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of

SIDE, POSES = 0.3, 20
CENTRE = np.array([0.0, 0.0, -0.23])


def _cell(height: float = 0.12) -> Cell:
    """Return a cell whose points are the corners of an equilateral triangle."""
    content = cell_dict()
    radius = SIDE / np.sqrt(3)
    content["frames"]["measurement_points"] = {
        f"mp{k + 1}": [radius * np.cos(angle), radius * np.sin(angle), height]
        for k, angle in enumerate(2 * np.pi * np.arange(3) / 3)
    }
    return Cell.model_validate(content)


def _angles(seed: int) -> np.ndarray:
    q = np.tile(HOME, (POSES, 1))
    q[:, 3:] += np.random.default_rng(seed).uniform(-1.2, 1.2, (POSES, 3))
    return q


def _bound(chain: Chain, q: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the (6, 6) bound of the wrist centre in flange and tracker frame; every rotation is unknown."""
    flanges = np.moveaxis(posture(chain, q).flange, -1, 0).transpose(0, 2, 1)
    m = len(q)

    def places(x: np.ndarray) -> np.ndarray:
        arms = corners - CENTRE - x[:3]
        turns = np.stack([rotation_about(w) @ flange for w, flange in zip(x[6:].reshape(m, 3), flanges, strict=True)])
        return (x[3:6] + arms @ np.swapaxes(turns, 1, 2)).ravel()

    slope = np.column_stack([(places(h) - places(-h)) / 2e-6 for h in 1e-6 * np.eye(6 + 3 * m)])
    return np.linalg.inv(slope.T @ slope)[:6, :6] * SIGMA**2


@pytest.mark.parametrize("seeds", [20, pytest.param(200, marks=pytest.mark.slow)])
def test_the_bound_is_reached_and_the_wrong_intersection_never_taken(seeds: int) -> None:
    cell = _cell()
    chain, truth = chain_of(cell), nominal_parameters(cell)
    at = posture(chain, HOME[None]).origin[4][:, 0]
    expected = truth.tracker[:3, :3].T @ (at - truth.tracker[:3, 3])
    corners = np.stack(list(truth.points.values()))
    ratio, inside, crude = [], [], []
    for seed in range(seeds):
        q = _angles(seed)
        found = identify_wrist_centre(_readings(cell, chain, q, SIGMA, seed), cell, truth.points)
        bound = _bound(chain, q, corners)
        turned = truth.tracker[:3, :3].T  # the bound's second half is in base axes
        error = np.concatenate([found.flange - CENTRE, found.position - expected])
        bound[3:, 3:] = turned @ bound[3:, 3:] @ turned.T
        ratio.append(
            [
                e @ np.linalg.solve(b, e) / 3
                for e, b in zip((error[:3], error[3:]), (bound[:3, :3], bound[3:, 3:]), strict=True)
            ]
        )
        std = np.sqrt(np.concatenate([np.diag(found.covariance), np.diag(found.position_covariance)]))
        inside.append(np.abs(error) <= 1.96 * std)
        crude.append(np.sum((found.trilaterated - CENTRE) ** 2) / np.trace(bound[:3, :3]))
        assert np.linalg.norm(found.flange - CENTRE) < 1e-3  # the other intersection is 0.7 m away
        assert np.linalg.norm(found.trilaterated - CENTRE) < 1e-3
    over, cover = np.sqrt(np.mean(ratio, axis=0)), np.mean(inside, axis=0)
    print(f"\n{seeds} seeds: error over the bound {over} (flange, tracker), by trilateration alone "
          f"{np.sqrt(np.mean(crude)):.2f}; 95 % intervals cover {100 * cover} %")  # fmt: skip
    assert np.all(over <= (1.1 if seeds >= 200 else 1.35))
    assert np.all(cover >= (0.92 if seeds >= 200 else 0.7))


@pytest.mark.parametrize("height", [0.0, -0.15, -0.4])
def test_the_right_side_is_taken_wherever_the_points_are(height: float) -> None:
    cell = _cell(height)
    readings = _readings(cell, chain_of(cell), _angles(1), SIGMA)
    found = identify_wrist_centre(readings, cell, nominal_parameters(cell).points)
    assert np.linalg.norm(found.flange - CENTRE) < 1e-3


def test_doubt_of_the_points_is_carried() -> None:
    cell = _cell()
    rng = np.random.default_rng(2)
    root = 1e-4 * rng.standard_normal((9, 9))
    chain, points = chain_of(cell), nominal_parameters(cell).points
    errors = []
    for seed in range(40):
        wrong = (root @ rng.standard_normal(9)).reshape(3, 3)
        believed = {name: point + error for (name, point), error in zip(points.items(), wrong, strict=True)}
        readings = _readings(cell, chain, _angles(seed), SIGMA, seed)
        found = identify_wrist_centre(readings, cell, believed, root @ root.T)
        errors.append((found.flange - CENTRE) / found.std)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("moving", [(3,), (5,)])
def test_a_motion_about_one_axis_is_refused(moving: tuple[int, ...]) -> None:
    cell = _cell()
    q = np.tile(HOME, (POSES, 1))
    q[:, list(moving)] += np.random.default_rng(1).uniform(-1.2, 1.2, (POSES, len(moving)))
    readings = _readings(cell, chain_of(cell), q, SIGMA)
    with pytest.raises(IdentificationError, match="wrist motion"):
        identify_wrist_centre(readings, cell, nominal_parameters(cell).points)


def test_too_few_common_poses_are_refused() -> None:
    cell = _cell()
    readings = _readings(cell, chain_of(cell), _angles(1), SIGMA)
    alone = dataclasses.replace(readings, configuration=np.arange(1, len(readings) + 1))
    with pytest.raises(IdentificationError, match="0 poses in which all points were seen"):
        identify_wrist_centre(alone, cell, nominal_parameters(cell).points)


def test_the_fit_itself_refuses_one_axis() -> None:
    local = np.array([[0.2, 0.0, 0.1], [-0.1, 0.17, 0.1], [-0.1, -0.17, 0.1]])
    seen = np.stack([local @ rotation_about(angle * np.array([0.0, 0.0, 1.0])).T for angle in np.linspace(0, 2, 9)])
    noise = np.broadcast_to(1e-10 * np.eye(3), (9, 3, 3, 3))
    with pytest.raises(ValueError, match="fewer than two axes"):
        fit_wrist(seen, noise, local, None, np.zeros(3), np.zeros(3))
