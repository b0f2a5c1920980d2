"""How the measured points follow whatever may give way, all places at once, to first order.

Every place is a spring of the true mechanism that has not given way: MuJoCo tells how the points move with it and what
loads it, weight and wrench together.  A compliance c moves the points by motion x load x c.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from calibration_core.timeseries import Float1D, Float2D, Float3D
from calibration_sim.cell.protocol import Protocol
from calibration_sim.cell.table import build_mechanism
from calibration_sim.effects.effect import Label
from calibration_sim.effects.structure import BEARING, Base, Beam, Tool
from calibration_sim.mechanics.chain import Chain
from calibration_sim.mechanics.mjcf import Spring
from calibration_sim.scenarios.world import World

UNNAMED = Label("structure", "any", {})
SHORTEST = 0.05  # m, of a link that may bend
GEAR_ORDERS = (1, 2)  # the waves of a gear that weight can imitate

Place = tuple[str, tuple[tuple[str, str | tuple[str, ...]], ...]]  # effect, items of its location


@dataclasses.dataclass(frozen=True, eq=False)
class Yielding:
    """Columns of one world under one protocol; rows are steps x points x coordinates, tracker frame.

    Attributes:
        geometry: (r, 6 n) m per m and per rad of every joint's frame.
        blocks: Effect and place -> (r, k), its parameters' columns.
    """

    geometry: Float2D
    blocks: Mapping[Place, Float2D]


@dataclasses.dataclass(frozen=True, eq=False)
class _Freedoms:
    """Motion (r, k) and load (s, k) of every coordinate of the mechanism, and angles (s, n)."""

    motion: Float2D
    load: Float2D
    q: Float2D

    def compliance(self, moved: int, loaded: int) -> Float1D:
        """Return how the points (r,) follow if the load of one coordinate moves another."""
        return self.motion[:, moved] * self._rows(self.load[:, loaded])

    def follow(self, moved: int, shift: Float1D) -> Float1D:
        """Return how the points (r,) follow if a coordinate moves by (s,)."""
        return self.motion[:, moved] * self._rows(shift)

    def _rows(self, values: Float1D) -> Float1D:
        return np.repeat(values, len(self.motion) // len(self.load))


def yielding(world: World, protocol: Protocol) -> Yielding:
    """Return the columns of everything that may give way."""
    mechanism = world.mechanism()
    chain, truth = mechanism.chain, world.actual
    springs = _springs(chain)
    every = [spring for group in springs.values() for spring in group]
    order, opened = _order(chain, every), build_mechanism(world.cell, truth, chain, every)
    points = np.array(list(truth.points.values()))
    motion, load, angles = [], [], []
    for configuration in protocol.configurations:
        for wrench in configuration.wrenches:
            moved, loaded = opened.freedoms(configuration.q, wrench, points)
            motion.append(_in_tracker(moved, truth.tracker.rotation))
            load.append(loaded)
            angles.append(configuration.q)
    free = _Freedoms(np.concatenate(motion), np.array(load), np.array(angles))
    places = {key: [order[id(spring)] for spring in group] for key, group in springs.items()}
    joints = [order[name] for name in chain.joints]
    geometry = [free.motion[:, dof] for j in range(len(joints)) for dof in places[f"frame {j}"]]
    return Yielding(np.array(geometry).T, _blocks(free, places, joints))


def _in_tracker(motion: Float3D, rotation: Float2D) -> Float2D:
    return np.asarray(np.einsum("ba,pbk->pak", rotation, motion).reshape(-1, motion.shape[2]))


def _springs(chain: Chain) -> dict[str, tuple[Spring, ...]]:
    """Return all springs by place: frames of the joints (slides, then turns across and about), beams, base, tool."""
    ones = (1.0, 1.0, 1.0)
    result = {"base": Base(UNNAMED, ones, ones).springs(chain), "tool": Tool(UNNAMED, ones, ones).springs(chain)}
    for j, name in enumerate(chain.joints):
        link = next(link for link in chain.links if link.joint == name)
        across = np.linalg.svd(link.axis[None, :])[2][1:]
        axes = (*across, link.axis)
        slides = [Spring(link.name, axis, np.zeros(3), 1.0, slides=True, rank=BEARING) for axis in axes]
        turns = [Spring(link.name, axis, np.zeros(3), 1.0, rank=BEARING) for axis in axes]
        result[f"frame {j}"] = (*slides, *turns)
    for index in range(len(chain.joints) - 1):
        child = chain.child_of(index)
        if np.linalg.norm(child.origin.translation) >= SHORTEST:
            result[f"beam {index}"] = Beam(UNNAMED, index, (1.0, 1.0), 1.0).springs(chain)
    return result


def _order(chain: Chain, springs: list[Spring]) -> dict[int | str, int]:
    """Return the coordinate of every spring (by identity) and joint (by name), as `build_mjcf` lays them out."""
    sorted_springs = sorted(springs, key=lambda spring: spring.rank)
    order: dict[int | str, int] = {}
    for link in chain.links:
        for spring in sorted_springs:
            if spring.link == link.name:
                order[id(spring)] = len(order)
        if link.joint or link.follows is not None:
            order[link.joint or link.name] = len(order)
    return order


def _blocks(free: _Freedoms, places: dict[str, list[int]], joints: list[int]) -> dict[Place, Float2D]:
    blocks: dict[Place, list[Float1D]] = {}

    def add(effect: str, key: str, value: str | tuple[str, ...], columns: list[Float1D]) -> None:
        blocks[effect, ((key, value),)] = columns

    for j, dof in enumerate(joints):
        name = f"joint_{j + 1}"
        x, y = places[f"frame {j}"][3:5]
        twisted = free.compliance(x, y) + free.compliance(y, x)
        add("off_axis_compliance", "joint", name, [free.compliance(x, x), free.compliance(y, y), twisted])
        torque, angle = free.load[:, dof], free.q[:, j]
        waves = [wave(angle) for wave in (np.cos, np.sin)]
        add("pose_dependent_stiffness", "joint", name, [free.follow(dof, torque * wave) for wave in waves])
        gears = [free.follow(dof, wave(k * angle)) for k in GEAR_ORDERS for wave in (np.cos, np.sin)]
        add("transmission_error", "joint", name, gears)
        if j + 1 < len(joints):
            other = joints[j + 1]
            pair = (name, f"joint_{j + 2}")
            add("joint_coupling", "joints", pair, [free.compliance(dof, other) + free.compliance(other, dof)])
    for key, dofs in places.items():
        kind, _, index = key.partition(" ")
        if kind == "beam":  # three axes at each of two stations
            pairs = zip(dofs[:3], dofs[3:], strict=True)
            columns = [free.compliance(a, a) + free.compliance(b, b) for a, b in pairs]
            add("link_bending", "link", f"link_{int(index) + 1}", columns)
        elif kind in {"base", "tool"}:
            add(f"{kind}_compliance", kind, kind, [free.compliance(dof, dof) for dof in dofs])
    return {place: np.array(columns).T for place, columns in blocks.items()}
