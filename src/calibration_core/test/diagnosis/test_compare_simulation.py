"""A simulation with another tool, with noise, or mixed up: what is said of it is true."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from robots import loaded_readings, write_cell

from calibration_core.cell import Cell
from calibration_core.diagnosis.comparison.recordings import compare
from calibration_core.diagnosis.simulated import compare_checked
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.nominal import nominal_parameters
from calibration_core.timeseries import Readings


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    return write_cell(tmp_path_factory.mktemp("cell"))


@pytest.fixture(scope="module")
def recorded(cell: Cell) -> Readings:
    return loaded_readings(cell, 3)


@pytest.fixture(scope="module")
def simulated(cell: Cell, recorded: Readings) -> Readings:
    """What the cell file's model says of the same angles and wrenches, without noise."""
    return dataclasses.replace(recorded, position=predict_readings(recorded, cell, nominal_parameters(cell)))


def by_model(readings: Readings, cell: Cell, **changes: object) -> Readings:
    model = nominal_parameters(cell).replace(**changes)
    return dataclasses.replace(readings, position=predict_readings(readings, cell, model))


@pytest.mark.parametrize("which", [("mp1", "mp2", "mp3"), ("mp2",)])
def test_another_tool_is_no_other_robot(
    cell: Cell, recorded: Readings, simulated: Readings, which: tuple[str, ...]
) -> None:
    points = dict(nominal_parameters(cell).points)
    points |= {name: points[name] + [0.02, 0.0, 0.015] for name in which}
    found = compare(recorded, by_model(simulated, cell, points=points), cell)
    assert [(d.kind, d.side) for d in found.differences] == [("points", "simulation")]
    (difference,) = found.differences
    assert difference.location == {"point": ", ".join(which)}
    assert difference.magnitude == pytest.approx(0.025, rel=0.1)
    plain = compare(recorded, simulated, cell)
    assert found.steps is not None
    assert plain.steps is not None
    assert found.steps.rms == pytest.approx(plain.steps.rms, rel=0.2)


def test_what_is_mixed_up_in_a_simulation_is_no_physics_of_it(
    cell: Cell, recorded: Readings, simulated: Readings
) -> None:
    assert simulated.wrench is not None
    found = compare(recorded, dataclasses.replace(simulated, wrench=-simulated.wrench), cell)
    assert [d.kind for d in found.differences] == ["wrench_sign"]
    assert not any("holds physics" in sentence for sentence in found.sentences)


def test_noise_of_a_simulation_is_no_physics_of_it(cell: Cell, recorded: Readings, simulated: Readings) -> None:
    noise = 6e-5 * np.random.default_rng(5).standard_normal(simulated.position.shape)
    found = compare_checked(recorded, dataclasses.replace(simulated, position=simulated.position + noise), cell)
    assert [d.kind for d in found.differences] == ["noise_understated"]
    assert found.reproduction.reproduced
    assert "to the noise seen in it" in found.sentences[0]
