"""Concealed causes that were once named wrongly, or beside others that are none.

Each is one scenario of the second grid, diagnosed as a user would; what it guards stands with it.  Of those that guard
one thing in several recordings, `make test` takes one or two, and `make prove` all.
"""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import load_cell
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.files.yaml_file import yaml_text
from calibration_sim.scenarios.generate import generate
from calibration_sim.scenarios.grid import Scenario, second_grid

SEED, PUBLISHED = 20265, 20261


@functools.cache
def scenarios(seed: int) -> tuple[Scenario, ...]:
    return second_grid(seed)


@dataclasses.dataclass(frozen=True)
class Answered:
    """What was concealed, and what was found."""

    label: dict[str, object]
    found: Diagnosis


def answered(number: int, folder: Path, seed: int = SEED) -> Answered:
    made = generate(scenarios(seed)[number])
    path = folder / "cell.yaml"
    path.write_text(yaml_text(made.cell))
    return Answered(made.label, diagnose(made.readings, load_cell(path)))


@pytest.mark.parametrize(
    ("number", "effect", "place"),
    [
        pytest.param(91, "off_axis_compliance", {"joint": "joint_4"}, id="a bearing of a robot in modified rows"),
        pytest.param(
            206,
            "gravity_compensator",
            {"joint": "joint_2"},
            id="a spring, most of whose forms are impossible",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            140,
            "hysteresis",
            {"joint": "joint_6"},
            id="a joint that lags on its way to a posture, too",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            153, "backlash", {"joint": "joint_5"}, id="one joint, and no other a little", marks=pytest.mark.slow
        ),
        pytest.param(
            130, "link_bending", {"link": "link_4"}, id="a link whose motors rest on its joint", marks=pytest.mark.slow
        ),
    ],
)
def test_the_cause_is_named_alone(number: int, effect: str, place: dict[str, str], tmp_path: Path) -> None:
    answer = answered(number, tmp_path)
    (finding,) = answer.found.findings
    assert (finding.effect, dict(finding.location)) == (effect, place)


@pytest.mark.parametrize(
    ("number", "effect", "place"),
    [
        pytest.param(22, "link_bending", {"link": "link_2"}, id="at rest"),
        pytest.param(117, "gravity_compensator", {"joint": "joint_2"}, id="beside loads", marks=pytest.mark.slow),
    ],
)
def test_what_is_missing_does_not_hide_the_geometry(
    number: int, effect: str, place: dict[str, str], tmp_path: Path
) -> None:
    """Frames alone explain as much as the geometry does, as long as a large effect is missing."""
    answer = answered(number, tmp_path)
    (finding,) = answer.found.findings
    assert (finding.effect, dict(finding.location)) == (effect, place)
    assert answer.found.verdict == "missing_physics"
    assert answer.found.compliance is not None
    true = 1 / np.array(answer.label["stiffness"])
    loaded = [1, 2]  # most by the weight
    np.testing.assert_allclose(answer.found.compliance[loaded], true[loaded], rtol=0.03)


@pytest.mark.parametrize(
    ("seed", "number", "causes"),
    [
        pytest.param(
            9001,
            244,
            {("backlash", "joint_2"), ("gravity_compensator", "joint_2")},
            id="a spring unloads the clearance",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            9002,
            245,
            {("hysteresis", "joint_1"), ("gravity_compensator", "joint_2")},
            id="friction as the joint arrived",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            9001,
            259,
            {("hysteresis", "joint_6"), ("transmission_error", "joint_5")},
            id="friction, hardly loaded",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            8086, 213, {("backlash", "joint_3"), ("transmission_error", "joint_3")}, id="clearance of a wide transition"
        ),
        pytest.param(
            PUBLISHED,
            228,
            {("soft_zone", "joint_2"), ("gravity_compensator", "joint_2")},
            id="a spring that other effects of its joint imitate",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_two_causes_under_load_and_at_rest_have_no_third(
    seed: int, number: int, causes: set[tuple[str, str]], tmp_path: Path
) -> None:
    """What a law leaves at another torque than its joint carries, or on arrival, is no cause of its own."""
    found = answered(number, tmp_path, seed).found
    assert {(f.effect, str(f.location["joint"])) for f in found.findings} == causes
    assert len(found.findings) == 2


@pytest.mark.slow
def test_a_joint_whose_law_is_open_has_a_stiffness_as_uncertain_as_the_law_is_large(tmp_path: Path) -> None:
    """Friction of another law, under loads and at rest: its compliance was 11 standard deviations from the truth."""
    answer = answered(218, tmp_path, PUBLISHED)
    law = {str(one.location["joint"]): one for one in answer.found.findings}["joint_6"]
    assert (law.effect, law.law_settled) == ("hysteresis", False)
    assert answer.found.compliance is not None
    assert answer.found.compliance_covariance is not None
    off = answer.found.compliance - 1 / np.array(answer.label["stiffness"])
    assert np.abs(off / np.sqrt(np.diag(answer.found.compliance_covariance))).max() < 3


def test_friction_of_another_law_is_one_cause_with_an_open_law(tmp_path: Path) -> None:
    """Wedge friction leaves something to creep at the same joint: both remember, and neither is settled."""
    answer = answered(347, tmp_path)
    (finding,) = answer.found.findings
    assert (finding.effect, dict(finding.location)) == ("hysteresis", {"joint": "joint_3"})
    assert not finding.law_settled
    assert [words.split()[0] for words in finding.refinements] == ["creep"]
    assert "the form of its law is not" in finding.explanation


@pytest.mark.slow
def test_what_friction_of_another_law_leaves_at_its_joint_is_no_cause_of_its_own(tmp_path: Path) -> None:
    """The rest of its loops looks like a stiffness that follows the load, and one that follows the angle."""
    answer = answered(354, tmp_path)
    (finding,) = answer.found.findings
    assert (finding.effect, dict(finding.location)) == ("hysteresis", {"joint": "joint_2"})
    assert not finding.law_settled
    beside = {words.split()[0] for words in finding.refinements}
    assert beside & {"nonlinear_stiffness", "pose_dependent_stiffness"}


@pytest.mark.slow
def test_friction_that_scatters_is_not_taken_for_noise(tmp_path: Path) -> None:
    """Uneven friction jumps from step to step as correlated noise of the tracker does, but along its joint alone."""
    found = answered(328, tmp_path).found
    assert found.verdict == "partly_explained"
    assert [(f.effect, dict(f.location)) for f in found.findings] == [("hysteresis", {"joint": "joint_1"})]
    assert list(found.rest.where["joints"]) == ["joint_1"]  # type: ignore[call-overload]
    assert "in which joint_1 moves them" in found.rest.text
    assert "The noise of the tracker has no such direction: the cause is at this joint" in found.rest.text


@pytest.mark.parametrize(
    "number",
    [
        pytest.param(552, id="a drift of the tracker", marks=pytest.mark.slow),
        pytest.param(554, id="a drift of the sensor"),
        pytest.param(586, id="a gear's order", marks=pytest.mark.slow),
    ],
)
def test_noise_that_lasts_is_no_cause(number: int, tmp_path: Path) -> None:
    """What is left of a posture's noise at the next one adds up as a drift does, or resembles waves of a joint."""
    answer = answered(number, tmp_path, PUBLISHED)
    assert not answer.label["effects"]
    assert (answer.found.verdict, answer.found.findings) == ("consistent", ())


@pytest.mark.parametrize(
    ("number", "joint"),
    [
        pytest.param(275, 0, id="a law that is no physics of the catalogue"),
        pytest.param(336, 0, id="a law of another form at its joint", marks=pytest.mark.slow),
    ],
)
def test_the_stiffness_of_a_joint_is_as_uncertain_as_its_law_is_open(number: int, joint: int, tmp_path: Path) -> None:
    """It was 58 and 31 standard deviations off, which said nothing of other forms of the law."""
    answer = answered(number, tmp_path, PUBLISHED)
    found = answer.found
    assert found.compliance is not None
    assert found.compliance_covariance is not None
    true, std = 1 / np.array(answer.label["stiffness"]), np.sqrt(np.diag(found.compliance_covariance))
    assert abs(found.compliance[joint] - true[joint]) < 2.5 * std[joint]
    assert found.stiffness[f"joint_{joint + 1}"][1] == pytest.approx(
        std[joint] / found.compliance[joint] ** 2, rel=1e-6
    )
    written = dict(zip(found.estimate.names, found.estimate.std, strict=True))  # in the model file
    assert written[f"compliance.joint_{joint + 1}"] == pytest.approx(std[joint], rel=1e-6)
    others = np.arange(len(true)) != joint
    assert np.median(std[others] / true[others]) < 0.02  # what else is known stays known


@pytest.mark.parametrize(
    ("seed", "number", "effect"),
    [
        pytest.param(PUBLISHED, 361, "soft_zone", id="the weakest zone resembles a clearance", marks=pytest.mark.slow),
        pytest.param(SEED, 368, "hysteresis", id="friction resembles creep", marks=pytest.mark.slow),
        pytest.param(4711, 384, "hysteresis", id="two laws share a joint", marks=pytest.mark.slow),
        pytest.param(PUBLISHED, 389, "soft_zone", id="two laws are open, and no sensor", marks=pytest.mark.slow),
    ],
)
def test_where_every_joint_has_one_law_no_other_is_named(seed: int, number: int, effect: str, tmp_path: Path) -> None:
    found = answered(number, tmp_path, seed).found
    assert {one.effect for one in found.findings} == {effect}
    assert len({str(one.location) for one in found.findings}) == len(found.findings) >= 5


@pytest.mark.slow
def test_a_compliance_that_is_none_is_zero_to_the_last_digit(tmp_path: Path) -> None:
    """It was -1e-31 rad/(N*m)."""
    found = answered(244, tmp_path, PUBLISHED).found
    (tool,) = (one for one in found.findings if one.effect == "tool_compliance")
    assert [one.value for one in tool.parameters if one.name == "rotation_z"] == [0.0]
    assert all(one.value >= 0.0 and one.interval[0] >= 0.0 for one in tool.parameters)
