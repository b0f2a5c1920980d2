"""What the joint-only model leaves out on a FANUC R-2000iC under 43 cable loads, measured by others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import load_cell
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.loaded import diagnose_loaded
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.observations.observe import observe

REAL = Path(__file__).parents[2] / "shared/data/real"
BAR = 0.22e-3  # m, mean error of loads left out; 0.331 mm without the extension

pytestmark = pytest.mark.skipif(not REAL.is_dir(), reason=f"no real recordings at {REAL}")


@pytest.fixture(scope="module")
def fanuc() -> Diagnosis:
    cell = load_cell(REAL / "fanuc.cell.yaml")
    return diagnose_loaded(observe(REAL / "fanuc.csv", cell), cell)


def test_the_joint_only_model_is_rejected_and_the_structure_named(fanuc: Diagnosis) -> None:
    assert fanuc.verdict in {"missing_physics", "partly_explained"}
    finding, *others = fanuc.findings
    assert all(other.log_bayes_factor < 0.5 * finding.log_bayes_factor for other in others)
    assert all(other.magnitude < 0.25 * finding.magnitude for other in others)
    assert finding.family == "structure"
    said = {(finding.effect, *finding.location.values())}
    said |= {(other.effect, *other.location.values()) for other in finding.cannot_be_told_from}
    assert {("off_axis_compliance", "joint_4"), ("link_bending", "link_4")} <= said
    assert finding.log_bayes_factor > 10
    assert finding.separate_by


def test_few_added_parameters_predict_left_out_loads_better(fanuc: Diagnosis) -> None:
    figures = fanuc.further_figures
    assert sum(len(finding.parameters) for finding in fanuc.findings) <= 9
    assert figures["held_out_mean_before"] == pytest.approx(0.33e-3, rel=0.03)
    assert figures["held_out_mean_after"] <= BAR


def test_no_compliance_is_negative_and_no_hinge_twists_without_bending(fanuc: Diagnosis) -> None:
    hinges = [f for f in fanuc.findings if {p.name for p in f.parameters} >= {"compliance_x", "compliance_y"}]
    assert hinges
    for finding in hinges:
        value = {p.name: p.value for p in finding.parameters}
        matrix = np.array(
            [[value["compliance_x"], value["compliance_xy"]], [value["compliance_xy"], value["compliance_y"]]]
        )
        assert np.linalg.eigvalsh(matrix)[0] >= -1e-9 * np.abs(matrix).max()


def test_joints_that_are_coupled_give_way_together_as_springs_do(fanuc: Diagnosis) -> None:
    """The compliance of two joints, with the coupling between them, is a positive matrix."""
    joints = list(fanuc.stiffness)
    assert fanuc.compliance is not None
    for finding in fanuc.findings:
        if finding.effect == "joint_coupling":
            first, second = (joints.index(name) for name in finding.location["joints"])
            (between,) = (p.value for p in finding.parameters)
            assert between**2 < fanuc.compliance[first] * fanuc.compliance[second]
    assert {finding.effect for finding in fanuc.findings} == {"off_axis_compliance", "joint_coupling"}


@pytest.mark.parametrize(
    ("recording", "cell", "least"),
    [
        ("fanuc", "fanuc", 1),
        *(pytest.param(f"{name}_grid", name, 3, marks=pytest.mark.slow) for name in ("ur5", "wam")),
    ],
)
def test_what_is_confounded_is_within_five_nats_nearest_first(recording: str, cell: str, least: int) -> None:
    """What is far more probable than a finding was refused for what it predicts: it is no alternative either."""
    where = load_cell(REAL / f"{cell}.cell.yaml")
    found = diagnose(observe(REAL / f"{recording}.csv", where), where)
    several = [(finding, finding.cannot_be_told_from) for finding in found.findings if finding.cannot_be_told_from]
    assert len(several) >= least
    for finding, alternatives in several:
        apart = [abs(other.log_bayes_factor - finding.log_bayes_factor) for other in alternatives]
        assert len(apart) <= 5
        assert max(apart) <= 5 + 1e-9
        assert apart == sorted(apart)


def test_what_the_model_leaves_is_never_stated_as_the_noise(fanuc: Diagnosis) -> None:
    """Two steps a configuration show no noise: what is stated is the tracker's claim."""
    assert fanuc.rms_after > 2 * fanuc.noise
    assert fanuc.noise == pytest.approx(20e-6)


def test_the_bias_of_all_findings_together_is_not_stated_as_that_of_one(fanuc: Diagnosis) -> None:
    assert len(fanuc.findings) == 2
    for finding in fanuc.findings:
        assert "Leaving all findings out biases the stiffness of joint_1" in finding.explanation
