"""Physics that the catalogue lacks is not called by the name of what comes nearest; physics that it has is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from loaded_cases import dahl, friction, shifted, true_state
from robots import loaded_readings

from calibration_core.cell import Cell
from calibration_core.diagnosis import loaded
from calibration_core.diagnosis.empirical import SIZE, rival
from calibration_core.diagnosis.evidence.design import LoadedSelection
from calibration_core.diagnosis.evidence.extended import ExtendedLoadedModel
from calibration_core.diagnosis.findings.loaded import RejectedCandidate
from calibration_core.diagnosis.loaded import diagnose_loaded
from calibration_core.policy import EQUIVALENT

JOINT, SHARE, PHASE = 1, 0.3, 0.2


@pytest.mark.parametrize(
    ("seed", "own", "effects"),
    [(5, 1, {"pose_dependent_stiffness", "off_axis_compliance"}), (7, 2, {"pose_dependent_stiffness"}), (6, 1, set())],
)
def test_a_law_outside_the_catalogue_is_not_called_by_a_name_in_it(
    cell: Cell, seed: int, own: int, effects: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The compliance of joint 2 follows its own and the next angle together; something in the catalogue comes near."""
    readings = loaded_readings(cell, seed, 18)
    state = true_state(readings, cell)
    wave = np.sin(own * state.q[:, JOINT] + state.q[:, JOINT + 1] + PHASE)
    deflection = SHARE * wave * state.compliance[JOINT] * state.load_torque[JOINT]
    held: list[RejectedCandidate] = []
    judge = loaded.rejected_candidates

    def remembered(extended: ExtendedLoadedModel, selection: LoadedSelection) -> tuple[RejectedCandidate, ...]:
        found = judge(extended, selection)
        held.extend(found)
        return found

    monkeypatch.setattr(loaded, "rejected_candidates", remembered)
    found = diagnose_loaded(shifted(readings, cell, state.joint_column(JOINT, deflection)), cell)
    assert {one.candidate.effect for one in held} == effects
    assert found.verdict == "unexplained"
    assert not found.physics
    assert [(law.effect, dict(law.location)) for law in found.findings] == [("empirical_law", {"joint": "joint_2"})]
    assert found.rest.significant
    for effect in effects:
        assert f"Not named, although it comes near: {effect} (" in found.rest.text
    assert ("joint_2 follows the angle " in found.rest.text) == bool(effects)
    assert "agrees with the noise" not in found.rest.text
    assert found.handed_out[0].effects == ()


@pytest.mark.parametrize("seed", [7, *(pytest.param(k, marks=pytest.mark.slow) for k in (6, 8))])
def test_a_softer_flank_is_not_called_friction(cell: Cell, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Joint 2 gives way more under loads of one sign, and less under those of the other.

    That follows the size of the torque at once: a rival of friction, and a possible image of laws without memory.
    """
    readings = loaded_readings(cell, seed, 18)
    state = true_state(readings, cell)
    deflection = SHARE * state.compliance[JOINT] * np.abs(state.load_torque[JOINT])
    seen: list[ExtendedLoadedModel] = []
    judge = loaded.rejected_candidates
    monkeypatch.setattr(
        loaded, "rejected_candidates", lambda extended, selection: seen.append(extended) or judge(extended, selection)
    )
    found = diagnose_loaded(shifted(readings, cell, state.joint_column(JOINT, deflection)), cell)
    assert not {"hysteresis", "creep"} & {one.effect for one in found.findings}
    assert found.verdict in {"unexplained", "partly_explained"}
    extended = dataclasses.replace(seen[-1], accepted=())
    best = {}
    for effect in ("hysteresis", "creep", "nonlinear_stiffness", "backlash"):
        places = [(c.effect, c.location.get("joint")) for c in extended.design.candidates]
        law = rival(extended, (places.index((effect, "joint_2")),))
        assert law is not None
        best[effect] = (law.term.joint, law.term.words)
    assert best["hysteresis"] == best["creep"] == (JOINT, SIZE)
    assert (JOINT, SIZE) not in (best["nonlinear_stiffness"], best["backlash"])


@pytest.mark.parametrize("width", [1.2e-5, 6e-5])  # rad
@pytest.mark.parametrize(
    ("law", "seed"),
    [("Dahl", 7), ("teeth", 7), *(pytest.param(law, 6, marks=pytest.mark.slow) for law in ("Dahl", "teeth"))],
)
def test_friction_of_another_law_that_begins_anywhere_is_friction(
    cell: Cell, law: str, seed: int, width: float
) -> None:
    """Where it stood on arrival in a configuration is neither noise nor a gross error."""
    readings = loaded_readings(cell, seed, 18)
    state = true_state(readings, cell)
    if law == "Dahl":
        lag = friction(state, JOINT, seed, lambda sliding, change: dahl(sliding, change / 0.2))
    else:
        slid = friction(state, JOINT, seed, lambda sliding, change: np.clip(sliding + change / 0.25, -1.0, 1.0))
        lag = 1.5 * slid * np.abs(state.torque[JOINT]) / state.largest_torque(JOINT)
    found = diagnose_loaded(shifted(readings, cell, state.joint_column(JOINT, -width * lag)), cell)
    assert [(one.effect, dict(one.location)) for one in found.findings] == [("hysteresis", {"joint": "joint_2"})]
    claimed = found.identification.noise.claimed
    assert found.noise < 1.2 * claimed
    assert 0.8 * claimed < found.rms_after < 1.1 * claimed
    assert not found.anomalies


def test_a_rejected_candidate_leaves_the_selection(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    readings = loaded_readings(cell, 7, 18)
    state = true_state(readings, cell)
    wave = np.sin(2 * state.q[:, JOINT] + state.q[:, JOINT + 1] + PHASE)
    deflection = SHARE * wave * state.compliance[JOINT] * state.load_torque[JOINT]
    seen: list[tuple[ExtendedLoadedModel, LoadedSelection]] = []
    monkeypatch.setattr(
        loaded, "rejected_candidates", lambda extended, selection: seen.append((extended, selection)) or ()
    )
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
    assert without.level == selection.level
    assert selection.without(selection.choices).accepted == ()
    assert selection.without([]).choices == selection.choices
