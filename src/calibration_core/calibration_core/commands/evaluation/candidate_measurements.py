"""Configurations and loads that a cell could measure next: fit to be measured, within rated load and what was used."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.proposals.choose import Offer, Offers
from calibration_core.diagnosis.result.finding import ProposedMeasurement
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.observations.kinds import is_loaded, largest_force, levels_of
from calibration_core.planning.feasible.loads import LoadRules, full_pulls, wrench_steps
from calibration_core.planning.feasible.space import Site, SpaceRules, joint_range, measurable
from calibration_core.planning.plans.plan import Plan, PlannedConfiguration
from calibration_core.planning.plans.planned_robot import planned_robot
from calibration_core.timeseries import Readings

POSTURES = 400  # that are offered without loads
LOADED_POSTURES = 100
DIRECTIONS = 3  # of the load in each of these
BATCH, BATCHES = 1000, 120


def offers_for(readings: Readings, cell: Cell, seed: int = 0) -> Offers | None:
    """Draw what could be measured next.

    No joint goes beyond its limits, no force beyond the rated load or the largest of the recording (the sensor has
    proven that range), and the steps are those of the recording; a recording without loads is offered postures.

    Returns:
        The offers; none if no posture is fit; None where a recording is loaded and there is no wrench point to pull at.
    """
    loaded = is_loaded(readings)
    if loaded and cell.frames.wrench_point is None:
        return None
    parameters = nominal_parameters(cell)
    site = Site.of(chain_of(cell), parameters, cell)
    rng = np.random.default_rng([seed, 0])
    low, high = joint_range(site.chain, SpaceRules())
    count = LOADED_POSTURES if loaded else POSTURES
    found = np.empty((0, site.chain.n))
    for _ in range(BATCHES):
        drawn = rng.uniform(low, high, (BATCH, site.chain.n))
        found = np.vstack([found, drawn[measurable(site, drawn, SpaceRules())]])[:count]
        if len(found) == count:
            break
    if not loaded:
        return Offers.of([Offer(k, q, np.zeros((1, 6))) for k, q in enumerate(found, start=1)], readings, cell)
    rules = LoadRules(directions=DIRECTIONS, largest_force=largest_force(readings))
    pulls = full_pulls(cell, parameters, rules, len(found), rng)
    levels = levels_of(readings)
    pairs = [(q, pull) for q, several in zip(found, pulls, strict=True) for pull in several]
    each = [Offer(k, q, wrench_steps(pull, levels)) for k, (q, pull) in enumerate(pairs, start=1)]
    return Offers.of(each, readings, cell)


def proposed_plan(measurements: Sequence[ProposedMeasurement], cell: Cell) -> Plan:
    """Return proposals as a plan, which `simulate` and the sequencer read."""
    configurations = tuple(
        PlannedConfiguration(number, np.array(proposal.q), np.array(proposal.steps))
        for number, proposal in enumerate(measurements, start=1)
    )
    no_cycle = np.empty((0, len(cell.robot.joints)))
    return Plan(cell.robot.name, cell.robot.joints, configurations, no_cycle, made_for=planned_robot(cell))
