"""`calibration plan --for geometry`: what is promised of frames and geometry is what a fit then delivers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from program import result_of, run

from calibration_core.cell import load_cell
from calibration_core.commands.planning.geometry import plan_geometry
from calibration_core.identification.geometry.fit import fit
from calibration_core.identification.geometry.identifiability import geometry_terms, pose_problem
from calibration_core.identification.geometry.terms import names_of
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.planning.loaded import PlanningRules
from calibration_core.planning.plans.plan_file import read_plan

SEEDS = 40


def test_promised_uncertainties_are_those_of_the_fit(cell_path: Path) -> None:
    cell = load_cell(cell_path)
    parameters = nominal_parameters(cell).replace(compliance=np.zeros(6))  # rigid: the readings know of no sag
    plan, found = plan_geometry(cell, parameters, PlanningRules(postures=100), configurations=18, spares=0.0, seed=3)
    chain = chain_of(cell)
    q = plan.table1()[1]
    problem = pose_problem(chain, cell, parameters, q)
    terms, _ = geometry_terms(chain, cell, parameters, q)
    assert names_of(terms) == found.expected.names
    exact = problem.position
    assert isinstance(problem.whitening, np.ndarray)
    root = np.linalg.inv(np.moveaxis(problem.whitening, -1, 0))
    rng, values = np.random.default_rng(0), []
    for _ in range(SEEDS):
        noise = np.einsum("mab,mb->am", root, rng.standard_normal((exact.shape[1], 3)))
        noisy = type(problem)(chain, problem.q, exact + noise, problem.names, problem.point, problem.whitening)
        fitted = fit(noisy, parameters, terms)
        assert fitted.converged
        change = [term.values(fitted.parameters) - term.values(parameters) for term in terms[1:]]
        values.append(np.concatenate(change))
    seen = np.sqrt(np.mean(np.square(values), axis=0)) / found.expected.std[6:]
    assert np.median(seen) == pytest.approx(1.0, abs=0.06)
    assert np.all(np.abs(seen - 1.0) < 0.4)  # 40 repeats know a scatter to 11 %


def test_the_command_writes_an_unloaded_plan_and_names_what_stays_nominal(
    cell_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("--for", "geometry", "--configurations", 14, "--no-report", "--out", tmp_path / "out")
    assert run("plan", "--cell", cell_path, *options) == 0
    assert "stay nominal: " in capsys.readouterr().out
    content = result_of(tmp_path / "out")
    assert content["recording"]["loaded"] is False
    assert content["geometry"]["efficiency"] > 0.9
    hidden = set(content["geometry"]["not_identifiable"])
    assert hidden == {"d_1", "theta_1", "d_3", "d_6", "theta_6"}  # base, parallel axes 2 and 3, tool
    assert not hidden & set(content["geometry"]["std"])
    assert content["geometry"]["std"]["a_2"] < 1e-4
    plan = read_plan(tmp_path / "out" / "plan.yaml", load_cell(cell_path))
    assert len(plan.primary) == 14
    assert all(one.steps.shape == (1, 6) and not one.steps.any() for one in plan.configurations)
