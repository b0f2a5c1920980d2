"""What an effect may depend on: the loaded robot at rest, reading by reading."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Hashable

import numpy as np

from calibration_core.cell import Cell
from calibration_core.model.chain import Chain
from calibration_core.model.equilibrium import Equilibrium, solve_equilibrium
from calibration_core.model.kinematics import Posture, cross, linear_jacobian, turned
from calibration_core.model.parameters import ModelParameters
from calibration_core.model.statics import Load, gravity_torque, load_torque
from calibration_core.model.virtual_joints import ExternalWrench, VirtualJoints
from calibration_core.timeseries import Float1D, Float2D, Float3D, FloatND, Int1D, Readings, in_time

UNLOADED = 1e-6  # N*m: a joint that carries less carries nothing


@dataclasses.dataclass(frozen=True, eq=False)
class SetUps:
    """Which of several recordings every reading comes from, and how the instruments of each stood.

    Attributes:
        count: How many recordings there are, some of which may have none of the readings.
        recording: (m,) number of the recording, from 0.
        viewpoint: (m, 3) m, where the tracker stood, base axes.
        wrench_change: (m, 6, 6) what takes a wrench from axes and origin of its own sensor to those of the state.
    """

    count: int
    recording: Int1D
    viewpoint: Float2D
    wrench_change: Float3D

    @property
    def numbers(self) -> range:
        """Numbers of the recordings."""
        return range(self.count)


@dataclasses.dataclass(frozen=True, eq=False)
class State:
    """The null model at one set of compliances, base axes, m readings of a robot with n joints.

    Attributes:
        chain: The robot, geometry corrections included.
        at: Deformed posture.
        answer: (3, n, m) m/rad, how the reading's point moves when a joint gives way, K_CSM included.
        compliance: (n,) rad/(N*m).
        load_torque: (n, m) N*m, of the external load.
        gravity_torque: (n, m) N*m, of the robot's own weight; zeros where masses are not known.
        point: (3, m) m, the reading's measurement point.
        point_index: (m,) which point it is.
        force: (3, m) N; zeros without external load.
        moment: (3, m) N*m, about `where`.
        where: (3, m) m, where the wrench is reduced to.
        follows: Whether the wrench turns with the flange, as one recorded in sensor axes does.
        wrench: (m, 6) N and N*m, in the axes it is recorded in.
        by_wrench: (m, 3, 6) how the point moves with the wrench as recorded.
        sensor_axes: (3, 3, m) columns of the axes in which the wrench is recorded.
        q: (m, n) rad, encoder angles.
        configuration: (m,) index of the configuration.
        step: (m,) number of the step.
        time: (m,) s, NaN where unknown.
        temperature: (m,) degrees Celsius, NaN where unknown.
        tracker: (4, 4) pose of the tracker in the base frame.
        rated_load: kg.
        reference_torque: (2, n) N*m, torque of the load, and with the weight, that laws relative to a largest torque
            refer to; None: the largest of these readings.
        setups: Of several recordings, how the instruments of each stood; None: one recording alone.
        side_torque: (n, m) N*m, of springs beside the joints that were found; None: none were.
    """

    chain: Chain
    at: Posture
    answer: Float3D
    compliance: Float1D
    load_torque: Float2D
    gravity_torque: Float2D
    point: Float2D
    point_index: Int1D
    force: Float2D
    moment: Float2D
    where: Float2D
    follows: bool
    wrench: Float2D
    by_wrench: Float3D
    sensor_axes: Float3D
    q: Float2D
    configuration: Int1D
    step: Int1D
    time: Float1D
    temperature: Float1D
    tracker: Float2D
    rated_load: float
    reference_torque: Float2D | None = None
    setups: SetUps | None = None
    side_torque: Float2D | None = None

    @property
    def m(self) -> int:
        """Number of readings."""
        return self.point.shape[1]

    @functools.cached_property
    def torque(self) -> Float2D:
        """(n, m) N*m, load, gravity and springs beside the joints: what the joints carry."""
        total = self.load_torque + self.gravity_torque
        return total if self.side_torque is None else total + self.side_torque

    @functools.cached_property
    def loaded(self) -> bool:
        """Whether any external load acts."""
        return bool(np.any(self.force) or np.any(self.moment))

    def of_rows(self, rows: Int1D) -> State:
        """Return posture, levers, load and weight of some readings; all else is left as it is, of all readings."""
        names = ("answer", "load_torque", "gravity_torque", "point", "force", "moment", "where")
        taken = {name: getattr(self, name).take(rows, axis=-1) for name in names}
        return dataclasses.replace(self, q=self.q[rows], at=self.at.of_readings(rows), **taken)

    def place(self, joint: int, *, other_end: bool = False) -> Float2D:
        """Return the (3, m) m where the frame before a joint stands, or the other end of the joint's axis."""
        return self.at.origin[joint] + self._beyond(joint, other_end=other_end)

    def foot(self, link: int, *, other_end: bool = False) -> Float2D:
        """Return the same behind the motion of the joint, where the link begins."""
        return self.at.body_origin[link] + self._beyond(link, other_end=other_end)

    def tip(self, link: int, *, other_end: bool = False) -> Float2D:
        """Return the (3, m) m where a link ends: at the frame before the next moving joint, or at the flange.

        That joint may be one that mimics another.
        """
        stage, moving = self.chain.stage(link) + 1, self.at.moving
        if stage == len(moving.origin):
            return self.at.flange_origin
        apart = float(self.chain.whole.other_end[stage]) if other_end else 0.0
        return moving.origin[stage] + apart * moving.axis(stage)

    def _beyond(self, joint: int, *, other_end: bool) -> Float2D:
        return (float(self.chain.other_end[joint]) if other_end else 0.0) * self.at.axis(joint)

    def seen_by(self, number: int) -> State:
        """Return the same state with the tracker where one recording's stood, and wrenches as the sensors read them."""
        if self.setups is None:
            return self
        rows = np.flatnonzero(self.setups.recording == number)
        tracker = np.array(self.tracker)
        if len(rows):
            tracker[:3, 3] = self.setups.viewpoint[rows[0]]
        change = self.setups.wrench_change
        read = np.asarray(np.linalg.solve(change, self.wrench[:, :, None])[:, :, 0], dtype=np.float64)
        return dataclasses.replace(self, tracker=tracker, wrench=read, by_wrench=self.by_wrench @ change)

    def bears_weight(self, joint: int) -> bool:
        """Say whether the robot's own weight loads a joint."""
        return bool(np.abs(self.gravity_torque[joint]).max(initial=0.0) > UNLOADED)

    def bears_load(self, joint: int) -> bool:
        """Say whether the external load loads a joint."""
        return bool(np.abs(self.load_torque[joint]).max(initial=0.0) > UNLOADED)

    def largest_torque(self, joint: int, of: object = "load torque") -> float:
        """Return the torque, N*m, that a joint's law refers to; at least a tiny number, so that it can divide.

        Where nothing pulls at the joint, the load torque gives way to the total one.
        """
        row = 1 if of == "total torque" else 0
        if self.reference_torque is not None:
            return float(self.reference_torque[row, joint])
        largest = [float(np.abs(torque[joint]).max(initial=0.0)) for torque in (self.load_torque, self.torque)]
        return max(largest[row] or largest[1], 1e-12)

    def largest_torques(self) -> Float2D:
        """Return the (2, n) N*m that the laws of all joints refer to."""
        joints = range(self.chain.n)
        return np.array([[self.largest_torque(j, of) for j in joints] for of in ("load torque", "total torque")])

    def joint_column(self, joint: int, deflection: Float1D) -> Float2D:
        """Return the (m, 3) movement of the points for an extra deflection (m,) rad of a joint."""
        return (self.answer[:, joint] * deflection).T

    def rotation_column(self, axis: Float2D, origin: Float2D, angle: Float1D) -> Float2D:
        """Return the (m, 3) movement of the points when all beyond `origin` turns by `angle` (m,) rad about `axis`."""
        return (cross(axis, self.point - origin) * angle).T

    @functools.cached_property
    def virtual(self) -> VirtualJoints:
        """Virtual joints: what structure gives way by, under load and weight."""
        load = ExternalWrench(self.force, self.moment, self.where, self.follows)
        return VirtualJoints(self.chain, self.at, self.point, load, self.answer * self.compliance[:, None])

    def along_steps(self, values: Float1D, operator: Callable[[Float2D], FloatND]) -> FloatND:
        """Apply a history operator along the steps of every configuration and point; return (m,) or (m, r).

        Args:
            values: (m,).
            operator: Maps (sequences, steps) to the same shape, or with r answers each; steps in the order of time.
        """
        found = [(index, operator(values[index])) for index in self.sequences]
        result = np.empty((self.m, *found[0][1].shape[2:]))
        for index, answer in found:
            result[index] = answer
        return result

    @functools.cached_property
    def sequences(self) -> list[Int1D]:
        """Index arrays (s, k): rows of one configuration and point in the order of steps, by length."""
        order = np.lexsort((self.step, self.point_index, self.configuration))
        key = self.configuration[order] * (int(self.point_index.max()) + 1) + self.point_index[order]
        _, starts, counts = np.unique(key, return_index=True, return_counts=True)
        return [order[starts[counts == k][:, None] + np.arange(k)] for k in np.unique(counts)]

    def once(self, function: Callable[..., FloatND], *arguments: Hashable) -> FloatND:
        """Return `function(state, *arguments)`, which several hypotheses ask for: it is evaluated once."""
        key = (function, *arguments)
        if key not in self._known:
            self._known[key] = function(self, *arguments)
        return self._known[key]

    @functools.cached_property
    def _known(self) -> dict[Hashable, FloatND]:
        return {}

    def since_step_zero(self, values: Float2D) -> Float2D:
        """Return `values` (m, ...) minus those of the first step of the same configuration and point."""
        result = np.array(values)
        for index in self.sequences:
            result[index] = values[index] - values[index[:, :1]]
        return result


def setups_of(readings: Readings, parameters: ModelParameters) -> SetUps | None:
    """Return how the instruments of several recordings stood; None: one recording alone."""
    if readings.recording is None or readings.viewpoint is None or readings.wrench_change is None:
        return None
    assert parameters.setups is not None  # noqa: S101 - several recordings begin with the frames of each
    return SetUps(len(parameters.setups), readings.recording, readings.viewpoint, readings.wrench_change)


def state_of(
    chain: Chain,
    q: Float2D,
    compliance: Float1D,
    load: Load | None,
    points: Float2D,
    *,
    point_index: Int1D,
    wrench: Float2D | None,
    configuration: Int1D,
    step: Int1D,
    time: Float1D,
    temperature: Float1D,
    tracker: Float2D,
    rated_load: float,
    rest: Equilibrium | None = None,
    setups: SetUps | None = None,
) -> State:
    """Solve the equilibrium and gather everything that effects need.

    Args:
        chain: The robot, geometry corrections included.
        q: (m, n) rad.
        compliance: (n,) rad/(N*m).
        load: External load; None if there is none.
        points: (3, m) m, each reading's point in the flange frame.
        point_index: (m,).
        wrench: (m, 6) as recorded; None without load.
        configuration: (m,) index.
        step: (m,).
        time: (m,) s.
        temperature: (m,) degrees Celsius.
        tracker: (4, 4) pose in the base frame.
        rated_load: kg.
        rest: The equilibrium, where it is known already; None: it is solved here.
        setups: Of several recordings, how the instruments of each stood; None: one recording alone.

    Raises:
        EquilibriumError: The load is beyond what the joints can carry.
    """
    m = len(q)
    rest = solve_equilibrium(chain, q, compliance, load) if rest is None else rest
    answer = rest.loaded_point_jacobian(points)
    zero = np.zeros((3, m))
    if load is None:
        force = moment = zero
        where, axes = rest.at.flange_origin, rest.at.flange
        of_load, by_wrench = np.zeros((chain.n, m)), np.zeros((m, 3, 6))
    else:
        force, moment, where = load.in_base(rest.at)
        axes = turned(rest.at.flange, load.rotation) if load.rotation is not None else _identity(m)
        of_load = load_torque(rest.at, load)
        by_wrench = wrench_response(answer * compliance[:, None], rest.at, load)
    return State(
        chain=chain,
        at=rest.at,
        answer=answer,
        compliance=compliance,
        load_torque=of_load,
        gravity_torque=gravity_torque(chain, rest.at),
        point=rest.at.point(points),
        point_index=point_index,
        force=force,
        moment=moment,
        where=where,
        follows=load is not None and load.rotation is not None,
        wrench=np.zeros((m, 6)) if wrench is None else wrench,
        by_wrench=by_wrench,
        sensor_axes=axes,
        q=q,
        configuration=configuration,
        step=step,
        time=time,
        temperature=temperature,
        tracker=tracker,
        rated_load=rated_load,
        setups=setups,
    )


def wrench_response(answer: Float3D, at: Posture, load: Load) -> Float3D:
    """Return d p / d wrench, (m, 3, 6), the wrench in the axes it is recorded in.

    Args:
        answer: (3, n, m) d p / d torque, K_CSM included.
        at: Deformed posture.
        load: External load.
    """
    linear, angular = linear_jacobian(at, at.point(load.point)), at.spins  # d tau / d force, d torque, base axes
    if load.rotation is not None:
        axes = turned(at.flange, load.rotation)  # columns: sensor axes in base
        linear, angular = (np.einsum("kam,nam->nkm", axes, part) for part in (linear, angular))
    return np.einsum("anm,nkm->mak", answer, np.concatenate([linear, angular], axis=1))


def _identity(m: int) -> Float3D:
    return np.ascontiguousarray(np.broadcast_to(np.eye(3)[:, :, None], (3, 3, m)))


# --- what effects depend on, for the readings of a recording ----------------------------------------------------------


def recorded_state(
    readings: Readings,
    cell: Cell,
    chain: Chain,
    parameters: ModelParameters,
    load: Load | None,
    rest: Equilibrium | None = None,
) -> State:
    """Return the state of all m readings, in their order.

    Args:
        readings: The recording.
        cell: For the rated load.
        chain: The robot, geometry corrected.
        parameters: Compliances, points and tracker.
        load: External load of every reading; None without one.
        rest: The equilibrium, where it is known already; None: it is solved here.

    Raises:
        EquilibriumError: The compliances do not carry the loads.
    """
    return state_of(
        chain,
        readings.q,
        parameters.compliance,
        load,
        np.stack([parameters.points[name] for name in readings.points])[readings.point].T,
        point_index=readings.point,
        wrench=None if load is None else readings.wrench,
        configuration=in_time(readings.configuration),
        step=readings.step,
        time=readings.time,
        temperature=readings.temperature,
        tracker=parameters.tracker,
        rated_load=cell.robot.rated_load,
        rest=rest,
        setups=setups_of(readings, parameters),
    )
