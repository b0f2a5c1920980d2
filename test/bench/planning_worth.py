"""What planning is worth: against random configurations, and whether its promises are kept."""

from __future__ import annotations

import numpy as np
from planning_problems import CELL

from calibration_core.identification.identify import identify
from calibration_core.model.nominal import nominal_parameters
from calibration_core.planning.feasible.candidates import draw_postures, loaded_postures
from calibration_core.planning.feasible.loads import LoadRules
from calibration_core.planning.feasible.space import SpaceRules
from calibration_core.planning.loaded import ground_of, make_plan
from calibration_core.planning.optimal_design.criteria import CRITERIA
from calibration_core.planning.optimal_design.design import choose
from calibration_core.planning.optimal_design.optimum import Candidates
from calibration_sim.cell.protocol import Configuration, Protocol
from calibration_sim.cell.table import measure, solve
from calibration_sim.cell.truth import draw_truth

COUNT = 18


def random_over_planned(seeds: int, criterion: str) -> np.ndarray:
    """Return the widest relative stiffness interval of random configurations over that of chosen ones, (seeds,).

    Both come from the same postures that can be measured, with pulls of the same size; a random choice takes 18
    postures, and a pull for each, by chance.
    """
    parameters = nominal_parameters(CELL)
    ground = ground_of(CELL, parameters, SpaceRules(), None)
    ratio = []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 77])
        q = draw_postures(ground, 600, 60, COUNT, rng)
        offered = loaded_postures(ground, parameters, q, LoadRules(), rng)
        candidates = Candidates(offered.information, parameters.compliance)
        planned = choose(candidates, COUNT, criterion=CRITERIA[criterion], group=offered.group, seed=seed).chosen
        postures = rng.choice(np.unique(offered.group), COUNT, replace=False)
        drawn = np.array([rng.choice(np.flatnonzero(offered.group == one)) for one in postures])
        worst = [np.sqrt(np.diag(np.linalg.inv(candidates.total(rows))).max()) for rows in (drawn, planned)]
        ratio.append(worst[0] / worst[1])
    return np.array(ratio)


def promised_and_seen(seeds: int) -> np.ndarray:
    """Return, per joint, the rms error of identified stiffnesses over the promised one, (6,).

    Every seed has its own truth (stiffnesses off by some 15 %) and noise; the simulated cell shares no kinematics and
    no statics with the planner.
    """
    plan = make_plan(CELL)
    assert plan.expected is not None
    assert plan.expected.stiffness_std is not None
    protocol = Protocol(tuple(Configuration(c.number, c.q, c.steps) for c in plan.primary))
    errors = []
    for seed in range(seeds):
        truth = draw_truth(CELL, 5000 + seed)
        found = identify(measure(solve(CELL, truth, protocol), CELL, 5000 + seed), CELL)
        errors.append([(j.value - k) / k for j, k in zip(found.stiffness, truth.stiffness, strict=True)])
    return np.asarray(np.sqrt(np.mean(np.square(errors), axis=0)) / plan.expected.stiffness_std)
