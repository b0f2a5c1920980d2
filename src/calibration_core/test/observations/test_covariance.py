"""What readings are worth: the claim, never less, and more where the window says so."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.errors import CellError
from calibration_core.observations.average import position_covariance, spherical_covariance, wrench_covariance
from calibration_core.timeseries import Provenance, Readings

SPHERICAL = "tracker: {sigma_range: 1.0e-5, sigma_range_per_m: 1.0e-6, sigma_angle: 5.0e-6}"


def readings(n: int = 4, *, wrench: bool = True) -> Readings:
    rng = np.random.default_rng(0)
    return Readings(
        points=("left", "right"),
        configuration=np.arange(n),
        step=np.zeros(n, np.int64),
        point=np.zeros(n, np.int64),
        q=np.zeros((n, 3)),
        position=rng.normal(size=(n, 3)) + np.array([3.0, 0.0, 1.0]),
        wrench=rng.normal(size=(n, 6)) if wrench else None,
        time=np.full(n, np.nan),
        temperature=np.full(n, np.nan),
        provenance=Provenance("", "csv", {}, {}),
    )


def altered(cell: Cell, tmp_path: Path, old: str, new: str) -> Cell:
    path = tmp_path / "altered.yaml"
    path.write_text(cell.path.read_text().replace(old, new))
    return load_cell(path)


def test_a_table_has_the_claim(cell: Cell) -> None:
    found = position_covariance(readings(), cell)
    assert found == pytest.approx(np.tile(4e-10 * np.eye(3), (4, 1, 1)))
    found = wrench_covariance(readings(), cell)
    assert found == pytest.approx(np.tile(np.diag([1, 1, 1, 0.25, 0.25, 0.25]), (4, 1, 1)))


def test_no_wrench_has_no_uncertainty(cell: Cell) -> None:
    assert not wrench_covariance(readings(wrench=False), cell).any()


def test_a_wrench_without_a_claim(cell: Cell, tmp_path: Path) -> None:
    bare = altered(cell, tmp_path, "  force_torque: {sigma_force: 1.0, sigma_torque: 0.5}\n", "")
    with pytest.raises(CellError, match=r"instruments\.force_torque: found nothing"):
        wrench_covariance(readings(), bare)


def test_spherical_claim_is_what_an_instrument_scatters(cell: Cell, tmp_path: Path) -> None:
    tracker = altered(cell, tmp_path, "tracker: {sigma: 2.0e-5}", SPHERICAL).instruments.tracker
    place = np.array([[3.0, -2.0, 1.5]])
    rng = np.random.default_rng(1)
    r = np.linalg.norm(place)
    azimuth, elevation = np.arctan2(-2.0, 3.0), np.arcsin(1.5 / r)
    reach = r + (1e-5 + 1e-6 * r) * rng.normal(size=400_000)
    azimuth = azimuth + 5e-6 * rng.normal(size=400_000)
    elevation = elevation + 5e-6 * rng.normal(size=400_000)
    level = reach * np.cos(elevation)
    seen = np.cov(np.array([level * np.cos(azimuth), level * np.sin(azimuth), reach * np.sin(elevation)]))
    assert spherical_covariance(place, tracker)[0] == pytest.approx(seen, rel=0.03, abs=2e-12)


@pytest.mark.parametrize("place", [[0.0, 0.0, 0.0], [0.0, 0.0, 2.0], [0.0, 0.0, -2.0], [1e-12, 0.0, 3.0]])
def test_spherical_claim_straight_up_is_regular(cell: Cell, tmp_path: Path, place: list[float]) -> None:
    tracker = altered(cell, tmp_path, "tracker: {sigma: 2.0e-5}", SPHERICAL).instruments.tracker
    found = spherical_covariance(np.array([place]), tracker)[0]
    assert np.isfinite(found).all()
    assert np.linalg.eigvalsh(found).min() >= 0.0


def test_displacements_need_a_cartesian_claim(cell: Cell, tmp_path: Path) -> None:
    other = altered(cell, tmp_path, "  tracker: {sigma: 2.0e-5}", f"  {SPHERICAL}").path
    other.write_text(other.read_text() + "measurements: {points: displacement}\n")
    with pytest.raises(CellError, match="displacements have no range"):
        position_covariance(readings(), load_cell(other))


def test_quiet_windows_change_nothing_and_loud_ones_inflate(cell: Cell) -> None:
    seen = np.tile(1e-12 * np.eye(3), (4, 1, 1))
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    seen[1] = turn @ np.diag([1e-8, 1e-12, 2e-10]) @ turn.T
    found = position_covariance(dataclasses.replace(readings(), position_covariance=seen), cell)
    assert found[0] == pytest.approx(4e-10 * np.eye(3), rel=1e-6, abs=1e-15)
    assert found[1] == pytest.approx(turn @ np.diag([1e-8, 4e-10, 4e-10]) @ turn.T, rel=1e-6, abs=1e-15)


@pytest.mark.parametrize("worse", [1.0, 1.5])
def test_the_scatter_of_few_samples_is_pooled_before_it_is_compared(cell: Cell, worse: float) -> None:
    """As many windows of 20 samples as a recording has: claimed, or half as much again, and one that shakes."""
    count, n, claim = 200, 20, 2e-5
    drawn = worse * claim * np.sqrt(n) * np.random.default_rng(3).standard_normal((count, n, 3))
    drawn[7] *= 5.0
    seen = np.array([np.cov(one.T) / n for one in drawn])
    recorded = dataclasses.replace(readings(count), position_covariance=seen, samples=np.full(count, n))
    std = np.sqrt(np.einsum("mii->m", position_covariance(recorded, cell)) / 3)
    assert np.median(std) == pytest.approx(worse * claim, rel=0.04)
    assert std[7] == pytest.approx(5 * worse * claim, rel=0.3)
    assert np.sqrt(np.mean(np.delete(std, 7) ** 2)) == pytest.approx(worse * claim, rel=0.05)


def test_inflation_does_not_depend_on_axes_or_units(cell: Cell) -> None:
    """For a claim that is no multiple of the unit matrix: in no direction below the claim, or below what was seen."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(4, 6, 6))
    seen = root @ np.swapaxes(root, 1, 2) * 0.2
    found = wrench_covariance(dataclasses.replace(readings(), wrench_covariance=seen), cell)
    claim = np.diag([1, 1, 1, 0.25, 0.25, 0.25])
    for i in range(4):
        assert np.linalg.eigvalsh(found[i] - claim).min() > -1e-9
        assert np.linalg.eigvalsh(found[i] - seen[i]).min() > -1e-9
