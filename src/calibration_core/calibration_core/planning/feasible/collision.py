"""Whether robot, tool, floor and the cell's boxes touch, at rest and on the way, and what the tracker's beam meets.

Bodies are those of the URDF (meshes or primitives), and capsules along the lines between neighbouring joints where it
has none or a mesh is missing; the tool
is a bundle of capsules from the flange to every point that it carries.  pinocchio places them, coal tells distances.
A motion is checked at postures so close together that no body can move farther between two of them than the safety
distance: what is clear at all of them is clear everywhere on the way.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.chain import pose_matrix
from calibration_core.model.kinematics import posture
from calibration_core.model.robot import pinocchio_model
from calibration_core.planning.feasible.space import WRIST, Site, SpaceRules, joint_range, positions
from calibration_core.timeseries import Bool1D, Float1D, Float2D

SLENDER = 0.6  # radius of the capsules of forearm and wrist over that of the arm
TOOL_RADIUS = 0.02  # m, of the capsules from the flange to the points: a 1.5 inch target in its nest
BEAM_RADIUS = 0.01  # m
BEAM_END = 0.06  # m of the beam before the target that may touch what carries it
FLOOR_SIZE = 40.0  # m
TRIED = 200  # random postures, by which pairs that touch by their shape alone are found
BY_SHAPE = 0.5  # share of them
MOST_SAMPLES = 4000


@dataclasses.dataclass(frozen=True, eq=False)
class CollisionModel:
    """Robot, tool and surroundings as bodies.

    Attributes:
        site: The robot in its cell.
        rules: Limits and safety distance.
        model: `pinocchio.Model` of the robot.
        geometry: `pinocchio.GeometryModel` with the pairs that are judged.
        sweep: (n,) m/rad, no body point ever moves farther than this per unit of each joint's motion.
        obstacles: Indices of the bodies that may hide a target: the robot's and the boxes, not the tool.
        unjudged: Pairs of the robot's bodies that touch by their shape alone and are left out.
    """

    site: Site
    rules: SpaceRules
    model: Any
    geometry: Any
    sweep: Float1D
    obstacles: tuple[int, ...]
    unjudged: tuple[str, ...]

    @staticmethod
    def of(cell: Cell, site: Site, rules: SpaceRules) -> CollisionModel:
        """Return the bodies of a cell.

        Raises:
            CellError: The URDF cannot be read.
        """
        return _Builder(cell, site, rules).build()

    def clear(self, q: Float2D) -> Bool1D:
        """Tell at which postures, (m, n) rad, all judged pairs keep the safety distance."""
        import pinocchio as pin

        data, found = self.model.createData(), _with_margin(self.geometry, self.rules.distance)
        rows = self.site.chain.expanded(q)
        touching = [
            pin.computeCollisions(self.model, data, self.geometry, found, np.asarray(row), True) for row in rows
        ]
        return ~np.array(touching, dtype=bool)

    def touching(self, q: Float1D) -> tuple[str, ...]:
        """Return the pairs that come nearer than the safety distance at one posture, (n,) rad, by name."""
        import pinocchio as pin

        data, found = self.model.createData(), _with_margin(self.geometry, self.rules.distance)
        row = self.site.chain.expanded(np.asarray(q)[None])[0]
        pin.computeCollisions(self.model, data, self.geometry, found, row, False)
        names = [one.name for one in self.geometry.geometryObjects]
        return tuple(
            f"{names[pair.first]} and {names[pair.second]}"
            for pair, result in zip(self.geometry.collisionPairs, found.collisionResults, strict=True)
            if result.isCollision()
        )

    def clear_way(self, start: Float1D, end: Float1D) -> bool:
        """Tell whether a straight motion in joint space, (n,) rad to (n,) rad, keeps clear all the way.

        Between two checked postures no body moves farther than the safety distance, so none is reached in between.
        """
        line = end - start
        count = int(np.ceil(float(np.abs(line) @ self.sweep) / (2.0 * self.rules.distance))) + 1
        if count > MOST_SAMPLES:
            return False
        shares = np.linspace(0.0, 1.0, count + 1)
        coarse = np.unique(np.linspace(0, count, 12).round().astype(np.int64))  # a motion that is not clear ends early
        if not self.clear(start + shares[coarse, None] * line).all():
            return False
        return bool(self.clear(start + np.delete(shares, coarse)[:, None] * line).all())

    def seen(self, q: Float2D) -> Bool1D:
        """Tell at which postures, (m, n) rad, nothing stands between the tracker and any measurement point."""
        import coal
        import pinocchio as pin

        tracker = self.site.tracker
        if tracker is None:
            return np.ones(len(q), dtype=bool)
        data, found = self.model.createData(), self.geometry.createData()
        shapes = [self.geometry.geometryObjects[i].geometry for i in self.obstacles]
        request, mask = coal.CollisionRequest(), np.ones(len(q), dtype=bool)
        points = positions(posture(self.site.chain, q), self.site.points).transpose(2, 0, 1)  # (m, p, 3)
        beams = [[_rod(tracker, point, BEAM_RADIUS, BEAM_END) for point in row] for row in points]
        for k, row in enumerate(self.site.chain.expanded(q)):
            pin.updateGeometryPlacements(self.model, data, self.geometry, found, np.asarray(row))
            places = [coal.Transform3s(found.oMg[i].rotation, found.oMg[i].translation) for i in self.obstacles]
            mask[k] = not any(
                coal.collide(shape, place, beam, there, request, coal.CollisionResult())
                for beam, there in beams[k]
                for shape, place in zip(shapes, places, strict=True)
            )
        return mask


def _with_margin(geometry: Any, distance: float) -> Any:
    """Return `pinocchio.GeometryData` for which bodies touch that come nearer than a distance, m."""
    found = geometry.createData()
    for request in found.collisionRequests:
        request.security_margin = distance
    return found


def _rod(start: Float1D, end: Float1D, radius: float, short: float = 0.0) -> tuple[Any, Any]:
    """Return a capsule between two points, ending `short` before the second, and its coal pose."""
    import coal

    line = end - start
    length = max(math.sqrt(float(line @ line)), 1e-9)
    kept = max(length - short, 1e-3)
    unit = line / length
    return coal.Capsule(radius, kept), coal.Transform3s(_along(unit), start + 0.5 * kept * unit)


def _along(unit: Float1D) -> Float2D:
    """Return a rotation, (3, 3), whose z column is a unit vector."""
    import pinocchio as pin

    return np.asarray(pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), unit).matrix(), dtype=np.float64)


class _Builder:
    """Gathers the bodies and the pairs to be judged."""

    def __init__(self, cell: Cell, site: Site, rules: SpaceRules) -> None:
        import pinocchio as pin

        self.pin, self.cell, self.site, self.rules, self.chain = pin, cell, site, rules, site.chain.whole
        self.geometry = pin.GeometryModel()
        self.link: list[int] = []  # of every body; -1 for the surroundings
        self.tool: set[int] = set()

    def build(self) -> CollisionModel:
        shaped = self._robot()
        self._tool()
        robot = len(self.link)
        self._surroundings()
        floor = [i for i in range(robot, len(self.link)) if self._name(i) == "floor"]
        rails = self.chain.rails
        for i, j in itertools.combinations(range(robot), 2):
            if abs(self.link[i] - self.link[j]) >= 2 and not (i in self.tool and j in self.tool):
                self.geometry.addCollisionPair(self.pin.CollisionPair(i, j))
        for i, j in itertools.product(range(robot), range(robot, len(self.link))):
            if self.link[i] >= rails + (2 if j in floor else 1):  # base and rail, and for the floor the column, stand
                self.geometry.addCollisionPair(self.pin.CollisionPair(i, j))
        model = pinocchio_model(self.site.chain)
        unjudged = self._leave_out(model, robot, 1.0 if shaped else BY_SHAPE)
        obstacles = tuple(i for i in range(len(self.link)) if i not in self.tool and i not in floor)
        return CollisionModel(self.site, self.rules, model, self.geometry, self._sweep(), obstacles, unjudged)

    def _name(self, i: int) -> str:
        return str(self.geometry.geometryObjects[i].name)

    def _add(self, link: int, name: str, shape: Any, pose: Any) -> None:
        placed = self.pin.GeometryObject(name, max(link, 0), pose, shape)
        self.geometry.addGeometryObject(placed)
        self.link.append(link)

    def _capsule(self, link: int, name: str, start: Float1D, end: Float1D, radius: float) -> None:
        shape, pose = _rod(start, end, radius)
        self._add(link, name, shape, self.pin.SE3(pose.getRotation(), pose.getTranslation()))

    def _robot(self) -> bool:
        """Add the robot's bodies, and capsules where there are none; tell whether all are those of a URDF."""
        bare = set(range(self.chain.n + 1))
        if self.cell.robot.urdf is not None:
            from calibration_core.model.urdf import urdf_shapes

            shapes, lost = urdf_shapes(self.cell)
            for body, shape in shapes:
                self._add(body.link, body.name, shape, self.pin.SE3(body.pose))
            if shapes or lost:
                bare = {body.link for body in lost} - {body.link for body, _ in shapes}
        chain, radius = self.chain, self.rules.body * self.chain.reach
        ends, wrist = [*chain.translation, chain.flange_translation], self.site.chain.stage(self.site.chain.n - WRIST)
        for link, end in enumerate(ends):
            length = float(np.linalg.norm(end))
            if length < 1e-6 or link not in bare:
                continue
            width = radius * (SLENDER if link >= wrist else 1.0)
            last = link == wrist  # the forearm ends at the wrist and not a radius beyond it
            kept = max(length - width, 0.5 * length) if last else length
            self._capsule(link, f"link {link}", np.zeros(3), end * kept / length, width)
        return not bare

    def _tool(self) -> None:
        chain = self.chain
        for k, point in enumerate(self.site.handled):
            end = chain.flange_translation + chain.flange_rotation @ point
            if np.linalg.norm(point) > 1e-6:
                self.tool.add(len(self.link))
                self._capsule(chain.n, f"tool {k + 1}", chain.flange_translation, end, TOOL_RADIUS)

    def _surroundings(self) -> None:
        import coal

        size = float(np.linalg.norm(self.chain.gravity))
        if self.site.floor is not None and size > 0.0:
            up = -self.chain.gravity / size
            pose = self.pin.SE3(_along(up), (self.site.floor - 0.5) * up)
            self._add(-1, "floor", coal.Box(FLOOR_SIZE, FLOOR_SIZE, 1.0), pose)
        for box in self.cell.boxes:
            pose = self.pin.SE3(pose_matrix(np.array(box.xyz), np.array(box.rpy)))
            self._add(-1, box.name, coal.Box(*box.size), pose)

    def _leave_out(self, model: Any, robot: int, share: float) -> tuple[str, ...]:
        """Take out pairs of the robot's own bodies that touch in so many of random postures: their shape, no clash.

        So is a body that touches the floor in all of them, such as the upper arm of a robot with a low shoulder: its
        elbow and what is behind it keep clear of the floor.
        """
        chain = self.site.chain
        low, high = joint_range(chain, self.rules)
        data, found = model.createData(), _with_margin(self.geometry, self.rules.distance)
        pairs = [(pair.first, pair.second) for pair in self.geometry.collisionPairs]
        count = np.zeros(len(pairs))
        for row in chain.expanded(np.random.default_rng(0).uniform(low, high, (TRIED, chain.n))):
            self.pin.computeCollisions(model, data, self.geometry, found, row, False)
            count += [result.isCollision() for result in found.collisionResults]
        floor = {i for i in range(robot, len(self.link)) if self._name(i) == "floor"}
        often = [
            pair
            for pair, hits in zip(pairs, count, strict=True)
            if hits >= (share * TRIED if max(pair) < robot else TRIED) and (max(pair) < robot or max(pair) in floor)
        ]
        for pair in often:
            self.geometry.removeCollisionPair(self.pin.CollisionPair(*pair))
        return tuple(f"{self._name(first)} and {self._name(second)}" for first, second in often)

    def _sweep(self) -> Float1D:
        """Bound how far any point of any body moves per unit of each joint's motion, (n,) m/rad (m/m on a slide)."""
        chain = self.chain
        extent = np.zeros(chain.n + 1)  # of the bodies of each link, from the link's origin
        for i, link in enumerate(self.link):
            if link > 0:
                one = self.geometry.geometryObjects[i]
                one.geometry.computeLocalAABB()
                centre = one.placement.act(np.asarray(one.geometry.aabb_center))
                extent[link] = max(extent[link], float(np.linalg.norm(centre)) + float(one.geometry.aabb_radius))
        steps, travel = np.linalg.norm(chain.translation, axis=1), chain.travel
        levers = [
            max(
                steps[j + 1 : link].sum() + travel[j + 1 : link].sum() + extent[link]
                for link in range(j + 1, chain.n + 1)
            )
            for j in range(chain.n)
        ]
        each = np.where(chain.prismatic, 1.0, levers)
        return each @ np.abs(self.site.chain.matrix) if self.site.chain.mimics else each
