"""Static equilibrium of the elastic robot, on MuJoCo's own forces.

The drive holds the motor side of every joint at the commanded angle; the link side gives way against the joint's
spring until spring, weight and external wrench balance:

    qfrc_passive(x) - qfrc_bias(x) + J(x)^T w = 0,    x = commanded angle + deflection,

with the wrench w acting at the deflected wrench point.  Springs are MuJoCo's (`qfrc_passive`, reference = commanded
angle), weight is MuJoCo's (`qfrc_bias` at rest), the wrench goes in through `mj_applyFT`.  Springs besides the joints
(`mjcf.Spring`), pushes on links and torques beside the joints take part in the same balance.

A joint that mimics another has no coordinate of its own: it stands where the link of the other makes it stand, and what
acts on it acts, times its multiplier, on the other (virtual work): with dx = G dy the balance is G^T F(x) = 0.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from calibration_core.errors import EquilibriumError
from calibration_core.timeseries import Float1D, Float2D, Float3D, FloatND, Int1D
from calibration_sim.mechanics.chain import Chain
from calibration_sim.mechanics.mjcf import Spring, build_mjcf
from calibration_sim.mechanics.transforms import Placement

RELATIVE_TOLERANCE = 1e-12  # of the largest torque at work
FAR = 10.0 * RELATIVE_TOLERANCE  # so much more than is left at rest: the largest torque grows less on the way there
ALONE = 1e-6  # of the largest torque: where more is not balanced, something besides the springs holds the robot
SLOW = 0.1  # a step that removes less than nine tenths of the residual asks for a new derivative
MAX_ITERATIONS = 50
DIFFERENCE_STEP = 1e-6  # rad


@dataclasses.dataclass(frozen=True, eq=False)
class Equilibrium:
    """A robot at rest under load.

    Attributes:
        deflection: (n,) rad, link side minus commanded angle.
        torque: (n,) N*m, what the springs exert on the links.
        flange: Flange frame in the base frame.
        rest: (nv,) rad and m, all coordinates; what a next solution nearby may start from.
        residual: Largest unbalanced torque, relative to the largest torque at work.
    """

    deflection: Float1D
    torque: Float1D
    flange: Placement
    rest: Float1D
    residual: float


@dataclasses.dataclass(frozen=True, eq=False)
class Push:
    """A force on a link that no sensor knows of.

    Attributes:
        link: Name of the link.
        place: (3,) m, where it acts, in the link's frame.
        force: Position (3,) m of that place -> force (3,) N, both in base axes.
    """

    link: str
    place: Float1D
    force: Callable[[Float1D], Float1D]


@dataclasses.dataclass(frozen=True, eq=False)
class SideTorque:
    """A torque that acts on a link about its joint, beside the drive.

    Attributes:
        joint: Index in the order of q.
        torque: Joint angle on the link side, rad -> N*m.
    """

    joint: int
    torque: Callable[[float], float]


@dataclasses.dataclass(frozen=True, eq=False)
class _Gear:
    """How mimic joints go with the others.

    Attributes:
        led: Coordinates of the k mimic joints.
        matrix: (nv, nv) G: the identity, but for the rows of mimic joints: their multipliers at their drivers.
        offset: (k,) rad, m where they slide.
    """

    led: Int1D
    matrix: Float2D
    offset: Float1D

    @staticmethod
    def of(model: mujoco.MjModel, chain: Chain) -> _Gear | None:
        """Return the gear of a robot; None where no joint mimics another."""
        follows = [link.follows for link in chain.links if link.follows is not None]
        if not follows:
            return None
        led = np.array([model.joint(one.name).dofadr[0] for one in follows], dtype=np.int64)
        matrix = np.eye(model.nv)
        matrix[led, led] = 0.0
        matrix[led, [model.joint(one.joint).dofadr[0] for one in follows]] = [one.multiplier for one in follows]
        return _Gear(led, matrix, np.array([one.offset for one in follows]))


class Mechanism:
    """A robot of hinges with springs, held by MuJoCo; the only object here that has a state, and it is scratch."""

    def __init__(
        self,
        chain: Chain,
        stiffness: ArrayLike,
        gravity: ArrayLike,
        *,
        joint_frame_errors: Float2D | None = None,
        joint_zero: ArrayLike | None = None,
        wrench_point: ArrayLike = (0.0, 0.0, 0.0),
        springs: Sequence[Spring] = (),
    ) -> None:
        """Compile the model.

        Args:
            chain: The robot as stated.
            stiffness: (n,) N*m/rad.
            gravity: (3,) m/s^2, base axes.
            joint_frame_errors: (n, 6) m and rad, see `build_mjcf`.
            joint_zero: (n,) rad, true angle minus encoder angle.
            wrench_point: (3,) m, flange frame.
            springs: What gives way besides the joints.
        """
        stiffness = np.asarray(stiffness, dtype=np.float64)
        self.chain = chain
        text = build_mjcf(chain, stiffness, np.asarray(gravity, dtype=np.float64), joint_frame_errors, springs)
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(self.model)
        self._zero = np.zeros(len(chain.joints)) if joint_zero is None else np.asarray(joint_zero, dtype=np.float64)
        self._wrench_point = np.asarray(wrench_point, dtype=np.float64)
        self._dofs = np.array([self.model.joint(name).dofadr[0] for name in chain.joints], dtype=np.int64)
        self._gear = _Gear.of(self.model, chain)
        self._flange = int(self.model.body(chain.links[chain.flange].name).id)
        self._links = [int(self.model.body(link.name).id) for link in chain.links]
        self._origins = np.array(self.model.body_pos)
        self._rates = np.array(self.model.jnt_stiffness, dtype=np.float64).reshape(self.model.nv, -1)[:, 0]
        if self._gear is not None:
            self._rates[self._gear.led] = 1.0  # never used: no force is left there
        self._grain = 8.0 * np.finfo(np.float64).eps * self._rates  # torque that rounding alone leaves, per rad
        # Views of the scratch, made once: MuJoCo makes a new one whenever it is asked.
        self._qpos, self._passive, self._bias = self.data.qpos, self.data.qfrc_passive, self.data.qfrc_bias
        self._turned, self._at = self.data.xmat[self._flange].reshape(3, 3), self.data.xpos[self._flange]
        self._load, self._parts = np.zeros(self.model.nv), np.zeros((3, self.model.nv))
        self._pushes: Sequence[Push] = ()
        self._sides: Sequence[SideTorque] = ()
        self._force, self._moment = np.zeros(3), np.zeros(3)  # at the wrench point, base axes

    def forward(self, angles: ArrayLike) -> Placement:
        """Return the flange frame in the base frame with the links (not the motors) at `angles` (n,) rad."""
        self._qpos[:] = 0.0
        self._qpos[self._dofs] = np.asarray(angles) + self._zero
        self._follow(self._qpos)
        mujoco.mj_kinematics(self.model, self.data)
        return self._flange_placement()

    def _follow(self, x: FloatND) -> None:
        """Put the mimic joints of coordinates (..., nv) where the others make them stand."""
        if self._gear is not None:
            x[..., self._gear.led] = x @ self._gear.matrix.T[:, self._gear.led] + self._gear.offset

    def _shared(self, columns: FloatND) -> FloatND:
        """Return derivatives by coordinates (..., nv), or forces on them: those of mimic joints at their drivers."""
        return columns if self._gear is None else np.asarray(columns @ self._gear.matrix)

    def jacobian(self, angles: ArrayLike, point: ArrayLike = (0.0, 0.0, 0.0)) -> Float2D:
        """Return the Jacobian (6, n) of a point of the flange frame (m): translation above rotation, base axes."""
        place = self.forward(angles)
        mujoco.mj_comPos(self.model, self.data)
        linear, angular = np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
        mujoco.mj_jac(self.model, self.data, linear, angular, place.apply(point), self._flange)
        return np.asarray(self._shared(np.vstack([linear, angular]))[:, self._dofs])

    def jacobians(self, angles: Float2D) -> Float3D:
        """Return the Jacobians (k, 6, n) of the flange's origin, as `jacobian`, for link angles (k, n) rad at once."""
        model, data, n = self.model, self.data, len(self._dofs)
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        result = np.empty((len(angles), 6, n))
        self._qpos[:] = 0.0
        for row, each in zip(result, np.asarray(angles) + self._zero, strict=True):
            self._qpos[self._dofs] = each
            self._follow(self._qpos)
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_jac(model, data, linear, angular, self._at, self._flange)
            row[:3], row[3:] = self._shared(linear)[:, self._dofs], self._shared(angular)[:, self._dofs]
        return result

    def freedoms(self, angles: ArrayLike, wrench: ArrayLike, points: Float2D) -> tuple[Float3D, Float1D]:
        """Return how points move with every coordinate, joint or spring, and what loads each, nothing having given way.

        Args:
            angles: (n,) rad, of the links.
            wrench: (6,) N and N*m, base axes, at the wrench point.
            points: (p, 3) m, flange frame.

        Returns:
            (p, 3, nv) m/rad or m/m, base axes, and (nv,) N*m or N of weight and wrench, coordinates from the base on.
        """
        place = self.forward(angles)
        model, data = self.model, self.data
        mujoco.mj_comPos(model, data)
        mujoco.mj_rne(model, data, 0, data.qfrc_bias)
        load = np.zeros(model.nv)
        w = np.asarray(wrench, dtype=np.float64)
        mujoco.mj_applyFT(model, data, w[:3], w[3:], place.apply(self._wrench_point), self._flange, load)
        motion = np.empty((len(points), 3, model.nv))
        for row, point in zip(motion, points, strict=True):
            mujoco.mj_jac(model, data, row, None, place.apply(point), self._flange)
        return self._shared(motion), self._shared(load - np.array(data.qfrc_bias))

    def softening(self, q: ArrayLike, wrench: ArrayLike, rest: Float1D, points: Float2D) -> Float3D:
        """Return how points move where a joint becomes softer, by the derivative of the balance at a rest.

        With F(x, k) = 0 the balance and S = dF/dx, a compliance 1/k_j that grows by a share moves the coordinates by
        S^-1 times what the spring of joint j carries (implicit function theorem).

        Args:
            q: (n,) rad, commanded angles.
            wrench: (6,) N and N*m, base axes, at the wrench point.
            rest: (nv,) all coordinates at that rest, springs alone.
            points: (p, 3) m, flange frame.

        Returns:
            (p, 3, n) m per share by which the compliance of a joint grows, base axes.

        Raises:
            ValueError: Springs, weight and wrench alone do not balance there.
        """
        model, data = self.model, self.data
        self._pushes, self._sides = (), ()
        model.qpos_spring[:] = 0.0
        model.qpos_spring[self._dofs] = np.asarray(q, dtype=np.float64) + self._zero
        self._hang(wrench)
        left = float(np.abs(self._unbalanced(rest)).max())
        if left > ALONE * self._largest():
            msg = f"{left:.3g} N*m are not balanced by springs, weight and wrench"
            raise ValueError(msg)
        slope = self._slope(np.array(rest))
        gives = np.zeros((model.nv, len(self._dofs)))
        gives[self._dofs, np.arange(len(self._dofs))] = self._passive[self._dofs]
        place, motion = self._flange_placement(), np.empty((len(points), 3, model.nv))
        for row, point in zip(motion, points, strict=True):
            mujoco.mj_jac(model, data, row, None, place.apply(point), self._flange)
        return np.asarray(self._shared(motion) @ np.linalg.solve(slope, gives))

    def origins(self, angles: ArrayLike) -> Float2D:
        """Return the origins (links, 3) of all links in the base frame, m, with the links at `angles` (n,) rad."""
        self.forward(angles)
        return np.array(self.data.xpos[self._links])

    def postures(self, angles: Float2D) -> tuple[Float3D, Float3D, Float2D]:
        """Return what `origins` and `forward` say, for link angles (k, n) rad at once.

        Returns:
            Origins (k, links, 3) m, rotations (k, 3, 3) and origins (k, 3) m of the flange, base frame.
        """
        data = self.data
        qpos, positions, rotations = data.qpos, data.xpos, data.xmat  # views, of which each row is copied
        at, turned = np.empty((len(angles), *positions.shape)), np.empty((len(angles), 9))
        q = np.zeros((len(angles), self.model.nq))
        q[:, self._dofs] = np.asarray(angles) + self._zero
        self._follow(q)
        for row, each in enumerate(q):
            qpos[:] = each
            mujoco.mj_kinematics(self.model, data)
            at[row], turned[row] = positions, rotations[self._flange]
        return at[:, self._links], turned.reshape(-1, 3, 3), at[:, self._flange]

    def places(self) -> Float2D:
        """Return the origins (links, 3) of all links in the base frame, m, where the last solution left them."""
        return np.array(self.data.xpos[self._links])

    def grow(self, share: float) -> None:
        """Make all links longer by a share of their length, as heat does."""
        self.model.body_pos[:] = (1.0 + share) * self._origins

    def equilibrium(
        self,
        q: ArrayLike,
        wrench: ArrayLike | None = None,
        *,
        shift: ArrayLike | None = None,
        pushes: Sequence[Push] = (),
        sides: Sequence[SideTorque] = (),
        start: Float1D | None = None,
    ) -> Equilibrium:
        """Solve for the rest position.

        Args:
            q: (n,) rad, commanded angles (the encoder sits on the motor side and reads these).
            wrench: (6,) N and N*m, base axes, acting on the flange at the wrench point; None: no external load.
            shift: (n,) rad, how far each link stands from its commanded angle with no torque on its spring.
            pushes: Forces on links.
            sides: Torques beside the drives.
            start: (nv,) where to start from; None: the springs' rest.

        Raises:
            EquilibriumError: Newton's method did not converge: the load is beyond what the springs can carry.
        """
        self._hang(np.zeros(6) if wrench is None else wrench)
        reference = np.zeros(self.model.nv)
        commanded = np.asarray(q, dtype=np.float64) + self._zero
        reference[self._dofs] = commanded if shift is None else commanded + np.asarray(shift)
        self._pushes, self._sides = pushes, sides
        self.model.qpos_spring[:] = reference
        rounding = self._grain * np.maximum(1.0, np.abs(reference))

        x = np.array(reference if start is None else start, dtype=np.float64)
        slope: Float2D | None = None  # that of the springs alone, while it serves
        unbalanced = self._unbalanced(x)
        step, left = np.zeros_like(x), np.abs(unbalanced)
        most, far = float(left.max()), max(FAR * self._largest(), float(rounding.max()))
        for _ in range(MAX_ITERATIONS):
            if most <= far and (left <= np.maximum(RELATIVE_TOLERANCE * (scale := self._largest()), rounding)).all():
                deflection = x[self._dofs] - commanded
                torque, place = self._passive[self._dofs], self._flange_placement()
                return Equilibrium(deflection, torque, place, x, most / scale if scale > 0.0 else 0.0)
            try:
                step = np.asarray(unbalanced / self._rates if slope is None else np.linalg.solve(slope, -unbalanced))
            except np.linalg.LinAlgError:  # the springs buckle here
                break
            x = x + step
            unbalanced = self._unbalanced(x)
            before, left = most, np.abs(unbalanced)
            most = float(left.max())
            if not math.isfinite(most):
                break
            if most > SLOW * before:
                slope = self._slope(x)
        raise EquilibriumError(float(np.max(np.abs(step))), MAX_ITERATIONS)

    def _largest(self) -> float:
        """Return the largest single torque in what was summed last."""
        self._parts[0], self._parts[1], self._parts[2] = self._passive, self._bias, self._load
        return float(np.abs(self._parts).max())

    def _hang(self, wrench: ArrayLike) -> None:
        """Let a wrench (6,) act at the wrench point, base axes."""
        w = np.asarray(wrench, dtype=np.float64)
        self._force, self._moment = w[:3], w[3:]

    def _unbalanced(self, x: Float1D) -> Float1D:
        """Return the unbalanced torque (nv,) at rest at x."""
        model, data, load = self.model, self.data, self._load
        self._qpos[:] = x
        self._follow(self._qpos)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_passive(model, data)
        mujoco.mj_rne(model, data, 0, self._bias)
        load.fill(0.0)
        point = self._turned.dot(self._wrench_point) + self._at
        mujoco.mj_applyFT(model, data, self._force, self._moment, point, self._flange, load)
        for push in self._pushes:
            body = model.body(push.link).id
            place = data.xpos[body] + data.xmat[body].reshape(3, 3) @ push.place
            mujoco.mj_applyFT(model, data, push.force(place), np.zeros(3), place, body, load)
        for side in self._sides:
            load[self._dofs[side.joint]] += side.torque(float(x[self._dofs[side.joint]]))
        return self._shared(np.asarray(self._passive - self._bias + load))

    def _slope(self, x: Float1D) -> Float2D:
        """Return the derivative (nv, nv) of the unbalanced torque by central differences."""
        columns = []
        for i in range(len(x)):
            shift = np.zeros_like(x)
            shift[i] = DIFFERENCE_STEP
            forces = self._unbalanced(x + shift) - self._unbalanced(x - shift)
            columns.append(forces / (2.0 * DIFFERENCE_STEP))
        self._unbalanced(x)
        slope = np.array(columns).T
        if self._gear is not None:
            slope[self._gear.led, self._gear.led] = 1.0  # they stay where they are, and no force is left there
        return slope

    def _flange_placement(self) -> Placement:
        return Placement(self._turned.copy(), self._at.copy())
