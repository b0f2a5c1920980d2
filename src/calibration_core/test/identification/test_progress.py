"""While measuring: intervals so far and at the end, a configuration that does not fit, enough, and what comes next."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from robots import LEVELS, STIFFNESS, loaded_readings

from calibration_core.cell import Cell
from calibration_core.errors import IdentificationError
from calibration_core.identification.identify import identify
from calibration_core.identification.progress import progress
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.simulation.simulate import simulate_plan
from calibration_core.timeseries import Readings

ALL = 14


@dataclasses.dataclass(frozen=True)
class Planned:
    """A configuration of the plan."""

    number: int
    q: np.ndarray
    steps: np.ndarray


@pytest.fixture(scope="module")
def plan() -> list[Planned]:
    """Return random configurations with oblique pulls."""
    rng = np.random.default_rng(17)
    found = []
    for number in range(1, ALL + 1):
        q = rng.uniform([-1.5, -0.6, -0.6, -2, -1.5, -2], [1.5, 0.6, 0.9, 2, 1.5, 2])
        pull = rng.normal(size=6) * [1, 1, 1, 0.2, 0.2, 0.2]
        found.append(Planned(number, q, np.outer(LEVELS, 2300 / np.linalg.norm(pull[:3]) * pull)))
    return found


@pytest.fixture(scope="module")
def readings(cell: Cell, plan: list[Planned]) -> Readings:
    """Return a whole session."""
    truth = nominal_parameters(cell).replace(compliance=1 / np.array(STIFFNESS))
    return simulate_plan(plan, cell, truth, 5)


def first(readings: Readings, count: int) -> Readings:
    return readings.select(readings.configuration <= count)


def test_at_the_end_it_says_what_the_evaluation_says(cell: Cell, readings: Readings) -> None:
    reported, found = progress(readings, cell), identify(readings, cell)
    assert reported.configuration == ALL
    assert reported.stiffness == pytest.approx([joint.value for joint in found.stiffness])
    assert reported.interval == pytest.approx(np.array([joint.interval for joint in found.stiffness]))
    std = np.array([joint.compliance_std / joint.compliance for joint in found.stiffness])
    assert reported.accuracy == pytest.approx(1.959964 * std, rel=1e-6)
    assert reported.expected == pytest.approx(reported.accuracy)
    assert (reported.next_configuration, reported.suspicious, reported.enough) == (None, False, False)


def test_intervals_narrow_towards_what_was_expected(cell: Cell, plan: list[Planned], readings: Readings) -> None:
    reported = [progress(first(readings, k), cell, plan[k:]) for k in (3, 6, 10, ALL)]
    for before, after in itertools.pairwise(reported):
        assert np.all(after.accuracy < before.accuracy)
        assert np.all(before.expected <= before.accuracy)
    seen = reported[-1].accuracy
    for early in reported[1:3]:
        assert early.expected == pytest.approx(seen, rel=0.15)
    assert np.all(np.abs(np.log(reported[-1].stiffness / STIFFNESS)) < 3 * reported[-1].accuracy)


def test_before_the_first_loads_there_is_nothing_to_tell(cell: Cell, readings: Readings) -> None:
    with pytest.raises(IdentificationError, match="at least 2"):
        progress(first(readings, 1), cell)
    with pytest.raises(IdentificationError, match="no load yet"):
        progress(readings.select(readings.step == 0), cell)


def test_a_sound_configuration_raises_no_alarm(cell: Cell) -> None:
    alarms = 0
    for seed in range(10):
        readings = loaded_readings(cell, 100 + seed, configurations=9)
        alarms += sum(progress(first(readings, k), cell).suspicious for k in (5, 7, 9))
    assert alarms <= 1


def moved(readings: Readings, number: int, by: np.ndarray) -> Readings:
    """Return readings of which a configuration's loaded ones lie elsewhere: a target that slipped under load."""
    position = np.array(readings.position)
    rows = (readings.configuration == number) & (readings.step == 2)
    position[rows] += by
    return dataclasses.replace(readings, position=position)


def test_a_configuration_that_does_not_fit_is_flagged_at_once(cell: Cell, readings: Readings) -> None:
    wrong = moved(first(readings, 8), 8, np.array([3e-4, -2e-4, 3e-4]))
    reported = progress(wrong, cell)
    assert reported.suspicious
    assert "configuration 8 does not fit the others" in reported.text
    sound = progress(first(readings, 8), cell)
    assert not sound.suspicious
    assert sound.misfit < sound.misfit_limit
    before = moved(first(readings, 9), 8, np.array([3e-4, -2e-4, 3e-4]))
    assert not progress(before, cell).suspicious  # the one measured last is asked about


def test_a_wrong_load_is_flagged(cell: Cell, readings: Readings) -> None:
    """A cable that touched something: the wrench that was recorded did not act."""
    eighth = first(readings, 8)
    assert eighth.wrench is not None
    wrench = np.array(eighth.wrench)
    wrench[eighth.configuration == 8] *= 0.8
    reported = progress(dataclasses.replace(eighth, wrench=wrench), cell)
    assert reported.suspicious
    assert reported.misfit > reported.misfit_limit


def test_enough_is_said_once_every_joint_has_the_wanted_accuracy(cell: Cell, readings: Readings) -> None:
    worst = float(progress(readings, cell).accuracy.max())
    assert progress(readings, cell, wanted=1.01 * worst).enough
    assert not progress(readings, cell, wanted=0.99 * worst).enough
    assert not progress(readings, cell, wanted=0.0).enough
    assert "enough" in progress(readings, cell, wanted=1.01 * worst).text


def test_the_next_configuration_is_the_one_that_helps_the_worst_joint_most(
    cell: Cell, plan: list[Planned], readings: Readings
) -> None:
    """Tried out: none of those offered leaves a smaller expected error of the worst joint."""
    offered = plan[5:]
    reported = progress(first(readings, 5), cell, offered[:5], offered[5:])
    alone = {one.number: float(progress(first(readings, 5), cell, [one]).expected.max()) for one in offered}
    assert reported.next_configuration == min(alone, key=lambda number: alone[number])
    assert f"configuration {reported.next_configuration} would add most" in reported.text


def test_unloaded_phases_before_do_not_disturb(cell: Cell, readings: Readings) -> None:
    swept = readings.select(readings.step == 0)
    swept = dataclasses.replace(swept, configuration=swept.configuration + 1000)
    names = [f.name for f in dataclasses.fields(Readings) if isinstance(getattr(readings, f.name), np.ndarray)]
    both = dataclasses.replace(
        readings, **{name: np.concatenate([getattr(swept, name), getattr(readings, name)]) for name in names}
    )
    reported, alone = progress(both, cell), progress(readings, cell)
    assert reported.accuracy == pytest.approx(alone.accuracy, rel=1e-2)
    assert not reported.suspicious
