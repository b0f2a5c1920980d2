"""Physics that a model leaves out makes no arm restless and no tracker noisy."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from loaded_cases import dahl, friction, shifted, true_state
from robots import loaded_readings

from calibration_core.cell import Cell, load_cell
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.model.effects.state import State
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.simulation.simulate import as_recording
from calibration_core.observations.observe import observe_recording
from calibration_core.timeseries import NANOSECONDS, Float1D, Float2D, Readings, TimeSeries

CELL = Path(__file__).resolve().parents[4] / "config" / "cells" / "small.cell.yaml"
JOINT, WIDTH = 1, 1.5e-4  # rad, from one side of the friction to the other


def with_friction(cell: Cell, seed: int) -> Readings:
    """Return a recording in which joint 2 lags by Dahl's law, and stood anywhere when it arrived."""
    readings = loaded_readings(cell, seed, 18)
    state = true_state(readings, cell)
    lag = friction(state, JOINT, seed, lambda sliding, change: dahl(sliding, change / 0.2))
    return shifted(readings, cell, state.joint_column(JOINT, -WIDTH * lag))


def moved(readings: Readings, shift: Float2D) -> Readings:
    return dataclasses.replace(readings, position=readings.position + shift)


@pytest.mark.parametrize("seed", [6, 7])
def test_friction_is_no_restless_arm_and_no_noise(cell: Cell, seed: int) -> None:
    found = diagnose(with_friction(cell, seed), cell)
    assert [(one.effect, dict(one.location)) for one in found.findings] == [("hysteresis", {"joint": "joint_2"})]
    assert not {one.kind for one in found.anomalies} & {"unsettled", "noise_understated"}


def test_an_arm_that_swings_is_restless_beside_friction(cell: Cell) -> None:
    readings = with_friction(cell, 6)
    keys = np.column_stack([readings.configuration, readings.step])
    _, step = np.unique(keys, axis=0, return_inverse=True)
    swing = 4e-4 * np.random.default_rng(1).standard_normal((step.max() + 1, 3))[step.reshape(-1)]
    swinging = np.isin(readings.configuration, [9, 13, 14])
    found = diagnose(moved(readings, swing * swinging[:, None]), cell)
    (text,) = (anomaly.text for anomaly in found.anomalies if anomaly.kind == "unsettled")
    assert text.startswith("in configurations 9, 13, 14 all points move together")


def on_a_hinge(cell: Cell, state: State, axis: Float1D, compliance: float) -> Float2D:
    """Return what a tool moves that gives way about an axis through the flange's origin, (m, 3) m, base axes."""
    lever, line = state.where - state.at.flange_origin, np.einsum("a,aim->im", axis, state.at.flange)
    torque = np.sum(line * (state.moment + np.cross(lever, state.force, axis=0)), axis=0)
    turned = np.cross(line, state.point - state.at.flange_origin, axis=0)
    return np.asarray((compliance * torque * turned).T)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_tool_that_gives_way_about_an_oblique_axis_is_no_error_of_the_sensor(cell: Cell, seed: int) -> None:
    readings = loaded_readings(cell, seed, 16)
    axis = np.array([0.6, -0.48, 0.64])
    shift = on_a_hinge(cell, true_state(readings, cell), axis, 4e-7)
    found = diagnose(shifted(readings, cell, shift), cell)
    assert [one.effect for one in found.findings] == ["tool_compliance"]
    assert found.verdict == "missing_physics"


@pytest.mark.parametrize("size", [8e-5, 1.2e-4])
def test_a_loose_target_alone_leaves_nothing_unexplained(cell: Cell, size: float) -> None:
    readings = loaded_readings(cell, 32, 18)
    shake = size * np.random.default_rng(3).standard_normal((len(readings), 3))
    found = diagnose(moved(readings, shake * (readings.point == 1)[:, None]), cell)
    assert [(one.kind, dict(one.location)) for one in found.anomalies] == [("loose_target", {"point": "mp2"})]
    assert (found.verdict, found.findings) == ("consistent", ())


@dataclasses.dataclass(frozen=True, eq=False)
class Pull:
    """A configuration that is pulled, and let go step by step.

    Attributes:
        number: Of the configuration.
        q: (6,) rad.
        steps: (s, 6) N and N*m, base axes.
    """

    number: int
    q: Float1D
    steps: Float2D


@pytest.mark.parametrize("ahead", [-0.4, 0.4])
def test_a_clock_that_differs_is_no_law_of_a_joint(ahead: float) -> None:
    """The tracker's stamps are off by up to what a computer without a time server is."""
    cell, rng = load_cell(CELL), np.random.default_rng(8)
    levels = np.outer([0.0, 0.5, 1.0, 0.5, 0.0], 9.0 * cell.robot.rated_load * np.eye(6)[2])
    middle = np.array([0.0, 0.3, -0.8, 0.2, 0.9, 0.1])
    pulls = [Pull(k, middle + rng.uniform(-0.6, 0.6, 6), -levels) for k in range(12)]
    streams = as_recording(pulls, cell, nominal_parameters(cell), 8)
    late = {
        name: TimeSeries(one.time + int(ahead * NANOSECONDS), one.values, one.received, one.frame)
        for name, one in streams.points.items()
    }
    readings = observe_recording(dataclasses.replace(streams, points=late), cell)
    assert ["the tracker's stamps are corrected" in one.text for one in readings.notes] == [True]
    found = diagnose(readings, cell)
    assert (found.verdict, found.findings, found.anomalies) == ("consistent", (), ())
