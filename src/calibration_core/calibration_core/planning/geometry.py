"""Make a plan for frames and geometry: postures, unloaded, chosen for what positions in them tell (CWA 17384, 5.4)."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import PlanError
from calibration_core.model.nominal import nominal_parameters, tool_point
from calibration_core.model.parameters import ModelParameters
from calibration_core.motion.speed import Monitored
from calibration_core.motion.trajectory import MotionLimits
from calibration_core.planning.feasible.candidates import Ground, draw_postures
from calibration_core.planning.feasible.order import startup_cycle
from calibration_core.planning.loaded import (
    ROUNDS,
    PlanningRules,
    check_counts,
    ground_of,
    largest_part,
    not_reached,
    reached,
)
from calibration_core.planning.optimal_design.criteria import CRITERIA, Observability
from calibration_core.planning.optimal_design.design import ExchangeResult, choose, extend
from calibration_core.planning.optimal_design.optimum import Candidates
from calibration_core.planning.plans.measurement_queue import SequenceRules
from calibration_core.planning.plans.plan import Plan, PlannedConfiguration, Reference
from calibration_core.planning.plans.planned_robot import planned_robot
from calibration_core.planning.route import Duration, clear_order, way_through
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D, read_only

InformationOf = Callable[[Float2D], Float3D]
"""What one reading of all points at each posture, (m, n) rad, tells about the parameters, (m, k, k)."""


@dataclasses.dataclass(frozen=True, eq=False)
class PoseExpectation:
    """What the postures promise, spares left out.

    Attributes:
        names: Of the k parameters.
        std: (k,) one standard deviation of each, m or rad.
        criterion: By which the postures were chosen.
        efficiency: Share of what any choice could reach that this one has for certain; None where nothing certifies it.
        observability: The standard's figures, columns scaled to equal mean information.
        duration: How long it takes.
        unclear_moves: Motions that cannot be proven clear.
        unjudged: Pairs of bodies that were not held against each other.
    """

    names: tuple[str, ...]
    std: Float1D
    criterion: str
    efficiency: float | None
    observability: Observability
    duration: Duration
    unclear_moves: int
    unjudged: tuple[str, ...]

    def __post_init__(self) -> None:
        """Copy to a read-only array."""
        object.__setattr__(self, "std", read_only(self.std))


def make_pose_plan(
    cell: Cell,
    information_in: Callable[[Float2D], tuple[tuple[str, ...], InformationOf]],
    *,
    configurations: int = 18,
    spares: float = 0.5,
    rules: PlanningRules | None = None,
    seed: int = 0,
    parameters: ModelParameters | None = None,
    task: Float2D | None = None,
) -> tuple[Plan, PoseExpectation]:
    """Choose postures, order, spares, start-up cycle and reference for the identification of frames and geometry.

    Args:
        cell: The cell.
        information_in: Postures that can be measured, (m, n) rad -> names of the parameters that these determine, and
            the information of a posture on them.
        configurations: How many to measure.
        spares: How many more, as a share.
        rules: How; the defaults if None.
        seed: The same seed gives the same plan.
        parameters: Frames and points to plan with; the cell file's if None.
        task: (k, 3) m, places of the task program; None: `rules.space.box`, or all that can be reached.

    Raises:
        CellError: The robot cannot be read.
        PlanError: Too few postures are asked for, can be reached and seen, or can be driven between without collision.
    """
    rules = rules or PlanningRules()
    check_counts(configurations, spares)
    parameters = parameters or nominal_parameters(cell)
    ground = ground_of(cell, parameters, rules.space, task)
    more = math.ceil(spares * configurations)
    rng = np.random.default_rng([seed, 0])
    q = draw_postures(ground, rules.postures, rules.batches, configurations + more, rng)
    names, information_of = information_in(q)
    joint_speed = np.full(ground.site.chain.n, rules.joint_speed)
    q, content, best, added, reference = _choose(ground, q, information_of, configurations, more, rules, seed)
    way, _ = clear_order(ground.bodies, q[best.chosen], reference, rules.reference_every, joint_speed)
    plan = Plan(
        robot=cell.robot.name,
        joints=cell.robot.joints,
        configurations=tuple(
            PlannedConfiguration(i + 1, q[row], np.zeros((1, 6)), spare=i >= configurations)
            for i, row in enumerate([*best.chosen[way], *added])
        ),
        startup_cycle=startup_cycle(ground.bodies, reference, seed=seed),
        reference=Reference(reference, rules.reference_every) if rules.reference_every else None,
        made_for=planned_robot(cell),
    )
    total = content.total(best.chosen)
    std = np.sqrt(np.diag(np.linalg.inv(total))) * content.scale
    monitored = Monitored.of(ground.site.chain, parameters, tool_point(cell))
    duration, unclear = way_through(plan, ground.bodies, monitored, MotionLimits(), SequenceRules())
    figures = Observability.of(total / configurations)
    unjudged = ground.bodies.unjudged
    return plan, PoseExpectation(names, std, rules.criterion, best.efficiency, figures, duration, unclear, unjudged)


def _choose(
    ground: Ground,
    q: Float2D,
    information_of: InformationOf,
    count: int,
    more: int,
    rules: PlanningRules,
    seed: int,
    start: Float1D | None = None,
) -> tuple[Float2D, Candidates, ExchangeResult, Int1D, Float1D]:
    """Choose postures and spares that can be reached from a reference; those that cannot are not offered again.

    Returns:
        The postures offered, what they tell, the choice, the spares' rows, and the reference.
    """
    criterion, path = CRITERIA[rules.criterion], ground.cell.path
    whole = q
    for _ in range(ROUNDS):
        content = Candidates(information_of(q))
        try:
            best = choose(content, count, criterion=criterion, seed=seed)
        except ValueError as error:
            raise PlanError(path, "robot", str(error), "postures that show every parameter") from None
        added = extend(content, best.chosen, more, group=np.arange(len(q)), criterion=criterion)
        if len(added) < more:
            break
        reference, apart = reached(ground, q, best.chosen, added, rules, start)
        if not apart:
            return q, content, best, added, reference
        q = np.delete(q, apart, axis=0)
    if start is not None:
        raise not_reached(ground, count + more)
    start, part = largest_part(ground, whole, count + more)
    return _choose(ground, part, information_of, count, more, rules, seed, start)
