"""What a measurement protocol can reveal of the physics that is usually left out, and what it costs.

A protocol is the load steps of every configuration, holds, and visits to a reference.  Readings are predicted as the
plan would take them; for every effect of the catalogue, at its typical size, the expected log Bayes factor against the
model of joint springs alone follows from the whitened columns, all compliances and all of the discrepancy refitted:

    E[log BF] = 1/2 sum_i [(1 + s_i a^2) s_i / (1 + s_i) - log(1 + s_i)],

s_i the eigenvalues of the projected information in prior standard deviations, a the typical size in these.  An effect
that a protocol shows may still be taken for another one: distinguished is what keeps a log likelihood against every
other effect, at any place, fitted in its stead.
Source: Kass and Raftery, 1995; Atkinson and Fedorov, 1975 (T-optimality).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from calibration_core.cell import Cell
from calibration_core.diagnosis.evidence.design import Design, build_design
from calibration_core.diagnosis.evidence.extended import loaded_state, structured_discrepancy
from calibration_core.diagnosis.proposals.choose import Offer
from calibration_core.identification.stiffness.problem import build_problem
from calibration_core.model.chain import Chain
from calibration_core.model.effects import candidates
from calibration_core.model.effects.candidate import Candidate
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.simulation.simulate import simulate_plan
from calibration_core.policy import PRIOR_WIDTH
from calibration_core.timeseries import Float1D, Float2D, Readings

SHOWN = 5.0  # nats, from which an effect counts as shown: above what chance makes of the whole catalogue
MINUTE = 60.0  # s
REFERENCE = 0  # number under which a reference is recorded


@dataclasses.dataclass(frozen=True)
class MeasurementProtocol:
    """How every configuration is loaded.

    Attributes:
        text: What is done.
        levels: Fractions of the full pull, one per step; negative: pulled the other way.
        hold: s, how long full and zero load are held in the configurations that are held; 0: not at all.
        held: How many configurations are held.
        every: The reference is visited after so many configurations; 0: never.
    """

    name: str
    text: str
    levels: tuple[float, ...]
    hold: float = 0.0
    held: int = 0
    every: int = 0


UP = (0.0, 0.25, 0.5, 0.75, 1.0)
UP_AND_DOWN = (*UP, 0.75, 0.5, 0.25, 0.0)
PROTOCOLS = (
    MeasurementProtocol("loading", "loaded in four steps, nothing else", UP),
    MeasurementProtocol("unloading", "and unloaded through the same steps", UP_AND_DOWN),
    MeasurementProtocol("small steps", "with steps of 5 and 10 %", (0.0, 0.05, 0.1, 0.25, 0.5, 0.75, 1.0)),
    MeasurementProtocol("reversed", "and pulled the other way", (0.0, 0.5, 1.0, 0.5, 0.0, -0.5, -1.0, -0.5, 0.0)),
    MeasurementProtocol("hold", "full and zero load held for ten minutes, in three configurations", UP, 600.0, 3),
    MeasurementProtocol("references", "with a reference posture visited again and again", UP, every=4),
    MeasurementProtocol(
        "everything", "all of it",
        (0.0, 0.05, 0.1, 0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0, -0.5, -1.0, -0.5, 0.0), 600.0, 3, 4,
    ),
)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Pace:
    """How long things take, s: to drive to the next configuration, to change a load, to settle and read."""

    moving: float = 20.0
    loading: float = 5.0
    reading: float = 5.0


@dataclasses.dataclass(frozen=True, eq=False)
class Worth:
    """What a protocol costs and buys.

    Attributes:
        minutes: How long it takes.
        evidence: Effect -> expected log Bayes factor at its typical size, nats; of the places that it may have, the
            middle one, each by its best variant.
        apart: Effect -> expected log likelihood ratio against the other effect that explains it best, nats, likewise.
        stiffness_std: (n,) standard deviation of every stiffness over its value.
    """

    protocol: MeasurementProtocol
    minutes: float
    evidence: Mapping[str, float]
    apart: Mapping[str, float]
    stiffness_std: Float1D

    def __post_init__(self) -> None:
        """Freeze the mappings."""
        for name in ("evidence", "apart"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    @property
    def shown(self) -> tuple[str, ...]:
        """Effects that it is expected to show at their typical size."""
        return tuple(effect for effect, nats in self.evidence.items() if nats > SHOWN)

    @property
    def distinguished(self) -> tuple[str, ...]:
        """Effects that it is expected to show and to tell from every other one."""
        return tuple(effect for effect in self.shown if self.apart[effect] > SHOWN)


def worth_of(
    protocol: MeasurementProtocol,
    pulls: Sequence[Offer],
    reference: Float1D,
    cell: Cell,
    chain: Chain,
    parameters: ModelParameters,
    pace: Pace | None = None,
) -> Worth:
    """Judge a protocol on the configurations of a plan.

    Args:
        protocol: The load steps.
        pulls: Configurations in order; their largest load is the full pull.
        reference: (n,) rad, where the reference is visited.
        cell: The cell.
        chain: The robot, geometry corrections included.
        parameters: The model, with compliances.
        pace: How long things take; the defaults if None.

    Raises:
        CellError: A frame that the load needs is missing.
        EquilibriumError: A load is beyond what the springs can carry.
    """
    offers, seconds, total = _schedule(protocol, pulls, reference, pace or Pace())
    readings = _timed(simulate_plan(offers, cell, parameters), seconds)
    problem = build_problem(readings, cell, chain, parameters)
    linear = problem.linearise(parameters.compliance)
    state = loaded_state(problem, cell, parameters.compliance)
    found = candidates(state)
    extra = structured_discrepancy(state, None)
    design = build_design(state, linear.rows, linear.residual, linear.columns, found, extra, chance=False)
    left, covariance = _left(design)
    evidence = _by_effect(found, [_log_bayes_factor(left[block, block]) for block in design.blocks])
    apart = _by_effect(found, _apart(found, design.blocks, left))
    std = np.sqrt(np.diag(covariance)) / parameters.compliance
    return Worth(protocol, total / MINUTE, evidence, apart, std)


def _by_effect(found: Sequence[Candidate], nats: Sequence[float]) -> dict[str, float]:
    """Return effect -> nats, of its places the middle one, each by its best variant."""
    places: dict[str, dict[object, float]] = {}
    for candidate, value in zip(found, nats, strict=True):
        at = places.setdefault(candidate.effect, {})
        at[candidate.place] = max(at.get(candidate.place, -np.inf), value)
    return {effect: float(np.median(list(values.values()))) for effect, values in places.items()}


def _schedule(
    protocol: MeasurementProtocol, pulls: Sequence[Offer], reference: Float1D, pace: Pace
) -> tuple[list[Offer], dict[tuple[int, int], float], float]:
    """Return what is measured, when each step is read (by configuration and step), and how long all takes, s."""
    now, visits = 0.0, 0
    offers: list[Offer] = []
    seconds: dict[tuple[int, int], float] = {}

    def visit() -> None:
        nonlocal now, visits
        now += pace.moving + pace.reading
        seconds[REFERENCE, visits] = now
        visits += 1

    for k, pull in enumerate(pulls):
        if protocol.every and k % protocol.every == 0:
            visit()
        levels, holds = _held(protocol) if k < protocol.held else (protocol.levels, frozenset[int]())
        now += pace.moving
        for step, level in enumerate(levels):
            moved = step > 0 and level != levels[step - 1]
            now += pace.loading * moved + protocol.hold * (step in holds) + pace.reading
            seconds[pull.number, step] = now
        offers.append(dataclasses.replace(pull, steps=np.outer(levels, pull.full)))
    if protocol.every:
        visit()
        offers.insert(0, Offer(REFERENCE, reference, np.zeros((visits, 6))))
    return offers, seconds, now


def _held(protocol: MeasurementProtocol) -> tuple[tuple[float, ...], frozenset[int]]:
    """Return levels with full load read again after the hold, zero load at the end likewise, and the steps held."""
    full = protocol.levels.index(1.0)
    levels = [*protocol.levels[: full + 1], 1.0, *protocol.levels[full + 1 :]]
    if levels[-1] != 0.0:
        levels.append(0.0)
    levels.append(0.0)
    return tuple(levels), frozenset({full + 1, len(levels) - 1})


def _timed(readings: Readings, seconds: Mapping[tuple[int, int], float]) -> Readings:
    """Return the readings at the times of the schedule."""
    keys = zip(readings.configuration.tolist(), readings.step.tolist(), strict=True)
    return dataclasses.replace(readings, time=np.array([seconds[key] for key in keys]))


def _left(design: Design) -> tuple[Float2D, Float2D]:
    """Return the candidates' Gram matrix (p, p) less null model and discrepancy, and the compliances' covariance."""
    n, k = design.n, design.discrepancy.start
    gram = design.gram()
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram)[:n], 1e-300))
    known = np.concatenate([np.arange(n), np.arange(n + design.discrepancy.start, n + design.discrepancy.stop)])
    weights = np.concatenate([scale, np.ones(len(known) - n)])
    matrix = gram[np.ix_(known, known)] * np.outer(weights, weights)
    matrix[np.arange(n, len(known)), np.arange(n, len(known))] += 1.0  # priors of the discrepancy
    inverse = np.linalg.inv(matrix)
    cross = gram[known, n : n + k] * weights[:, None]
    left = gram[n : n + k, n : n + k] - cross.T @ inverse @ cross
    return left, inverse[:n, :n] * np.outer(scale, scale)


def _log_bayes_factor(own: Float2D) -> float:
    """Return what is expected of an effect of typical size, nats."""
    values = np.maximum(np.linalg.eigvalsh(own), 0.0)
    gained = (1.0 + values / PRIOR_WIDTH**2) * values / (1.0 + values) - np.log1p(values)
    return 0.5 * float(gained.sum())


def _apart(found: Sequence[Candidate], blocks: Sequence[slice], left: Float2D) -> list[float]:
    """Return, for every candidate at typical size, what the other effect that explains it best leaves of it, nats."""
    shapes: dict[int, list[int]] = {}
    for index, block in enumerate(blocks):
        shapes.setdefault(block.stop - block.start, []).append(index)
    rivals = []
    for size, members in shapes.items():
        columns = np.array([range(blocks[i].start, blocks[i].stop) for i in members])
        own = left[columns[:, :, None], columns[:, None, :]] + np.eye(size)
        names = np.array([found[i].effect for i in members])
        rivals.append((names, columns, np.linalg.inv(own)))
    nats = []
    for candidate, block in zip(found, blocks, strict=True):
        rows = np.arange(block.start, block.stop)
        least = np.inf
        for names, columns, inverse in rivals:
            cross = left[rows[None, :, None], columns[:, None, :]]  # (c, k, size)
            explained = np.einsum("cks,cst,ckt->c", cross, inverse, cross)
            rest = float(np.trace(left[block, block])) - explained[names != candidate.effect]
            least = min(least, float(rest.min(initial=np.inf)))
        nats.append(0.5 * max(least, 0.0) / PRIOR_WIDTH**2)
    return nats
