"""Pairs of a simulation, by the product or MuJoCo, and a recording of another plant: steps lead from one to the other.

`make prove-pairs` runs as many as PROVE_PAIRS says.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration_core.cell import Cell, load_cell
from calibration_core.diagnosis.comparison.result import Comparison
from calibration_core.diagnosis.diagnose import diagnose
from calibration_core.diagnosis.simulated import compare_checked
from calibration_core.files.yaml_file import yaml_text
from calibration_core.formats.calibrated import calibrated_robot
from calibration_core.formats.mjcf import mjcf_files
from calibration_core.model.effects.words import effect_sentence
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.simulation.simulate import simulate_plan
from calibration_core.observations.observe import observe
from calibration_core.recording.tables.table import write_table
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Readings
from calibration_sim.cell.protocol import Configuration
from calibration_sim.effects.draw import robot_cell
from calibration_sim.scenarios.generate import generate
from calibration_sim.scenarios.grid import LOUDER, Planned, Scenario, grid, second_grid
from calibration_sim.scenarios.protocols import make_protocol

SEED, MANY = int(os.environ.get("PROVE_SEED", "20261")), int(os.environ.get("PROVE_PAIRS", "200"))
FITTED, TESTED = 18, 8  # configurations
FOREIGN = 40  # simulations of other conventions, and by another program
ROUNDS = 12  # until MuJoCo's robot rests: its springs are stiff beside what load and weight change
UNLOADED = 40  # pairs at rest, or with postures at rest beside loads
FAULTY = 36  # recordings of a robot in which nothing is missing, with a fault of tracker, targets or encoders
SENSOR = frozenset({"wrench_gain", "wrench_crosstalk", "wrench_frame_misalignment"})
MODELLED = frozenset({"simulation", "frames", "geometry", "stiffness", "noise"})


Simulate = Callable[[Cell, Scenario], Readings]
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


def since(readings: Readings, rng: np.random.Generator) -> Bool1D:
    """From one of the configurations on, a few of which are on either side."""
    return np.asarray(readings.configuration > rng.integers(4, 14))


def elsewhere(readings: Readings, rng: np.random.Generator) -> Readings:
    later, turn = since(readings, rng)[:, None], Rotation.from_rotvec(0.2 * rng.standard_normal(3)).as_matrix()
    moved = readings.position @ turn.T + 0.3 * rng.standard_normal(3)
    return dataclasses.replace(readings, position=np.where(later, moved, readings.position))


def exchanged(readings: Readings, rng: np.random.Generator) -> Readings:
    position, later, two = readings.position.copy(), since(readings, rng), rng.choice(3, 2, replace=False)
    rows = [np.flatnonzero(later & (readings.point == k)) for k in two]
    position[np.concatenate(rows)] = readings.position[np.concatenate(rows[::-1])]
    return dataclasses.replace(readings, position=position)


def slipped(readings: Readings, rng: np.random.Generator) -> Readings:
    angles, later = readings.q.copy(), since(readings, rng)
    angles[later, rng.integers(1, 5)] += 2e-3
    return dataclasses.replace(readings, q=angles)


def shaky(readings: Readings, rng: np.random.Generator) -> Readings:
    keys = np.column_stack([readings.configuration, readings.step])
    step = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
    angles = readings.q.copy()
    angles[:, rng.integers(1, 5)] += 3e-4 * rng.standard_normal(step.max() + 1)[step]
    return dataclasses.replace(readings, q=angles)


def warm(readings: Readings, _: np.random.Generator) -> Readings:
    return dataclasses.replace(readings, temperature=readings.temperature + 8.0)


# Faults of the simulator by their name, those of single channels by what does them; and what names each.
FAULTS: tuple[tuple[str | Callable[[Readings, np.random.Generator], Readings], frozenset[str]], ...] = (
    ("target_moved", frozenset({"target_moved"})),
    (slipped, frozenset({"joint angles", "zero_moved"})),
    ("tracker_moved", frozenset({"tracker_moved"})),
    (exchanged, frozenset({"point_order"})),
    ("loose_target", frozenset({"loose_target"})),
    (shaky, frozenset({"joint angles"})),
    ("outlier_readings", frozenset({"outlier_readings"})),
    (elsewhere, frozenset({"tracker_moved"})),
    ("noise_understated", frozenset({"noise_understated"})),
    (warm, frozenset({"temperature"})),
    ("tracker_scale", frozenset()),  # a geometry of another size does the same: it has to stay open
    ("tracker_drift", frozenset({"tracker_drift"})),
)


def loads(readings: Readings) -> Float2D:
    assert readings.wrench is not None
    return readings.wrench


class Measured(NamedTuple):
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


def others(seed: int) -> list[Scenario]:
    """Return further loaded recordings, to be simulated by another program."""
    return scenarios(seed + 1)[:FOREIGN]


def unloaded(seed: int) -> list[Scenario]:
    """Return recordings of one effect at rest, and with postures at rest beside loads, in turn."""
    kinds = [[one for one in second_grid(seed) if one.group == kind] for kind in ("rest", "mixed")]
    return [one for both in zip(*kinds, strict=False) for one in both][:UNLOADED]


def measured(scenario: Scenario) -> tuple[Configuration, ...]:
    return make_protocol(robot_cell(scenario.robot), scenario.protocol, scenario.seed).configurations


def simulated(cell: Cell, scenario: Scenario) -> Readings:
    """Return what the product's `simulate` says of the same plan, by the cell file alone."""
    planned = [Measured(one.number, one.q, one.wrenches) for one in measured(scenario)]
    return simulate_plan(planned, cell, nominal_parameters(cell))


def by_mujoco(cell: Cell, scenario: Scenario) -> Readings:
    """Return what MuJoCo says of the same plan, as a table: the cell's exported model at rest under every load."""
    parameters = nominal_parameters(cell)
    model = mujoco.MjModel.from_xml_string(mjcf_files(calibrated_robot(cell, parameters)).files["robot.xml"].decode())
    data, joints, tracker = mujoco.MjData(model), cell.robot.joints, parameters.tracker
    drives = [int(model.jnt_qposadr[model.joint(name).id]) for name in joints]
    give = model.jnt_stiffness.copy()
    give[model.actuator_trnid[:, 0]] = model.actuator_gainprm[:, 0]
    positions = []
    for configuration in measured(scenario):
        for wrench in configuration.wrenches:
            data.qpos[:], data.ctrl[:] = 0.0, configuration.q
            data.qpos[drives] = configuration.q
            for _ in range(ROUNDS):
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                data.qfrc_applied[:] = 0.0
                if wrench.any():
                    at = data.site("wrench_point").xpos
                    flange = model.body("flange").id
                    mujoco.mj_applyFT(model, data, wrench[:3], wrench[3:], at, flange, data.qfrc_applied)
                mujoco.mj_forward(model, data)
                data.qpos += data.qfrc_smooth / give
            assert np.abs(data.qfrc_smooth / give).max() < 1e-8, "it has not come to rest"
            seen = np.array([data.site(name).xpos for name in cell.frames.measurement_points])
            positions.append((seen - tracker[:3, 3]) @ tracker[:3, :3])
    table = cell.path.with_name("mujoco.csv")
    write_table(table, dataclasses.replace(simulated(cell, scenario), position=np.concatenate(positions)))
    return observe(table, cell, simulated=True)


def pairs(chosen: list[Scenario], simulate: Simulate, folder: Path) -> Iterator[Pair]:
    for scenario in chosen:
        made = generate(scenario)
        path = folder / "cell.yaml"
        path.write_text(yaml_text(made.cell), encoding="utf-8")
        cell, readings = load_cell(path), made.readings
        last = np.unique(readings.configuration)[-TESTED:]
        tested = np.isin(readings.configuration, last)
        found = diagnose(
            readings.select(~tested), cell, test=readings.select(tested), simulation=simulate(cell, scenario)
        )
        true = frozenset(str(effect["effect"]) for effect in made.label["effects"])
        same = [one for effect in made.label["effects"] for one in effect["equivalent"]]
        alike = frozenset(effect_sentence(one["effect"], one["location"]) for one in same)
        yield Pair(scenario.group, true, alike, found.comparisons[0], found.noise_known)


def faulty(folder: Path) -> Iterator[tuple[str, str, bool | None, set[str]]]:
    """Yield a fault, how was measured, whether it is named (None: it cannot be), and what physics is claimed."""
    sound = [one for one in grid(SEED) if one.group == "nothing" and one.protocol == "L"]
    for number in range(FAULTY):
        fault, words = FAULTS[number % len(FAULTS)]
        turn, protocols = number // len(FAULTS), (f"L{FITTED}", "A", f"L{FITTED}A20")
        slow = fault == "tracker_drift"  # which only positions show, beside the geometry
        protocol = protocols[-1 - turn % 2 if slow else (number + turn) % 3]
        planned = (Planned(fault, 1.5, snr=LOUDER if slow else 0.0, at_least=True),) if isinstance(fault, str) else ()
        own = sound[number % len(sound)]
        scenario = dataclasses.replace(
            own, protocol=protocol, planned=planned, group="anomaly", seed=own.seed + number, second=slow
        )
        made = generate(scenario)
        path = folder / "cell.yaml"
        path.write_text(yaml_text(made.cell), encoding="utf-8")
        cell, readings = load_cell(path), made.readings
        if not isinstance(fault, str):
            readings = fault(readings, np.random.default_rng(scenario.seed))
        found = diagnose(readings, cell, simulation=simulated(cell, scenario))
        wrong = [one.what for one in found.comparisons[0].witnesses if one.wrong != "simulation"]
        said = {*wrong, *(one.kind for one in found.anomalies), *(one.effect for one in found.findings)}
        physics = {one.effect for one in found.findings if "tracker" not in one.location}
        yield str(getattr(fault, "__name__", fault)), protocol, bool(said & words) if words else None, physics


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


@pytest.mark.slow
def test_faults_of_tracker_and_encoders_are_named_and_no_physics(tmp_path: Path) -> None:
    named, claimed = [], []
    for fault, protocol, right, physics in faulty(tmp_path):
        print(fault, protocol, "named" if right else "open", sorted(physics), flush=True)
        named += [] if right is None else [right]
        claimed.append(not physics)
    print(f"faults of tracker and encoders named: {share(named)}, without physics of the robot: {share(claimed)}")
    assert all(claimed)
    assert np.mean(named) >= 0.9


def share(hits: list[bool]) -> str:
    return f"{sum(hits)} of {len(hits)}"


@pytest.mark.slow
@pytest.mark.parametrize(("chosen", "simulate"), [(scenarios, simulated), (unloaded, simulated), (others, by_mujoco)])
def test_the_steps_lead_from_the_simulation_to_the_noise(
    chosen: Callable[[int], list[Scenario]], simulate: Simulate, tmp_path: Path
) -> None:
    sums, ends, largest, nothing, closed, worse, witnessed = [], [], [], [], [], [], []
    for pair in pairs(chosen(SEED)[:MANY], simulate, tmp_path):
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
