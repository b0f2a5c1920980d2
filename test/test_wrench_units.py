"""Forces and torques in units that do not belong together, less than a thousand apart."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.files.yaml_file import yaml_text
from calibration_core.input_checks.check import check_inputs
from calibration_core.timeseries import Readings
from calibration_sim.scenarios.generate import generate
from calibration_sim.scenarios.grid import Scenario
from calibration_sim.scenarios.measure import Noise


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Readings, Cell]:
    """A recording that shows differences of less than ten times between forces and torques."""
    noise = Noise(1.0, False, 0.0, spherical_claim=False)
    played = generate(Scenario(0, "nothing", "heavy", "L", 781, (), 0.0, noise))
    path = tmp_path_factory.mktemp("many") / "cell.yaml"
    path.write_text(yaml_text(played.cell), encoding="utf-8")
    return played.readings, load_cell(path)


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize(
    ("force", "torque", "words"),
    [
        (1 / 9.80665, 1.0, "multiply the forces by 9.80665: they look like kgf (daN: by 10)"),
        (0.1, 1.0, "multiply the forces by 9.80665: they look like kgf (daN: by 10)"),
        (1 / 4.44822, 1.0, "multiply the forces by 4.44822: they look like lbf"),
        (1.0, 1 / 9.80665, "multiply the torques by 9.80665: they look like kgf·m"),
        (1.0, 1 / 0.112985, "multiply the torques by 0.112985: they look like lbf·in"),
    ],
)
def test_units_that_are_less_than_a_thousand_apart_are_named(
    recorded: tuple[Readings, Cell], force: float, torque: float, words: str, *, stated: bool
) -> None:
    readings, cell = recorded
    assert check_inputs(readings, cell) == ()
    assert readings.wrench is not None
    if not stated:
        cell = cell.model_copy(update={"robot": cell.robot.model_copy(update={"stiffness": None})})
    wrench = readings.wrench * np.repeat([force, torque], 3)
    (found,) = check_inputs(dataclasses.replace(readings, wrench=wrench), cell)
    assert found.kind == "wrench_unit"
    assert found.remedy.startswith(words)
