"""Proposals for absolute recordings: what is promised of a posture is what measuring it brings."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from absolute_cases import SIGMA, make_cell, make_readings, random_angles, truth_of

from calibration_core.cell import Cell
from calibration_core.commands.evaluation.candidate_measurements import offers_for, proposed_plan
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.proposals.choose import Offers
from calibration_core.diagnosis.proposals.postures import NO_POSTURE, NOTHING_FOUND, Known, propose_postures
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.estimation.estimate import estimate
from calibration_core.identification.absolute.evaluate import evaluate_absolute
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.planning.plans.plan_file import plan_text, read_plan
from calibration_core.timeseries import Provenance, Readings

SEED, CONFIGURATIONS, LOADED, JOINT = 5, 60, 14, 1
SINE = 1.5e-4  # rad


@pytest.fixture(scope="module")
def cell() -> Cell:
    return make_cell(points=("mp1", "mp2", "mp3"))


def recorded(cell: Cell, q: np.ndarray, order: int) -> Readings:
    """Return readings of a robot whose joint 2 has an error of `order` waves per revolution."""
    extra = np.zeros_like(q)
    extra[:, JOINT] = SINE * np.sin(order * q[:, JOINT] + 0.4)
    seen = make_readings(cell, truth_of(cell, SEED), q + extra, seed=SEED)
    return dataclasses.replace(seen, q=np.repeat(q, len(cell.points), axis=0))


def asked(cell: Cell, q: np.ndarray, order: int = 2) -> Diagnosis:
    readings = recorded(cell, q, order)
    return diagnose(readings, cell, offers=offers_for(readings, cell))


def shares(why: str) -> tuple[float, float]:
    """Return from where to where a standard deviation falls, per cent."""
    found = re.search(r"falls from ([\d.]+) % to ([\d.]+) %", why)
    assert found is not None
    return float(found[1]), float(found[2])


def test_a_finding_is_made_more_certain_by_as_much_as_is_promised(cell: Cell, tmp_path: Path) -> None:
    q = random_angles(SEED, CONFIGURATIONS, 6)
    found = asked(cell, q)
    assert [(f.effect, dict(f.location)) for f in found.findings] == [("transmission_error", {"joint": "joint_2"})]
    assert 1 <= len(found.next_measurements) <= 3
    for proposal in found.next_measurements:
        before, after = shares(proposal.why)
        assert before - after >= 0.02 * before  # less is not worth the way
        assert "makes “the gear of joint 2 runs unevenly (order 2)” more certain" in proposal.why
        assert proposal.gain > proposal.gain_at_random > 0
        assert (proposal.wrench, proposal.steps) == ((0.0,) * 6, ((0.0,) * 6,))
    now, then = shares(found.next_measurements[0].why)
    measured = asked(cell, np.vstack([q, found.next_measurements[0].q]))
    again, _ = shares(measured.next_measurements[0].why)
    assert now - again == pytest.approx(now - then, rel=0.5)
    path = tmp_path / "next.yaml"
    path.write_text(plan_text(proposed_plan(found.next_measurements, cell)))
    np.testing.assert_allclose(read_plan(path, cell).configurations[0].q, found.next_measurements[0].q)


def known_of(cell: Cell, readings: Readings, rival: tuple[str, str, str]) -> Known:
    """Return what a recording tells where (effect, joint, variant) is said to explain it as well as the finding."""
    case = estimate(readings, cell, evaluate_absolute(readings, cell))
    (accepted,) = case.selection.accepted
    places = [(h.effect, h.location.get("joint"), h.variant) for h in case.offered.hypotheses]
    index = places.index(rival)
    sizes = dict.fromkeys((accepted, index), float(case.selection.sizes.size[0]))
    return Known(case.field, sizes, case.selection.accepted, {accepted: ((index, 10.0),)}, case.null.model, 1.0)


def test_what_cannot_be_told_apart_gets_a_posture_that_parts_it(cell: Cell) -> None:
    q = random_angles(SEED, CONFIGURATIONS, 6)
    q[:, JOINT] = 0.4 * q[:, JOINT]
    readings = recorded(cell, q, 3)
    known = known_of(cell, readings, ("transmission_error", "joint_2", "order 4"))
    offers = offers_for(readings, cell)
    assert offers
    found = propose_postures(known, cell, offers)
    first, second = found.measurements[:2]
    assert first.gain_unit == "nats"
    assert "order 3" in first.why
    assert "order 4" in first.why
    assert first.gain > max(2 * first.gain_at_random, 1.0)
    inside = np.abs(q[:, JOINT]).max()
    assert abs(first.q[JOINT]) > inside  # both describe what was recorded, and differ beyond
    assert second.gain_unit == "%"
    assert found.text == ""


def test_what_no_posture_parts_is_said(cell: Cell) -> None:
    readings = recorded(cell, random_angles(SEED, CONFIGURATIONS, 6), 2)
    known = known_of(
        cell, readings, ("transmission_error", "joint_2", "order 2")
    )  # itself: as exact as an alias can be
    offers = offers_for(readings, cell)
    assert offers
    found = propose_postures(known, cell, offers)
    assert "“the gear of joint 2 runs unevenly (order 2)”" in found.text
    assert found.measurements
    assert {m.gain_unit for m in found.measurements} == {"%"}


def test_no_posture_is_promised_to_tell_of_what_depends_on_the_way_there(cell: Cell) -> None:
    q = random_angles(SEED, CONFIGURATIONS, 6)
    extra = np.zeros_like(q)
    extra[1:, JOINT] = 2e-4 * np.sign(np.diff(q[:, JOINT]))
    seen = make_readings(cell, truth_of(cell, SEED), q + extra, seed=SEED)
    readings = dataclasses.replace(seen, q=np.repeat(q, len(cell.points), axis=0))
    found = diagnose(readings, cell, offers=offers_for(readings, cell))
    assert {f.effect for f in found.findings} == {"approach_direction"}
    assert (found.next_measurements, found.next_text) == ((), NOTHING_FOUND)


def test_a_recording_with_loads_too_gets_proposals() -> None:
    frames = {"wrench_point": [0.0, 0.0, 0.1], "force_torque": {"xyz": [0.0, 0.0, 0.0], "rpy": [0.0, 0.0, 0.0]}}
    sigma = {"tracker": {"sigma": SIGMA}, "force_torque": {"sigma_force": 1.0, "sigma_torque": 0.5}}
    robot = {"stiffness": [1e6, 1e6, 1e6, 3e5, 3e5, 3e5]}
    cell = make_cell(points=("mp1", "mp2", "mp3"), robot=robot, frames=frames, instruments=sigma)
    rng, points = np.random.default_rng(SEED), 3
    share = np.concatenate([np.zeros(CONFIGURATIONS), np.tile([0.0, 0.5, 1.0], LOADED)])  # a row a step
    number = np.concatenate([np.arange(CONFIGURATIONS), CONFIGURATIONS + np.repeat(np.arange(LOADED), 3)])
    pull = 900.0 * rng.standard_normal((CONFIGURATIONS + LOADED, 3))
    q = random_angles(SEED, CONFIGURATIONS + LOADED, 6)[number]
    wrench = np.zeros((len(q), 6))
    wrench[:, :3] = share[:, None] * pull[number]
    turned = q.copy()
    turned[:, JOINT] += SINE * np.sin(2 * q[:, JOINT] + 0.4)
    there = Readings(
        points=cell.points,
        configuration=np.repeat(number, points) + 1,
        step=np.repeat(np.where(number < CONFIGURATIONS, 0, (2 * share).astype(np.int64)), points),
        point=np.tile(np.arange(points), len(q)),
        q=np.repeat(turned, points, axis=0),
        position=np.zeros((points * len(q), 3)),
        wrench=np.repeat(wrench, points, axis=0),
        time=np.full(points * len(q), np.nan),
        temperature=np.full(points * len(q), 20.0),
        provenance=Provenance("simulated", "csv", {}, {}),
    )
    truth = truth_of(cell, SEED).replace(compliance=1 / np.array(robot["stiffness"]))
    seen = predict_readings(there, cell, truth) + SIGMA * rng.standard_normal((points * len(q), 3))
    both = dataclasses.replace(there, position=seen, q=np.repeat(q, points, axis=0))
    found = diagnose(both, cell, offers=offers_for(both, cell))
    assert [(f.effect, dict(f.location)) for f in found.findings] == [("transmission_error", {"joint": "joint_2"})]
    assert len(found.next_measurements) == 3
    assert all(proposal.gain > proposal.gain_at_random > 0 for proposal in found.next_measurements)


def test_where_nothing_is_found_nothing_is_proposed(cell: Cell) -> None:
    readings = make_readings(cell, truth_of(cell, SEED), random_angles(SEED, 40, 6), seed=SEED)
    found = diagnose(readings, cell, offers=offers_for(readings, cell))
    assert (found.next_measurements, found.next_text) == ((), NOTHING_FOUND)


def test_without_a_posture_to_measure_it_says_so(cell: Cell) -> None:
    readings = recorded(cell, random_angles(SEED, CONFIGURATIONS, 6), 2)
    found = diagnose(readings, cell, offers=Offers.of((), readings, cell))
    assert (found.next_measurements, found.next_text) == ((), NO_POSTURE)


@pytest.mark.parametrize("count", [1, 2])
def test_postures_that_would_not_fix_the_frames_by_themselves_are_offers_all_the_same(cell: Cell, count: int) -> None:
    readings = recorded(cell, random_angles(SEED, CONFIGURATIONS, 6), 3)
    known = known_of(cell, readings, ("transmission_error", "joint_2", "order 4"))
    offers = offers_for(readings, cell)
    assert offers
    found = propose_postures(known, cell, Offers.of(offers.each[:count], readings, cell))
    assert 0 < len(found.measurements) <= count
