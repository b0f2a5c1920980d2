"""Random configurations that a real cell could measure, for when no plan is given.

Within the joint limits, away from singularities, above the floor, with every measurement point on the tracker's side of
the robot; out of many candidates those that lie farthest apart are kept and put into a short order.
"""

from __future__ import annotations

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import PlanError
from calibration_core.timeseries import Bool1D, Float1D, Float2D
from calibration_sim.cell.protocol import NINE_STEPS, Configuration, Protocol, oblique_direction, pull, rated_force
from calibration_sim.cell.truth import PROTOCOL_STREAM, generator
from calibration_sim.mechanics.chain import Chain, read_chain
from calibration_sim.mechanics.statics import Mechanism

CANDIDATES_PER_CONFIGURATION = 12
ATTEMPTS_PER_CANDIDATE = 200
BLOCK = 512  # candidates that are looked at together
LIMIT_MARGIN = 0.05  # of each joint's range, at both ends
WIDEST_RANGE = np.radians(150.0)  # from the middle of the range: no joint needs more than that
LEAST_DEXTERITY = 0.08  # smallest over largest singular value of the Jacobian scaled by the reach
CLEARANCE = 0.08  # of the reach: least height of links beyond the second, and of the points
SIDE = 0.2  # of the reach: least distance of the points from the base axis towards the tracker


def random_protocol(
    cell: Cell, count: int, seed: int, *, levels: tuple[float, ...] = NINE_STEPS, load: float = 1.0
) -> Protocol:
    """Draw configurations and give each an oblique pull of its own direction.

    Raises:
        CellError: The robot cannot be read.
        PlanError: Too few configurations satisfy the conditions.
    """
    rng = generator(seed, PROTOCOL_STREAM)
    chain = read_chain(cell)
    candidates = _candidates(cell, chain, count, rng)
    chosen = candidates[_short_order(candidates, _farthest(_normalised(candidates, chain), count))]
    force = load * rated_force(cell)
    configurations = []
    for number, q in enumerate(chosen, start=1):
        direction = oblique_direction(rng, cell.gravity)
        no_load = cell.frames.wrench_point is None
        wrenches = np.zeros((1, 6)) if no_load else pull(direction, force, levels)
        configurations.append(Configuration(number, q, wrenches))
    return Protocol(tuple(configurations))


def _candidates(cell: Cell, chain: Chain, count: int, rng: np.random.Generator) -> Float2D:
    mechanism = Mechanism(chain, np.ones(len(chain.joints)), cell.gravity)
    low, high = _ranges(chain)
    anywhere = rng.uniform(low, high, (200, len(low)))
    reach = max(float(np.linalg.norm(mechanism.forward(q).translation)) for q in anywhere)
    wanted = count * CANDIDATES_PER_CONFIGURATION
    found: list[Float1D] = []
    left = wanted * ATTEMPTS_PER_CANDIDATE
    while left and len(found) < wanted:
        state, size = rng.bit_generator.state, min(BLOCK, left)
        block = rng.uniform(low, high, (size, len(low)))
        drawn = _usable(cell, mechanism, block, reach)[: wanted - len(found)]
        found += [block[i] for i in drawn]
        left -= size
        if len(found) == wanted:  # no number more is used than one draw after another would
            rng.bit_generator.state = state
            rng.uniform(low, high, (drawn[-1] + 1, len(low)))
    if len(found) < count:
        raise PlanError(cell.path, "robot", f"{len(found)} configurations that can be reached and seen", f"{count}")
    return np.array(found)


def _ranges(chain: Chain) -> tuple[Float1D, Float1D]:
    middle = chain.limits.mean(axis=1)
    slides = [next(link.slides for link in chain.links if link.joint == name) for name in chain.joints]
    half = np.minimum((0.5 - LIMIT_MARGIN) * np.ptp(chain.limits, axis=1), np.where(slides, np.inf, WIDEST_RANGE))
    return middle - half, middle + half


def _usable(cell: Cell, mechanism: Mechanism, q: Float2D, reach: float) -> list[int]:
    """Return which rows of q, (k, n) rad, a real cell could measure."""
    origins, rotation, flange = mechanism.postures(q)
    targets = np.array(list(cell.frames.measurement_points.values()))
    points = np.einsum("kij,pj->kpi", rotation, targets) + flange[:, None]
    usable = np.ones(len(q), dtype=bool)
    if cell.frames.tracker is not None:
        to_tracker = np.array([*cell.frames.tracker.xyz[:2], 0.0])
        distance = float(np.linalg.norm(to_tracker))
        if distance > 0.0:
            usable &= (points @ to_tracker).min(axis=1) / distance >= SIDE * reach
    size = float(np.linalg.norm(cell.gravity))
    if size > 0.0:
        heights = np.concatenate([origins[:, 2:], points], axis=1) @ (-cell.gravity / size)
        usable &= heights.min(axis=1) >= CLEARANCE * reach
    seen = np.flatnonzero(usable)
    return [int(i) for i in seen[_dexterous(mechanism, q[seen], reach)]]


def _dexterous(mechanism: Mechanism, q: Float2D, reach: float) -> Bool1D:
    """Say for every row of joint angles, (k, n) rad, whether it is away from singularities."""
    jacobians = mechanism.jacobians(q) / np.repeat([reach, 1.0], 3)[:, None]
    if q.shape[1] < 6:
        jacobians = jacobians[:, :3]
    singular_values = np.linalg.svd(jacobians, compute_uv=False)
    return np.asarray(singular_values[:, -1] >= LEAST_DEXTERITY * singular_values[:, 0])


def _normalised(q: Float2D, chain: Chain) -> Float2D:
    low, high = _ranges(chain)
    return np.asarray((q - low) / (high - low))


def _farthest(rows: Float2D, count: int) -> list[int]:
    """Choose `count` rows, each the one farthest from those already chosen; the first is nearest to the middle."""
    chosen = [int(np.argmin(np.linalg.norm(rows - rows.mean(axis=0), axis=1)))]
    distance = np.linalg.norm(rows - rows[chosen[0]], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(rows - rows[chosen[-1]], axis=1))
    return chosen


def _short_order(rows: Float2D, chosen: list[int]) -> list[int]:
    """Order the chosen rows so that each is followed by its nearest neighbour among the rest."""
    rest = list(chosen)
    order = [rest.pop(0)]
    while rest:
        order.append(rest.pop(int(np.argmin(np.linalg.norm(rows[rest] - rows[order[-1]], axis=1)))))
    return order
