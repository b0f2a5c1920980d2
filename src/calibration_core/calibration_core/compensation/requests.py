"""What is asked for outside a file, a place or a trajectory, as a task; and a corrected trajectory's velocities."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from calibration_core.compensation.inverse import rpy_of_axes
from calibration_core.compensation.task import LARGEST, Task, first_not_later, places
from calibration_core.errors import InputError, quoted
from calibration_core.timeseries import Float1D, Float2D, Float3D

AXES = ("base", "tool")
UNIT = 1e-3  # by which the length of a quaternion may differ from 1
MOST = 20_000  # points of a trajectory


@dataclasses.dataclass(frozen=True, eq=False)
class Request:
    """What a caller asks for besides the task itself.

    Attributes:
        axes: Axes of the wrenches: `base` or `tool`.
        payload: Mass (kg) and centre of gravity (m, flange frame); None: nothing.
        temperature: Degrees Celsius; None: not known.
    """

    axes: str = "base"
    payload: tuple[float, ...] | None = None
    temperature: float | None = None

    def __post_init__(self) -> None:
        """Refuse what makes no sense.

        Raises:
            InputError: An axis name that there is none of, a negative mass, or a number that is not finite.
        """
        if self.axes not in AXES:
            raise InputError("request", "axes", quoted(self.axes), f"one of {', '.join(AXES)}")
        if self.payload is not None:
            finite("payload", np.array(self.payload))
            if self.payload[0] < 0:
                raise InputError("request", "payload_mass", f"{self.payload[0]:g}", "a mass in kg, not negative")
        if self.temperature is not None:
            finite("temperature", np.array([self.temperature]))


def place_task(
    request: Request, pose: tuple[Float1D, Float1D] | None, q: Float1D | None, wrench: Float1D, n: int
) -> Task:
    """Return the task of one place.

    Args:
        request: What is said besides.
        pose: Origin (3,) m and quaternion (4,) x, y, z, w of the tool, base frame; None: where the nominal robot has
            its tool at `q`.
        q: (n,) rad (m where a joint slides), the nominal angles, or what chooses the branch; None: neither.
        wrench: (6,) N and N*m at the wrench point.
        n: Number of joints.

    Raises:
        InputError: A number is not finite or makes no sense, or the target is not stated.
    """
    if q is not None:
        if q.shape != (n,):
            raise InputError("request", "q", f"{len(q)} values", f"{n}, one per joint")
        finite("q", q)
    finite("wrench", wrench)
    if pose is None:
        if q is None:
            raise InputError("request", "q", "nothing", "joint angles, for they are to be the target")
        task = places(q=q[None], wrench=wrench[None])
    else:
        origin, quaternion = pose
        finite("target.position", origin)
        task = places(pose=np.hstack([origin, _rpy(quaternion)])[None], wrench=wrench[None])
        task = dataclasses.replace(task, q=None if q is None else q[None])
    return _warm(dataclasses.replace(task, source="request", labels=("q",)), request)


def trajectory_task(request: Request, q: Float2D, times: Float1D, wrench: Float2D, rate: Float2D | None = None) -> Task:
    """Return the task of a trajectory: one path in order of travel.

    Args:
        request: What is said besides.
        q: (m, n) rad (m where a joint slides), nominal angles.
        times: (m,) s from the start.
        wrench: (m, 6) N and N*m at the wrench point: one per point; (1, 6) for all; (0, 6) for none.
        rate: (m, n) rad/s (m/s where a joint slides), nominal joint rates; None: none.

    Raises:
        InputError: There is no point, or more than 20,000; a number is not finite; the times do not increase; or there
            are not as many wrenches as points.
    """
    m = len(q)
    if not 0 < m <= MOST:
        raise InputError("request", "trajectory.points", f"{m} points", f"1 to {MOST}")
    finite("trajectory.points", q)
    place = 0 if times[0] < 0 else first_not_later(times)
    if place is not None:
        expected = "times that increase from point to point"
        raise InputError("request", f"trajectory.points[{place}].time_from_start", f"{times[place]:g} s", expected)
    if len(wrench) not in {0, 1, m}:
        raise InputError("request", "wrenches", f"{len(wrench)} wrenches", f"{m}, one per point, or one for all")
    finite("wrenches", wrench)
    if rate is not None:
        finite("trajectory.points", rate)
    loads = np.zeros((m, 6)) if not len(wrench) else np.broadcast_to(wrench, (m, 6))
    labels = tuple(f"trajectory.points[{k}]" for k in range(m))
    task = places(q=q, wrench=loads, one_path=True)
    return _warm(dataclasses.replace(task, time=times, rate=rate, source="request", labels=labels), request)


def ordered(joints: tuple[str, ...], names: Sequence[str], place: str) -> list[int]:
    """Return where each joint of the robot stands among names that a request gives.

    Raises:
        InputError: A joint is missing, comes twice, or is none of the robot's.
    """
    if sorted(names) != sorted(joints):
        raise InputError("request", place, quoted(", ".join(names)), f"each of {', '.join(joints)} once")
    return [list(names).index(joint) for joint in joints]


def corrected_rates(nominal: Float2D, corrected: Float2D, times: Float1D, rates: Float2D) -> Float2D:
    """Return the joint rates (m, n) of a corrected trajectory: the nominal ones, and how the correction changes.

    Where the nominal robot stands, the corrected one stands.

    Args:
        nominal: (m, n) rad.
        corrected: (m, n) rad.
        times: (m,) s, increasing.
        rates: (m, n) rad/s, of the nominal trajectory.
    """
    if len(times) < 2:
        return rates
    change = np.gradient(corrected - nominal, times, axis=0)
    moving = np.any(rates != 0.0, axis=1)
    return rates + np.where(moving[:, None], change, 0.0)


def quaternions(axes: Float3D) -> Float2D:
    """Return the unit quaternions (m, 4), x, y, z, w, of axes (3, 3, m): axis of the tool, base axis, row."""
    return np.asarray(Rotation.from_matrix(np.transpose(axes, (2, 1, 0))).as_quat())


def finite(place: str, values: Float1D | Float2D) -> None:
    """Refuse numbers that a robot has no use for.

    Raises:
        InputError: One is not finite, or beyond 1e6; it is named as part of `place`.
    """
    wrong = ~(np.abs(values) <= LARGEST)
    if wrong.any():
        raise InputError("request", place, f"{values[wrong][0]:g}", f"finite numbers of at most {LARGEST:g}")


def _rpy(quaternion: Float1D) -> Float1D:
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1.0) <= UNIT:
        raise InputError("request", "target.orientation", f"a quaternion of length {length:g}", "one of length 1")
    return rpy_of_axes(Rotation.from_quat(quaternion).as_matrix().T[:, :, None])[0]


def _warm(task: Task, request: Request) -> Task:
    if request.temperature is None:
        return task
    return dataclasses.replace(task, temperature=np.full(len(task), request.temperature))
