"""Pairs of a simulation by the product and a recording of another plant: the steps lead from the one to the other.

`make prove-pairs` runs as many as PROVE_PAIRS says.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from calibration_core.cell import Cell, load_cell
from calibration_core.diagnosis.comparison.result import Comparison
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.simulated import compare_checked
from calibration_core.files.yaml_file import yaml_text
from calibration_core.model.effects.words import effect_sentence
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.simulation.simulate import simulate_plan
from calibration_core.timeseries import Float1D, Float2D, Readings
from calibration_sim.cell.protocol import Configuration
from calibration_sim.effects.draw import robot_cell
from calibration_sim.scenarios.generate import generate
from calibration_sim.scenarios.grid import Scenario, grid, second_grid
from calibration_sim.scenarios.protocols import make_protocol

SEED, MANY = int(os.environ.get("PROVE_SEED", "20261")), int(os.environ.get("PROVE_PAIRS", "200"))
FITTED, TESTED = 18, 8  # configurations
FOREIGN = 40  # simulations of other conventions
UNLOADED = 40  # pairs at rest, or with postures at rest beside loads
SENSOR = frozenset({"wrench_gain", "wrench_crosstalk", "wrench_frame_misalignment"})
MODELLED = frozenset({"simulation", "frames", "geometry", "stiffness", "noise"})


CONVENTIONS: tuple[tuple[str, Callable[[Readings], Readings]], ...] = (
    ("wrench_sign", lambda r: dataclasses.replace(r, wrench=-loads(r))),
    ("wrench_unit", lambda r: dataclasses.replace(r, wrench=1e-3 * loads(r))),
    ("position_unit", lambda r: dataclasses.replace(r, position=1e3 * r.position)),
    ("angle_unit", lambda r: dataclasses.replace(r, q=np.degrees(r.q))),
    ("joint_order", lambda r: dataclasses.replace(r, q=r.q[:, [0, 1, 2, 4, 3, 5]])),
    ("wrong_robot_file", lambda r: dataclasses.replace(r, q=r.q * [1, 1, -1, 1, 1, 1])),
    ("wrong_robot_file", lambda r: dataclasses.replace(r, q=r.q + np.array([0, 0, 0, 0, 0.2, 0]))),
    ("wrench_frame", lambda r: dataclasses.replace(r, wrench=loads(r)[:, [1, 2, 0, 4, 5, 3]])),
)


def loads(readings: Readings) -> Float2D:
    assert readings.wrench is not None
    return readings.wrench


class Planned(NamedTuple):
    """A configuration as the product simulates it."""

    number: int
    q: Float1D
    steps: Float2D


class Pair(NamedTuple):
    """What one pair came to; `alike` says in words what does exactly the same as a concealed effect."""

    group: str
    true: frozenset[str]
    alike: frozenset[str]
    compared: Comparison
    noise: float


def scenarios(seed: int) -> list[Scenario]:
    """Return loaded recordings of none to three effects, with eight configurations more to test on, mixed."""
    chosen = [one for one in grid(seed) if one.group in {"nothing", "single", "pair", "triple"}]
    chosen = [one for one in chosen if one.protocol == "L" and len(one.planned) < 4]
    groups = [[one for one in chosen if one.group == group] for group in ("nothing", "single", "pair", "triple")]
    longest = max(map(len, groups))
    mixed = [one[k] for k in range(longest) for one in groups if k < len(one)]
    return [dataclasses.replace(one, protocol=f"L{FITTED + TESTED}") for one in mixed]


def unloaded(seed: int) -> list[Scenario]:
    """Return recordings of one effect at rest, and with postures at rest beside loads, in turn."""
    kinds = [[one for one in second_grid(seed) if one.group == kind] for kind in ("rest", "mixed")]
    return [one for both in zip(*kinds, strict=False) for one in both][:UNLOADED]


def simulated(cell: Cell, scenario: Scenario) -> Readings:
    """Return what the product's `simulate` says of the same plan, by the cell file alone."""
    measured: tuple[Configuration, ...] = make_protocol(
        robot_cell(scenario.robot), scenario.protocol, scenario.seed
    ).configurations
    planned = [Planned(one.number, one.q, one.wrenches) for one in measured]
    return simulate_plan(planned, cell, nominal_parameters(cell))


def pairs(chosen: list[Scenario], folder: Path) -> Iterator[Pair]:
    for scenario in chosen:
        made = generate(scenario)
        path = folder / "cell.yaml"
        path.write_text(yaml_text(made.cell), encoding="utf-8")
        cell, readings = load_cell(path), made.readings
        last = np.unique(readings.configuration)[-TESTED:]
        tested = np.isin(readings.configuration, last)
        found = diagnose(
            readings.select(~tested), cell, test=readings.select(tested), simulation=simulated(cell, scenario)
        )
        true = frozenset(str(effect["effect"]) for effect in made.label["effects"])
        same = [one for effect in made.label["effects"] for one in effect["equivalent"]]
        alike = frozenset(effect_sentence(one["effect"], one["location"]) for one in same)
        yield Pair(scenario.group, true, alike, found.comparisons[0], found.noise_known)


def told(folder: Path) -> Iterator[tuple[str, set[tuple[str, str]], bool]]:
    """Yield a convention, what is said of a simulation in it (kind and side), and whether with the cure."""
    for number, scenario in enumerate(scenarios(SEED)[:FOREIGN]):
        made = generate(scenario)
        path = folder / "cell.yaml"
        path.write_text(yaml_text(made.cell), encoding="utf-8")
        cell, readings = load_cell(path), made.readings
        kind, foreign = CONVENTIONS[number % len(CONVENTIONS)]
        found = compare_checked(readings, foreign(simulated(cell, scenario)), cell)
        said = [one for one in found.differences if one.kind != "noise_understated"]
        yield kind, {(one.kind, one.side) for one in said}, all(one.remedy and one.remedy in one.text for one in said)


@pytest.mark.slow
def test_conventions_of_foreign_simulations_are_named(tmp_path: Path) -> None:
    named = [(kind, said == {(kind, "simulation")} and cure) for kind, said, cure in told(tmp_path)]
    print(f"foreign simulations named: {share([right for _, right in named])}")
    assert all(right for _, right in named), [kind for kind, right in named if not right]


def share(hits: list[bool]) -> str:
    return f"{sum(hits)} of {len(hits)}"


@pytest.mark.slow
@pytest.mark.parametrize("chosen", [scenarios, unloaded])
def test_the_steps_lead_from_the_simulation_to_the_noise(
    chosen: Callable[[int], list[Scenario]], tmp_path: Path
) -> None:
    sums, ends, largest, nothing, closed, worse, witnessed = [], [], [], [], [], [], []
    for pair in pairs(chosen(SEED)[:MANY], tmp_path):
        steps, improved = pair.compared.waterfall, pair.compared.improved
        print(pair.group, sorted(pair.true), [(step.name, round(1e6 * step.rms, 1)) for step in steps], flush=True)
        witnesses = [one for one in pair.compared.witnesses if one.what == "wrench"]
        if pair.true & SENSOR:
            witnessed.append(next((one.wrong for one in witnesses), "either"))
        if not steps or improved is None:
            ends.append(False)
            continue
        sums.append(abs(sum(step.share for step in steps) - 1) < 1e-6)
        physics = [step for step in steps if step.name not in MODELLED]
        if pair.group == "nothing":
            nothing.append(all(step.share <= 0.02 for step in physics))
        else:
            ends.append(steps[-1].rms <= 1.2 * pair.noise)
            bar = max(physics, key=lambda step: step.share, default=steps[0])
            largest.append(bar.name in pair.true or bar.what in pair.alike)
        closed.append(improved.test_rms / steps[-1].test_rms - 1)
        before = steps[-3].test_rms if physics else steps[-2].test_rms
        worse.append(improved.test_rms <= 1.05 * before)
    right = [one == "recording" for one in witnessed]
    print(f"steps add up: {share(sums)}")
    print(f"last step within 1.2 times the noise: {share(ends)}")
    print(f"the true cause's bar is the largest of the physics: {share(largest)}")
    print(f"nothing missing, no bar of physics: {share(nothing)}")
    print(f"new simulation against the test, beyond the promise, median: {100 * np.median(np.abs(closed)):.1f} %")
    print(f"never worse than the step before: {share(worse)}")
    print(f"sensor at fault, witness named: {share(right)}, the simulation instead: {witnessed.count('simulation')}")
    assert all(sums)
    assert np.mean(ends) >= 0.9
    assert np.mean(largest) >= 0.95
    assert all(nothing)
    assert np.median(np.abs(closed)) <= 0.1
    assert all(worse)
    assert not right or np.mean(right) >= 0.9
    assert "simulation" not in witnessed
