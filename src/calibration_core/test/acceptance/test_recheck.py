"""The few poses of `plan --for verify`: a change is seen, and an unchanged robot conforms, as often as promised."""

from __future__ import annotations

import numpy as np
import pytest
from acceptance_cases import identified, small

from calibration_core.acceptance.recheck import FEWEST, MOST, Recheck, changes_of
from calibration_core.acceptance.verification import frame_columns, verify
from calibration_core.commands.planning.recheck import plan_recheck, recheck_question, recheck_summary
from calibration_core.errors import PlanError
from calibration_core.model.identified.named_values import value_of, with_values
from calibration_core.model.simulation.simulate import simulate_plan
from calibration_core.planning.loaded import PlanningRules
from calibration_core.planning.plans.plan import Plan

TOLERANCE, RISK = 1e-4, 0.05


@pytest.fixture(scope="module")
def planned() -> tuple[Plan, Recheck]:
    return plan_recheck(small(), identified()[1], PlanningRules(), TOLERANCE, RISK, seed=2)


def test_few_poses_decide(planned: tuple[Plan, Recheck]) -> None:
    plan, found = planned
    assert FEWEST <= len(plan.primary) <= MOST
    assert found.missed == ()
    question = f"{len(plan.primary)} poses for the question: does the calibration hold within 0.1 mm?"
    assert recheck_summary(found)[0] == recheck_question(found) == question
    assert min(found.coverage.values()) >= 1.0
    assert all(len(one.steps) == 2 for one in plan.primary)


@pytest.mark.parametrize("trials", [6, pytest.param(40, marks=pytest.mark.slow)])
def test_an_unchanged_robot_conforms(planned: tuple[Plan, Recheck], trials: int) -> None:
    plan, model = planned[0], identified()[1]
    wrong = 0
    for seed in range(trials):
        readings = simulate_plan(plan.primary, small(), model.parameters, seed)
        wrong += verify(readings, small(), model, TOLERANCE, fit_tracker=True).decision != "conforming"
    assert wrong <= trials * RISK + 3 * np.sqrt(trials * RISK * (1 - RISK))


@pytest.mark.parametrize("signs", [(1.0,), pytest.param((-1.0, 1.0), marks=pytest.mark.slow)], ids=["one", "both"])
def test_a_changed_robot_is_seen(planned: tuple[Plan, Recheck], signs: tuple[float, ...]) -> None:
    """Each single change that reaches the tolerance in 5 % of the operating space: said to conform in 5 % at most."""
    plan, found = planned
    model = identified()[1]
    rng = np.random.default_rng(8)
    wrong = trials = 0
    for name, coverage in found.coverage.items():
        readings = simulate_plan(plan.primary, small(), model.parameters)
        names, fields = changes_of(readings, small(), model)
        field, frame = fields[:, :, names.index(name)], frame_columns(readings)
        basis, _ = np.linalg.qr(frame.reshape(-1, 6))
        flat = field.reshape(-1) - basis @ (basis.T @ field.reshape(-1))
        largest = np.linalg.norm(flat.reshape(-1, 3), axis=1).max()
        amount = coverage * TOLERANCE / largest  # its size is the tolerance
        for sign in signs:
            value = value_of(model.parameters, name) + sign * amount
            if name.startswith("compliance.") and value <= 0:
                continue
            changed = with_values(model.parameters, {name: value})
            for _ in range(2):
                again = simulate_plan(plan.primary, small(), changed, int(rng.integers(1 << 30)))
                wrong += verify(again, small(), model, TOLERANCE, fit_tracker=True).decision == "conforming"
                trials += 1
    assert trials >= 20 * len(signs)
    assert wrong <= trials * RISK + 3 * np.sqrt(trials * RISK * (1 - RISK))


def test_a_tolerance_below_what_the_instruments_can_tell() -> None:
    with pytest.raises(PlanError, match="at least 4"):
        plan_recheck(small(), identified()[1], PlanningRules(), 2e-5, RISK, seed=2)
