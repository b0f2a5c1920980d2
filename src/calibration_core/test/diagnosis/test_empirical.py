"""The empirical law: found where a joint follows something outside the catalogue, and not where nothing is followed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from loaded_cases import shifted, true_state
from robots import loaded_readings

from calibration_core.cell import Cell
from calibration_core.diagnosis import loaded
from calibration_core.diagnosis.empirical import dictionary, empirical_law
from calibration_core.diagnosis.evidence.extended import ExtendedLoadedModel
from calibration_core.diagnosis.loaded import diagnose_loaded
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.identification.statistics import whitened
from calibration_core.report.diagnosis_summary import diagnosis_summary
from calibration_core.report.documents.diagnosis import diagnosis_document
from calibration_core.report.results.diagnosis import diagnosis_dict
from calibration_core.report.results.traffic_light import light_of

JOINT, OTHER, SHARE, PHASE = 1, 2, 0.25, 0.7


@pytest.fixture(scope="module")
def diagnosed(cell: Cell) -> tuple[Diagnosis, ExtendedLoadedModel]:
    """A recording in which the compliance of joint 2 follows its own and the next angle together."""
    readings = loaded_readings(cell, 5, 18)
    state = true_state(readings, cell)
    wave = np.sin(2 * state.q[:, JOINT] + 3 * state.q[:, OTHER] + PHASE)
    deflection = SHARE * wave * state.compliance[JOINT] * state.load_torque[JOINT]
    held: list[ExtendedLoadedModel] = []
    seen = loaded.what_remains

    def remembered(extended: ExtendedLoadedModel, *rest: object) -> object:
        held.append(extended)
        return seen(extended, *rest)  # type: ignore[arg-type]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loaded, "what_remains", remembered)
        found = diagnose_loaded(shifted(readings, cell, state.joint_column(JOINT, deflection)), cell)
    return found, held[-1]


def test_a_law_outside_the_catalogue_is_found_with_its_joint_and_what_it_follows(
    diagnosed: tuple[Diagnosis, ExtendedLoadedModel],
) -> None:
    found, _ = diagnosed
    assert found.verdict == "unexplained"
    assert not found.physics
    (law,) = found.findings
    assert (law.effect, law.family, dict(law.location)) == ("empirical_law", "empirical", {"joint": "joint_2"})
    assert law.variant == "the angle 2 joint_2 + 3 joint_3"
    assert "not physics" in law.explanation
    assert law.held_out_gain > 0.3
    values = {p.name[:3]: p for p in law.parameters}
    for name, true in (("cos", SHARE * np.sin(PHASE)), ("sin", SHARE * np.cos(PHASE))):
        assert abs(values[name].value - true) < 4 * values[name].std
        assert values[name].std < 0.1 * SHARE


def test_a_law_is_said_but_stands_in_no_model_and_no_stiffness(
    diagnosed: tuple[Diagnosis, ExtendedLoadedModel], cell: Cell
) -> None:
    found, extended = diagnosed
    assert found.handed_out[0].effects == ()
    assert np.array_equal(found.compliance, extended.compliance)
    content = diagnosis_dict(found, cell)
    assert [f["family"] for f in content["findings"]] == ["empirical"]
    assert content["unexplained"]["significant"]
    assert "no physics" in content["unexplained"]["text"]
    assert "follows a law that fits, without a known cause" in diagnosis_summary(found)
    words = str(diagnosis_document(found, cell, b"{}", light_of(content)))
    assert "it is a law that fits, nothing more" in words
    assert "no effect of the catalogue stands out" in words.lower()
    assert "which is no physics" in words


def test_a_rest_without_a_law_gives_none(diagnosed: tuple[Diagnosis, ExtendedLoadedModel]) -> None:
    """The rest of every configuration is as large as that of the law, but follows nothing."""
    _, extended = diagnosed
    state, design = extended.state, extended.design
    assert empirical_law(extended) is not None
    raw = state.joint_column(JOINT, state.compliance[JOINT] * state.load_torque[JOINT])

    column, _ = whitened(extended.rows, raw[extended.used][:, :, None])
    false = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        erratic = rng.standard_normal(18)[design.configuration]
        value = SHARE * erratic * column[:, 0] + rng.standard_normal(len(column))
        drawn = dataclasses.replace(extended, design=dataclasses.replace(design, residual=value))
        false += empirical_law(drawn) is not None
    assert false <= 2


def test_every_term_moves_the_points_by_its_own_joint_alone(diagnosed: tuple[Diagnosis, ExtendedLoadedModel]) -> None:
    _, extended = diagnosed
    state = extended.state
    withins, terms = dictionary(state)
    assert {term.joint for term in terms} == set(range(6))
    for term in terms[:: len(terms) // 20]:
        columns = term.columns(state, withins)
        assert columns.shape == (state.m, 3, len(term.names))
        direction = state.answer[:, term.joint].T
        across = np.cross(columns[:, :, 0], direction)
        assert np.abs(across).max() < 1e-9 * max(np.abs(columns).max() * np.abs(direction).max(), 1e-30)
