"""A target, the tracker or a joint's zero that moved part-way through a recording: hypotheses, but no physics.

Each is a step at one configuration: of a target in the flange frame, of the tracker in the base frame (six parameters),
or of a joint's angle.  What is constant after the change tells which of them it is.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from calibration_core.model.chain import Chain
from calibration_core.model.effects.applied import stacked
from calibration_core.model.effects.candidate import Candidate, Parameter
from calibration_core.model.effects.state import State
from calibration_core.model.kinematics import cross
from calibration_core.timeseries import Bool1D, Float3D, Int1D, Readings, in_time

FAMILY = "anomaly"
MOVED, TURNED = 1e-3, 1e-3  # m, rad: typical
POSITIONS = 40  # change points tried
EDGE = 3  # configurations at either end that show no change
AXES = ("x", "y", "z")


def shifts(readings: Readings, chain: Chain, near: Int1D | None = None) -> tuple[Candidate, ...]:
    """Return the steps to be tried: evenly over the configurations, or at the given ones.

    Args:
        readings: The recording, in the order of time.
        chain: The robot.
        near: Positions (index of the first configuration after the change, in the order of time).
    """
    order = in_time(readings.configuration)
    count = int(order.max()) + 1
    if near is None:
        near = np.unique(np.linspace(EDGE, count - EDGE, POSITIONS).astype(np.int64))
    found = []
    for k in (int(k) for k in near if EDGE <= k <= count - EDGE):
        inside = around(readings, order, k)
        if order[inside].min() + EDGE > k or k > order[inside].max() + 1 - EDGE:
            continue
        after, points = inside & (order >= k), np.unique(readings.point[inside])
        found += [_target(readings.points[p], k, after & (readings.point == p)) for p in points]
        found.append(_tracker(k, after))
        found += [_zero(j, chain.joints[j], k, after) for j in chain.revolute]
    return tuple(found)


def around(readings: Readings, order: Int1D, position: int) -> Bool1D:
    """Return the readings of the recording in which a change may lie, (m,): of one alone, all.

    Args:
        readings: One recording, or several.
        order: (m,) position of every reading's configuration in time.
        position: Of the first configuration after the change.
    """
    if readings.recording is None:
        return np.ones(len(readings), dtype=bool)
    return np.asarray(readings.recording == readings.recording[order == position][0])


def spacing(readings: Readings) -> int:
    """Return how many configurations lie between two of the change points that are tried first."""
    return max(len(np.unique(readings.configuration)) // POSITIONS, 1)


def _target(name: str, position: int, after: Bool1D) -> Candidate:
    parameters = tuple(Parameter(axis, "m", MOVED) for axis in AXES)
    columns = partial(_target_columns, after=after)
    return Candidate("target_moved", FAMILY, {"point": name}, _words(position), parameters, columns, shape=position)


def _tracker(position: int, after: Bool1D) -> Candidate:
    shifted = tuple(Parameter(axis, "m", MOVED) for axis in AXES)
    turned = tuple(Parameter(f"r{axis}", "rad", TURNED) for axis in AXES)
    columns = partial(_tracker_columns, after=after)
    place, several = {"tracker": "tracker"}, (*shifted, *turned)
    return Candidate("tracker_moved", FAMILY, place, _words(position), several, columns, shape=position)


def _zero(joint: int, name: str, position: int, after: Bool1D) -> Candidate:
    columns, parameters = partial(_zero_columns, joint=joint, after=after), (Parameter("offset", "rad", TURNED),)
    return Candidate("zero_moved", FAMILY, {"joint": name}, _words(position), parameters, columns, shape=position)


def _words(position: int) -> str:
    return f"from position {position}"


def _target_columns(state: State, after: Bool1D) -> Float3D:
    return stacked(*((axis * after).T for axis in state.at.flange))


def _zero_columns(state: State, joint: int, after: Bool1D) -> Float3D:
    return stacked(state.joint_column(joint, after.astype(float)))


def _tracker_columns(state: State, after: Bool1D) -> Float3D:
    unit = np.eye(3)[:, :, None] * after
    arm = state.point - state.point.mean(axis=1, keepdims=True)
    turns = [cross(np.broadcast_to(axis[:, None], arm.shape), arm) * after for axis in np.eye(3)]
    return stacked(*(axis.T for axis in unit), *(turn.T for turn in turns))
