"""The phases before the compliance: which joint is swept from where, and where wrist and points are measured.

Base coordinate system: joints 1 and 2, each alone on a wide arc (CWA 17384, 7.1).  DH parameters: every further joint
likewise (7.2).  Wrist centre: the last three joints together, the arm stands (7.3).  Points: postures all over the
operating space (7.4, 7.5).  A sweep is a row of standstills on one circle: what is averaged at rest needs no common
clock of robot and tracker.  Between them the robot moves as everywhere, no monitored point faster than 250 mm/s.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import PlanError
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters, tool_point
from calibration_core.model.parameters import ModelParameters
from calibration_core.motion.speed import Monitored
from calibration_core.motion.trajectory import MotionLimits
from calibration_core.planning.feasible.candidates import Ground
from calibration_core.planning.feasible.collision import CollisionModel
from calibration_core.planning.feasible.space import WRIST, Site, SpaceRules, fitness, joint_range, positions
from calibration_core.planning.loaded import ground_of
from calibration_core.planning.plans.measurement_queue import SequenceRules
from calibration_core.planning.plans.plan import PREPARATION, PhaseName, Plan, PlannedConfiguration
from calibration_core.planning.route import Duration, way_through
from calibration_core.timeseries import Bool1D, Float1D, Float2D

NUMBERS = 1000  # configurations of the k-th phase are numbered from k times this
GRID = 41  # angles of a joint that are looked at
TRIED = 120  # postures that a sweep may begin from
LOOKED_AT = 60  # of them, whose way there is checked
ARMS = 12  # for the wrist centre, likewise
MORE = 4  # postures for the points, of which the last ones are left out where the way home is not clear from them
RADIUS = 0.25  # how much the radius of a circle counts beside its arc
SINGULAR = ("away from singularities", "inside the operating space")  # rules that a sweep need not keep


@dataclasses.dataclass(frozen=True)
class PhaseRules:
    """How the phases before the compliance are planned.

    Attributes:
        space: Which postures are fit; singular ones are, in a sweep.
        arc: rad, of a sweep, where limits, floor and sight allow it.
        least_arc: rad; a joint that cannot be swept so far is not.
        dwells: Standstills of a sweep.
        wrist_turn: rad, largest turn of a wrist joint off its middle in the phase of the wrist centre.
        wrist_postures: Standstills there.
        postures: Least number of standstills in the phase of the points.
    """

    space: SpaceRules = dataclasses.field(default_factory=SpaceRules)
    arc: float = math.radians(170)
    least_arc: float = math.radians(60)
    dwells: int = 13
    wrist_turn: float = 1.2
    wrist_postures: int = 20
    postures: int = 16


@dataclasses.dataclass(frozen=True, eq=False)
class PlannedSweep:
    """One joint turned alone, slowly, from standstill to standstill.

    Attributes:
        joint: Index of the joint.
        start: (n,) rad.
        arc: rad, covered by the joint.
        dwells: Standstills, the first at `start`.
    """

    joint: int
    start: Float1D
    arc: float
    dwells: int

    @property
    def q(self) -> Float2D:
        """(dwells, n) rad."""
        rows = np.tile(self.start, (self.dwells, 1))
        rows[:, self.joint] += np.linspace(0.0, self.arc, self.dwells)
        return rows


def _standstills(
    ground: Ground, rules: PhaseRules, seed: int, home: Float1D | None
) -> tuple[PlannedConfiguration, ...]:
    """Plan the standstills of all phases on prepared ground."""
    cell, bodies, chain = ground.cell, ground.bodies, ground.site.chain
    rng = np.random.default_rng([seed, 4])
    here = home
    planned: list[PlannedConfiguration] = []

    def add(phase: PhaseName, q: Float2D) -> Float1D:
        first = 1 + NUMBERS * (1 + PREPARATION.index(phase))
        first += sum(one.phase == phase for one in planned)
        planned.extend(PlannedConfiguration(first + i, row, np.zeros((1, 6)), phase=phase) for i, row in enumerate(q))
        return np.asarray(q[-1])

    for joint in chain.circling:
        sweep = best_sweep(bodies, joint, rules, rng, here)
        if sweep is not None:
            here = add("base_frame" if joint < 2 else "geometry", sweep.q)
        elif joint < 2:
            found = f"no arc of {math.degrees(rules.least_arc):.0f}° that is free and seen"
            raise PlanError(cell.path, chain.joints[joint], found, "a joint that can be swept (CWA 17384, 7.1)")
    if chain.n > WRIST and chain.wrist_apart(WRIST):
        here = add("wrist_centre", _wrist(ground, rules, rng, here))
    add("points", _everywhere(ground, rules, rng, here, home))
    return tuple(planned)


def with_phases(
    plan: Plan,
    cell: Cell,
    rules: PhaseRules | None = None,
    *,
    seed: int = 0,
    parameters: ModelParameters | None = None,
) -> tuple[Plan, Duration, int]:
    """Return a plan with the phases before it, how long all of it takes, and its motions that cannot be proven clear.

    Every arc is free of collisions from end to end, and every standstill is seen; the ways between standstills are
    straight in joint space, and clear ones are taken where there are any.  What the plan promises then holds for all of
    it, too.

    Args:
        plan: What follows the phases; they begin and end where it begins.
        cell: The cell; without `frames.tracker` sight is not judged.
        rules: How; the defaults if None.
        seed: The same seed gives the same phases.
        parameters: Frames and points to plan with; the cell file's if None.

    Raises:
        CellError: The robot cannot be read.
        PlanError: Joint 1 or 2 cannot be swept far enough, or too few postures can be measured.
    """
    rules = rules or PhaseRules()
    parameters = parameters or nominal_parameters(cell)
    ground = ground_of(cell, parameters, rules.space, None)
    home = plan.primary[0].q if plan.reference is None else plan.reference.q
    plan = dataclasses.replace(plan, preparation=_standstills(ground, rules, seed, home))
    monitored = Monitored.of(ground.site.chain, parameters, tool_point(cell))
    duration, unclear = way_through(plan, ground.bodies, monitored, MotionLimits(), SequenceRules())
    if plan.expected is not None:
        expected = dataclasses.replace(plan.expected, duration=duration.named, unclear_moves=unclear)
        plan = dataclasses.replace(plan, expected=expected)
    return plan, duration, unclear


def best_sweep(
    bodies: CollisionModel, joint: int, rules: PhaseRules, rng: np.random.Generator, here: Float1D | None = None
) -> PlannedSweep | None:
    """Return the widest sweep of a joint that is free and seen all along, on a large circle; None if none is.

    The centre of a short arc is badly known (at 60 degrees 8 times worse than at 170), so the arc comes first and the
    radius second; of the best, one that is reached on a clear way is taken, if there is one.

    Args:
        bodies: The robot in its cell.
        joint: Index of the joint.
        rules: Arc, standstills, limits.
        rng: Draws the postures of the other joints.
        here: (n,) rad, where the robot comes from; None: anywhere.
    """
    site = bodies.site
    low, high = joint_range(site.chain, rules.space)
    homes = rng.uniform(low, high, (TRIED, site.chain.n))
    grid = np.linspace(low[joint], high[joint], GRID)
    q = np.repeat(homes, GRID, axis=0)
    q[:, joint] = np.tile(grid, TRIED)
    begin, end = _longest(_free(site, q, rules.space).reshape(TRIED, GRID))
    arc = np.minimum(grid[end] - grid[begin], rules.arc)
    homes[:, joint] = 0.5 * (grid[begin] + grid[end] - arc)
    worth = arc / rules.arc + RADIUS * np.minimum(_radius(site, homes, joint) / site.chain.reach, 1.0)
    order = np.argsort(-worth, kind="stable")
    offered = [PlannedSweep(joint, homes[i], float(arc[i]), rules.dwells) for i in order if arc[i] >= rules.least_arc]
    found: PlannedSweep | None = None
    for one in offered[:LOOKED_AT]:
        if not _swept_freely(bodies, one):
            continue
        if here is None or bodies.clear_way(here, one.start):
            return one
        found = found or one
    return found


def _swept_freely(bodies: CollisionModel, sweep: PlannedSweep) -> bool:
    q = sweep.q
    return bool(bodies.clear_way(q[0], q[-1]) and bodies.seen(q).all())


def _longest(free: Bool1D) -> tuple[np.ndarray, np.ndarray]:
    """Return first and last index of the longest run of True in every row of (m, g); equal where there is none."""
    begin, end = np.zeros(len(free), dtype=int), np.zeros(len(free), dtype=int)
    start = np.where(free[:, 0], 0, -1)
    for k in range(free.shape[1]):
        start = np.where(free[:, k], np.where(start < 0, k, start), -1)
        longer = (start >= 0) & (k - start > end - begin)
        begin, end = np.where(longer, start, begin), np.where(longer, k, end)
    return begin, end


def _free(site: Site, q: Float2D, rules: SpaceRules) -> Bool1D:
    """Tell which postures are free and seen, whether or not they are singular."""
    masks = [mask for name, mask in fitness(site, q, rules).items() if name not in SINGULAR]
    return np.logical_and.reduce(masks)


def _radius(site: Site, q: Float2D, joint: int) -> Float1D:
    """Return the (m,) smallest distances of the measurement points from the axis of a joint, m."""
    at = posture(site.chain, q)
    axis, origin = at.axis(joint), at.origin[joint]
    away = positions(at, site.points) - origin
    across = away - np.einsum("pam,am->pm", away, axis)[:, None] * axis
    return np.asarray(np.linalg.norm(across, axis=1).min(axis=0))


def _wrist(ground: Ground, rules: PhaseRules, rng: np.random.Generator, here: Float1D | None) -> Float2D:
    """Return postures in which only the last three joints differ, (w, n) rad, in a short order."""
    site, bodies, wanted = ground.site, ground.bodies, rules.wrist_postures
    low, high = joint_range(site.chain, rules.space)
    middle, half = 0.5 * (low + high)[-WRIST:], np.minimum(0.5 * (high - low)[-WRIST:], rules.wrist_turn)
    arms = rng.uniform(low, high, (TRIED // 2, site.chain.n))
    turns = middle + half * rng.uniform(-1.0, 1.0, (3 * wanted, WRIST))
    q = np.repeat(arms, len(turns), axis=0)
    q[:, -WRIST:] = np.tile(turns, (len(arms), 1))
    free = _free(site, q, rules.space).reshape(len(arms), -1)
    most = 0
    for arm in np.argsort(-free.sum(axis=1), kind="stable")[:ARMS]:
        postures = np.tile(arms[arm], (int(free[arm].sum()), 1))
        postures[:, -WRIST:] = turns[free[arm]]
        postures = postures[bodies.clear(postures)]
        postures = postures[bodies.seen(postures)]
        if len(postures) >= wanted:
            route = _route(bodies, _spread(postures, len(postures)), wanted, here)
            if len(route) == wanted:
                return route
        most = max(most, len(postures))
    raise PlanError(ground.cell.path, "wrist", f"{most} postures free and seen while the arm stands", f"{wanted}")


def _everywhere(
    ground: Ground, rules: PhaseRules, rng: np.random.Generator, here: Float1D | None, home: Float1D | None
) -> Float2D:
    """Return postures all over the joints' ranges, away from singularities, (p, n) rad, in a short order."""
    bodies = ground.bodies
    low, high = joint_range(ground.site.chain, rules.space)
    drawn = rng.uniform(low, high, (80 * rules.postures, ground.site.chain.n))
    found = drawn[ground.fit(drawn)]
    offered = _spread(found / (high - low), min(2 * (rules.postures + MORE), len(found))) * (high - low)
    route = _route(bodies, offered, rules.postures + MORE, here)
    if len(route) < rules.postures:
        expected = f"at least {rules.postures} for the points (CWA 17384, 7.5)"
        raise PlanError(ground.cell.path, "robot", f"{len(route)} postures that can be measured", expected)
    ends = range(len(route), rules.postures - 1, -1) if home is not None else [rules.postures]
    return route[: next((k for k in ends if home is None or bodies.clear_way(route[k - 1], home)), rules.postures)]


def _route(bodies: CollisionModel, q: Float2D, wanted: int, here: Float1D | None) -> Float2D:
    """Return at most `wanted` of the postures, (m, n) rad, each the nearest that is reached on a clear way."""
    left = list(range(len(q)))
    way: list[int] = []
    at = q[0] if here is None else here
    while left and len(way) < wanted:
        near = sorted(left[: 2 * wanted], key=lambda i: float(np.max(np.abs(q[i] - at))))
        pick = next((i for i in near if bodies.clear_way(at, q[i])), None)
        if pick is None:
            if way:
                break
            pick = near[0]  # from where the robot comes no way is clear: the plan's report tells so
        way.append(pick)
        left.remove(pick)
        at = q[pick]
    return np.asarray(q[way])


def _spread(values: Float2D, count: int) -> Float2D:
    """Return `count` of the rows, (m, k), each as far as can be from those before it."""
    order: list[int] = []
    gap = np.linalg.norm(values - values.mean(axis=0), axis=1) if count else np.empty(0)
    for _ in range(count):
        order.append(int(np.argmax(gap)))
        away = np.linalg.norm(values - values[order[-1]], axis=1)
        gap = np.minimum(gap, away) if len(order) > 1 else away
    return np.asarray(values[order])
