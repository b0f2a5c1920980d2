"""What a compensation is written as: the task with its corrections, places for any controller, a ROS trajectory."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration_core.compensation.compensate import Compensation
from calibration_core.compensation.inverse import rpy_of_axes
from calibration_core.compensation.task import Task
from calibration_core.files.written import csv_bytes
from calibration_core.files.yaml_file import yaml_text
from calibration_core.timeseries import Float1D, Float2D

PLACE = ("cx", "cy", "cz", "croll", "cpitch", "cyaw")
RESULT = ("error_before", "error_after", "u95", "status")
NANOSECONDS = 1_000_000_000


def compensated_csv(task: Task, found: Compensation) -> bytes:
    """Return the rows of the task with corrected angles and place, errors (m) and status; empty where refused."""
    n = found.q.shape[1]
    own = [k for k, name in enumerate(task.header) if not (name.startswith("q") and name[1:].isdecimal())]
    header = [*(task.header[k] for k in own), *(f"q{i + 1}" for i in range(n)), *PLACE, *RESULT]
    before, after = (np.linalg.norm(error, axis=1) for error in (found.error_before, found.error_after))
    place = np.hstack([found.sent.T, rpy_of_axes(found.sent_axes)])
    rows = []
    for k, ok in enumerate(found.ok):
        corrected = [*found.q[k], *place[k]] if ok else [""] * (n + 6)
        kept = (task.rows[k][column] for column in own)
        rows.append([*kept, *corrected, before[k], after[k], found.u95[k], found.status[k]])
    return csv_bytes(header, rows)


def poses_csv(found: Compensation) -> bytes:
    """Return the corrected places for controllers that are sent places: row of the task, m, degrees, rotation."""
    axes = [f"{column}{row}" for row in "xyz" for column in ("ux", "uy", "uz")]
    angles = np.degrees(rpy_of_axes(found.sent_axes))
    matrices = found.sent_axes.transpose(2, 1, 0).reshape(-1, 9)
    rows = ([int(k) + 1, *found.sent[:, k], *angles[k], *matrices[k]] for k in np.flatnonzero(found.ok))
    return csv_bytes(["row", "x", "y", "z", "roll_deg", "pitch_deg", "yaw_deg", *axes], rows)


def trajectory_yaml(joints: Sequence[str], found: Compensation, times: Float1D) -> bytes:
    """Return the compensated rows as a `trajectory_msgs/JointTrajectory` in YAML.

    Args:
        joints: Names.
        found: The compensation.
        times: (k,) s from the start, increasing, of the k rows that were compensated.
    """
    points = [
        {"positions": [float(x) for x in q], "time_from_start": duration(float(time))}
        for q, time in zip(found.q[found.ok], times, strict=True)
    ]
    return yaml_text({"joint_names": list(joints), "points": points}, flow=None).encode()


def duration(seconds: float) -> dict[str, int]:
    """Return a time as `builtin_interfaces/Duration`: whole seconds and nanoseconds."""
    total = round(seconds * NANOSECONDS)
    return {"sec": total // NANOSECONDS, "nanosec": total % NANOSECONDS}


def times_of(q: Float2D, lever: Float2D, speed: float) -> Float1D:
    """Return when each row is reached, (k,) s: as soon as no monitored point exceeds a speed.

    Between rows the joints move on a straight line; a point moves by no more than the sum of |dq_j| times its lever.

    Args:
        q: (k, n) rad, m where a joint slides.
        lever: (p, n) m/rad, bound of the speed of every monitored point per joint rate.
        speed: m/s.
    """
    travel = (np.abs(np.diff(q, axis=0)) @ lever.T).max(axis=1, initial=0.0)
    return np.concatenate([np.zeros(min(len(q), 1)), np.cumsum(np.maximum(travel / speed, 1e-3))])
