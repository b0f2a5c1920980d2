"""Diagnosis of absolute recordings of simulated robots: what was planted is found, and nothing where nothing is."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from absolute_cases import SIGMA, make_cell, make_readings, random_angles, truth_of

from calibration_core.cell import Cell
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.positions import diagnose_still
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.estimation.alternatives import equivalents
from calibration_core.estimation.estimate import estimate
from calibration_core.identification.absolute.evaluate import evaluate_absolute
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.model.effects.absolute.approach_direction import last_motion
from calibration_core.model.effects.structure.gravity_compensator import Triangle, spring_torque, triangle_of
from calibration_core.model.kinematics import posture
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import gravity_torque
from calibration_core.policy import EQUIVALENT
from calibration_core.report.diagnosis_summary import diagnosis_summary
from calibration_core.timeseries import Readings

POINTS = ("mp1", "mp2", "mp3")
SEED, CONFIGURATIONS = 5, 60
WAVES = {2: (1.5e-4, 0.5), 7: (1.0e-4, -1.0)}


@pytest.fixture(scope="module")
def cell() -> Cell:
    return make_cell(points=POINTS)


def planted(cell: Cell, q: np.ndarray, extra: np.ndarray, seed: int = SEED) -> Readings:
    """Return readings whose joints stand `extra` rad from where the encoders say; same robot for the same `SEED`."""
    truth = truth_of(cell, SEED)
    seen = make_readings(cell, truth, q + extra, seed=seed)
    return dataclasses.replace(seen, q=np.repeat(q, len(cell.points), axis=0))


def waves(q: np.ndarray) -> np.ndarray:
    extra = np.zeros_like(q)
    extra[:, 1] = sum(size * np.sin(k * q[:, 1] + phase) for k, (size, phase) in WAVES.items())
    return extra


def named(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    return [(f.effect, str(*f.location.values())) for f in diagnosis.findings]


def test_a_second_recording_is_held_against_noise_that_is_less_than_claimed() -> None:
    """The tracker is three times as good as its claim; what the joints do besides, in the test alone, is as large."""
    q, other = random_angles(SEED, CONFIGURATIONS, 6), random_angles(99, 25, 6)
    quiet = make_cell(points=POINTS, instruments={"tracker": {"sigma": 3 * SIGMA}})
    for more, verdict in ((0.0, "missing_physics"), (1e-4, "partly_explained")):
        extra = waves(other)
        extra[:, 0] += more * np.sin(3 * other[:, 0])
        found = diagnose(planted(quiet, q, waves(q)), quiet, test=planted(quiet, other, extra, seed=7))
        assert found.verdict == verdict


@pytest.mark.parametrize("points", [("mp1",), POINTS])
def test_what_physics_explains_is_no_noise(points: tuple[str, ...]) -> None:
    """A tracker that is worse than its claim, and as stated, beside gears that move the points twenty times as far."""
    cell, q = make_cell(points=points), random_angles(SEED, CONFIGURATIONS, 6)
    truth = truth_of(cell, SEED)
    extra = 6e-4 * np.sin(2 * q + np.arange(6))
    for noise in (1.0, 1.5):
        seen = make_readings(cell, truth, q + extra, noise=noise * SIGMA, seed=SEED)
        found = diagnose(dataclasses.replace(seen, q=np.repeat(q, len(points), axis=0)), cell)
        assert {one.effect for one in found.findings} == {"transmission_error"}
        assert found.noise_known < 1.1 * noise * SIGMA


def test_transmission_error_is_found_with_its_orders_and_proven_on_other_poses(cell: Cell) -> None:
    q, other = random_angles(SEED, CONFIGURATIONS, 6), random_angles(99, 25, 6)
    test = planted(cell, other, waves(other), seed=7)
    found = diagnose_still(planted(cell, q, waves(q)), cell, test=test)
    assert found.verdict == "missing_physics"
    assert named(found) == [("transmission_error", "joint_2")]
    finding = found.findings[0]
    lines = diagnosis_summary(found).splitlines()
    (said,) = [line for line in lines if line.startswith("1. ")]
    assert re.match(
        r"1\. the gear of joint 2 runs unevenly: moves the points by .* µm rms; .* evidence, and .* %", said
    )
    assert max(map(len, lines)) < 300
    values = {p.name: p for p in finding.parameters}
    terms = {int(values[f"harmonic_{i}"].value): (values[f"amplitude_{i}"], values[f"phase_{i}"]) for i in (1, 2)}
    assert set(terms) == set(WAVES)
    for order, (size, phase) in WAVES.items():
        amplitude, angle = terms[order]
        assert abs(amplitude.value - size) < 4 * amplitude.std < 0.2 * size
        assert abs(angle.value - phase) < 4 * angle.std
    assert not found.anomalies  # readings that only the wrong model called gross errors are used again
    assert found.held_out_after < 1.3 * SIGMA < found.held_out_before
    assert found.blocks["posture"][1] < 1.4 * np.sqrt(3) * SIGMA
    assert found.test is not None
    assert found.identification.test is not None
    assert found.test.rms < 1.4 * SIGMA < 0.5 * found.identification.test.rms
    assert found.model is not None
    again = predict_readings(test, cell, found.model) - test.position
    assert np.isclose(np.sqrt(np.mean(again**2)), found.test.rms, rtol=1e-6)


@pytest.mark.parametrize("order", [40, pytest.param(160, marks=pytest.mark.slow), 320])
def test_a_strain_wave_gear_is_found_whose_ratio_the_recording_resolves(cell: Cell, order: int) -> None:
    """1.5 arc minutes peak to peak, once and twice a turn of the wave generator of ratio 160."""
    q = random_angles(SEED, 400, 6)
    extra = np.zeros_like(q)
    extra[:, 1] = 2.2e-4 * np.sin(order * q[:, 1] + 0.5)
    found = diagnose_still(planted(cell, q, extra), cell)
    assert found.verdict == "missing_physics"
    assert named(found) == [("transmission_error", "joint_2")]
    values = {p.name: p for p in found.findings[0].parameters}
    assert values["harmonic"].value == order
    assert values["amplitude"].value == pytest.approx(2.2e-4, rel=0.05)
    assert found.held_out_after < 1.1 * SIGMA


def test_approach_direction_from_the_order_of_the_poses(cell: Cell) -> None:
    q = random_angles(SEED, CONFIGURATIONS, 6)
    extra = np.zeros_like(q)
    extra[:, 0] = -1e-4 * last_motion(q, 2e-4)[:, 0]
    found = diagnose_still(planted(cell, q, extra), cell)
    assert named(found) == [("approach_direction", "joint_1")]
    width = found.findings[0].parameters[0]
    assert width.value == pytest.approx(-1e-4, abs=4 * width.std)
    assert width.std < 5e-6


def test_a_drift_of_the_tracker_is_found_with_its_rate(cell: Cell) -> None:
    q, hours = random_angles(SEED, CONFIGURATIONS, 6), 2.0
    readings = planted(cell, q, np.zeros_like(q))
    time = np.repeat(np.linspace(0.0, 3600 * hours, len(q)), len(cell.points))
    rate = np.array([1.2e-8, -9e-9, 6e-9])  # m/s: 86, 65 and 43 µm in all
    drifted = dataclasses.replace(readings, time=time, position=readings.position + time[:, None] * rate)
    found = diagnose_still(drifted, cell)
    (finding,) = found.findings
    assert finding.variant == "linear in time"
    assert (finding.effect, dict(finding.location)) == ("tracker_drift", {"tracker": "tracker"})
    assert found.model is not None
    moved = found.shift @ found.model.tracker[:3, :3]
    gone = (moved[-1] - moved[0]) / time[-1]
    np.testing.assert_allclose(gone, rate, atol=3e-9)


@pytest.mark.parametrize("joint", [0, 3])
def test_a_hose_that_winds_up_with_a_joint_is_no_gear(joint: int) -> None:
    """Its torque is linear in the angle, which a wave is over less than a quarter of a turn."""
    stiffness = [1.5e6, 2e6, 1e6, 3e5, 3e5, 2e5]
    cell = make_cell(points=POINTS, robot={"stiffness": stiffness})
    truth = truth_of(cell, SEED).replace(compliance=1 / np.array(stiffness))
    q = 0.8 * random_angles(SEED, CONFIGURATIONS, 6)
    extra = np.zeros_like(q)
    extra[:, joint] = 200.0 * q[:, joint] / stiffness[joint]
    seen = make_readings(cell, truth, q + extra, seed=SEED)
    found = diagnose_still(dataclasses.replace(seen, q=np.repeat(q, len(cell.points), axis=0)), cell)
    (finding,) = found.findings
    assert (finding.effect, finding.variant) == ("cable_force", f"winds up with joint_{joint + 1}")
    turned = finding.parameters[0].value * found.compliance[joint]  # at rest the joint's own compliance is hardly known
    assert turned == pytest.approx(200.0 / stiffness[joint], rel=0.1)


def test_wrist_coupling(cell: Cell) -> None:
    q = random_angles(SEED, CONFIGURATIONS, 6)
    extra = np.zeros_like(q)
    extra[:, 4] = 3e-4 * q[:, 3]
    found = diagnose_still(planted(cell, q, extra), cell)
    assert named(found) == [("wrist_coupling", "joint_5")]
    assert found.findings[0].variant == "follows joint_4"


def test_sag_passes_its_controls_and_a_file_that_states_stiffness_refits_it(cell: Cell) -> None:
    q = random_angles(SEED, CONFIGURATIONS, 6)
    truth = truth_of(cell, SEED, compliance=1e-6)
    readings = make_readings(cell, truth, q)
    found = diagnose_still(readings, cell)
    assert set(named(found)) == {("joint_elasticity", "joint_2"), ("joint_elasticity", "joint_3")}
    for joint in ("joint_2", "joint_3"):
        value, std = found.stiffness[joint]
        assert value == pytest.approx(1e6, rel=0.02)
        assert std < 0.02 * value
    stated = make_cell(points=POINTS, robot={"stiffness": [0.87e6] * 6})
    again = diagnose_still(readings, stated)
    assert again.findings == ()  # 15 % wrong stiffnesses are refitted: no physics is missing
    assert again.compliance[1] == pytest.approx(1e-6, rel=0.02)


def test_sag_is_not_claimed_where_a_low_harmonic_does(cell: Cell) -> None:
    q = random_angles(SEED, CONFIGURATIONS, 6)
    extra = np.zeros_like(q)
    extra[:, 1] = 3e-4 * np.sin(q[:, 1] + 0.3)
    found = diagnose_still(planted(cell, q, extra), cell)
    assert ("joint_elasticity", "joint_2") not in named(found)
    assert not found.stiffness


def overtones(torque: float, shape: Triangle) -> np.ndarray:
    """Return the second to fourth harmonic of a spring's torque; the first hides behind geometry and weight."""
    q = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    values = torque * spring_torque(np.radians(shape.anchor) - q, shape.flatness, shape.preload)
    return np.asarray(np.fft.rfft(values)[2:5])


@pytest.mark.parametrize(
    "shape", [pytest.param(Triangle(183.8, 0.498, 0.58), marks=pytest.mark.slow), Triangle(221.0, 0.4, 0.7)]
)
def test_a_compensator_is_found_with_its_triangle_and_without_waves_that_imitate_it(shape: Triangle) -> None:
    stated = make_cell(points=POINTS, robot={"stiffness": [1e6] * 6})
    q, other = random_angles(SEED, CONFIGURATIONS, 6), random_angles(99, 25, 6)
    torque = -1500.0

    def extra(q: np.ndarray) -> np.ndarray:
        result = np.zeros_like(q)
        result[:, 1] = 1e-6 * torque * spring_torque(np.radians(shape.anchor) - q[:, 1], shape.flatness, shape.preload)
        return result

    def seen(q: np.ndarray, seed: int) -> Readings:
        readings = make_readings(stated, truth_of(stated, SEED, compliance=1e-6), q + extra(q), seed=seed)
        return dataclasses.replace(readings, q=np.repeat(q, len(stated.points), axis=0))

    test = seen(other, 7)
    found = diagnose_still(seen(q, SEED), stated, test=test)
    assert named(found) == [("gravity_compensator", "joint_2")]
    assert found.verdict == "missing_physics"
    told = triangle_of(found.findings[0].variant)
    assert told is not None
    parameters = {p.name: p.value for p in found.findings[0].parameters}
    seen_ones, true_ones = overtones(parameters["torque"], told), overtones(torque, shape)
    np.testing.assert_allclose(seen_ones, true_ones, atol=0.15 * np.abs(true_ones).max())
    assert found.model is not None
    assert found.test is not None
    assert found.test.rms < 1.4 * SIGMA
    again = predict_readings(test, stated, found.model) - test.position
    assert np.isclose(np.sqrt(np.mean(again**2)), found.test.rms, rtol=1e-6)


def test_waves_of_high_order_are_not_taken_for_a_compensator() -> None:
    stated = make_cell(points=POINTS, robot={"stiffness": [1e6] * 6})
    q = random_angles(SEED, CONFIGURATIONS, 6)
    seen = make_readings(stated, truth_of(stated, SEED, compliance=1e-6), q + waves(q), seed=SEED)
    found = diagnose_still(dataclasses.replace(seen, q=np.repeat(q, len(POINTS), axis=0)), stated)
    assert named(found) == [("transmission_error", "joint_2")]
    orders = {p.value for p in found.findings[0].parameters if p.name.startswith("harmonic")}
    assert orders == set(WAVES)


def test_thermal_growth(cell: Cell) -> None:
    q = random_angles(SEED, CONFIGURATIONS, 6)
    truth = truth_of(cell, SEED)
    readings = make_readings(cell, truth, q)
    warm = 20 + 8 * (1 - np.exp(-np.repeat(np.arange(CONFIGURATIONS), 3) / 25.0))
    pose = truth.tracker
    base = readings.position @ pose[:3, :3].T + pose[:3, 3]
    flange = posture(chain_of(cell).corrected(truth.geometry), readings.q).flange_origin.T
    grown = (base + 12e-6 * (warm - 20)[:, None] * flange - pose[:3, 3]) @ pose[:3, :3]
    found = diagnose_still(dataclasses.replace(readings, position=grown, temperature=warm), cell)
    assert named(found) == [("thermal_growth", "arm")]
    expansion = found.findings[0].parameters[0]
    assert abs(expansion.value - 12e-6) < 3 * expansion.std < 2e-6


@pytest.mark.parametrize("share", [0.1, 0.2])
def test_a_tracker_that_warms_up_is_no_gear(cell: Cell, share: float) -> None:
    """It settles 0.2 mm and 0.1 mrad elsewhere, with a time constant of a share of the recording."""
    q, whole = random_angles(SEED, CONFIGURATIONS, 6), 7200.0
    readings = planted(cell, q, np.zeros_like(q))
    time = np.repeat(np.linspace(0.0, whole, len(q)), len(cell.points))
    settled = 1 - np.exp(-time / (share * whole))
    warm = np.array([1.2e-4, -1.5e-4, 0.5e-4]) + np.cross([6e-5, -4e-5, 7e-5], readings.position)
    seen = dataclasses.replace(readings, time=time, position=readings.position + settled[:, None] * warm)
    found = diagnose_still(seen, cell)
    (finding,) = found.findings
    assert (finding.effect, found.verdict) == ("tracker_drift", "missing_physics")
    assert float(finding.variant.split()[2]) == pytest.approx(share * whole, rel=0.6)
    assert found.model is not None
    again = predict_readings(seen, cell, found.model) - seen.position
    assert np.sqrt(np.mean(again**2)) < 1.2 * SIGMA


def test_a_moved_target_is_an_anomaly_and_no_physics(cell: Cell) -> None:
    truth = truth_of(cell, SEED)
    readings = make_readings(cell, truth, random_angles(SEED, CONFIGURATIONS, 6))
    flange = posture(chain_of(cell).corrected(truth.geometry), readings.q).flange
    step = np.array([1.0e-3, 0.5e-3, -0.8e-3])
    shift = np.einsum("kam,k->ma", flange, step) @ truth.tracker[:3, :3]
    moved = (readings.configuration >= 41) & (readings.point == 1)
    found = diagnose_still(dataclasses.replace(readings, position=readings.position + shift * moved[:, None]), cell)
    assert [a.kind for a in found.anomalies] == ["target_moved"]
    anomaly = found.anomalies[0]
    assert anomaly.location == {"point": "mp2"}
    assert anomaly.configurations == (41, 60)
    assert anomaly.magnitude == pytest.approx(np.linalg.norm(step), rel=0.05)
    assert "flange" in anomaly.text
    assert found.findings == ()
    assert found.verdict == "consistent"


def test_a_moved_tracker_is_told_from_a_moved_target(cell: Cell) -> None:
    readings = make_readings(cell, truth_of(cell, SEED), random_angles(SEED, CONFIGURATIONS, 6))
    step = np.array([1.0e-3, -1.0e-3, 1.0e-3])
    position = readings.position + step * (readings.configuration >= 25)[:, None]
    found = diagnose_still(dataclasses.replace(readings, position=position), cell)
    assert [a.kind for a in found.anomalies] == ["tracker_moved"]
    assert found.anomalies[0].configurations == (1, 24)  # the smaller part
    assert found.anomalies[0].magnitude == pytest.approx(np.linalg.norm(step), rel=0.05)
    assert found.findings == ()


@pytest.mark.parametrize("joint", [0, pytest.param(1, marks=pytest.mark.slow), 3])
def test_a_zero_that_is_lost_part_way_is_placed_in_time(cell: Cell, joint: int) -> None:
    q = random_angles(SEED, CONFIGURATIONS, 6)
    extra = np.zeros_like(q)
    extra[30:, joint] = 1e-3
    found = diagnose_still(planted(cell, q, extra), cell)
    (anomaly,) = found.anomalies
    assert (anomaly.kind, dict(anomaly.location)) == ("zero_moved", {"joint": f"joint_{joint + 1}"})
    assert "between configurations 30 and 31 the readings step" in anomaly.text
    assert "1.00 mrad" in anomaly.text
    assert found.findings == ()


def test_what_no_catalogue_holds_is_said_to_be_unexplained(cell: Cell) -> None:
    q = random_angles(SEED, CONFIGURATIONS, 6)
    extra = np.zeros_like(q)
    extra[:, 1] = 4e-4 * np.random.default_rng(8).standard_normal(CONFIGURATIONS)  # another angle at every pose
    found = diagnose_still(planted(cell, q, extra), cell)
    assert found.verdict == "unexplained"
    assert found.rest.significant
    assert found.rest.rms > 5 * SIGMA
    assert found.findings == ()


@pytest.mark.parametrize(("points", "several"), [(("mp1",), 8), pytest.param(POINTS, 20, marks=pytest.mark.slow)])
def test_nothing_is_found_where_nothing_is(points: tuple[str, ...], several: int) -> None:
    """One false alarm in a hundred is expected; two or more of twenty happen in 2 % of such tests."""
    cell = make_cell(points=points)
    alarms = 0
    for seed in range(several):
        misstated = np.random.default_rng(seed).uniform(0.7, 1.5)
        q = random_angles(1000 + seed, 45, 6)
        readings = make_readings(cell, truth_of(cell, seed), q, noise=misstated * SIGMA, seed=seed)
        alarms += bool(estimate(readings, cell, evaluate_absolute(readings, cell)).selection.accepted)
    assert alarms <= 1


def ripple(cell: Cell, q: np.ndarray, size: float) -> np.ndarray:
    """Return how much further joint 3 gives way where its compliance has three waves a turn besides one."""
    compliance, joint = 1e-6, 2
    torque = gravity_torque(chain_of(cell), posture(chain_of(cell), q))[joint]
    extra = np.zeros_like(q)
    extra[:, joint] = size * compliance * torque * (np.cos(q[:, joint]) + 0.6 * np.cos(3 * q[:, joint] + 0.4))
    return extra


def with_ripple(size: float) -> tuple[Readings, Cell]:
    """Return readings of a robot whose third joint has it."""
    stated = make_cell(points=POINTS, robot={"stiffness": [1e6] * 6})
    q = random_angles(SEED, CONFIGURATIONS, 6)
    readings = make_readings(stated, truth_of(stated, SEED, compliance=1e-6), q + ripple(stated, q, size), seed=SEED)
    return dataclasses.replace(readings, q=np.repeat(q, len(POINTS), axis=0)), stated


def test_a_compliance_of_several_waves_a_turn_is_no_transmission_error() -> None:
    found = diagnose_still(*with_ripple(0.5))
    assert named(found) == [("pose_dependent_stiffness", "joint_3")]
    assert found.findings[0].variant == "to four waves a turn"
    assert found.verdict == "missing_physics"


def test_a_finding_of_several_terms_names_what_explains_as_much() -> None:
    """Waves of a gear that together imitate a compliance which follows the angle are confounded with it."""
    imitated = ("pose_dependent_stiffness", {"joint": "joint_3"})
    for size, near in ((0.02, True), (0.2, False)):  # far more probable, it is no alternative but the finding
        readings, stated = with_ripple(size)
        found = estimate(readings, stated, evaluate_absolute(readings, stated))
        search, hypotheses = found.search, found.offered.hypotheses
        waves = [i for i in search.judged if hypotheses[i].place == ("transmission_error", (("joint", "joint_3"),))]
        low = {hypotheses[i].variant: i for i in waves}
        members = tuple(low[f"order {n}"] for n in (1, 2, 3, 4))
        together = search.sizes(members).value - search.sizes(()).value
        selection = dataclasses.replace(found.selection, accepted=members, gain=(together / 4,) * 4)
        listed = equivalents(search, selection, members)
        places = [(hypotheses[i].effect, dict(hypotheses[i].location)) for i, _ in listed]
        assert (imitated in places) is near
        apart = [abs(nats - together) for _, nats in listed]
        assert apart == sorted(apart)
        assert max(apart, default=0.0) <= EQUIVALENT
