"""Candidates of the planning benchmarks: random postures, and what each tells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from bench_geometry import bench_cell

from calibration_core.cell import load_cell
from calibration_core.identification.geometry.identifiability import geometry_terms, pose_information
from calibration_core.identification.geometry.terms import names_of
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.planning.feasible.loads import LoadRules, full_pulls, information
from calibration_core.planning.feasible.space import SpaceRules, joint_range

CELL = load_cell(Path(__file__).parents[2] / "config" / "cells" / "demo.cell.yaml")


def stiffness_candidates(count: int) -> np.ndarray:
    """Return information on six compliances, (count, 6, 6), of random postures, each with one oblique pull."""
    chain, parameters, rules = chain_of(CELL), nominal_parameters(CELL), LoadRules(directions=1)
    low, high = joint_range(chain, SpaceRules())
    q = np.random.default_rng(0).uniform(low, high, (count, chain.n))
    force = full_pulls(CELL, parameters, rules, count, np.random.default_rng(1))
    return information(chain, CELL, parameters, q, force, rules)[:, 0]


def kinematic_candidates(count: int) -> np.ndarray:
    """Return information on all kinematic parameters that one point shows with the base known, (count, 23, 23)."""
    cell = bench_cell()
    chain, parameters = chain_of(cell), nominal_parameters(cell)
    low, high = joint_range(chain, SpaceRules())
    q = np.random.default_rng(0).uniform(low, high, (count, chain.n))
    terms, _ = geometry_terms(chain, cell, parameters, q, base_known=True)
    assert len(names_of(terms)) == 23
    return pose_information(chain, cell, parameters, q, terms)
