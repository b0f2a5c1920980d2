"""Effects written into a model mean the same on another recording."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import STIFFNESS, loaded_readings

from calibration_core.cell import Cell
from calibration_core.identification.stiffness.problem import build_problem
from calibration_core.model.effects import candidates, effects_with
from calibration_core.model.effects.applied import REFERENCE, applied, applied_shift
from calibration_core.model.effects.candidate import Trait
from calibration_core.model.effects.state import State, state_of
from calibration_core.model.effects.structure.gravity_compensator import Triangle, spring, triangle_of
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import load_of
from calibration_core.timeseries import Readings

SINCE_THE_BEGINNING = {"creep", "tracker_drift", "wrench_drift"}  # of a recording, which a part lacks


def state_at(readings: Readings, cell: Cell) -> State:
    model = nominal_parameters(cell).replace(compliance=1 / np.array(STIFFNESS))
    problem = build_problem(readings, cell, chain_of(cell), model)
    points = np.stack([model.points[name] for name in readings.points])[readings.point].T
    return state_of(
        chain_of(cell), readings.q, model.compliance, load_of(readings, cell, model), points,
        point_index=readings.point, wrench=readings.wrench, configuration=problem.configuration, step=readings.step,
        time=readings.time, temperature=readings.temperature, tracker=model.tracker, rated_load=240.0,
    )  # fmt: skip


def test_an_effect_stays_the_same_law_on_a_part_of_the_recording(cell: Cell) -> None:
    """All of the catalogue: laws relative to the largest torque, and no others, keep that torque with them."""
    readings = loaded_readings(cell, 1)
    whole = state_at(readings, cell)
    weak = np.isin(readings.configuration, readings.configuration[np.argsort(np.abs(whole.load_torque[1]))[:60]])
    strongest = readings.configuration[np.argmax(np.abs(whole.load_torque[1]))]
    some = weak & (readings.configuration != strongest)
    part = state_at(readings.select(some), cell)
    assert part.largest_torque(1) < whole.largest_torque(1)
    at_second = [c for c in candidates(whole) if c.location.get("joint", "joint_2") == "joint_2"]
    effects = {candidate.effect for candidate in at_second}
    assert len(effects) >= 12
    relative, referring = set(), set()
    for candidate in at_second:
        effect, value = candidate.effect, np.array([p.typical for p in candidate.parameters])
        known = applied(candidate, value, whole)
        expected = (candidate.columns(whole) @ value)[some]
        if effect not in SINCE_THE_BEGINNING:
            np.testing.assert_allclose(applied_shift([known], part), expected, atol=1e-12, err_msg=effect)
        if REFERENCE in known.parameters:
            assert known.parameters[REFERENCE] == whole.largest_torque(1, candidate.shape)
            free = dataclasses.replace(known, parameters={k: v for k, v in known.parameters.items() if k != REFERENCE})
            referring.add(effect)
            if np.abs(applied_shift([free], part) - expected).max() > 1e-7:
                relative.add(effect)
    declared = effects_with(Trait.OF_LARGEST_TORQUE)
    assert referring == declared <= effects
    assert relative >= declared - {"backlash"}  # which lies at its flank in all of these readings


@settings(deadline=None)  # how fast a machine is says nothing of a spring
@given(anchor=st.floats(-400, 800), flatness=st.floats(0.05, 0.9), preload=st.floats(0.05, 0.9))
def test_a_spring_of_any_shape_is_restored_from_its_variant(
    cell: Cell, anchor: float, flatness: float, preload: float
) -> None:
    state = state_at(loaded_readings(cell, 1), cell)
    candidate = spring(state, 1, Triangle(anchor, flatness, preload))
    told = triangle_of(candidate.variant)
    assert told is not None
    assert abs((told.anchor - anchor + 180) % 360 - 180) <= 0.051
    assert abs(told.flatness - flatness) <= 0.00051
    assert abs(told.preload - preload) <= 0.00051
    value = np.array([-3000.0, 400.0])
    shift = applied_shift([applied(candidate, value, state)], state)
    np.testing.assert_array_equal(shift, candidate.columns(state) @ value)


@pytest.mark.parametrize(
    "variant",
    [
        "torque, anchor 5 deg, flatness 1.2, preload 0.5",
        "torque, anchor -5 deg, flatness 0.2, preload 0.5",
        "torque, anchor 5 deg, flatness 0.2",
        "torque, anchor 5 deg, flatness 0.2, preload 0.5 ",
    ],
)
def test_a_spring_that_cannot_be_is_refused(cell: Cell, variant: str) -> None:
    state = state_at(loaded_readings(cell, 1), cell)
    known = applied(spring(state, 1, Triangle(5.0, 0.2, 0.5)), np.array([1.0, 1.0]), state)
    with pytest.raises(ValueError, match="cannot be evaluated"):
        applied_shift([dataclasses.replace(known, variant=variant)], state)
    with pytest.raises(ValueError, match="cannot be evaluated"):
        applied_shift([dataclasses.replace(known, location={"joint": "joint_9"})], state)
