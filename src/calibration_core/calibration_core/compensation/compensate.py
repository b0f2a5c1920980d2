"""Where to send a calibrated, loaded robot so that its tool arrives at its target."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from numpy.typing import NDArray

from calibration_core.compensation.inverse import (
    SINGULAR,
    Reached,
    Solve,
    axes_of,
    into_limits,
    jacobian,
    reach_for,
    rigid,
)
from calibration_core.compensation.limits import OVERLOAD, check_units, overloaded
from calibration_core.compensation.motion import covariance_of, length_bound, tool_columns, tool_movement
from calibration_core.compensation.robot import CalibratedRobot, Conditions, left_aside, parts_of
from calibration_core.compensation.task import Task
from calibration_core.model.chain import Chain
from calibration_core.model.identified.gaussian import GaussianEstimate
from calibration_core.model.parameters import AppliedEffect
from calibration_core.model.robot import chain_of
from calibration_core.model.statics import Load
from calibration_core.timeseries import Bool1D, Float1D, Float2D, Float3D, Int1D

Status = NDArray[np.object_]
OK = "ok"
ROUNDS = 6  # of effects and angles
SETTLED = 1e-7  # m and rad: what effects change between two rounds
JUMP = 0.5  # rad or m, that neighbouring rows of a path are apart at most without a second look
BRANCH = 0.2  # rad or m, that a correction never is
ARRIVED = 1e-6  # m: less is arrived


@dataclasses.dataclass(frozen=True, eq=False)
class Compensation:
    """A task with its corrections, m rows; those that are refused keep their nominal angles.

    Attributes:
        nominal: (m, n) rad, angles of the nominal, rigid robot.
        q: (m, n) rad, corrected angles.
        target: (3, m) m, where the tool should be, base frame.
        axes: (3, 3, m) its axes there, columns.
        sent: (3, m) m, where the nominal robot would have its tool at the corrected angles: the corrected place.
        sent_axes: (3, 3, m) its axes there.
        error_before: (m, 3) m, tool - target of the loaded robot at the nominal angles.
        error_after: (m, 3) m, the same at the corrected angles, as the model predicts it.
        u95: (m,) m, what the error at the corrected angles exceeds in one of twenty cases, by the model's covariance;
            NaN where the model has none.
        status: `ok`, or why a row was refused.
        aside: Effects of the model that were not compensated: of the measurement, or the task lacks what they need.
    """

    nominal: Float2D
    q: Float2D
    target: Float2D
    axes: Float3D
    sent: Float2D
    sent_axes: Float3D
    error_before: Float2D
    error_after: Float2D
    u95: Float1D
    status: tuple[str, ...]
    aside: tuple[AppliedEffect, ...]

    @property
    def lengths(self) -> tuple[Float1D, Float1D]:
        """(m,) m each: distance of the tool from its target at the nominal and at the corrected angles."""
        return np.linalg.norm(self.error_before, axis=1), np.linalg.norm(self.error_after, axis=1)

    @property
    def ok(self) -> Bool1D:
        """(m,) rows that were compensated."""
        return np.array([status == OK for status in self.status])


def compensate(
    robot: CalibratedRobot,
    task: Task,
    estimate: GaussianEstimate | None,
    *,
    axes: str = "base",
    seed_q: Float1D | None = None,
) -> Compensation:
    """Correct all rows of a task.

    Args:
        robot: The calibrated robot with its payload.
        task: What it should do.
        estimate: Covariance of the model; None: no intervals.
        axes: Axes of the wrenches: `base` or `tool`.
        seed_q: (n,) rad, chooses the branch where the task states places alone; None: the middle of the limits.

    Raises:
        CellError: There is a load, and the cell file has no wrench point.
        InputError: Angles are in degrees, or travels in millimetres.
        EquilibriumError: A load is beyond what the joints can carry.
    """
    nominal_chain = chain_of(robot.cell)
    forward = rigid(nominal_chain, robot.tool)
    status = np.full(len(task), OK, dtype=object)
    target, goal, nominal = _targets(task, forward, nominal_chain, seed_q, status)
    _refuse(status, overloaded(task, robot), OVERLOAD)
    going = np.flatnonzero(status == OK)
    part = _Part(robot, task, target, goal, nominal, going, axes)
    q = nominal.copy()
    before, after = np.full((len(task), 3), np.nan), np.full((len(task), 3), np.nan)
    u95 = np.full(len(task), np.nan)
    aside: tuple[AppliedEffect, ...] = robot.parameters.effects
    if len(going):
        before[going] = part.error(nominal[going])
        solved = part.solve()
        q[going] = into_limits(solved.q, nominal_chain)
        after[going], bound, aside = part.judged(q[going], estimate)
        if bound is not None:
            u95[going] = bound
        _judge(status, going, solved, q[going], nominal[going], after[going], robot)
    refused = np.flatnonzero(status != OK)
    q[refused] = nominal[refused]
    after[refused], u95[refused] = np.nan, np.nan
    sent, sent_axes, _ = forward(q, np.arange(len(q)))
    return Compensation(
        nominal, q, target, goal, sent, sent_axes, before, after, u95, tuple(str(one) for one in status), aside
    )


def nominal_angles(task: Task, robot: CalibratedRobot) -> tuple[Float2D, list[tuple[int, str]]]:
    """Return the nominal robot's angles (m, n) for a task, and the rows, counted from 0, that are refused, with why.

    Raises:
        InputError: Angles are in degrees, or travels in millimetres.
    """
    chain = chain_of(robot.cell)
    status: Status = np.full(len(task), OK, dtype=object)
    _, _, nominal = _targets(task, rigid(chain, robot.tool), chain, None, status)
    _refuse(status, overloaded(task, robot), OVERLOAD)
    return nominal, [(k, str(why)) for k, why in enumerate(status) if why != OK]


def _targets(
    task: Task, forward: Solve, chain: Chain, seed_q: Float1D | None, status: Status
) -> tuple[Float2D, Float3D, Float2D]:
    """Return target (3, m), axes (3, 3, m) and nominal angles (m, n); rows without a nominal solution are refused."""
    check_units(task, chain, seed_q)
    everything = np.arange(len(task))
    if task.pose is None:
        assert task.q is not None  # noqa: S101 - a task has one of them
        target, goal, _ = forward(task.q, everything)
        nominal = np.array(task.q)
    else:
        target, goal = np.ascontiguousarray(task.pose[:, :3].T), axes_of(task.pose[:, 3:])
        if task.q is not None:
            start = np.array(task.q)
        else:
            middle = chain.limits.mean(axis=1) if seed_q is None else np.asarray(seed_q, dtype=float)
            start = np.tile(middle, (len(task), 1))
        nominal = _nominal(target, goal, start, forward, chain, status)
        if task.q is None:
            _follow(task.path, target, goal, nominal, forward, chain, status)
    outside = (nominal < chain.limits[:, 0] - 1e-9) | (nominal > chain.limits[:, 1] + 1e-9)
    for joint, name in enumerate(chain.joints):
        _refuse(status, outside[:, joint], f"beyond the limits of {name}")
    return target, goal, nominal


def _nominal(target: Float2D, goal: Float3D, start: Float2D, forward: Solve, chain: Chain, status: Status) -> Float2D:
    """Solve for the nominal robot: from the given angles, then, where that fails, from the nearest place that was."""
    found = reach_for(target, goal, start, forward, chain.reach, far=True)
    q, arrived = into_limits(found.q, chain), found.arrived.copy()
    inside = np.all((q >= chain.limits[:, 0] - 1e-9) & (q <= chain.limits[:, 1] + 1e-9), axis=1)
    good = np.flatnonzero(arrived & inside)
    lost = np.flatnonzero(~(arrived & inside))
    if len(good) and len(lost):
        near = good[np.array([np.argmin(np.linalg.norm(target[:, good] - target[:, [k]], axis=0)) for k in lost])]
        again = reach_for(
            target[:, lost],
            goal[:, :, lost],
            q[near],
            lambda angles, rows: forward(angles, lost[rows]),
            chain.reach,
            far=True,
        )
        better = again.arrived
        q[lost[better]], arrived[lost[better]] = into_limits(again.q[better], chain), True
    _refuse(status, ~arrived, "out of reach")
    return np.where(arrived[:, None], q, start)


def _follow(
    path: Int1D, target: Float2D, goal: Float3D, nominal: Float2D, forward: Solve, chain: Chain, status: Status
) -> None:
    """Keep the branch along every path: a row that left it is solved again from the one before, in place."""
    for number in np.unique(path[path >= 0]):
        rows = [int(k) for k in np.flatnonzero((path == number) & (status == OK))]
        for before, row in itertools.pairwise(rows):
            if np.abs(nominal[row] - nominal[before]).max() <= JUMP:
                continue
            again = reach_for(target[:, [row]], goal[:, :, [row]], nominal[[before]], forward, chain.reach, far=True)
            q = into_limits(again.q, chain)[0]
            if again.arrived[0] and np.abs(q - nominal[before]).max() < np.abs(nominal[row] - nominal[before]).max():
                nominal[row] = q


def _refuse(status: Status, rows: Bool1D, why: str) -> None:
    status[rows & (status == OK)] = why


def _judge(
    status: Status, rows: Int1D, solved: Reached, q: Float2D, nominal: Float2D, after: Float2D, robot: CalibratedRobot
) -> None:
    """Refuse what cannot be sent: singular, out of the branch, beyond limits, or not arrived."""
    own = status[rows]
    _refuse(own, solved.singular < SINGULAR, "near a singularity")
    _refuse(own, np.abs(q - nominal).max(axis=1) > BRANCH, "the correction leaves the branch")
    limits = robot.chain.limits
    for joint, name in enumerate(robot.chain.joints):
        outside = (q[:, joint] < limits[joint, 0] - 1e-9) | (q[:, joint] > limits[joint, 1] + 1e-9)
        _refuse(own, outside, f"beyond the limits of {name}")
    _refuse(own, ~(np.linalg.norm(after, axis=1) < ARRIVED), "an effect that jumps here keeps the tool from arriving")
    status[rows] = own


@dataclasses.dataclass(frozen=True, eq=False)
class _Part:
    """The rows of a task that are worked on."""

    robot: CalibratedRobot
    task: Task
    target: Float2D
    goal: Float3D
    nominal: Float2D
    rows: Int1D
    axes: str

    def __post_init__(self) -> None:
        """Keep what belongs to these rows."""
        for name in ("target", "goal"):
            object.__setattr__(self, name, getattr(self, name)[..., self.rows])
        object.__setattr__(self, "nominal", self.nominal[self.rows])

    @property
    def load(self) -> Load | None:
        return self.robot.load(self.task.wrench[self.rows], self.axes)

    @property
    def conditions(self) -> Conditions:
        return Conditions(self.task.time, self.task.temperature, self.task.path).rows(self.rows)

    def moved(self, q: Float2D, *, turns: bool = True) -> Float2D:
        """Return what effects do at angles (m, n): (m, 6) m and rad, or (m, 3) m."""
        if not self.robot.parameters.effects:
            return np.zeros((len(q), 6 if turns else 3))
        load = self.load
        parts = tuple(parts_of(self.robot, q, load, self.robot.stand(q, load), self.conditions, turns=turns))
        return tool_movement(self.robot, parts, len(q), turns=turns)

    def error(self, q: Float2D) -> Float2D:
        """Return tool - target at angles (m, n), (m, 3) m."""
        origin, _ = self.robot.places(self.robot.stand(q, self.load))
        return np.asarray((origin - self.target).T + self.moved(q, turns=False))

    def judged(
        self, q: Float2D, estimate: GaussianEstimate | None
    ) -> tuple[Float2D, Float1D | None, tuple[AppliedEffect, ...]]:
        """Return tool - target, its 95 % length, and the effects that were left aside."""
        load = self.load
        rest = self.robot.stand(q, load)
        parts = tuple(parts_of(self.robot, q, load, rest, self.conditions, turns=False))
        error = (self.robot.places(rest)[0] - self.target).T + tool_movement(self.robot, parts, len(q), turns=False)
        aside = left_aside(self.robot, parts)
        if estimate is None:
            return error, None, aside
        columns = tool_columns(self.robot, rest, parts, estimate)[:, :3]
        return error, length_bound(covariance_of(columns, estimate)), aside

    def solve(self) -> Reached:
        """Return the angles at which the tool is at its target, effects and all.

        Effects change little with the correction: they are taken at the last angles, and the angles found anew, until
        they stand still.
        """
        q, shift = self.nominal, self.moved(self.nominal)
        load = self.load

        def forward(angles: Float2D, rows: Int1D) -> tuple[Float2D, Float3D, Float3D]:
            own = load if load is None else load.rows(rows)
            rest = self.robot.stand(angles, own)
            origin, now = self.robot.places(rest)
            derivative = jacobian(rest.at, origin) @ np.moveaxis(rest.amplification, -1, 0)
            turned = np.stack([one + np.cross(shift[rows, 3:], one.T).T for one in now])
            return origin + shift[rows, :3].T, turned, derivative

        for remaining in reversed(range(ROUNDS)):
            solved = reach_for(self.target, self.goal, q, forward, self.robot.chain.reach)
            if not self.robot.parameters.effects or not remaining:
                return solved
            q, before, shift = solved.q, shift, self.moved(solved.q)
            if np.abs(shift - before).max() < SETTLED:
                return solved
        raise AssertionError  # the last round returns
