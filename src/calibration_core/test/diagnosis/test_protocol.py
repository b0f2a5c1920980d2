"""What a protocol is said to reveal is what the physics lets it reveal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibration_core.cell import load_cell
from calibration_core.diagnosis.proposals.choose import Offer
from calibration_core.diagnosis.proposals.protocol import PROTOCOLS, SHOWN, Pace, Worth, _log_bayes_factor, worth_of
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.robot import chain_of
from calibration_core.policy import PRIOR_WIDTH

CELL = load_cell(Path(__file__).parents[4] / "config" / "cells" / "demo.cell.yaml")


@pytest.fixture(scope="module")
def judged() -> dict[str, Worth]:
    rng = np.random.default_rng(4)
    pulls = []
    for number in range(1, 13):
        q = rng.uniform([-1, -0.3, -1.0, -2, -1.5, -2], [1, 0.9, 0.6, 2, 1.5, 2])
        force = 2300.0 * np.array([0.5 * np.cos(number), 0.5 * np.sin(number), -0.866])
        pulls.append(Offer(number, q, np.outer([0.0, 1.0], np.r_[force, np.zeros(3)])))
    parameters = nominal_parameters(CELL)
    chain = chain_of(CELL)
    return {
        one.name: worth_of(one, pulls, pulls[0].q, CELL, chain, parameters, Pace(20.0, 5.0, 5.0)) for one in PROTOCOLS
    }


def test_time(judged: dict[str, Worth]) -> None:
    assert judged["loading"].minutes == pytest.approx(12 * (20 + 5 * 5 + 4 * 5) / 60)
    assert judged["unloading"].minutes == pytest.approx(12 * (20 + 9 * 5 + 8 * 5) / 60)
    held = judged["hold"].minutes - judged["loading"].minutes
    assert held == pytest.approx(
        3 * (2 * 600 + 5 + 5 + 5 + 5) / 60
    )  # two holds, two readings more after a load, one more
    assert judged["references"].minutes - judged["loading"].minutes == pytest.approx(4 * 25 / 60)


def test_each_step_reveals_what_it_is_made_for(judged: dict[str, Worth]) -> None:
    base = judged["loading"]
    assert judged["unloading"].apart["hysteresis"] > 5 * base.apart["hysteresis"]
    assert judged["hold"].apart["creep"] > 3 * max(base.apart["creep"], judged["unloading"].apart["creep"])
    assert judged["small steps"].apart["backlash"] > 1.5 * base.apart["backlash"]
    assert judged["reversed"].evidence["tool_compliance"] > 3 * base.evidence["tool_compliance"]
    assert judged["reversed"].stiffness_std.max() < 0.7 * base.stiffness_std.max()
    assert set(judged["everything"].distinguished) >= set(base.distinguished)


def test_exact_aliases_are_never_told(judged: dict[str, Worth]) -> None:
    for one in judged.values():
        assert one.apart["wrench_gain"] < SHOWN
        assert one.apart["gravity_compensator"] < SHOWN
        assert "gravity_compensator" not in one.distinguished


def test_expected_bayes_factor_is_the_mean_of_drawn_ones() -> None:
    rng = np.random.default_rng(1)
    columns = rng.normal(size=(40, 2)) * 3
    own = columns.T @ columns
    total = 0.0
    for _ in range(4000):
        size = rng.choice([-1.0, 1.0], 2) / PRIOR_WIDTH
        y = columns @ size + rng.normal(size=40)
        covariance = np.eye(40) + columns @ columns.T
        total += 0.5 * (y @ y - y @ np.linalg.solve(covariance, y) - np.linalg.slogdet(covariance)[1])
    assert _log_bayes_factor(own) == pytest.approx(total / 4000, rel=0.03)
