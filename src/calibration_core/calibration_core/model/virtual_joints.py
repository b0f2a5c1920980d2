"""Virtual joints anywhere in the chain: which wrench they carry, and how the measured point moves when they give way.

A virtual joint is a cut through the chain with a spring in it.  What lies beyond the cut moves by a twist; the wrench
on the cut is the external load together with the weight of everything beyond it, and the drives' own springs answer
the change of their torques.  Twists are (6, m), angular above linear velocity of the base origin; wrenches are (6, m),
moment about the base origin above force; their scalar product is work.
Source: virtual joint method (Pashkevich, Klimchik, Chablat 2011); screw notation as in Murray, Li and Sastry (1994).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from calibration_core.model.chain import Chain
from calibration_core.model.kinematics import Posture, by_axis, by_joint, cross, differing, dot
from calibration_core.model.statics import masses_beyond
from calibration_core.timeseries import Float1D, Float2D, Float3D, Int1D


@dataclasses.dataclass(frozen=True)
class Cut:
    """Where a virtual joint sits; all moving joints are counted, those that mimic others too (`Chain.stage`).

    Attributes:
        joint: Index of the first joint beyond it; the number of joints at the flange.
        weight: Index of the first link whose weight lies beyond it; the number of joints at the flange.
    """

    joint: int
    weight: int


def before_joint(joint: int) -> Cut:
    """Return the cut before a joint: the joint and all that it carries lie beyond."""
    return Cut(joint, joint)


def behind_joint(joint: int) -> Cut:
    """Return the cut between a joint and its link."""
    return Cut(joint + 1, joint)


@dataclasses.dataclass(frozen=True, eq=False)
class ExternalWrench:
    """The external load on the flange, base axes, m readings.

    Attributes:
        force: (3, m) N.
        moment: (3, m) N*m, about `where`.
        where: (3, m) m, base frame.
        follows: Whether it turns with the flange, as one recorded in sensor axes does.
    """

    force: Float2D
    moment: Float2D
    where: Float2D
    follows: bool

    def of_readings(self, rows: Int1D) -> ExternalWrench:
        """Return the load of some readings (indices)."""
        force, moment, where = (part.take(rows, axis=-1) for part in (self.force, self.moment, self.where))
        return ExternalWrench(force, moment, where, self.follows)


class VirtualJoints:
    """Wrenches on the cuts of a loaded robot, and its answers to twists there; each cut is worked out once."""

    def __init__(
        self,
        chain: Chain,
        at: Posture,
        point: Float2D,
        load: ExternalWrench,
        by_torque: Float3D,
    ) -> None:
        """Keep what the cuts need.

        Args:
            chain: The robot.
            at: Its deformed posture.
            point: (3, m) m, the measured points, base frame.
            load: On the flange.
            by_torque: (3, n, m) m/(N*m), how the points move with a torque on each joint, K_CSM included.
        """
        self._point, self._by_torque = point, by_torque
        first, self._place = differing(at.moving.body, at.moving.body_origin, load.force, load.moment, load.where)
        self._robot = _LoadedRobot.of(chain, at.of_readings(first), load.of_readings(first))
        self._wrenches: dict[int, Float2D] = {}
        self._answers: dict[Cut, Float3D] = {}

    def wrench(self, cut: Cut) -> Float2D:
        """Return the (6, m) wrench of load and weight on what lies beyond the cut."""
        if cut.weight not in self._wrenches:
            self._wrenches[cut.weight] = self._robot.wrench(cut.weight).take(self._place, axis=-1)
        return self._wrenches[cut.weight]

    def answer(self, cut: Cut) -> Float3D:
        """Return the (3, 6, m) movement of the points per unit twist of what lies beyond the cut."""
        if cut not in self._answers:
            m = self._point.shape[1]
            direct = np.zeros((3, 6, m))
            for k, axis in enumerate(np.eye(3)):
                direct[:, k] = cross(np.broadcast_to(axis[:, None], (3, m)), self._point)
                direct[k, 3 + k] = 1.0
            self._answers[cut] = direct + np.einsum("anm,nkm->akm", self._by_torque, self.torque_slope(cut))
        return self._answers[cut]

    def column(self, cut: Cut, moved: Float2D, loaded: Float2D | None = None) -> Float2D:
        """Return the (m, 3) movement per unit compliance: twist `moved` in answer to the work on twist `loaded`.

        Args:
            cut: Where.
            moved: (6, m) twist.
            loaded: (6, m) twist; None: the same.
        """
        work = np.einsum("km,km->m", moved if loaded is None else loaded, self.wrench(cut))
        return np.einsum("akm,km->ma", self.answer(cut), moved * work)

    def torque_slope(self, cut: Cut) -> Float3D:
        """Return the (n, 6, m) change of the joints' torques per unit twist of what lies beyond the cut, N*m."""
        return self._robot.torque_slope(cut).take(self._place, axis=-1)


@dataclasses.dataclass(frozen=True, eq=False)
class _LoadedRobot:
    """What all points of one step have in common: posture, load and weight, for m of them.

    Attributes:
        at: The deformed posture; where joints mimic others, with all N moving joints taken as joints of their own.
        joints: The same posture as the robot's own joints have it.
        load: On the flange.
        external: (6, m) the same as a wrench about the base origin.
        gravity: (3, 1, 1) m/s^2, base axes.
        mass: (N + 1,) kg, of every link and all beyond.
        first_moment: (N + 1, 3, m) kg*m, likewise.
    """

    at: Posture
    joints: Posture
    load: ExternalWrench
    external: Float2D
    gravity: Float3D
    mass: Float1D
    first_moment: Float3D

    @staticmethod
    def of(chain: Chain, at: Posture, load: ExternalWrench) -> _LoadedRobot:
        external = np.concatenate([load.moment + cross(load.where, load.force), load.force])
        beyond = masses_beyond(chain.whole, at.moving)
        return _LoadedRobot(at.moving, at, load, external, chain.gravity[:, None, None], *beyond)

    def wrench(self, link: int) -> Float2D:
        """Return the (6, m) wrench of the load, and of the weight of a link and all beyond it."""
        first, gravity = self.first_moment[link], self.gravity[:, 0]
        weight = [cross(first, gravity), np.broadcast_to(self.mass[link] * gravity, first.shape)]
        return np.asarray(self.external + np.concatenate(weight))

    def torque_slope(self, cut: Cut) -> Float3D:
        """Return the (n, 6, m) change of the joints' torques per unit twist of what lies beyond the cut, N*m.

        A joint before the cut sees the wrench beyond it move; a joint beyond moves itself, too.  Source: product rule
        on tau_i = screw_i . wrench_i.
        """
        n = len(self.mass) - 1
        weight = np.maximum(np.arange(n), cut.weight)
        mass, first = self.mass[weight, None], by_axis(self.first_moment[weight])
        spin, shift, gravity = by_axis(self.at.spins), by_axis(self.at.shifts), self.gravity
        moment, force = self.external[:3, None], self.external[3:, None]
        before, beyond = slice(0, cut.joint), slice(cut.joint, n)
        by_weight, by_force = cross(gravity, spin), cross(force, spin)
        by_turn, by_shift = cross(first, by_weight), mass * by_weight + by_force
        by_shift[:, beyond] = 0.0
        by_turn[:, beyond] += (cross(spin, cross(first, gravity)) + cross(shift, mass * gravity))[:, beyond]
        turned = cross(spin, moment) + cross(shift, force)
        if self.load.follows:  # joints beyond and wrench move together
            by_turn[:, before] -= turned[:, before]
        else:
            by_turn += cross(self.load.where[:, None], by_force)
            by_turn[:, beyond] += turned[:, beyond]
        slope = by_joint(np.concatenate([by_turn, by_shift]))
        return slope if self.joints.whole is None else self.joints.gathered(slope)


def rotation_twist(axis: Float2D, origin: Float2D) -> Float2D:
    """Return the (6, m) unit twist about an axis (3, m) through a point (3, m) m."""
    return np.concatenate([axis, cross(origin, axis)])


def translation_twist(axis: Float2D) -> Float2D:
    """Return the (6, m) unit twist along an axis (3, m)."""
    return np.concatenate([np.zeros_like(axis), axis])


def work(twist: Float2D, wrench: Float2D) -> Float1D:
    """Return the (m,) work of a wrench on a twist: the torque or force that a virtual joint carries."""
    return dot(twist[:3], wrench[:3]) + dot(twist[3:], wrench[3:])
