"""What a proposal is worth: one proposed configuration against four taken at random.

Recordings with one concealed effect are diagnosed.  Where the finding is confounded with something else, the proposed
configuration is measured in the same simulated cell, again and again with new noise, and so are sets of four of those
that could have been proposed, drawn by lot.  What counts is by how much the truth then stands out, on average, from
the nearest rival that either of the two can part from it; an exact alias is parted by neither and left out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calibration_sim.scenarios.generate as simulator
from calibration_core.cell import Cell, load_cell
from calibration_core.commands.evaluation.candidate_measurements import offers_for
from calibration_core.diagnosis.evidence.design import Design
from calibration_core.diagnosis.evidence.extended import design_at, loaded_state
from calibration_core.diagnosis.loaded import diagnose_loaded
from calibration_core.diagnosis.proposals.choose import Offer
from calibration_core.diagnosis.result.finding import Diagnosis
from calibration_core.files.yaml_file import yaml_text
from calibration_core.identification.stiffness.loaded import Options, prepare_loaded
from calibration_core.model.effects import candidates
from calibration_core.recording.tables.table import read_table, write_table
from calibration_core.timeseries import Float1D, Readings
from calibration_sim.cell.protocol import Configuration, Protocol
from calibration_sim.scenarios.grid import Scenario, grid, sample

SEEDS = (31, 32, 3, 11, 5, 2, 13, 17, 41, 43)  # the first six for development; none of make prove or the small proof
EFFECTS = (  # often ambiguous
    "off_axis_compliance",
    "link_bending",
    "tool_compliance",
    "joint_coupling",
    "soft_zone",
    "backlash",
    "nonlinear_stiffness",
    "wrench_crosstalk",
)
PER_SEED = 30  # recordings, at most
WANTED = 16  # ambiguous cases, at least
RANDOM = 4
REPEATS = 6  # of the proposed configuration, and of the lot
AS_GOOD = 0.1  # nats
PARTED = 0.5  # nats: a rival that neither measurement moves by so much is an alias
FIRST = 1001  # numbers of the added configurations
PROCESSES = 2

Place = tuple[str, dict[str, Any]]


@dataclasses.dataclass(frozen=True)
class Case:
    """One ambiguous recording: by how many nats the truth stands above the nearest rival that can be parted from it."""

    name: str
    before: float
    proposed: float
    at_random: float
    expected: float


def scenarios() -> Iterator[Scenario]:
    """Yield loaded recordings of the seeds in turn."""
    loaded = [[s for s in grid(seed) if s.group == "single" and s.protocol in {"L", "R"}] for seed in SEEDS]
    for several in zip(*(sample(some, PER_SEED, EFFECTS) for some in loaded), strict=True):
        yield from several


def case_of(scenario: Scenario, folder: Path) -> Case | None:
    """Diagnose, measure what is proposed and what is drawn; None where nothing is ambiguous that could be parted."""
    folder = folder / f"{scenario.seed}"
    folder.mkdir()
    made = simulator.generate(scenario)
    cell = written(made.cell, folder)
    readings = table(made.readings, cell, folder)
    offers = offers_for(readings, cell)
    found = diagnose_loaded(readings, cell, offers=offers)
    (truth,) = made.label["effects"]
    if len(found.physics) != 1 or not found.physics[0].location or not found.next_measurements or not offers:
        return None
    (finding,), proposal = found.physics, found.next_measurements[0]
    places: list[Place] = [(finding.effect, dict(finding.location))]
    places += [(other.effect, dict(other.location)) for other in finding.cannot_be_told_from]
    right = [k for k, place in enumerate(places) if is_truth(place, truth)]
    if proposal.gain_unit != "nats" or not right:
        return None
    measured = [Offer(0, np.array(proposal.q), np.array(proposal.steps))] * REPEATS + by_lot(offers.each, scenario.seed)
    further = more(scenario, measured, cell, folder)
    asked = FIRST + np.arange(len(measured))
    judged = [margins(readings, cell, found, places, right[0])]
    for sets in (asked[:REPEATS, None], asked[REPEATS:].reshape(REPEATS, RANDOM)):
        also = [joined(readings, further.select(np.isin(further.configuration, some))) for some in sets]
        judged.append(np.mean([margins(some, cell, found, places, right[0]) for some in also], axis=0))
    before, proposed, at_random = judged
    parted = np.maximum(np.abs(proposed - before), np.abs(at_random - before)) > PARTED
    if not parted.any():
        return None
    name = f"{truth['effect']} {scenario.robot} {scenario.protocol} {scenario.seed}"
    nearest = (float(each[parted].min()) for each in judged)
    return Case(name, *nearest, proposal.gain)


def by_lot(offers: Sequence[Offer], seed: int) -> list[Offer]:
    """Draw what could have been proposed: every second with the steps of the recording, the others to and fro."""
    drawn = np.random.default_rng(seed).choice(len(offers), REPEATS * RANDOM, replace=False)
    return [offers[index].alternating if k % 2 else offers[index] for k, index in enumerate(drawn)]


def is_truth(place: Place, label: Mapping[str, Any]) -> bool:
    """Say whether a place is the labelled one."""
    plain, stated = (
        {key: [value] if isinstance(value, str) else list(value) for key, value in location.items()}
        for location in (place[1], label["location"])
    )
    return bool(place[0] == label["effect"]) and plain == stated


def more(scenario: Scenario, measured: Sequence[Offer], cell: Cell, folder: Path) -> Readings:
    """Measure further configurations in the same cell, with the same robot and effect."""
    protocol = Protocol(tuple(Configuration(FIRST + k, offer.q, offer.steps) for k, offer in enumerate(measured)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulator, "make_protocol", lambda *_: protocol)
        return table(simulator.generate(scenario).readings, cell, folder)


def written(content: Mapping[str, Any], folder: Path) -> Cell:
    """Write a cell file and read it."""
    path = folder / "cell.yaml"
    path.write_text(yaml_text(dict(content)))
    return load_cell(path)


def table(readings: Readings, cell: Cell, folder: Path) -> Readings:
    """Write a measurement table and read it."""
    path = folder / "measurements.csv"
    path.unlink(missing_ok=True)
    write_table(path, readings)
    return read_table(path, cell)


def joined(first: Readings, second: Readings) -> Readings:
    """Return both recordings as one, the second later."""
    arrays = {
        f.name: np.concatenate([getattr(first, f.name), getattr(second, f.name)])
        for f in dataclasses.fields(first)
        if isinstance(getattr(first, f.name), np.ndarray)
    }
    arrays["time"] = np.concatenate([first.time, second.time + float(np.nanmax(first.time)) + 100.0])
    return dataclasses.replace(first, **arrays)


def margins(readings: Readings, cell: Cell, found: Diagnosis, places: Sequence[Place], truth: int) -> Float1D:
    """Return by how many nats the truth stands above each of the others, every place under its best law."""
    prepared = prepare_loaded(readings, cell, Options())
    state = loaded_state(prepared.problem, cell, found.compliance)
    asked = tuple(c for c in candidates(state) if (c.effect, dict(c.location)) in places)
    rows = prepared.problem.linearise(found.compliance).rows
    factor = (found.noise / found.identification.noise.claimed) ** 2
    used = np.flatnonzero(prepared.rejection.used)
    rows = dataclasses.replace(rows, noise=rows.noise * factor).select(used)
    design = design_at(prepared.problem, cell, found.compliance, rows, used, asked, prepared.frames)[1]
    scores = log_bayes_factors(design)
    best = [
        max(s for s, c in zip(scores, asked, strict=True) if (c.effect, dict(c.location)) == place) for place in places
    ]
    return np.array([best[truth] - score for k, score in enumerate(best) if k != truth])


def log_bayes_factors(design: Design) -> list[float]:
    """Return the log Bayes factor of every candidate beside the null model, with its wide prior, nats."""
    beside = np.column_stack([design.null / np.linalg.norm(design.null, axis=0), design.columns[:, design.discrepancy]])
    prior = np.concatenate([np.zeros(design.n), np.ones(beside.shape[1] - design.n)])
    inverse = np.linalg.inv(beside.T @ beside + np.diag(prior))
    factors = []
    for index in range(len(design.candidates)):
        own = design.columns[:, design.own(index)]
        left = own - beside @ (inverse @ (beside.T @ own))
        matrix, vector = own.T @ left + np.eye(own.shape[1]), left.T @ design.residual
        factors.append(0.5 * float(vector @ np.linalg.solve(matrix, vector) - np.linalg.slogdet(matrix)[1]))
    return factors


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> list[Case]:
    """All ambiguous recordings of the seeds, measured further."""
    tasks, folder = list(scenarios()), tmp_path_factory.mktemp("proposals")
    with ProcessPoolExecutor(PROCESSES) as pool:
        found = [case for case in pool.map(case_of, tasks, [folder] * len(tasks)) if case is not None]
    for case in found:
        print(
            f"{case.name}: {case.before:.1f} nats, with the proposed one {case.proposed:.1f} (gain expected "
            f"{case.expected:.1f}), with {RANDOM} at random {case.at_random:.1f}",
            flush=True,
        )
    assert len(found) >= WANTED
    return found


@pytest.mark.slow
def test_one_proposed_configuration_tells_as_much_as_four_random_ones(cases: list[Case]) -> None:
    proposed = np.array([case.proposed - case.before for case in cases])
    at_random = np.array([case.at_random - case.before for case in cases])
    print(f"gain on average {proposed.mean():.1f} nats, {at_random.mean():.1f} nats with {RANDOM} at random")
    assert proposed.mean() >= at_random.mean()


@pytest.mark.slow
@pytest.mark.xfail(
    reason="15 of 21 cases: four random configurations tell as much where a joint or the tool tilts (measured.yaml)",
    strict=True,
)
def test_it_does_so_in_four_of_five_cases(cases: list[Case]) -> None:
    good = [case.proposed >= case.at_random - AS_GOOD for case in cases]
    print(f"at least as good in {sum(good)} of {len(good)} ambiguous cases")
    assert np.mean(good) >= 0.8
