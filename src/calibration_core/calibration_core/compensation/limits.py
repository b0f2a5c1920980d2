"""How far a task may go: the rated load, the model's valid range, joint limits in radians; one rule for every caller.

A row beyond the rated load has no answer.  A row beyond what the recording covered has one, and is named.
"""

from __future__ import annotations

import numpy as np

from calibration_core.cell.values import TURN
from calibration_core.compensation.robot import CalibratedRobot
from calibration_core.compensation.task import Task
from calibration_core.errors import InputError
from calibration_core.model.chain import Chain
from calibration_core.model.identified.calibrated import CalibratedModel
from calibration_core.timeseries import Bool1D, Float1D, Float2D

OVERLOAD = "load beyond the rated load"
GRAVITY = 9.80665


def force_of(task: Task, robot: CalibratedRobot) -> Float1D:
    """Return the load of every row, (m,) N: the force of the environment and the weight of the payload."""
    return np.asarray(np.linalg.norm(task.wrench[:, :3], axis=1) + robot.payload * GRAVITY)


def overloaded(task: Task, robot: CalibratedRobot) -> Bool1D:
    """Return (m,) whether the load of a row exceeds the rated load of the robot."""
    return np.asarray(force_of(task, robot) > robot.cell.robot.rated_load * GRAVITY * (1 + 1e-9))


def outside(task: Task, q: Float2D, robot: CalibratedRobot, model: CalibratedModel) -> dict[str, list[int]]:
    """Return the rows, counted from 1, beyond what the recording covered: `joints`, `load`, `temperature`.

    Args:
        task: The task, m rows.
        q: (m, n) rad, m where a joint slides.
        robot: The robot with its payload.
        model: The model with its valid range; without one, nothing is beyond it.
    """
    covered = model.valid_range
    if covered is None:
        return {}
    beyond = {
        "joints": covered.joint_outside(q).any(axis=1),
        "load": covered.load_outside(force_of(task, robot), np.linalg.norm(task.wrench[:, 3:], axis=1)),
        "temperature": covered.temperature_outside(task.temperature),
    }
    return {key: [int(k) + 1 for k in np.flatnonzero(rows)] for key, rows in beyond.items() if rows.any()}


def check_units(task: Task, chain: Chain, seed_q: Float1D | None = None) -> None:
    """Refuse angles in degrees and travels in millimetres.

    A joint that is a little beyond its limits is a fault of one row; one that is a whole turn beyond them, or a whole
    travel where it slides, is in another unit.

    Args:
        task: The task.
        chain: The robot.
        seed_q: (n,) rad, m where a joint slides, that choose the branch; None: none.

    Raises:
        InputError: Such a value; it names the row.
    """
    if seed_q is not None:
        fault = _far_beyond(np.asarray(seed_q, dtype=float)[None], chain)
        if fault is not None:
            raise InputError("seed_q", "", *fault[1:])
    if task.q is not None:
        fault = _far_beyond(task.q, chain)
        if fault is not None:
            raise task.fault(*fault)
    if task.pose is not None:
        rows, columns = np.nonzero(np.abs(task.pose[:, 3:]) > TURN)
        if len(rows):
            name, value = ("roll", "pitch", "yaw")[columns[0]], task.pose[rows[0], 3 + columns[0]]
            raise task.fault(int(rows[0]), f"{name} = {value:g}", "radians, at most one turn: are these degrees?")


def _far_beyond(q: Float2D, chain: Chain) -> tuple[int, str, str] | None:
    """Return the first row with a joint far beyond its limits, what was found there, and what was expected."""
    low, high = chain.limits.T
    slides = np.array(chain.prismatic)
    allowed = np.where(slides, high - low, TURN)
    rows, joints = np.nonzero((q < low - allowed) | (q > high + allowed))
    if not len(rows):
        return None
    row, joint = int(rows[0]), int(joints[0])
    unit, other = ("metres", "millimetres") if slides[joint] else ("radians", "degrees")
    found = f"{chain.joints[joint]} at {q[row, joint]:g}, far beyond the limits"
    return row, found, f"{unit} within [{low[joint]:g}, {high[joint]:g}]: are these {other}?"
