"""Physics that the catalogue lacks is not called by the name of what comes nearest; physics that it has is."""

from __future__ import annotations

import numpy as np
import pytest
from loaded_cases import shifted, true_state
from robots import loaded_readings, write_cell

from calibration_core.cell import Cell
from calibration_core.diagnosis import loaded
from calibration_core.diagnosis.empirical import EQUIVALENT, rival
from calibration_core.diagnosis.extended import Extended
from calibration_core.diagnosis.loaded import diagnose_loaded
from calibration_core.diagnosis.selection import Selection
from calibration_core.diagnosis.withheld import Withheld

JOINT, SHARE, PHASE = 1, 0.3, 0.2


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    return write_cell(tmp_path_factory.mktemp("cell"))


@pytest.mark.parametrize(
    ("seed", "own", "effects"), [(6, 1, {"base_compliance"}), (7, 2, {"pose_dependent_stiffness"})]
)
def test_a_law_outside_the_catalogue_is_not_called_by_a_name_in_it(
    cell: Cell, seed: int, own: int, effects: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The compliance of joint 2 follows its own and the next angle together; something in the catalogue comes near."""
    readings = loaded_readings(cell, seed, 18)
    state = true_state(readings, cell)
    wave = np.sin(own * state.q[:, JOINT] + state.q[:, JOINT + 1] + PHASE)
    deflection = SHARE * wave * state.compliance[JOINT] * state.load_torque[JOINT]
    held: list[Withheld] = []
    judge = loaded.withheld

    def remembered(extended: Extended, selection: Selection) -> tuple[Withheld, ...]:
        found = judge(extended, selection)
        held.extend(found)
        return found

    monkeypatch.setattr(loaded, "withheld", remembered)
    found = diagnose_loaded(shifted(readings, cell, state.joint_column(JOINT, deflection)), cell)
    assert {one.candidate.effect for one in held} == effects
    assert found.verdict == "unexplained"
    assert not found.physics
    assert [(law.effect, dict(law.location)) for law in found.findings] == [("empirical_law", {"joint": "joint_2"})]
    assert found.rest.significant
    for effect in effects:
        assert f"Not named, although it comes near: {effect} (" in found.rest.text
    assert "That joint_2 follows the angle " in found.rest.text
    assert "agrees with the noise" not in found.rest.text
    assert found.model is not None
    assert found.model.effects == ()


def test_what_is_withheld_leaves_the_selection(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    readings = loaded_readings(cell, 7, 18)
    state = true_state(readings, cell)
    wave = np.sin(2 * state.q[:, JOINT] + state.q[:, JOINT + 1] + PHASE)
    deflection = SHARE * wave * state.compliance[JOINT] * state.load_torque[JOINT]
    seen: list[tuple[Extended, Selection]] = []
    monkeypatch.setattr(loaded, "withheld", lambda extended, selection: seen.append((extended, selection)) or ())
    diagnose_loaded(shifted(readings, cell, state.joint_column(JOINT, deflection)), cell)
    extended, selection = next(one for one in seen if one[1].choices)
    choice = selection.choices[0]
    law = rival(extended, (choice.candidate,))
    assert law is not None
    assert law.term.words == "the angle 2 joint_2 + joint_3"
    assert law.log_bayes_factor > law.own + EQUIVALENT
    without = selection.without([choice])
    assert without.accepted == tuple(i for i in selection.accepted if i not in {choice.candidate, *choice.refinements})
    assert without.choices == selection.choices[1:]
    assert (without.level, without.limit) == (selection.level, selection.limit)
    assert selection.without(selection.choices).accepted == ()
    assert selection.without([]).choices == selection.choices
