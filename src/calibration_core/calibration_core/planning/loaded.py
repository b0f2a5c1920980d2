"""Make a plan: postures and pulls chosen together for what they tell about the joints (CWA 17384, 5.1, 5.2, 5.4)."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import ModelFileError, PlanError
from calibration_core.model.nominal import nominal_parameters, tool_point
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.motion.speed import Monitored
from calibration_core.motion.trajectory import MotionLimits
from calibration_core.planning.expected_uncertainty import determined, expected_of
from calibration_core.planning.feasible.candidates import Ground, Loaded, draw_postures, loaded_postures
from calibration_core.planning.feasible.collision import CollisionModel
from calibration_core.planning.feasible.loads import LoadRules, wrench_steps
from calibration_core.planning.feasible.order import startup_cycle, travel
from calibration_core.planning.feasible.space import Site, SpaceRules
from calibration_core.planning.optimal_design.criteria import CRITERIA
from calibration_core.planning.optimal_design.design import ExchangeResult, choose, extend, rated
from calibration_core.planning.optimal_design.optimum import Candidates
from calibration_core.planning.optimal_design.spread import spacing, spread_out
from calibration_core.planning.plans.measurement_queue import SequenceRules
from calibration_core.planning.plans.plan import Plan, PlannedConfiguration, Reference
from calibration_core.planning.plans.planned_robot import planned_robot
from calibration_core.planning.route import clear_order, way_through
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Int1D

LEAST_CONFIGURATIONS = 12  # CWA 17384, 5.1
MOST_CONFIGURATIONS = 200
SPACE_SAMPLE = 400
PART = 400  # postures among which the largest part of a divided free space is looked for
PART_TRIED = (16, 24)  # references that are tried for it, and postures that are tried from each
ROUNDS = 8  # choices made until all of them can be reached from the reference


@dataclasses.dataclass(frozen=True)
class PlanningRules:
    """How a plan is made.

    Attributes:
        space: Which postures are fit.
        load: How the robot is loaded.
        criterion: By which configurations are chosen, see `criteria`.
        postures: Postures to choose from.
        batches: Batches of random postures drawn at most to find them.
        kept: Least share of the best efficiency found that is kept when configurations are spread out evenly.
        reference_every: The reference configuration is measured again after so many configurations; 0: never.
        joint_speed: rad/s, for the order of visiting.
    """

    space: SpaceRules = dataclasses.field(default_factory=SpaceRules)
    load: LoadRules = dataclasses.field(default_factory=LoadRules)
    criterion: str = "D"
    postures: int = 2000
    batches: int = 60
    kept: float = 0.97
    reference_every: int = 4
    joint_speed: float = 0.3


@dataclasses.dataclass(frozen=True, eq=False)
class _Chosen:
    """Configurations to measure and spares, by their rows, all of which the reference can be reached from."""

    offered: Loaded
    content: Candidates
    choice: ExchangeResult
    added: Int1D
    reference: Float1D


def make_plan(
    cell: Cell,
    *,
    configurations: int = 18,
    spares: float = 0.5,
    rules: PlanningRules | None = None,
    seed: int = 0,
    parameters: ModelParameters | None = None,
    task: Float2D | None = None,
    motion: MotionLimits | None = None,
    sequence: SequenceRules | None = None,
    least: int = LEAST_CONFIGURATIONS,
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
        task: (k, 3) m, places of the task program in the base frame: the operating space; None: `rules.space.box`, or
            all that can be reached.
        motion: How fast it moves, for the estimate of the time; the defaults if None.
        sequence: How long a load and a reading take, likewise.
        least: Fewest configurations that make sense: the standard's, or fewer where sisters of the robot are known.

    Raises:
        CellError: The robot cannot be read, or the cell has no wrench point.
        ModelFileError: The given parameters have no wrench point.
        PlanError: Too few configurations are asked for, or too few can be reached and seen under the rules.
    """
    rules = rules or PlanningRules()
    check_counts(configurations, spares, least)
    if cell.frames.wrench_point is None:
        raise cell.missing("frames.wrench_point", "planning loads")
    parameters = parameters or nominal_parameters(cell)
    if parameters.wrench_point is None:
        raise ModelFileError("the given model", "wrench_point", "nothing", "a point in the flange frame, to plan loads")
    ground = ground_of(cell, parameters, rules.space, task)
    chain = ground.site.chain
    more = math.ceil(spares * configurations)
    rng = np.random.default_rng([seed, 0])
    q = draw_postures(ground, rules.postures, rules.batches, configurations + more, rng)
    offered = loaded_postures(ground, parameters, q, rules.load, np.random.default_rng([seed, 3]))
    determinable = determined(offered.information)
    if not determinable.any():
        raise PlanError(cell.path, "frames", "no joint's stiffness shows", "points and a wrench point that show joints")
    scale = parameters.compliance[determinable] if np.all(parameters.compliance[determinable] > 0) else None
    space = offered.place[:: max(len(offered.place) // SPACE_SAMPLE, 1)]
    joint_speed = np.full(chain.n, rules.joint_speed)
    found = _choose(ground, offered, determinable, scale, configurations, more, rules, space, seed)
    chosen, offered = found.choice.chosen, found.offered
    way, took = clear_order(ground.bodies, offered.q[chosen], found.reference, rules.reference_every, joint_speed)
    planned = tuple(
        PlannedConfiguration(
            number=i + 1,
            q=offered.q[row],
            steps=wrench_steps(offered.force[row], rules.load.levels),
            spare=i >= configurations,
        )
        for i, row in enumerate([*chosen[way], *found.added])
    )
    plan = Plan(
        robot=cell.robot.name,
        joints=cell.robot.joints,
        configurations=planned,
        startup_cycle=startup_cycle(ground.bodies, found.reference, seed=seed),
        reference=Reference(found.reference, rules.reference_every) if rules.reference_every else None,
        made_for=planned_robot(cell),
    )
    monitored = Monitored.of(chain, parameters, tool_point(cell))
    duration, unclear = way_through(
        plan, ground.bodies, monitored, motion or MotionLimits(), sequence or SequenceRules()
    )
    expected = expected_of(
        found.content,
        found.choice,
        determinable,
        parameters,
        spread=spacing(space, offered.place[chosen]),
        travel_time=took,
        unclear=unclear,
        duration=duration,
        k_csm=float(offered.k_csm[chosen].max()),
        unjudged=ground.bodies.unjudged,
    )
    return dataclasses.replace(plan, expected=expected)


def check_counts(configurations: int, spares: float, least: int = LEAST_CONFIGURATIONS) -> None:
    """Raise PlanError where fewer configurations or spares are asked for than make sense."""
    if not least <= configurations <= MOST_CONFIGURATIONS:
        expected = f"{least} to {MOST_CONFIGURATIONS} (CWA 17384, 5.1)"
        raise PlanError("plan", "--configurations", str(configurations), expected)
    if not 0.0 <= spares <= 5.0:
        raise PlanError("plan", "--spares", f"{spares:g}", "a share from 0 to 5, the standard asks for 0.5")


def ground_of(cell: Cell, parameters: ModelParameters, rules: SpaceRules, task: Float2D | None) -> Ground:
    """Return where postures are looked for; raise CellError where the robot cannot be read."""
    chain = chain_of(cell).corrected(parameters.geometry)
    site = dataclasses.replace(Site.of(chain, parameters, cell), task=task)
    return Ground(cell, site, CollisionModel.of(cell, site, rules), rules)


def _choose(
    ground: Ground,
    offered: Loaded,
    determinable: Bool1D,
    scale: Float1D | None,
    count: int,
    more: int,
    rules: PlanningRules,
    space: Float2D,
    seed: int,
    start: Float1D | None = None,
) -> _Chosen:
    """Choose configurations and spares that can be reached from the reference; what cannot is not offered again.

    Where that leads to none, the largest part of the free space is looked for, and `start` is the reference in it.
    """
    criterion = CRITERIA[rules.criterion]
    path, whole = ground.cell.path, offered
    for _ in range(ROUNDS):
        content = Candidates(offered.information[:, determinable][:, :, determinable], scale)
        group = offered.group
        try:
            best = choose(content, count, criterion=criterion, group=group, seed=seed)
        except ValueError as error:
            raise PlanError(path, "robot", str(error), "postures that can be reached and show every joint") from None
        least = best.score + math.log(rules.kept)
        chosen = spread_out(content, criterion, best.chosen, offered.place, group, space, least, seed)
        added = extend(content, chosen, more, group=group, criterion=criterion)
        if len(added) < more:
            break
        reference, apart = reached(ground, offered.q, chosen, added, rules, start)
        if not apart:
            return _Chosen(offered, content, rated(content, chosen, best), added, reference)
        offered = offered.of(~np.isin(group, group[apart]))
    if start is not None:
        raise not_reached(ground, count + more)
    start, part = largest_part(ground, whole.q, count + more)
    rows = {row.tobytes() for row in part}
    kept = whole.of(np.array([row.tobytes() in rows for row in whole.q]))
    return _choose(ground, kept, determinable, scale, count, more, rules, space, seed, start)


def largest_part(ground: Ground, q: Float2D, wanted: int) -> tuple[Float1D, Float2D]:
    """Return the posture from which straight clear motions lead to most others, (n,) rad, and these, (k, n) rad.

    What stands in a cell may divide its free space: the largest part that is found is measured in.

    Args:
        ground: The robot in its cell.
        q: (m, n) rad, postures that can be measured.
        wanted: How many are needed.

    Raises:
        PlanError: There are fewer; it says how many, and what stands in the way.
    """
    some = np.unique(q, axis=0)
    some = some[np.random.default_rng(0).permutation(len(some))[:PART]]
    tried = some[: PART_TRIED[1]]
    ways = [sum(ground.bodies.clear_way(start, row) for row in tried) for start in some[: PART_TRIED[0]]]
    start = some[int(np.argmax(ways))]
    part = some[[ground.bodies.clear_way(start, row) for row in some]]
    if len(part) < wanted:
        raise not_reached(ground, wanted, f"{len(part)} of {len(some)}")
    return start, part


def reached(
    ground: Ground, q: Float2D, chosen: Int1D, added: Int1D, rules: PlanningRules, start: Float1D | None = None
) -> tuple[Float1D, list[int]]:
    """Return the reference for chosen postures, (n,) rad, and the rows that no clear straight motion leads to from it.

    Args:
        ground: The robot in its cell.
        q: (m, n) rad, all postures.
        chosen: Rows to be measured.
        added: Rows of the spares.
        rules: Joint speed, for what is near.
        start: (n,) rad, the reference that is to be taken; None: the one with the least travel.
    """
    speed = np.full(ground.site.chain.n, rules.joint_speed)
    reference = reference_of(q, q[chosen], speed) if start is None else start
    taken = np.concatenate([chosen, added])
    return reference, [int(row) for row in taken if not ground.bodies.clear_way(reference, q[row])]


def not_reached(ground: Ground, wanted: int, found: str = "too few") -> PlanError:
    """Return the error that so many postures cannot be reached from one reference; `found` says how many can."""
    text = f"{found} postures that a straight motion without collision reaches from one reference"
    obstacles = ", ".join([box.name for box in ground.cell.boxes] + ["the floor"] * (ground.site.floor is not None))
    expected = f"at least {wanted}: more free space beside {obstacles or 'the robot itself'}, or fewer configurations"
    return PlanError(ground.cell.path, "boxes" if ground.cell.boxes else "robot", text, expected)


def reference_of(q: Float2D, chosen: Float2D, joint_speed: Float1D) -> Float1D:
    """Return the posture of (m, n) rad with the least travel to the chosen ones, (n,) rad."""
    every = q[np.sort(np.unique(q, axis=0, return_index=True)[1])]
    total = np.array([travel(np.vstack([row, chosen]), joint_speed)[0].sum() for row in every])
    return np.asarray(every[int(np.argmin(total))])
