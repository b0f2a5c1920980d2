"""What can be measured at all: postures that a cell allows, drawn evenly in the operating space, with pulls."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter

import numpy as np

from calibration_core.cell import Cell
from calibration_core.errors import PlanError, beyond, rounded_down
from calibration_core.model.kinematics import linear_jacobian, posture
from calibration_core.model.parameters import ModelParameters
from calibration_core.planning.feasible.collision import CollisionModel
from calibration_core.planning.feasible.loads import LoadRules, complementary_share, full_pulls, information
from calibration_core.planning.feasible.space import Site, SpaceRules, fitness, joint_range, measurable, positions
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Int1D

BATCH = 4000
STEPS = 12  # Gauss-Newton steps towards a place
DAMPING = 0.05  # m per rad, keeps the steps finite near singularities
FREE = "free of collision"
HARD = 0.5  # share of free postures below which the bodies that stand in the way are named
TOUCHED = 100  # postures by which it is said which they are
SHOWN = 1000  # postures by which it is said which rule stands in the way


@dataclasses.dataclass(frozen=True, eq=False)
class Ground:
    """Where postures are looked for.

    Attributes:
        site: The robot in it.
        bodies: What may touch and what hides a target.
        rules: What makes a posture fit.
    """

    cell: Cell
    site: Site
    bodies: CollisionModel
    rules: SpaceRules

    def fit(self, q: Float2D) -> Bool1D:
        """Tell which postures, (m, n) rad, can be measured; cheaper rules first."""
        mask = measurable(self.site, q, self.rules)
        for rule in (self.bodies.clear, self.bodies.seen):
            rows = np.flatnonzero(mask)
            mask[rows] = rule(q[rows])
        return mask

    def shares(self, q: Float2D) -> dict[str, float]:
        """Return the share of postures, (m, n) rad, that satisfy each rule, by its name."""
        named = {name: float(mask.mean()) for name, mask in fitness(self.site, q, self.rules).items()}
        named[FREE] = float(self.bodies.clear(q[:SHOWN]).mean())
        return named

    def obstacle(self, q: Float2D) -> str:
        """Say which bodies touch at the most of some postures, (m, n) rad; some do at one of them."""
        pairs = Counter(pair for row in q[:TOUCHED] for pair in self.bodies.touching(row))
        pair, count = pairs.most_common(1)[0]
        return f"; {pair} touch in {_percent(count / len(q[:TOUCHED]))}"


def draw_postures(ground: Ground, most: int, batches: int, needed: int, rng: np.random.Generator) -> Float2D:
    """Return up to `most` postures, (m, n) rad, that can be measured.

    Where an operating space is stated, postures are brought by Gauss-Newton steps to places drawn evenly in it, else
    they are drawn evenly between the joint limits.

    Raises:
        PlanError: Fewer than `needed` are found; it says which rule stands in the way.
    """
    low, high = joint_range(ground.site.chain, ground.rules)
    found: list[Float2D] = []
    drawn = np.empty((0, ground.site.chain.n))
    count = 0
    for _ in range(batches):
        drawn = rng.uniform(low, high, (BATCH, ground.site.chain.n))
        places = _places(ground, BATCH, rng)
        if places is not None:
            drawn = brought(ground.site, drawn, places, low, high)
        found.append(drawn[ground.fit(drawn)])
        count += len(found[-1])
        if count >= most:
            break
    if count < needed:
        shares = sorted(ground.shares(drawn).items(), key=lambda x: x[1])
        hardest = ", ".join(f"{_percent(share)} {name}" for name, share in shares)
        touching = ground.obstacle(drawn) if shares[0][0] == FREE and shares[0][1] < HARD else ""
        text = f"{count} postures that can be measured (of those drawn: {hardest}{touching})"
        raise PlanError(ground.cell.path, "robot", text, f"at least {needed}")
    return np.vstack(found)[:most]


def _percent(share: float) -> str:
    """Return a share for a message: `0.4 %`, `100 %`."""
    return f"{100 * share:.2g} %" if share < 0.095 else f"{100 * share:.0f} %"


def _places(ground: Ground, count: int, rng: np.random.Generator) -> Float2D | None:
    """Return places, (count, 3) m, drawn evenly in the operating space; None where none is stated."""
    if ground.site.task is not None:
        off = rng.normal(size=(count, 3))
        off *= (ground.rules.task_radius * rng.uniform(size=(count, 1)) ** (1 / 3)) / np.linalg.norm(
            off, axis=1, keepdims=True
        )
        return np.asarray(ground.site.task[rng.integers(len(ground.site.task), size=count)] + off)
    if ground.rules.box is not None:
        low, high = np.array(ground.rules.box).T
        return rng.uniform(low, high, (count, 3))
    return None


def brought(site: Site, q: Float2D, places: Float2D, low: Float1D, high: Float1D) -> Float2D:
    """Return postures, (m, n) rad, moved so that the middle of the points comes to places, (m, 3) m, in the limits."""
    middle = site.points.mean(axis=0)
    for _ in range(STEPS):
        at = posture(site.chain, q)
        here = at.point(middle)
        jacobian = linear_jacobian(at, here).transpose(2, 1, 0)  # (m, 3, n)
        gram = jacobian @ jacobian.transpose(0, 2, 1) + DAMPING**2 * np.eye(3)
        step = np.einsum("man,ma->mn", jacobian, np.linalg.solve(gram, (places - here.T)[..., None])[..., 0])
        q = np.clip(q + np.clip(step, -0.5, 0.5), low, high)
    return np.asarray(q)


@dataclasses.dataclass(frozen=True, eq=False)
class Loaded:
    """Postures with pulls, one row each; `group` numbers the posture.

    Attributes:
        q: (m, n) rad.
        force: (m, 3) N, full pull at the wrench point, base axes.
        group: (m,) number of the posture.
        place: (m, 3) m, middle of the measurement points, base frame.
        information: (m, n, n) what each tells about the compliances.
        k_csm: (m,) m, largest movement by the complementary stiffness.
    """

    q: Float2D
    force: Float2D
    group: Int1D
    place: Float2D
    information: Float3D
    k_csm: Float1D

    def of(self, mask: Bool1D) -> Loaded:
        """Return some of the rows."""
        return Loaded(*(getattr(self, field.name)[mask] for field in dataclasses.fields(self)))


def loaded_postures(
    ground: Ground, parameters: ModelParameters, q: Float2D, rules: LoadRules, rng: np.random.Generator
) -> Loaded:
    """Return postures, (m, n) rad, each with several pulls; pulls for which K_CSM matters too much are left out.

    Raises:
        PlanError: No pull is left.
    """
    chain, cell = ground.site.chain, ground.cell
    force = full_pulls(cell, parameters, rules, len(q), rng)
    content = information(chain, cell, parameters, q, force, rules)
    share = complementary_share(chain, parameters, q, force)
    place = places_of(ground.site, q)
    k = rules.directions
    found = Loaded(
        q=np.repeat(q, k, axis=0),
        force=force.reshape(-1, 3),
        group=np.repeat(np.arange(len(q)), k),
        place=np.repeat(place, k, axis=0),
        information=content.reshape(-1, chain.n, chain.n),
        k_csm=share.reshape(-1),
    )
    limit = math.inf if rules.k_csm is None else rules.k_csm
    if not (found.k_csm <= limit).any():
        most = rounded_down(1e6 * limit)
        least = beyond(1e6 * float(found.k_csm.min()), most)
        text = f"K_CSM moves the points by {least} µm or more under every pull"
        raise PlanError(cell.path, "robot.stiffness", text, f"at most {most:g} µm")
    return found.of(found.k_csm <= limit)


def places_of(site: Site, q: Float2D) -> Float2D:
    """Return the middle of the measurement points, (m, 3) m, base frame."""
    return np.asarray(positions(posture(site.chain, q), site.points).mean(axis=0).T)
