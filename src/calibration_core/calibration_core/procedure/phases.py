"""The phases before the compliance: which joint is swept from where, and where wrist and points are measured.

Base coordinate system: joints 1 and 2, each alone on a wide arc (CWA 17384, 7.1).  DH parameters: every further joint
likewise (7.2).  Wrist centre: the last three joints together, the arm stands (7.3).  Points: postures all over the
operating space (7.4, 7.5).  A sweep is a row of standstills on one circle: what is averaged at rest needs no common
clock of robot and tracker.  Between them the robot moves as everywhere, no monitored point faster than 250 mm/s.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import PlanError
from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import posture
from calibration_core.model.nominal import nominal_parameters
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.robot import chain_of
from calibration_core.procedure.order import clear_paths, short_order, travel
from calibration_core.procedure.plan import PREPARATION, PhaseName, PlannedConfiguration
from calibration_core.procedure.space import WRIST, Site, SpaceRules, fitness, joint_range, positions
from calibration_core.timeseries import Bool1D, Float1D, Float2D

NUMBERS = 1000  # configurations of the k-th phase are numbered from k times this
GRID = 41  # angles of a joint that are looked at
TRIED = 120  # postures that a sweep may begin from
LOOKED_AT = 12  # of them, whose way there is checked
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
        postures: Standstills in the phase of the points.
        joint_speed: rad/s, for the order of visiting.
    """

    space: SpaceRules = dataclasses.field(default_factory=SpaceRules)
    arc: float = math.radians(170)
    least_arc: float = math.radians(60)
    dwells: int = 13
    wrist_turn: float = 1.2
    wrist_postures: int = 20
    postures: int = 16
    joint_speed: float = 0.3


@dataclasses.dataclass(frozen=True, eq=False)
class Sweep:
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


def plan_phases(
    cell: Cell, rules: PhaseRules | None = None, *, seed: int = 0, parameters: ModelParameters | None = None
) -> tuple[PlannedConfiguration, ...]:
    """Plan the standstills of all phases before the compliance, in the order in which they are measured.

    Args:
        cell: The cell; without `frames.tracker` sight is not judged.
        rules: How; the defaults if None.
        seed: The same seed gives the same plan.
        parameters: Frames and points to plan with; the cell file's if None.

    Raises:
        CellError: The robot cannot be read.
        PlanError: Joint 1 or 2 cannot be swept far enough, or too few postures can be measured.
    """
    rules = rules or PhaseRules()
    parameters = parameters or nominal_parameters(cell)
    chain = chain_of(cell).corrected(parameters.geometry)
    site = Site.of(chain, parameters, tracker_known=cell.frames.tracker is not None)
    rng = np.random.default_rng([seed, 4])
    here: Float1D | None = None
    planned: list[PlannedConfiguration] = []

    def add(phase: PhaseName, q: Float2D) -> Float1D:
        first = 1 + NUMBERS * (1 + PREPARATION.index(phase))
        first += sum(one.phase == phase for one in planned)
        planned.extend(PlannedConfiguration(first + i, row, np.zeros((1, 6)), phase=phase) for i, row in enumerate(q))
        return np.asarray(q[-1])

    for joint in range(chain.n):
        sweep = best_sweep(site, joint, rules, rng, here)
        if sweep is not None:
            here = add("base_frame" if joint < 2 else "geometry", sweep.q)
        elif joint < 2:
            found = f"no arc of {math.degrees(rules.least_arc):.0f}° that is free and seen"
            raise PlanError(cell.path, chain.joints[joint], found, "a joint that can be swept (CWA 17384, 7.1)")
    if chain.n > WRIST:
        here = add("wrist_centre", _wrist(cell, site, rules, rng))
    add("points", _everywhere(cell, site, rules, rng, here))
    return tuple(planned)


def best_sweep(
    site: Site, joint: int, rules: PhaseRules, rng: np.random.Generator, here: Float1D | None = None
) -> Sweep | None:
    """Return the widest sweep of a joint that is free and seen all along, on a large circle; None if none is.

    The centre of a short arc is badly known (at 60 degrees 8 times worse than at 170), so the arc comes first and the
    radius second; of the best, one that is reached on a clear way is taken.

    Args:
        site: The robot in its cell.
        joint: Index of the joint.
        rules: Arc, standstills, limits.
        rng: Draws the postures of the other joints.
        here: (n,) rad, where the robot comes from; None: anywhere.
    """
    low, high = joint_range(site.chain, rules.space)
    homes = rng.uniform(low, high, (TRIED, site.chain.n))
    grid = np.linspace(low[joint], high[joint], GRID)
    q = np.repeat(homes, GRID, axis=0)
    q[:, joint] = np.tile(grid, TRIED)
    begin, end = _longest(_free(site, q, rules.space).reshape(TRIED, GRID))
    arc = np.minimum(grid[end] - grid[begin], rules.arc)
    homes[:, joint] = 0.5 * (grid[begin] + grid[end] - arc)
    worth = arc / rules.arc + RADIUS * np.minimum(_radius(site, homes, joint) / site.chain.reach, 1.0)
    best = np.argsort(-np.where(arc >= rules.least_arc, worth, -1.0), kind="stable")[:LOOKED_AT]
    best = best[arc[best] >= rules.least_arc]
    if not len(best):
        return None
    clear = np.ones(len(best), dtype=bool)
    if here is not None:
        clear = clear_paths(site, np.broadcast_to(here, (len(best), len(here))), homes[best], rules.space)
    pick = int(best[np.argmax(clear)])  # the best of all where no way is clear
    return Sweep(joint, homes[pick], float(arc[pick]), rules.dwells)


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


def _wrist(cell: Cell, site: Site, rules: PhaseRules, rng: np.random.Generator) -> Float2D:
    """Return postures in which only the last three joints differ, (w, n) rad, in a short order."""
    chain = site.chain
    low, high = joint_range(chain, rules.space)
    middle, half = 0.5 * (low + high)[-WRIST:], np.minimum(0.5 * (high - low)[-WRIST:], rules.wrist_turn)
    wanted = rules.wrist_postures
    arms = rng.uniform(low, high, (TRIED // 2, chain.n))
    turns = middle + half * rng.uniform(-1.0, 1.0, (3 * wanted, WRIST))
    q = np.repeat(arms, len(turns), axis=0)
    q[:, -WRIST:] = np.tile(turns, (len(arms), 1))
    free = _free(site, q, rules.space).reshape(len(arms), -1)
    best = int(np.argmax(free.sum(axis=1)))
    seen = turns[free[best]]
    if len(seen) < wanted:
        raise PlanError(cell.path, "wrist", f"{len(seen)} postures free and seen while the arm stands", f"{wanted}")
    chosen = _spread(seen, wanted)
    postures = np.tile(arms[best], (wanted, 1))
    postures[:, -WRIST:] = chosen
    return _ordered(chain, postures, postures[0], rules)


def _everywhere(cell: Cell, site: Site, rules: PhaseRules, rng: np.random.Generator, here: Float1D | None) -> Float2D:
    """Return postures all over the joints' ranges, away from singularities, (p, n) rad, in a short order."""
    low, high = joint_range(site.chain, rules.space)
    drawn = rng.uniform(low, high, (80 * rules.postures, site.chain.n))
    found = drawn[np.logical_and.reduce(list(fitness(site, drawn, rules.space).values()))]
    if len(found) < rules.postures:
        expected = f"at least {rules.postures} for the points (CWA 17384, 7.5)"
        raise PlanError(cell.path, "robot", f"{len(found)} postures that can be measured", expected)
    chosen = _spread(found / (high - low), rules.postures) * (high - low)
    return _ordered(site.chain, chosen, chosen[0] if here is None else here, rules)


def _spread(values: Float2D, count: int) -> Float2D:
    """Return `count` of the rows, (m, k), each as far as can be from those before it."""
    order = list(_farthest(values, count))
    return np.asarray(values[order])


def _farthest(values: Float2D, count: int) -> Iterator[int]:
    gap = np.linalg.norm(values - values.mean(axis=0), axis=1)
    for _ in range(count):
        pick = int(np.argmax(gap))
        yield pick
        gap = np.minimum(gap if _ else np.inf, np.linalg.norm(values - values[pick], axis=1))


def _ordered(chain: Chain, q: Float2D, here: Float1D, rules: PhaseRules) -> Float2D:
    cost = travel(np.vstack([here, q]), np.full(chain.n, rules.joint_speed))
    return np.asarray(q[short_order(cost, 0)[1:] - 1])
