"""A tracker or a target that moved is found, and errors of the robot's geometry are not taken for it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.diagnosis.data_checks.loaded_anomalies import check_each
from calibration_core.diagnosis.evidence.extended import loaded_state
from calibration_core.identification.stiffness.loaded import Options, prepare_loaded
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.timeseries import Readings
from calibration_sim.cell.configurations import random_protocol
from calibration_sim.cell.protocol import Protocol
from calibration_sim.cell.table import simulate_readings
from calibration_sim.cell.truth import ROUGH, WORKSHOP, draw_truth

LOADED, AT_REST, MANY = (18, 0), (14, 20), (100, 0)


@pytest.fixture(scope="module")
def cell() -> Cell:
    return load_cell(Path(__file__).parent.parent / "config" / "cells" / "demo.cell.yaml")


def recording(cell: Cell, seed: int, counts: tuple[int, int], *, imperfect: bool) -> Readings:
    """Return loaded configurations and, scattered among them, postures at rest."""
    loaded, rest = counts
    protocol = random_protocol(cell, loaded + rest, seed)
    single = np.zeros(loaded + rest, dtype=bool)
    single[np.random.default_rng(seed).permutation(loaded + rest)[:rest]] = True
    several = (
        dataclasses.replace(one, wrenches=one.wrenches[:1]) if alone else one
        for one, alone in zip(protocol.configurations, single, strict=True)
    )
    truth = draw_truth(cell, seed, spread=WORKSHOP if imperfect else ROUGH)
    return simulate_readings(cell, truth, Protocol(tuple(several)), seed)


def kinds(readings: Readings, cell: Cell) -> list[str]:
    prepared = prepare_loaded(readings, cell, Options())
    found = check_each(prepared, lambda problem: loaded_state(problem, cell, prepared.fit.compliance))
    return [anomaly.kind for anomaly in found.anomalies]


def late(readings: Readings) -> np.ndarray:
    return np.asarray(readings.configuration > np.quantile(np.unique(readings.configuration), 0.55))


@pytest.mark.parametrize("seed", [0, 6, 9])
def test_geometric_errors_that_go_up_and_down_are_no_tracker_that_moved(cell: Cell, seed: int) -> None:
    """Millimetres of geometry over a hundred configurations, of which those that follow each other are neighbours."""
    assert kinds(recording(cell, seed, MANY, imperfect=True), cell) == []


def test_geometric_errors_that_go_up_and_down_are_no_target_that_moved(cell: Cell) -> None:
    assert kinds(recording(cell, 3, MANY, imperfect=True), cell) == []


@pytest.mark.parametrize("counts", [LOADED, AT_REST])
@pytest.mark.parametrize("imperfect", [False, True])
def test_a_tracker_that_moves_by_half_a_millimetre_is_found(
    cell: Cell, counts: tuple[int, int], *, imperfect: bool
) -> None:
    readings = recording(cell, 1, counts, imperfect=imperfect)
    shifted = readings.position + 5e-4 * late(readings)[:, None] * [0.6, 0.0, 0.8]
    assert kinds(dataclasses.replace(readings, position=shifted), cell) == ["tracker_moved"]


@pytest.mark.parametrize("imperfect", [False, True])
def test_a_target_that_moves_by_a_millimetre_is_found(cell: Cell, *, imperfect: bool) -> None:
    readings = recording(cell, 2, LOADED, imperfect=imperfect)
    flange = posture(chain_of(cell), readings.q).flange
    to_tracker = nominal_parameters(cell).tracker[:3, :3]
    moved = np.einsum("kam,k->ma", flange, [6e-4, 0.0, 8e-4]) @ to_tracker
    concerned = late(readings) & (readings.point == 1)
    shifted = readings.position + concerned[:, None] * moved
    assert kinds(dataclasses.replace(readings, position=shifted), cell) == ["target_moved"]
