"""Proposals: the expected gain is what sampling gives, the limits are kept, and aliases are not promised to part."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from robots import STIFFNESS, loaded_readings, write_cell
from several_cases import setup

from calibration_core.cell import Cell
from calibration_core.commands.evaluation.candidate_measurements import offers_for, proposed_plan
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.loaded import diagnose_loaded
from calibration_core.diagnosis.proposals.choose import HypothesisPosterior, Offer, expected_log_bayes_factor
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.identification.stiffness.predict import predict_readings
from calibration_core.identification.stiffness.problem import build_problem
from calibration_core.model.effects import candidates
from calibration_core.model.effects.state import State, state_of
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.model.simulation.simulate import simulate_plan
from calibration_core.model.statics import load_of
from calibration_core.observations.kinds import levels_of
from calibration_core.planning.feasible.loads import wrench_steps
from calibration_core.planning.plans.plan import PlannedConfiguration
from calibration_core.planning.plans.plan_file import plan_text, read_plan
from calibration_core.report.document import Items
from calibration_core.report.sections.diagnosis import next_blocks
from calibration_core.timeseries import Readings


def state_at(readings: Readings, cell: Cell) -> State:
    model = nominal_parameters(cell)
    problem = build_problem(readings, cell, chain_of(cell), model)
    points = np.stack([model.points[name] for name in readings.points])[readings.point].T
    return state_of(
        chain_of(cell), readings.q, model.compliance, load_of(readings, cell, model), points,
        point_index=readings.point, wrench=readings.wrench, configuration=problem.configuration, step=readings.step,
        time=readings.time, temperature=readings.temperature, tracker=model.tracker, rated_load=240.0,
    )  # fmt: skip


def with_effect(cell: Cell, seed: int, effect: str, variant: str, values: list[float], **location: object) -> Readings:
    readings = loaded_readings(cell, seed)
    state = state_at(readings, cell)
    chosen = next(
        c
        for c in candidates(state)
        if (c.effect, c.variant) == (effect, variant) and all(c.location[k] == v for k, v in location.items())
    )
    shift = chosen.columns(state) @ np.array(values) @ nominal_parameters(cell).tracker[:3, :3]
    return dataclasses.replace(readings, position=readings.position + shift)


def test_the_expected_log_bayes_factor_is_what_sampling_gives() -> None:
    rng = np.random.default_rng(0)
    recorded = [rng.standard_normal((30, 3)) for _ in range(2)]
    residual = recorded[0] @ [0.5, -0.2, 1.0] + rng.standard_normal(30)
    known = [HypothesisPosterior.of(columns, residual, 1) for columns in recorded]
    further = rng.standard_normal((2, 4, 3))
    first, second = (k.predict(further[[i]]) for i, k in enumerate(known))
    expected = expected_log_bayes_factor(first, second)[0]
    drawn = rng.multivariate_normal(first.mean[0], first.covariance[0], 200_000)

    def log_density(mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        apart = drawn - mean
        squares = np.einsum("ki,ij,kj->k", apart, np.linalg.inv(covariance), apart)
        return -0.5 * (squares + np.linalg.slogdet(covariance)[1])

    sampled = log_density(first.mean[0], first.covariance[0]) - log_density(second.mean[0], second.covariance[0])
    assert expected == pytest.approx(float(sampled.mean()), abs=5 * float(sampled.std()) / 447)


def test_knowledge_after_a_measurement_is_that_of_both_together() -> None:
    rng = np.random.default_rng(1)
    columns, residual = rng.standard_normal((40, 4)), rng.standard_normal(40)
    apart = HypothesisPosterior.of(columns[:30], residual[:30], 2).after(columns[30:], residual[30:])
    weight = columns.T @ columns + np.diag([0.0, 0.0, 1.0, 1.0])
    np.testing.assert_allclose(apart.mean, np.linalg.solve(weight, columns.T @ residual), rtol=1e-6)
    np.testing.assert_allclose(apart.covariance, np.linalg.inv(weight), rtol=1e-6)
    for known in (30, 37):  # more rows than parameters, and fewer
        before = HypothesisPosterior.of(columns[:known], residual[:known], 2)
        np.testing.assert_allclose(
            before.variances_after(columns[None, known:], [0, 2])[0], np.diag(apart.covariance)[[0, 2]], rtol=1e-6
        )


def test_offers_keep_the_limits(cell: Cell) -> None:
    readings = loaded_readings(cell, 1)
    offers = offers_for(readings, cell)
    assert offers
    assert levels_of(readings) == (0.0, 0.5, 1.0, 0.5, 0.0)
    largest = np.linalg.norm(np.array(readings.wrench)[:, :3], axis=1).max()
    for offer in offers.each:
        assert np.abs(offer.q).max() < 3.0
        force = np.linalg.norm(offer.steps[:, :3], axis=1)
        assert force[0] == 0.0
        assert force.max() <= min(240 * 9.80665, largest) + 1e-6
        np.testing.assert_allclose(force, force.max() * np.array([0.0, 0.5, 1.0, 0.5, 0.0]))


@pytest.mark.parametrize(
    ("levels", "expected"),
    [
        ((0.0, 0.5, 1.0, 0.5, 0.0), (0.0, 1.0, 0.0, 1.0, 0.0)),
        ((0.0, 1.0, 0.5, -1.0, -0.5, 0.0), (0.0, 1.0, -1.0, 1.0, -1.0, 1.0)),
        ((0.0,), (0.0,)),
    ],
)
def test_an_alternating_offer_goes_to_and_fro_between_its_extremes(
    levels: tuple[float, ...], expected: tuple[float, ...]
) -> None:
    force = np.array([100.0, -300.0, 50.0])
    offer = Offer(1, np.arange(6.0), wrench_steps(force, levels))
    other = offer.alternating
    np.testing.assert_array_equal(other.steps, wrench_steps(force, expected))
    np.testing.assert_array_equal(other.q, offer.q)


def test_what_grows_with_the_load_is_sharpened_by_going_to_and_fro(cell: Cell) -> None:
    readings = loaded_readings(cell, 1)
    found = diagnose_loaded(readings, cell, offers=offers_for(readings, cell))
    for proposal in found.next_measurements:
        force = np.linalg.norm(np.array(proposal.steps)[:, :3], axis=1)
        np.testing.assert_allclose(force, force.max() * np.array([0.0, 1.0, 0.0, 1.0, 0.0]))
    assert said_of(found).count("Steps: 0 % of F, then 100 % and 0 % in turn, 5 in all.") == 3
    as_recorded = dataclasses.replace(
        found.next_measurements[0], steps=tuple(map(tuple, wrench_steps(force_of(found), (0.0, 0.5, 1.0, 0.5, 0.0))))
    )
    other = dataclasses.replace(found, next_measurements=(as_recorded,))
    assert said_of(other).endswith("Steps: 0, 50, 100, 50, 0 % of F.")
    unloaded = dataclasses.replace(as_recorded, wrench=(0.0,) * 6, steps=((0.0,) * 6,))
    assert said_of(dataclasses.replace(found, next_measurements=(unloaded,))).endswith("No load.")


def said_of(found: Diagnosis) -> str:
    """Return what the report says below the table of the proposals."""
    (items,) = (block for block in next_blocks(found, [False] * 6) if isinstance(block, Items))
    return " ".join(items.texts)


def force_of(found: Diagnosis) -> np.ndarray:
    return np.array(found.next_measurements[0].wrench[:3])


def test_an_ambiguous_finding_gets_a_proposal_that_the_sequencer_can_read(cell: Cell, tmp_path: Path) -> None:
    readings = with_effect(cell, 11, "backlash", "total torque, within 4 %", [2e-4], joint="joint_4")
    found = diagnose_loaded(readings, cell, offers=offers_for(readings, cell))
    ambiguous = [f for f in found.findings if f.cannot_be_told_from]
    assert ambiguous
    first = found.next_measurements[0]
    assert first.gain_unit == "nats"
    assert first.gain > first.gain_at_random
    assert ambiguous[0].effect.replace("_", " ") in first.why
    path = tmp_path / "next.yaml"
    path.write_text(plan_text(proposed_plan(found.next_measurements, cell)))
    plan = read_plan(path, cell)
    np.testing.assert_allclose(plan.configurations[0].q, first.q)
    np.testing.assert_allclose(plan.configurations[0].steps, first.steps)


def test_nothing_is_expected_to_part_exact_aliases() -> None:
    rng = np.random.default_rng(2)
    columns, residual, further = rng.standard_normal((30, 3)), rng.standard_normal(30), rng.standard_normal((5, 6, 3))
    turned = np.linalg.qr(rng.standard_normal((2, 2)))[0]  # the same space, other parameters
    mixed = np.eye(3)
    mixed[1:, 1:] = turned
    first = HypothesisPosterior.of(columns, residual, 1).predict(further)
    second = HypothesisPosterior.of(columns @ mixed, residual, 1).predict(further @ mixed)
    np.testing.assert_allclose(expected_log_bayes_factor(first, second), 0.0, atol=1e-9)


def test_without_a_finding_the_worst_stiffness_is_made_more_certain(cell: Cell) -> None:
    readings = loaded_readings(cell, 1)
    found = diagnose_loaded(readings, cell, offers=offers_for(readings, cell))
    assert found.findings == ()
    worst = max(found.stiffness, key=lambda joint: found.stiffness[joint][1] / found.stiffness[joint][0])
    assert len(found.next_measurements) == 3
    assert worst in found.next_measurements[0].why
    assert found.next_measurements[0].gain >= found.next_measurements[0].gain_at_random > 0


def hung(cell: Cell, loaded: int, rest: int) -> Readings:
    """Return a recording of weights that hang, which turn no vertical axis, beside postures at rest."""
    rng = np.random.default_rng(3)
    weight = np.array([0.0, 0.0, -2000.0, 0.0, 0.0, 0.0])
    planned = [
        PlannedConfiguration(
            number,
            rng.uniform([-1.5, -0.6, -0.6, -2, -1.5, -2], [1.5, 0.6, 0.9, 2, 1.5, 2]),
            wrench_steps(weight[:3], (0.0, 0.5, 1.0, 0.5, 0.0) if number <= loaded else (0.0,)),
        )
        for number in range(1, loaded + rest + 1)
    ]
    return simulate_plan(planned, cell, nominal_parameters(cell), 3)


@pytest.mark.parametrize("rest", [5, 30])
def test_a_joint_that_no_load_turned_is_offered_one_beside_postures_at_rest(rest: int, tmp_path: Path) -> None:
    """More postures at rest than loaded configurations: the load steps are those of the loaded ones all the same."""
    cell = setup(tmp_path, 0, sigma=2e-5)
    readings = hung(cell, 14, rest)
    assert levels_of(readings) == (0.0, 0.5, 1.0, 0.5, 0.0)
    found = diagnose(readings, cell, offers=offers_for(readings, cell))
    assert [joint.joint for joint in found.identification.stiffness if not joint.identifiable] == ["joint_1"]
    first = found.next_measurements[0]
    assert first.why.startswith("makes the stiffness of joint_1 more certain")
    assert first.gain > first.gain_at_random > 50
    assert len(first.steps) == 5
    assert np.abs(first.wrench[:2]).max() > 100
    without = diagnose(readings, cell)
    assert not without.next_measurements
    assert (without.verdict, without.findings) == (found.verdict, found.findings)


@pytest.mark.parametrize("axis", [0, 2])
def test_where_exact_weights_never_load_a_joint_a_configuration_that_does_is_proposed(
    tmp_path: Path, axis: int
) -> None:
    """Weights hung up or pulled along one axis of the base, with no sensor: one target, zero and full load."""
    cell = write_cell(tmp_path, measurements={"wrench_axes": "base", "wrench_at": "wrench_point"})
    drawn = loaded_readings(cell, 3, 12)
    drawn = drawn.select(np.flatnonzero((drawn.step < 2) & (drawn.point == 0)))
    wrench = np.zeros((len(drawn), 6))
    wrench[drawn.step == 1, axis] = -2300.0
    weights = dataclasses.replace(drawn, wrench=wrench, points=("mp1",))
    truth = nominal_parameters(cell).replace(compliance=1 / np.array(STIFFNESS))
    noise = 2e-5 * np.random.default_rng(4).standard_normal((len(weights), 3))
    readings = dataclasses.replace(weights, position=predict_readings(weights, cell, truth) + noise)
    found = diagnose(readings, cell, offers=offers_for(readings, cell))
    assert found.verdict == "consistent"
    unknown = {joint.joint for joint in found.identification.stiffness if not joint.identifiable}
    assert unknown == ({"joint_1"} if axis == 2 else set())
    said = [one.why for one in found.next_measurements if "of which the recording says nothing" in one.why]
    assert all(0 < one.gain <= 100 for one in found.next_measurements)
    assert bool(said) is bool(unknown)
    assert all("joint_1" in one for one in said)
