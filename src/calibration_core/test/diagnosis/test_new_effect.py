"""An effect that somebody adds: one file, and it is found, written, applied elsewhere, said and judged."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator

import numpy as np
import pytest
from loaded_cases import planted, true_state
from robots import STIFFNESS, loaded_readings, write_cell

from calibration_core.cell import Cell
from calibration_core.compensation.robot import CalibratedRobot, Conditions, left_aside, parts_of
from calibration_core.diagnosis.loaded import diagnose_loaded
from calibration_core.model import effects
from calibration_core.model.effects import effects_with
from calibration_core.model.effects.applied import REFERENCE, applied_shift
from calibration_core.model.effects.candidate import Trait
from calibration_core.model.effects.words import effect_sentence
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters

NAME = "one_sided_yield"
FILE = '''
"""A joint gives way to one side, whichever way it is loaded: theta = w (tau/tau_r)^2, tau_r the largest torque."""

from functools import partial

from calibration_core.model.effects.candidate import Candidate, Effect, Parameter
from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Trait


def columns(state, joint):
    share = state.load_torque[joint] / state.largest_torque(joint)
    return stacked(state.joint_column(joint, share**2))


def candidates(state):
    for joint, name in enumerate(state.chain.joints):
        parameter = (Parameter("yield", "rad", 1.0e-4),)
        yield Candidate(EFFECT.name, EFFECT.family, {"joint": name}, "square", parameter, partial(columns, joint=joint))


EFFECT = Effect(
    name="one_sided_yield",
    family="joint law",
    equation="theta = w (tau/tau_r)^2",
    source="a test",
    reveal="reversed loads",
    candidates=candidates,
    sentence="{place} gives way to one side",
    traits=frozenset({Trait.OF_LARGEST_TORQUE}),
)
'''
SIZE = 5e-4  # rad


@pytest.fixture
def cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    return write_cell(tmp_path_factory.mktemp("cell"))


@pytest.fixture
def added(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Add the file to the catalogue, as if it stood in its family's folder."""
    folder = tmp_path_factory.mktemp("joint_law")
    (folder / f"{NAME}.py").write_text(FILE)
    effects.__path__.append(str(folder))
    effects.catalogue.cache_clear()
    effects.effects_with.cache_clear()
    yield
    effects.__path__.remove(str(folder))
    sys.modules.pop(f"{effects.__name__}.{NAME}", None)
    effects.catalogue.cache_clear()
    effects.effects_with.cache_clear()


@pytest.mark.usefixtures("added")
def test_one_file_makes_an_effect_take_part(cell: Cell) -> None:
    place = {"joint": "joint_2"}
    found = diagnose_loaded(planted(cell, 4, NAME, "square", [SIZE], **place), cell)
    assert [(one.effect, dict(one.location)) for one in found.findings] == [(NAME, place)]
    assert found.findings[0].explanation.startswith("Joint 2 gives way to one side. ")
    (known,) = found.model.effects
    assert known.parameters["yield"] == pytest.approx(SIZE, rel=0.2)

    whole = loaded_readings(cell, 4)
    state = true_state(whole, cell)
    assert known.parameters[REFERENCE] == pytest.approx(state.largest_torque(1), rel=0.02)
    torque = np.abs(state.load_torque[1])
    weak = ~np.isin(whole.configuration, whole.configuration[torque > 0.5 * torque.max()])
    part = true_state(whole.select(weak), cell)
    assert part.largest_torque(1) < 0.6 * state.largest_torque(1)
    np.testing.assert_allclose(applied_shift([known], part), applied_shift([known], state)[weak], atol=1e-12)

    assert effect_sentence(NAME, place) == "joint 2 gives way to one side"
    assert NAME in effects_with(Trait.DAMAGE)
    assert aside(cell, found.model) == ()


@pytest.mark.usefixtures("added")
def test_what_says_nothing_of_itself_is_what_its_family_is() -> None:
    silent = dataclasses.replace(effects.effect_named(NAME), traits=frozenset(), sentence="")
    assert {trait for trait in Trait if silent.has(trait)} == {Trait.ACTS_IN_USE, Trait.DAMAGE, Trait.BY_WEIGHT}
    sensor = dataclasses.replace(silent, family="load chain")
    assert not any(sensor.has(trait) for trait in Trait)


def test_the_catalogue_is_as_before() -> None:
    assert NAME not in {effect.name for effect in effects.catalogue()}
    assert effect_sentence(NAME, {"joint": "joint_2"}) == "one sided yield at joint 2"


def aside(cell: Cell, model: ModelParameters) -> tuple[object, ...]:
    """Return what the compensation of one place leaves aside of a model."""
    robot = CalibratedRobot.of(cell, nominal_parameters(cell).replace(compliance=1 / np.array(STIFFNESS)))
    robot = dataclasses.replace(robot, parameters=robot.parameters.replace(effects=model.effects))
    q, load = np.zeros((1, 6)), robot.load(np.array([[0.0, 0.0, -900.0, 0.0, 0.0, 0.0]]))
    rest = robot.stand(q, load)
    return left_aside(robot, tuple(parts_of(robot, q, load, rest, Conditions.unknown(1))))
