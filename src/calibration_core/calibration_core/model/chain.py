"""The kinematic chain as plain numbers: one normal form for DH rows and URDF.

Every joint turns about the z axis of the frame before it, or slides along it:

    T_base_flange(q) = prod_i [ P_i J_i(q_i) ] F,    J_i = Rz(q_i + offset_i)  or  Rz(offset_i) Tz(q_i)

with P_i the fixed pose of the frame before joint i in the body frame of link i-1, and F the flange in the body frame
of the last link.  For standard DH rows the frame before joint i is the DH frame i-1.  For modified rows it is DH
frame i before its turn theta_i and its shift d_i, which `Chain.along` holds.

Joints that mimic others stand beside the chain's own (`Chain.mimics`).  All that is counted per joint counts the own
ones; `Chain.whole` is the chain of all moving joints, own and mimic, N of them, each taken as a joint of its own, and
`Chain.expanded` says where these stand.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
import numpy.typing as npt

from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D, read_only


@dataclasses.dataclass(frozen=True, eq=False)
class Mimic:
    """One mimic joint, in the form of `Chain`.

    Attributes:
        behind: Number of the robot's own joints that stand before it in the chain.
        driver: Index of the robot's own joint that moves it.
        multiplier: Its rad, m where it slides, per rad of the driver, m where that slides.
        offset: rad, m where it slides: where it stands while its driver stands at zero.
        rotation: (3, 3) orientation of the frame before it in the body frame of the link before, z along its axis.
        translation: (3,) m, the origin of that frame there.
        mass: kg, of the link that it carries; None where the masses are not known.
        com: (3,) m, centre of gravity of that link in its body frame; None as `mass`.
    """

    name: str
    behind: int
    driver: int
    multiplier: float
    offset: float
    rotation: Float2D
    translation: Float1D
    prismatic: bool
    mass: float | None = None
    com: Float1D | None = None

    def __post_init__(self) -> None:
        """Copy to read-only arrays."""
        for name in ("rotation", "translation", "com"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, read_only(getattr(self, name)))


@dataclasses.dataclass(frozen=True, eq=False)
class Chain:
    """A serial chain of n joints.

    Attributes:
        rotation: (n, 3, 3) orientation of the frame before joint i in the body frame of link i-1.
        translation: (n, 3) m, its origin there.
        offset: (n,) rad, added to the angle of a revolute joint; the angle at which a prismatic one stands.
        flange_rotation: (3, 3) flange orientation in the body frame of the last link.
        flange_translation: (3,) m.
        limits: (n, 2) rad; m where the joint is prismatic.
        gravity: (3,) m/s^2, base axes.
        mass: (n,) kg; None where the masses are not known.
        com: (n, 3) m, centre of gravity in the body frame (after the joint's rotation) of each link; None as `mass`.
        inertials_known: Whether the masses are known, and not guesses.
        prismatic: Per joint, whether it slides: its q is m, its load a force, its stiffness N/m.
        rigid: Per joint, whether it is declared rigid: its stiffness is not asked for.
        along: (n,) m, how far along its axis the joint's own frame stands from the frame before: d of modified rows.
        mimics: Joints that mimic others, base to flange.  `rotation` and `translation` of a joint behind one of them,
            and the flange's, are in the body frame of the mimic joint's link.
    """

    joints: tuple[str, ...]
    rotation: Float3D
    translation: Float2D
    offset: Float1D
    flange_rotation: Float2D
    flange_translation: Float1D
    limits: Float2D
    gravity: Float1D
    mass: Float1D | None = None
    com: Float2D | None = None
    inertials_known: bool = True
    prismatic: tuple[bool, ...] = ()
    rigid: tuple[bool, ...] = ()
    along: Float1D = dataclasses.field(default_factory=lambda: np.zeros(0))
    mimics: tuple[Mimic, ...] = ()

    def __post_init__(self) -> None:
        """Copy to read-only arrays."""
        if not len(self.along):
            object.__setattr__(self, "along", np.zeros(len(self.joints)))
        for name in ("prismatic", "rigid"):
            if not getattr(self, name):
                object.__setattr__(self, name, (False,) * len(self.joints))
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name not in {"joints", "inertials_known", "prismatic", "rigid", "mimics"} and value is not None:
                object.__setattr__(self, field.name, read_only(value))

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def reach(self) -> float:
        """Sum of the distances between neighbouring joints and the flange, m: a length scale of the robot."""
        steps = np.vstack([self.whole.translation[1:], self.flange_translation[None]])
        return float(np.linalg.norm(steps, axis=1).sum())

    @property
    def other_end(self) -> Float1D:
        """(n,) m, from the frame before each joint to the other end of the stretch of its axis that the file shows.

        The frame before a joint may have its origin anywhere on the axis, and does not show where the bearing sits.
        With modified rows the other end is the joint's own frame, d away; with a URDF it is the point of the axis next
        to the previous joint's frame.  0 where both ends are one.
        """
        if self.mimics:
            return self.whole.other_end[self.own]
        own = np.zeros((self.n, 3))
        own[1:, 2] = self.along[:-1]
        near = np.einsum("nik,ni->nk", self.rotation, own - self.translation)[:, 2]
        return np.where(np.abs(self.along) > np.abs(near), self.along, near)

    @property
    def units(self) -> tuple[str, ...]:
        """Per joint the unit of its q: rad or m."""
        return tuple("m" if slides else "rad" for slides in self.prismatic)

    @property
    def travel(self) -> Float1D:
        """(n,) m, how far a sliding joint can stand from its zero within the limits; 0 where the joint turns."""
        return np.where(self.prismatic, np.abs(self.limits).max(axis=1), 0.0)

    @property
    def rails(self) -> int:
        """Number of sliding joints, of all moving ones, before the first that turns: a unit that carries the robot."""
        return next((i for i, slides in enumerate(self.whole.prismatic) if not slides), self.whole.n)

    @property
    def revolute(self) -> tuple[int, ...]:
        """Indices of the joints that turn."""
        return tuple(i for i, slides in enumerate(self.prismatic) if not slides)

    @functools.cached_property
    def whole(self) -> Chain:
        """The chain of all N moving joints, each taken as a joint of its own; this one where none mimics another."""
        if not self.mimics:
            return self
        rows: list[tuple[str, Float2D, Float1D, bool, float | None, Float1D | None]] = []
        for k in range(self.n + 1):
            rows += [
                (one.name, one.rotation, one.translation, one.prismatic, one.mass, one.com)
                for one in self.mimics
                if one.behind == k
            ]
            if k < self.n:
                mass, com = (None, None) if self.mass is None or self.com is None else (self.mass[k], self.com[k])
                rows.append((self.joints[k], self.rotation[k], self.translation[k], self.prismatic[k], mass, com))
        names, rotation, translation, prismatic, mass, com = zip(*rows, strict=True)
        known = self.mass is not None
        offset = np.zeros(len(rows))
        offset[self.own] = self.offset
        ends = self.expanded(self.limits.T)
        return Chain(
            joints=names,
            rotation=np.stack(rotation),
            translation=np.stack(translation),
            offset=offset,
            flange_rotation=self.flange_rotation,
            flange_translation=self.flange_translation,
            limits=np.sort(ends.T, axis=1),
            gravity=self.gravity,
            mass=np.array(mass) if known else None,
            com=np.stack(com) if known else None,
            inertials_known=self.inertials_known,
            prismatic=prismatic,
        )

    @functools.cached_property
    def own(self) -> Int1D:
        """(n,) places of the own joints among all moving ones."""
        behind = np.array([one.behind for one in self.mimics], dtype=np.int64)
        return np.array([i + int(np.count_nonzero(behind <= i)) for i in range(self.n)], dtype=np.int64)

    @functools.cached_property
    def matrix(self) -> Float2D:
        """(N, n) rad or m per rad or m: how every moving joint goes with the own ones."""
        matrix = np.zeros((self.n + len(self.mimics), self.n))
        matrix[self.own, np.arange(self.n)] = 1.0
        for place, one in zip(self._mimic_places, self.mimics, strict=True):
            matrix[place, one.driver] = one.multiplier
        return matrix

    @property
    def _mimic_places(self) -> Int1D:
        return np.setdiff1d(np.arange(self.n + len(self.mimics)), self.own)

    def expanded(self, q: Float2D) -> Float2D:
        """Return where all moving joints stand, (m, N), the own ones standing at (m, n); rad, m where one slides."""
        if not self.mimics:
            return q
        rest = np.zeros(len(self.matrix))
        rest[self._mimic_places] = [one.offset for one in self.mimics]
        return np.asarray(q @ self.matrix.T + rest)

    def stage(self, joint: int) -> int:
        """Return the place of an own joint among all moving ones; of the flange, n, their number."""
        if not self.mimics:
            return joint
        return len(self.matrix) if joint == self.n else int(self.own[joint])

    @property
    def leading(self) -> tuple[bool, ...]:
        """Per joint, whether a mimic joint goes with it."""
        drivers = {one.driver for one in self.mimics if one.multiplier != 0.0}
        return tuple(joint in drivers for joint in range(self.n))

    @property
    def circling(self) -> tuple[int, ...]:
        """Indices of the joints that alone turn the flange about their axis: they turn, and none mimics them."""
        return tuple(i for i in self.revolute if not self.leading[i])

    def wrist_apart(self, joints: int) -> bool:
        """Say whether no mimic joint stands between or behind so many last joints, nor goes with one of them."""
        return self.stage(self.n - joints) + joints == self.whole.n and not any(self.leading[-joints:])

    def corrected(self, geometry: Float2D) -> Chain:
        """Return the chain with every frame before a joint moved by `geometry` ((n, 6): x, y, z, rx, ry, rz)."""
        if not np.any(geometry):
            return self
        translation = self.translation + np.einsum("nij,nj->ni", self.rotation, geometry[:, :3])
        rotation = np.stack(
            [r @ rotation_xyz(*angles) for r, angles in zip(self.rotation, geometry[:, 3:], strict=True)]
        )
        return dataclasses.replace(self, rotation=rotation, translation=translation)

    def with_gravity(self, gravity: Float1D) -> Chain:
        """Return the chain under another acceleration of gravity, (3,) m/s^2 in base axes."""
        return dataclasses.replace(self, gravity=gravity)


def rotation_x(angle: float) -> Float2D:
    """Return the (3, 3) rotation by `angle` rad about x."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rotation_y(angle: float) -> Float2D:
    """Return the (3, 3) rotation by `angle` rad about y."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def rotation_z(angle: float) -> Float2D:
    """Return the (3, 3) rotation by `angle` rad about z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def nearest_rotation(moment: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.float64]:
    """Return the rotations (..., 3, 3) nearest to matrices (Kabsch, 1976; Umeyama, 1991)."""
    u, _, vt = np.linalg.svd(moment)
    u[..., 2] *= np.where(np.linalg.det(u @ vt) < 0.0, -1.0, 1.0)[..., None]
    return np.asarray(u @ vt)


def aligned(target: Float2D, source: Float2D) -> Float2D:
    """Return the (3, 3) rotation that brings points (m, 3) nearest to others, (m, 3), both about their means."""
    return nearest_rotation((target - target.mean(axis=0)).T @ (source - source.mean(axis=0)))


def rotation_xyz(rx: float, ry: float, rz: float) -> Float2D:
    """Return Rx(rx) Ry(ry) Rz(rz), angles in rad."""
    return rotation_x(rx) @ rotation_y(ry) @ rotation_z(rz)


def rotation_about(vector: Float1D) -> Float2D:
    """Return the rotation about a vector, (3,), by its length in rad (Rodrigues' formula)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    once, twice = np.sinc(angle / np.pi), np.sinc(angle / (2 * np.pi)) ** 2 / 2  # sin(t) / t and (1 - cos(t)) / t^2
    return np.asarray(np.eye(3) + once * cross + twice * cross @ cross)


def rotation_vector(rotation: Float2D) -> Float1D:
    """Return the (3,) rad vector of a (3, 3) rotation of less than half a turn, the inverse of `rotation_about`."""
    twice_sin = np.array([
        rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]
    ])  # fmt: skip
    angle = np.arctan2(np.linalg.norm(twice_sin), np.trace(rotation) - 1.0)
    return twice_sin / (2 * np.sinc(angle / np.pi))


def rotation_rpy(roll: float, pitch: float, yaw: float) -> Float2D:
    """Return Rz(yaw) Ry(pitch) Rx(roll), fixed axes, angles in rad."""
    return rotation_z(yaw) @ rotation_y(pitch) @ rotation_x(roll)


def xyz_rpy(pose: Float2D) -> Float1D:
    """Return x, y, z (m) and roll, pitch, yaw (rad) of a (4, 4) pose, see `rpy_of`."""
    return np.concatenate([pose[:3, 3], rpy_of(pose[:3, :3])])


def rpy_of(rotation: Float2D) -> Float1D:
    """Return roll, pitch, yaw in rad of a (3, 3) rotation, the inverse of `rotation_rpy`.

    Yaw is that of the rotation freed of its roll: at a pitch of 90 degrees, where roll and yaw are one turn, rounding
    errors share it out, and the two still compose to it.
    """
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0]))
    second = np.cos(roll) * rotation[:, 1] - np.sin(roll) * rotation[:, 2]  # Rz(yaw) y
    return np.array([roll, pitch, np.arctan2(-second[0], second[1])])


def pose_matrix(xyz: Float1D, rpy: Float1D) -> Float2D:
    """Return the (4, 4) homogeneous matrix of a pose (m, rad, fixed axes)."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_rpy(*(float(angle) for angle in rpy))
    pose[:3, 3] = xyz
    return pose
