"""The way through a plan: every stop in the order in which the procedure makes it, how long it takes, what is clear."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from calibration_core.motion.speed import Monitored
from calibration_core.motion.trajectory import MotionLimits, plan_motion
from calibration_core.planning.feasible.collision import CollisionModel
from calibration_core.planning.feasible.order import UNCLEAR, short_order, visiting_cost
from calibration_core.planning.plans.measurement_queue import Item, MeasurementQueue, SequenceRules
from calibration_core.planning.plans.plan import Plan
from calibration_core.timeseries import Float1D, Float2D, Int1D

TRIES = 60  # orders looked at until every way is clear
WORKING_DAY = 8 * 3600.0  # s; what takes longer needs references of the cell (CWA 17384, 5.1)


@dataclasses.dataclass(frozen=True)
class Duration:
    """How long a plan takes, s, without spares.

    Attributes:
        moving: Between configurations, reference and start-up cycle at the bounded speed.
        startup: Start-up cycles, repeated ones included.
        loading: Changing loads.
        reading: Settling and reading, visits to the reference included.
    """

    moving: float
    startup: float
    loading: float
    reading: float

    @property
    def total(self) -> float:
        """All of it."""
        return self.moving + self.startup + self.loading + self.reading

    @property
    def named(self) -> dict[str, float]:
        """Every part and the `total`, s, by name."""
        return {**dataclasses.asdict(self), "total": self.total}

    @property
    def days(self) -> int:
        """Working days begun."""
        return int(np.ceil(self.total / WORKING_DAY))


def clear_order(
    bodies: CollisionModel, q: Float2D, reference: Float1D, every: int, joint_speed: Float1D
) -> tuple[Int1D, float]:
    """Return a short order of configurations whose ways are clear, as far as there is one.

    Ways are proven clear only where the order uses them; those that are not become expensive, and the order is looked
    for again.

    Args:
        bodies: What may touch.
        q: (m, n) rad.
        reference: (n,) rad, where the way begins and returns to.
        every: Configurations between two visits to the reference; 0: it is not visited again.
        joint_speed: (n,) rad/s.

    Returns:
        The order, (m,) indices, and the time between configurations, s, at these joint speeds.
    """
    places = np.vstack([reference, q])
    cost = visiting_cost(bodies.site, places, joint_speed, bodies.rules)
    proven: dict[tuple[int, int], bool] = {}
    way = short_order(cost, 0)
    for _ in range(TRIES):
        blocked = False
        for k, (i, j) in enumerate(itertools.pairwise(int(x) for x in way)):
            by_reference = every > 0 and k % every == 0  # the reference is visited in between
            key = (min(i, j), max(i, j))
            if by_reference or cost[i, j] >= UNCLEAR:
                continue
            if key not in proven:
                proven[key] = bodies.clear_way(places[i], places[j])
            if not proven[key]:
                cost[i, j] += UNCLEAR
                cost[j, i] += UNCLEAR
                blocked = True
        if not blocked:
            break
        way = short_order(cost, 0)
    legs = cost[way[:-1], way[1:]]
    return way[1:] - 1, float(legs.sum() - UNCLEAR * np.count_nonzero(legs >= UNCLEAR))


def stops(plan: Plan, rules: SequenceRules, seconds: float = 0.0) -> list[Item]:
    """Return everything that the procedure does if all goes well, in order.

    Args:
        plan: The plan.
        rules: How it runs.
        seconds: Time that one stop takes, which decides when the start-up cycle is due again.
    """
    queue = MeasurementQueue(plan, rules, frozenset(), frozenset(), 0)
    found: list[Item] = []
    while (item := queue.next(seconds * len(found))) is not None:
        found.append(item)
        queue.done(item)
    return found


def way_through(
    plan: Plan, bodies: CollisionModel, monitored: Monitored, limits: MotionLimits, rules: SequenceRules
) -> tuple[Duration, int]:
    """Return how long a plan takes, and how many of its motions cannot be proven clear.

    Every motion is timed by the trajectory that will be driven: at most 250 mm/s at every monitored point.
    """
    steps = sum(len(c.steps) for c in plan.primary)
    each = (rules.load_seconds + rules.reading_seconds) * steps / max(len(plan.primary), 1)
    items = stops(plan, rules, each)
    moving = startup = loading = reading = 0.0
    unclear = 0
    known: dict[tuple[bytes, bytes], tuple[float, bool]] = {}
    for before, item in itertools.pairwise(items):
        key = (before.q.tobytes(), item.q.tobytes())
        if key not in known:
            there = plan_motion(monitored, before.q, item.q, limits).duration
            known[key] = there, bodies.clear_way(before.q, item.q)
        took, clear = known[key]
        unclear += not clear
        if item.kind == "startup":
            startup += took
        else:
            moving += took
    for item in items:
        loading += rules.load_seconds * max(len(item.steps) - 1, 0)
        reading += rules.reading_seconds * len(item.steps)
    return Duration(moving, startup, loading, reading), unclear
