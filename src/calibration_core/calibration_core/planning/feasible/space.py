"""Which postures a cell can measure: within limits, clear of floor and arm, dexterous, in the tracker's sight.

The arm is taken as capsules around the lines between neighbouring joints up to the wrist.  This sorts out postures that
nobody would drive to, quickly; whether bodies touch is judged by `collision`.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.chain import Chain, pose_matrix
from calibration_core.model.kinematics import Posture, linear_jacobian, posture, turn
from calibration_core.model.parameters import ModelParameters
from calibration_core.timeseries import Bool1D, Bool2D, Float1D, Float2D, Float3D

WRIST = 3  # joints at the end whose links are not taken as part of the arm's body


@dataclasses.dataclass(frozen=True)
class SpaceRules:
    """What makes a posture fit for measuring.

    Attributes:
        limit_margin: Share of each joint's range kept free at both ends.
        widest: rad, no joint goes farther from the middle of its range.
        dexterity: Least ratio of smallest to largest singular value of the flange Jacobian, lengths scaled by the reach
            (CWA 17384, 5.4 and 6.2: away from singularities, where K_CSM would matter).
        clearance: Share of the reach kept free above the floor.
        body: Radius of the arm, as a share of the reach: points stay outside, and so do lines of sight.
        distance: m, safety distance between bodies, at rest and on the way.
        beam: m, kept free around a line of sight of other targets: a reflector of 1.5 inches and the beam.
        tracker_range: m, nearest and farthest distance from tracker to point; what the cell file states goes before.
        box: m, ((low, high),) * 3 in the base frame for the measurement points: the operating space; None: all.
        task_radius: m, how far from a place of the task the middle of the measurement points may be.
    """

    limit_margin: float = 0.05
    widest: float = 2.6
    dexterity: float = 0.08
    clearance: float = 0.08
    body: float = 0.06
    distance: float = 0.03
    beam: float = 0.025
    tracker_range: tuple[float, float] = (1.0, 30.0)
    box: tuple[tuple[float, float], ...] | None = None
    task_radius: float = 0.25


@dataclasses.dataclass(frozen=True, eq=False)
class Site:
    """What of a cell decides where the robot can be measured.

    Attributes:
        points: (p, 3) m, measurement points in the flange frame.
        other: (k, 3) m, further points in the flange frame that must stay clear (flange, wrench point, sensor).
        tracker: (3,) m, tracker in the base frame; None where its pose is not known.
        normals: (p, 3) unit vectors in the flange frame, where the targets open to; rows of zeros where not known.
        acceptance: rad, largest angle between a target's normal and the beam; None where not known.
        range: m, nearest and farthest distance from tracker to point; None where the cell file states none.
        task: (k, 3) m, places of the task program in the base frame, the operating space; None where none is stated.
        boxes: Pose (4, 4) in the base frame and edge lengths (3,), m, of what stands in the cell.
        floor: m, height of the floor over the base frame's origin, against gravity; None: no floor.
    """

    chain: Chain
    points: Float2D
    other: Float2D
    tracker: Float1D | None
    normals: Float2D | None = None
    acceptance: float | None = None
    range: tuple[float, float] | None = None
    task: Float2D | None = None
    boxes: tuple[tuple[Float2D, Float1D], ...] = ()
    floor: float | None = 0.0

    @staticmethod
    def of(chain: Chain, parameters: ModelParameters, cell: Cell) -> Site:
        """Return the site of a robot with these frames and points in a cell."""
        other = [np.zeros(3)]
        if parameters.wrench_point is not None:
            other.append(parameters.wrench_point)
        if parameters.force_torque is not None:
            other.append(parameters.force_torque[:3, 3])
        normals = np.array([cell.frames.target_normals.get(name, (0.0, 0.0, 0.0)) for name in parameters.points])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return Site(
            chain,
            np.stack(list(parameters.points.values())),
            np.stack(other),
            None if cell.frames.tracker is None else parameters.tracker[:3, 3],
            normals / np.where(length > 0, length, 1.0),
            cell.instruments.tracker.acceptance_angle,
            cell.instruments.tracker.range,
            boxes=tuple((pose_matrix(np.array(b.xyz), np.array(b.rpy)), np.array(b.size)) for b in cell.boxes),
            floor=cell.floor,
        )

    @property
    def handled(self) -> Float2D:
        """(p + k, 3) m, every point on the flange that must stay clear."""
        return np.vstack([self.points, self.other])


def joint_range(chain: Chain, rules: SpaceRules) -> tuple[Float1D, Float1D]:
    """Return the lowest and highest joint positions that are used, (n,) rad, m where a joint slides."""
    middle = chain.limits.mean(axis=1)
    half = np.minimum((0.5 - rules.limit_margin) * np.ptp(chain.limits, axis=1),
                      np.where(chain.prismatic, np.inf, rules.widest))  # fmt: skip
    return middle - half, middle + half


def safe(site: Site, q: Float2D, rules: SpaceRules) -> Bool1D:
    """Tell which postures, (m, n) rad, keep clear of the floor and of the arm itself (on the way, too)."""
    at = posture(site.chain, q)
    return _above_floor(site, at, rules) & _off_arm(site, at, rules)


def fitness(site: Site, q: Float2D, rules: SpaceRules) -> Mapping[str, Bool1D]:
    """Tell which postures, (m, n) rad, satisfy each rule, by the rule's name."""
    at = posture(site.chain, q)
    return {
        "above the floor": _above_floor(site, at, rules),
        "clear of the arm": _off_arm(site, at, rules),
        "inside the operating space": _in_box(site, at, rules),
        "in the tracker's sight": _visible(site, at, rules),
        "away from singularities": _dexterous(site, at, rules),
    }


def measurable(site: Site, q: Float2D, rules: SpaceRules) -> Bool1D:
    """Tell which postures, (m, n) rad, satisfy every rule; cheaper rules first."""
    kept = np.arange(len(q))
    for rule in (_above_floor, _in_box, _off_arm, _visible, _dexterous):
        if len(kept):
            kept = kept[rule(site, posture(site.chain, q[kept]), rules)]
    mask = np.zeros(len(q), dtype=bool)
    mask[kept] = True
    return mask


def positions(at: Posture, points: Float2D) -> Float3D:
    """Return the (p, 3, m) positions of points, (p, 3) m in the flange frame, in the base frame."""
    return np.stack([at.point(point) for point in points])


def _above_floor(site: Site, at: Posture, rules: SpaceRules) -> Bool1D:
    m = at.flange_origin.shape[1]
    size = float(np.linalg.norm(site.chain.gravity))
    if site.floor is None or size == 0.0:
        return np.ones(m, dtype=bool)
    up = -site.chain.gravity / size
    watched = np.concatenate([at.moving.origin[2 + site.chain.rails :], positions(at, site.handled)])
    height = np.einsum("pam,a->pm", watched, up)
    return np.asarray(height.min(axis=0) >= site.floor + rules.clearance * site.chain.reach)


def _in_box(site: Site, at: Posture, rules: SpaceRules) -> Bool1D:
    if site.task is not None:
        from scipy.spatial import cKDTree  # slow to load, and few cells state a task

        middle = positions(at, site.points).mean(axis=0).T
        away = cKDTree(site.task).query(middle)[0]
        return np.asarray(away <= rules.task_radius)
    if rules.box is None:
        return np.ones(at.flange_origin.shape[1], dtype=bool)
    low, high = np.array(rules.box).T
    points = positions(at, site.points)
    return np.asarray(((points >= low[:, None]) & (points <= high[:, None])).all(axis=(0, 1)))


def _arm(site: Site, at: Posture) -> list[tuple[Float2D, Float2D]]:
    """Return the ends, (3, m) each, of the lines between neighbouring joints from the base to the wrist."""
    origins, rails = at.moving.origin, site.chain.rails
    foot = np.zeros_like(at.flange_origin) if rails == 0 else origins[rails]
    ends = [foot, *origins[rails : site.chain.stage(max(site.chain.n - WRIST, 1)) + 1]]
    return list(itertools.pairwise(ends))


def _off_arm(site: Site, at: Posture, rules: SpaceRules) -> Bool1D:
    """Points keep two radii from the arm's lines, but for the last one, which carries the wrist."""
    points = positions(at, site.handled)
    clear = np.ones(at.flange_origin.shape[1], dtype=bool)
    for start, end in _arm(site, at)[:-1]:
        along = _share(points, start, end)
        gap = np.linalg.norm(points - (start + along[:, None] * (end - start)), axis=1)
        clear &= gap.min(axis=0) >= 2.0 * rules.body * site.chain.reach
    return clear


def _visible(site: Site, at: Posture, rules: SpaceRules) -> Bool1D:
    if site.tracker is None:
        return np.ones(at.flange_origin.shape[1], dtype=bool)
    points = positions(at, site.points)
    tracker = np.broadcast_to(site.tracker[:, None], points.shape)
    distance = np.linalg.norm(points - tracker, axis=1)
    nearest, farthest = rules.tracker_range if site.range is None else site.range
    seen = ((distance >= nearest) & (distance <= farthest)).all(axis=0) & _accepted(site, at, points, tracker)
    for pose, size in site.boxes:
        seen &= ~_behind(points, tracker, pose, size).any(axis=0)
    for start, end in _arm(site, at):
        seen &= (_segment_distance(points, tracker, start, end) >= rules.body * site.chain.reach).all(axis=0)
    for one, other in itertools.combinations(range(len(points)), 2):
        free = min(rules.beam, 0.5 * float(np.linalg.norm(site.points[one] - site.points[other])))
        near, far = np.sort(distance[[one, other]], axis=0)
        angle = np.einsum("am,am->m", points[one] - tracker[one], points[other] - tracker[other]) / (near * far)
        seen &= near * np.sqrt(np.maximum(1.0 - angle**2, 0.0)) >= free
    return np.asarray(seen)


def _accepted(site: Site, at: Posture, points: Float3D, tracker: Float3D) -> Bool1D:
    """Tell where every target opens towards the tracker, within its acceptance angle; true where none is stated."""
    if site.normals is None or site.acceptance is None:
        return np.ones(points.shape[2], dtype=bool)
    beam = tracker - points
    beam = beam / np.maximum(np.linalg.norm(beam, axis=1, keepdims=True), 1e-12)
    stated = np.any(site.normals, axis=1)
    normal = np.stack([turn(at.flange, one) for one in site.normals])
    inside = np.einsum("pam,pam->pm", normal, beam) >= np.cos(site.acceptance)
    return np.asarray((inside | ~stated[:, None]).all(axis=0))


def _behind(points: Float3D, tracker: Float3D, pose: Float2D, size: Float1D) -> Bool2D:
    """Tell which lines from tracker to points, (p, 3, m), a box cuts, (p, m): Kay and Kajiya's slabs, 1986."""
    start = np.einsum("ba,pbm->pam", pose[:3, :3], tracker - pose[:3, 3:4])
    line = np.einsum("ba,pbm->pam", pose[:3, :3], points - tracker)
    line = np.where(np.abs(line) < 1e-12, 1e-12, line)
    half = 0.5 * size[:, None]
    one, two = (-half - start) / line, (half - start) / line
    enters, leaves = np.minimum(one, two).max(axis=1), np.maximum(one, two).min(axis=1)
    return np.asarray((enters <= leaves) & (leaves >= 0.0) & (enters <= 1.0))


def _share(points: Float3D, start: Float2D, end: Float2D) -> Float2D:
    """Return where on each line the nearest place to a point is, 0 ... 1, (p, m)."""
    line = end - start
    length = np.maximum(np.einsum("am,am->m", line, line), 1e-12)
    return np.clip(np.einsum("pam,am->pm", points - start, line) / length, 0.0, 1.0)


def _segment_distance(a0: Float3D, a1: Float3D, b0: Float2D, b1: Float2D) -> Float2D:
    """Return the (p, m) distances between lines a0-a1 (p, 3, m) and b0-b1 (3, m), m.

    Source: Lumelsky, On fast computation of distance between line segments (1985): clamp one parameter, then the other.
    """
    u, v, w = a1 - a0, np.broadcast_to(b1 - b0, a0.shape), a0 - b0
    uu, uv, vv = (np.einsum("pam,pam->pm", x, y) for x, y in ((u, u), (u, v), (v, v)))
    uw, vw = np.einsum("pam,pam->pm", u, w), np.einsum("pam,pam->pm", v, w)
    vv = np.maximum(vv, 1e-12)
    s = np.clip((uv * vw - vv * uw) / np.maximum(uu * vv - uv**2, 1e-12), 0.0, 1.0)
    t = np.clip((uv * s + vw) / vv, 0.0, 1.0)
    s = np.clip((uv * t - uw) / np.maximum(uu, 1e-12), 0.0, 1.0)
    gap: Float2D = np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=1)
    return gap


def _dexterous(site: Site, at: Posture, rules: SpaceRules) -> Bool1D:
    linear = linear_jacobian(at, at.flange_origin) / site.chain.reach
    angular = at.spins
    jacobian = np.concatenate([linear, angular], axis=1) if site.chain.n >= 6 else linear
    singular = np.linalg.svd(np.moveaxis(jacobian, -1, 0), compute_uv=False)
    return np.asarray(singular[:, -1] >= rules.dexterity * singular[:, 0])
