"""Make a plan: postures and pulls chosen together for what they tell about the joints (CWA 17384, 5.1, 5.2, 5.4)."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import PlanError
from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.procedure.design import choose, extend, rated
from calibration_core.procedure.loads import LoadRules, full_pulls, information, wrench_steps
from calibration_core.procedure.order import UNCLEAR, short_order, startup_cycle, travel, visiting_cost
from calibration_core.procedure.plan import Expected, Plan, PlannedConfiguration, Reference
from calibration_core.procedure.space import Site, SpaceRules, fitness, joint_range, measurable, positions
from calibration_core.procedure.spread import spacing, spread_out
from calibration_core.timeseries import Float2D, Float3D, Int1D

LEAST_CONFIGURATIONS = 12  # CWA 17384, 5.1
MOST_CONFIGURATIONS = 200
BATCH = 4000
SPACE_SAMPLE = 400


@dataclasses.dataclass(frozen=True)
class PlanningRules:
    """How a plan is made.

    Attributes:
        space: Which postures are fit.
        load: How the robot is loaded.
        postures: Postures to choose from.
        batches: Batches of random postures drawn at most to find them.
        kept: Least share of the best D-efficiency found that is kept when configurations are spread out evenly.
        reference_every: The reference configuration is measured again after so many configurations; 0: never.
        joint_speed: rad/s, for the order of visiting.
    """

    space: SpaceRules = dataclasses.field(default_factory=SpaceRules)
    load: LoadRules = dataclasses.field(default_factory=LoadRules)
    postures: int = 2000
    batches: int = 60
    kept: float = 0.97
    reference_every: int = 4
    joint_speed: float = 0.3


@dataclasses.dataclass(frozen=True, eq=False)
class _Candidates:
    """Postures with pulls, one row each; `group` numbers the posture."""

    q: Float2D
    force: Float2D
    group: Int1D
    place: Float2D
    information: Float3D


def make_plan(
    cell: Cell,
    *,
    configurations: int = 18,
    spares: float = 0.5,
    rules: PlanningRules | None = None,
    seed: int = 0,
    parameters: ModelParameters | None = None,
) -> Plan:
    """Choose configurations, pulls, order, spares, start-up cycle and reference for a cell.

    Args:
        cell: The cell; without `frames.tracker` sight is not judged, without `robot.stiffness` (and `parameters`) the
            choice is the same but for the wrench noise, and relative uncertainties are not stated.
        configurations: How many to measure.
        spares: How many more, as a share (the standard asks for 0.5 or more).
        rules: How; the defaults if None.
        seed: The same seed gives the same plan.
        parameters: Frames, points and compliances to plan with; the cell file's if None.

    Raises:
        CellError: The robot cannot be read, or the cell has no wrench point.
        PlanError: Too few configurations are asked for, or too few can be reached and seen under the rules.
    """
    rules = rules or PlanningRules()
    if not LEAST_CONFIGURATIONS <= configurations <= MOST_CONFIGURATIONS:
        expected = f"{LEAST_CONFIGURATIONS} to {MOST_CONFIGURATIONS} (CWA 17384, 5.1)"
        raise PlanError(cell.path, "configurations", str(configurations), expected)
    if not 0.0 <= spares <= 5.0:
        raise PlanError(cell.path, "spares", f"{spares:g}", "a share from 0 to 5, the standard asks for 0.5")
    if cell.frames.wrench_point is None:
        raise cell.missing("frames.wrench_point", "planning loads")
    parameters = parameters or nominal_parameters(cell)
    chain = chain_of(cell).corrected(parameters.geometry)
    site = Site.of(chain, parameters, tracker_known=cell.frames.tracker is not None)
    more = math.ceil(spares * configurations)
    q = _postures(cell, site, rules, configurations + more, np.random.default_rng([seed, 0]))
    candidates = _candidates(chain, cell, parameters, q, rules, seed)
    try:
        best = choose(candidates.information, configurations, group=candidates.group, seed=seed)
    except ValueError as error:
        raise PlanError(cell.path, "frames", str(error), "points and a wrench point that show every joint") from None
    space = candidates.place[:: max(len(candidates.place) // SPACE_SAMPLE, 1)]
    least = best.log_det + chain.n * math.log(rules.kept)
    chosen = spread_out(candidates.information, best.chosen, candidates.place, candidates.group, space, least, seed)
    choice = rated(candidates.information, chosen, best)
    added = extend(candidates.information, chosen, more, group=candidates.group)

    joint_speed = np.full(chain.n, rules.joint_speed)
    reference = _reference(q, candidates.q[chosen], joint_speed)
    cost = visiting_cost(site, np.vstack([reference, candidates.q[chosen]]), joint_speed, rules.space)
    way = short_order(cost, 0)
    legs = cost[way[:-1], way[1:]]
    ordered = [*chosen[way[1:] - 1], *added]
    planned = tuple(
        PlannedConfiguration(
            number=i + 1,
            q=candidates.q[row],
            steps=wrench_steps(candidates.force[row], rules.load.levels),
            spare=i >= configurations,
        )
        for i, row in enumerate(ordered)
    )
    unclear = int((legs >= UNCLEAR).sum())
    return Plan(
        robot=cell.robot.name,
        joints=cell.robot.joints,
        configurations=planned,
        startup_cycle=startup_cycle(site, reference, rules.space, seed=seed),
        reference=Reference(reference, rules.reference_every) if rules.reference_every else None,
        expected=_expected(
            candidates.information[chosen],
            parameters,
            efficiency=choice.efficiency,
            spread=spacing(space, candidates.place[chosen]),
            travel_time=float(legs.sum() - UNCLEAR * unclear),
            unclear=unclear,
        ),
    )


def _postures(cell: Cell, site: Site, rules: PlanningRules, needed: int, rng: np.random.Generator) -> Float2D:
    low, high = joint_range(site.chain, rules.space)
    found: list[Float2D] = []
    drawn = np.empty((0, site.chain.n))
    count = 0
    for _ in range(rules.batches):
        drawn = rng.uniform(low, high, (BATCH, site.chain.n))
        found.append(drawn[measurable(site, drawn, rules.space)])
        count += len(found[-1])
        if count >= rules.postures:
            break
    if count < needed:
        shares = {name: float(mask.mean()) for name, mask in fitness(site, drawn, rules.space).items()}
        hardest = ", ".join(f"{100 * share:.2g} % {name}" for name, share in sorted(shares.items(), key=lambda x: x[1]))
        raise PlanError(
            cell.path,
            "robot",
            f"{count} postures that can be measured (of those drawn: {hardest})",
            f"at least {needed}",
        )
    return np.vstack(found)[: rules.postures]


def _candidates(
    chain: Chain, cell: Cell, parameters: ModelParameters, q: Float2D, rules: PlanningRules, seed: int
) -> _Candidates:
    force = full_pulls(cell, parameters, rules.load, len(q), np.random.default_rng([seed, 3]))
    content = information(chain, cell, parameters, q, force, rules.load)
    points = np.stack(list(parameters.points.values()))
    place = positions(posture(chain, q), points).mean(axis=0).T
    k = rules.load.directions
    return _Candidates(
        q=np.repeat(q, k, axis=0),
        force=force.reshape(-1, 3),
        group=np.repeat(np.arange(len(q)), k),
        place=np.repeat(place, k, axis=0),
        information=content.reshape(-1, chain.n, chain.n),
    )


def _reference(q: Float2D, chosen: Float2D, joint_speed: Float2D) -> Float2D:
    """Return the posture with the least travel to the chosen ones, (n,) rad."""
    total = np.array([travel(np.vstack([row, chosen]), joint_speed)[0].sum() for row in q])
    return np.asarray(q[int(np.argmin(total))])


def _expected(
    content: Float3D, parameters: ModelParameters, *, efficiency: float, spread: float, travel_time: float, unclear: int
) -> Expected:
    total = content.sum(axis=0)
    scale = 1.0 / np.sqrt(np.diag(total))
    values = np.linalg.eigvalsh(total * scale[:, None] * scale)
    covariance = np.linalg.inv(total)
    std = np.sqrt(np.diag(covariance))
    relative = worst = mean = None
    if np.all(parameters.compliance > 0):
        # a small relative error of a compliance is that of its stiffness
        share = covariance / np.outer(parameters.compliance, parameters.compliance)
        relative = np.sqrt(np.diag(share))
        mean = float(np.sqrt(np.trace(share) / len(share)))
        worst = float(np.sqrt(np.linalg.eigvalsh(share)[-1]))
    return Expected(
        efficiency=efficiency,
        condition=float(np.sqrt(values[-1] / values[0])),
        compliance_std=std,
        stiffness_std=relative,
        a_value=mean,
        e_value=worst,
        spacing=spread,
        travel=travel_time,
        unclear_moves=unclear,
    )
