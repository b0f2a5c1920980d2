"""In which order to visit configurations, and a start-up cycle that moves every joint."""

from __future__ import annotations

import numpy as np

from calibration_core.planning.feasible.collision import CollisionModel
from calibration_core.planning.feasible.space import Site, SpaceRules, joint_range, safe
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Int1D

PATH_SAMPLES = 24
UNCLEAR = 1e3  # s, added to the travel of a motion whose straight path is not clear
LEAST_GAIN = 0.02  # of one joint's range, for a waypoint of the start-up cycle to be worth driving to
LOOKED_AT = 64  # candidates whose paths are checked per waypoint


def travel(q: Float2D, joint_speed: Float1D) -> Float2D:
    """Return the (m, m) travel times between postures (m, n) rad at joint speeds (n,) rad/s: the slowest joint's."""
    return np.asarray(np.max(np.abs(q[:, None] - q[None]) / joint_speed, axis=2))


def clear_paths(site: Site, start: Float2D, end: Float2D, rules: SpaceRules) -> Bool1D:
    """Tell which straight motions in joint space, (m, n) rad to (m, n) rad, keep clear of floor and arm (sampled)."""
    share = np.linspace(0.0, 1.0, PATH_SAMPLES)[None, :, None]
    path = start[:, None] + share * (end - start)[:, None]
    return np.asarray(safe(site, path.reshape(-1, path.shape[2]), rules).reshape(len(start), -1).all(axis=1))


def visiting_cost(site: Site, q: Float2D, joint_speed: Float1D, rules: SpaceRules) -> Float2D:
    """Return travel times (m, m) s, with a large addition where the straight path is not clear."""
    m = len(q)
    i, j = np.triu_indices(m, 1)
    cost = travel(q, joint_speed)
    blocked = ~clear_paths(site, q[i], q[j], rules)
    cost[i[blocked], j[blocked]] += UNCLEAR
    cost[j[blocked], i[blocked]] += UNCLEAR
    return cost


def short_order(cost: Float2D, start: int = 0) -> Int1D:
    """Return an order of all m places beginning at `start` with a short way: nearest neighbour, then 2-opt.

    Args:
        cost: (m, m) symmetric.
        start: The first place.
    """
    m = len(cost)
    order, left = [start], set(range(m)) - {start}
    while left:
        nearest = min(left, key=lambda place: (cost[order[-1], place], place))
        order.append(nearest)
        left.remove(nearest)
    way = np.array(order)
    better = True
    while better:
        better = False
        for i in range(1, m - 1):
            for j in range(i + 1, m):
                before = cost[way[i - 1], way[i]] + (cost[way[j], way[j + 1]] if j + 1 < m else 0.0)
                after = cost[way[i - 1], way[j]] + (cost[way[i], way[j + 1]] if j + 1 < m else 0.0)
                if after < before - 1e-9:
                    way[i : j + 1] = way[i : j + 1][::-1].copy()
                    better = True
    return way


def startup_cycle(bodies: CollisionModel, home: Float1D, *, seed: int, candidates: int = 2000) -> Float2D:
    """Return a cycle of postures that moves all joints as much as possible and ends at `home` (CWA 17384, 5.2).

    From waypoint to waypoint, the posture that widens the ranges moved through most and can be reached and left on a
    clear path is taken, until nothing is gained.

    Args:
        bodies: The robot in its cell.
        home: (n,) rad, where the cycle begins and ends.
        seed: Of the postures tried.
        candidates: How many are tried.

    Returns:
        (k, n) rad, the last row is `home`.
    """
    site, rules = bodies.site, bodies.rules
    low, high = joint_range(site.chain, rules)
    span = high - low
    tried = np.random.default_rng([seed, 1]).uniform(low, high, (candidates, site.chain.n))
    tried = tried[safe(site, tried, rules)]
    moved_low, moved_high = home.copy(), home.copy()
    here, cycle = home, []
    for _ in range(2 * site.chain.n):
        gain = (np.maximum(moved_low - tried, 0.0) + np.maximum(tried - moved_high, 0.0)) / span
        best = np.argsort(-gain.sum(axis=1), kind="stable")[:LOOKED_AT]
        best = best[gain[best].sum(axis=1) > LEAST_GAIN]
        if not len(best):
            break
        there = tried[best]
        clear = clear_paths(site, np.broadcast_to(here, there.shape), there, rules)
        clear &= clear_paths(site, there, np.broadcast_to(home, there.shape), rules)
        reached = (row for row in there[clear] if bodies.clear_way(here, row) and bodies.clear_way(row, home))
        nearest = next(reached, None)
        if nearest is None:
            break
        here = nearest
        cycle.append(here)
        moved_low, moved_high = np.minimum(moved_low, here), np.maximum(moved_high, here)
    return np.array([*cycle, home])
