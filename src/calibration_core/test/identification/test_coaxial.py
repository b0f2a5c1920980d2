"""Axes and base coordinate system against the Cramér-Rao bound, and the arc that a wanted accuracy needs (7.1)."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from robots import cell_dict
from test_circle_point import SIGMA

from calibration_core.cell import Cell
from calibration_core.identification.circle_point.circle import (
    _linearised,
    arc_for,
    centre_std,
    fit_circle,
    fit_coaxial,
)
from calibration_core.identification.circle_point.joint_axes import identify_axes
from calibration_core.model.chain import pose_matrix, rotation_about, rotation_vector
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Provenance, Readings

POSES = 24
ARC = np.radians(170.0)


def test_derivatives_against_finite_differences() -> None:
    rng = np.random.default_rng(1)
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points = [rng.normal(size=(7, 3)), rng.normal(size=(5, 3))]
    foot, normal, across = rng.normal(size=3), frame[2], frame[:2]
    heights, radii = rng.normal(size=2), rng.uniform(0.5, 1, 2)

    def residual(x: np.ndarray) -> np.ndarray:
        turned = normal + x[2:4] @ across
        turned = turned / np.linalg.norm(turned)
        return _linearised(points, foot + x[:2] @ across, turned, across, heights + x[4:6], radii + x[6:])[0]

    exact = _linearised(points, foot, normal, across, heights, radii)[1]
    numeric = [(residual(h) - residual(-h)) / 2e-6 for h in 1e-6 * np.eye(8)]
    np.testing.assert_allclose(exact, np.column_stack(numeric), atol=1e-8)


def test_points_on_one_axis_fix_nothing() -> None:
    angle = np.linspace(0, 1e-9, 6)
    points = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(6)])
    good = fit_circle(np.column_stack([np.cos(np.arange(6.0)), np.sin(np.arange(6.0)), np.zeros(6)]))
    with pytest.raises(ValueError, match="do not fix an axis"):
        fit_coaxial([good], [points])


def test_a_short_arc_costs_what_the_bound_says() -> None:
    worse = centre_std(np.radians(60), SIGMA, 200) / centre_std(np.radians(170), SIGMA, 200)
    assert worse == pytest.approx(8.0, rel=0.2)
    needed = arc_for(5e-5, SIGMA, 30)
    assert needed is not None
    assert centre_std(needed, SIGMA, 30) == pytest.approx(5e-5, rel=1e-4)
    assert arc_for(1e-6, SIGMA, 30) is None
    assert arc_for(1.0, SIGMA, 30) == pytest.approx(np.radians(1.0))
    with pytest.raises(ValueError, match="at least 4"):
        centre_std(1.0, SIGMA, 3)
    angle = np.linspace(-0.5, 0.5, 30)
    clean = 1.5 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(30)])
    rng = np.random.default_rng(4)
    seen = [fit_circle(clean + rng.normal(0, SIGMA, clean.shape)).centre[0] for _ in range(100)]
    assert np.std(seen) == pytest.approx(centre_std(1.0, SIGMA, 30), rel=0.25)


@dataclasses.dataclass(frozen=True)
class Play:
    """Two sweeps of a random robot: what is seen, and how it is made."""

    readings: Readings
    lines: np.ndarray  # (2, 6) axes of joints 1 and 2, tracker frame
    arms: np.ndarray  # (2, 3, 3) points at the middle of the sweep relative to a point of the axis
    angles: np.ndarray


def _play(seed: int) -> Play:
    """Turn three points about two skew, nearly perpendicular axes, seen from anywhere."""
    rng = np.random.default_rng(seed)
    tracker = pose_matrix(rng.normal(0, 2, 3), rng.uniform(-1, 1, 3))
    seen = np.linalg.inv(tracker)
    first = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    second = np.concatenate([[0.35, 0.0, 0.75], rotation_about(rng.normal(0, 5e-4, 3)) @ [0.0, 1.0, 0.0]])
    tool = rng.normal([1.7, 0.1, 1.6], 0.2, (3, 3))
    angles = np.linspace(-ARC / 2, ARC / 2, POSES)
    rows, lines, arms = [], [], []
    for joint, line in enumerate((first, second)):
        lines.append(np.concatenate([seen[:3, :3] @ line[:3] + seen[:3, 3], seen[:3, :3] @ line[3:]]))
        arms.append((tool - line[:3]) @ seen[:3, :3].T)
        for angle in angles:
            turned = (tool - line[:3]) @ rotation_about(angle * line[3:]).T + line[:3]
            q = np.zeros(6)
            q[joint] = angle
            rows += [(q, k, seen[:3, :3] @ point + seen[:3, 3]) for k, point in enumerate(turned)]
    position = np.stack([row[2] for row in rows])
    m = len(rows)
    readings = Readings(
        points=("mp1", "mp2", "mp3"), configuration=np.repeat(np.arange(1, m // 3 + 1), 3), step=np.zeros(m, dtype=int),
        point=np.array([row[1] for row in rows]), q=np.stack([row[0] for row in rows]),
        position=position + rng.normal(0, SIGMA, position.shape), wrench=None, time=np.full(m, np.nan),
        temperature=np.full(m, np.nan), provenance=Provenance("sweeps", "csv", {}, {}),
    )  # fmt: skip
    return Play(readings, np.stack(lines), np.stack(arms), angles)


def _clause(lines: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return origin and axes by the words of clause 7.1; `centre` is that of joint 2's circle."""
    z, other = lines[0, 3:] / np.linalg.norm(lines[0, 3:]), lines[1, 3:] / np.linalg.norm(lines[1, 3:])
    y = np.cross(z, other) / np.linalg.norm(np.cross(z, other))
    axes = np.column_stack([np.cross(y, z), y, z])
    first, second = axes.T @ lines[0, :3], axes.T @ centre
    return axes @ np.array([first[0], first[1], second[2]]), axes


def _bound(play: Play, best: int) -> np.ndarray:
    """Return the (6, 6) Cramér-Rao bound of origin and axes; every point's angle on its circle is unknown."""
    total = np.zeros((6, 6))
    true_centre = _centre(play, best)
    origin, axes = _clause(play.lines, true_centre)
    for joint in range(2):
        base, direction = play.lines[joint, :3], play.lines[joint, 3:]
        across = np.linalg.svd(direction[None])[2][1:]
        arms = play.arms[joint]

        def positions(x: np.ndarray, base=base, direction=direction, across=across, arms=arms) -> np.ndarray:
            turned = direction + x[2:4] @ across
            turned = turned / np.linalg.norm(turned)
            tilt = rotation_about(np.cross(direction, turned))
            angle = play.angles + x[10:].reshape(3, POSES)
            axial = arms @ direction
            radial = arms - axial[:, None] * direction
            radial = radial * (1 + x[7:10] / np.linalg.norm(radial, axis=1))[:, None]
            about = (
                np.cos(angle)[..., None] * radial[:, None]
                + np.sin(angle)[..., None] * np.cross(direction, radial)[:, None]
            )
            local = about + (axial + x[4:7])[:, None, None] * direction
            return (base + x[:2] @ across + local @ tilt.T).ravel()

        size = 10 + 3 * POSES
        slope = np.column_stack([(positions(h) - positions(-h)) / 2e-6 for h in 1e-6 * np.eye(size)])
        covariance = np.linalg.inv(slope.T @ slope)[:10, :10] * SIGMA**2

        def result(x: np.ndarray, joint=joint, base=base, direction=direction, across=across, arms=arms) -> np.ndarray:
            turned = direction + x[2:4] @ across
            turned = turned / np.linalg.norm(turned)
            lines = play.lines.copy()
            lines[joint] = np.concatenate([base + x[:2] @ across, turned])
            centre = true_centre
            if joint == 1:
                centre = base + x[:2] @ across + (arms[best] @ direction + x[4 + best]) * turned
            there, frame = _clause(lines, centre)
            return np.concatenate([there - origin, rotation_vector(frame @ axes.T)])

        change = np.column_stack([(result(h) - result(-h)) / 2e-6 for h in 1e-6 * np.eye(10)])
        total += change @ covariance @ change.T
    return total


def _centre(play: Play, circle: int) -> np.ndarray:
    direction = play.lines[1, 3:]
    return play.lines[1, :3] + (play.arms[1][circle] @ direction) * direction


@pytest.mark.parametrize("seeds", [20, pytest.param(200, marks=pytest.mark.slow)])
def test_base_frame_reaches_the_bound_and_its_intervals_cover(seeds: int) -> None:
    cell = Cell.model_validate(cell_dict())
    errors, ratios = [], []
    for seed in range(seeds):
        play = _play(seed)
        found = identify_axes(play.readings, cell).base
        centres = np.stack([_centre(play, k) for k in range(3)])
        best = int(np.argmin(np.linalg.norm(centres - found.axes[1].point, axis=1)))
        origin, axes = _clause(play.lines, centres[best])
        error = np.concatenate([found.origin - origin, rotation_vector(found.axes_in_tracker @ axes.T)])
        bound = _bound(play, best)
        errors.append(error / np.sqrt(np.diag(found.clause_covariance)))
        ratios.append(error @ np.linalg.solve(bound, error))
    over = float(np.sqrt(np.mean(ratios) / 6))
    cover = np.mean(np.abs(errors) <= 1.96, axis=0)
    print(f"\n{seeds} seeds: error over the Cramér-Rao bound {over:.3f}, 95 % intervals cover {100 * cover} %")
    assert over <= (1.1 if seeds >= 200 else 1.3)
    low = 0.92 if seeds >= 200 else 0.7
    assert np.all(cover >= low)
    assert np.mean(cover) >= min(low + 0.15, 0.92)
    assert chain_of(cell).n == 6
